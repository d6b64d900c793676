"""The as-affine-as-possible energy of a deformed surface, on a weighted graph.

Every vertex i has a position x_i and a linear map A_i (3 x 3). The energy

    E(x, A) = sum_ij w_ij |x_i - x_j - A_ij (p_i - p_j)|^2 + epsilon sum_ij w_ij |A_i - A_j|^2,  2 A_ij = A_i + A_j,

vanishes for every affine deformation of the rest positions p, and measures how far the deformation is from one that is
locally affine with a smoothly varying differential. Scale and anisotropy may thus change from limb to limb at little
cost, which a rigid or conformal energy does not allow. The graph is a mesh (cotangent weights) or a coarse clustering
of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cagemap.deform.config import GraphConfig
from cagemap.numerics.arrays import (
    FloatArray,
    IndexArray,
    grouped_sums,
    label_components,
    mask_of,
    places_of,
    read_only,
)
from cagemap.numerics.sparse_algebra import Factorization, factor
from cagemap.numerics.threads import kept
from cagemap.operators.laplacian import stiffness, vertex_areas
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows

STATIONS = 60  # number of vertices, far from each other, from which distances along a surface are measured
MIN_PIECE_AREA = 0.05  # connected pieces with less than this share of the mesh's area (eyes, teeth) have no stations
EPSILON = 1e-9  # least length and least weight, where vertices coincide


@dataclass(frozen=True, eq=False)
class ElasticGraph:
    """Weighted graph with the rest shape of the energy."""

    positions: FloatArray  # (n, 3) at rest, at unit surface area
    normals: FloatArray  # (n, 3) unit normals
    areas: FloatArray  # (n,) shares of the surface's area, sum 1
    heads: IndexArray  # (2 m,) every edge in both directions
    tails: IndexArray
    weights: FloatArray  # (2 m,) positive

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.positions)

    @property
    def edges(self) -> FloatArray:
        """(2 m, 3) rest differences p_head - p_tail."""
        return np.asarray(self.positions.take(self.heads, axis=0) - self.positions.take(self.tails, axis=0))

    @kept
    def lengths(self) -> FloatArray:
        """(2 m,) length of every edge."""
        return read_only(np.linalg.norm(self.edges, axis=1))

    @kept
    def laplacian(self) -> sparse.csr_array:
        """(n, n) weighted graph Laplacian, positive semi-definite."""
        weights = sparse.csr_array((self.weights, (self.heads, self.tails)), shape=(self.n, self.n))
        return sparse.csr_array(sparse.diags_array(np.asarray(weights.sum(axis=1)).ravel()) - weights)

    @kept
    def length_matrix(self) -> sparse.csr_array:
        """(n, n) sparse matrix of `lengths`."""
        return sparse.csr_array((self.lengths, (self.heads, self.tails)), shape=(self.n, self.n))

    def distances(self, vertices: IndexArray) -> FloatArray:
        """(k, n) distances along the edges from vertices (k,); infinite if unreached."""
        return np.asarray(dijkstra(self.length_matrix, indices=vertices))

    @kept
    def station_distances(self) -> FloatArray:
        """(s, n) distances along the edges from `STATIONS` distant vertices, none on a small piece."""
        piece = label_components(self.heads, self.tails, self.n)
        sizes = np.bincount(piece, self.areas)
        rows, nearest = [], np.where(sizes >= min(MIN_PIECE_AREA, sizes.max()), np.inf, -1.0)[piece]
        for _ in range(min(STATIONS, self.n)):
            rows.append(self.distances(np.array([nearest.argmax()]))[0])
            nearest = np.minimum(nearest, rows[-1])
        return read_only(np.array(rows))

    def energies(self, positions: FloatArray, maps: FloatArray, epsilon: float) -> FloatArray:
        """(n,) E(x, A) by vertex: half of every edge's energy at each end."""
        means = 0.5 * (maps[self.heads] + maps[self.tails])
        residual = positions[self.heads] - positions[self.tails] - np.einsum("eab,eb->ea", means, self.edges)
        change = ((maps[self.heads] - maps[self.tails]) ** 2).sum(axis=(1, 2))
        of_edges = 0.5 * self.weights * ((residual**2).sum(axis=1) + epsilon * change)
        return np.asarray(np.bincount(self.heads, of_edges, self.n), dtype=np.float64)

    @kept
    def _known_cells(self) -> dict[tuple[int, GraphConfig], IndexArray]:
        return {}

    def cells(self, count: int, config: GraphConfig) -> IndexArray:
        """(n,) connected grid cell of every vertex in position and normal, about ``count`` cells; cached."""
        if (count, config) not in self._known_cells:
            self._known_cells[count, config] = read_only(_cells(self, count, config))
        return self._known_cells[count, config]

    @kept
    def moments(self) -> sparse.csr_array:
        """(3 n, n) matrix B: row 3 i + b of B x holds ``sum_j w_ij e_ij,b (x_i - x_j)``."""
        weighted = (self.weights[:, None] * self.edges).ravel()
        rows = (3 * self.heads[:, None] + np.arange(3)).ravel()
        at_heads, at_tails = np.repeat(self.heads, 3), np.repeat(self.tails, 3)
        return sparse.csr_array(
            (np.concatenate([weighted, -weighted]), (np.tile(rows, 2), np.concatenate([at_heads, at_tails]))),
            shape=(3 * self.n, self.n),
        )

    def divergence(self, maps: FloatArray) -> FloatArray:
        """(n, 3) ``B^T A / 2`` of the moments B and maps A (n, 3, 3): ``sum_j w_ij A_ij e_ij``."""
        return np.asarray(0.5 * (self.moments.T @ maps.transpose(0, 2, 1).reshape(-1, 3)))

    @kept
    def _block_pattern(self) -> tuple[sparse.csc_array, IndexArray]:
        """L for three coordinates with zeros at all entries of (3, 3) diagonal blocks, and where these are stored."""
        n = self.n
        ones = sparse.bsr_array((np.ones((n, 3, 3)), np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
        # One complex matrix L + i blocks has the entries of both: a sum of real ones would drop zeros.
        both = sparse.csc_array(sparse.kron(self.laplacian, sparse.eye_array(3)) + 1j * ones)
        both.sort_indices()
        by_column = np.flatnonzero(both.data.imag).reshape(n, 3, 3)
        padded = sparse.csc_array((both.data.real.copy(), both.indices, both.indptr), shape=both.shape)
        return padded, by_column.transpose(0, 2, 1).ravel()

    def block_matrix(self, alpha: float, blocks: FloatArray) -> sparse.csc_array:
        """(3 n, 3 n) matrix alpha L + block diagonal (n, 3, 3); its pattern is the same for all alpha and blocks."""
        elastic, places = self._block_pattern
        values = alpha * elastic.data
        values[places] += blocks.ravel()
        return sparse.csc_array((values, elastic.indices, elastic.indptr), shape=elastic.shape)

    def smoother(self, length: float, masses: FloatArray | None = None) -> Factorization:
        """Factors of ``M + length^2 L``: screened Poisson smoothing over a length, masses M (n,), default areas."""
        masses = self.areas if masses is None else masses
        return factor(sparse.csc_array(sparse.diags_array(masses) + length**2 * self.laplacian))

    def part(self, vertices: IndexArray, stiffness: FloatArray) -> ElasticGraph:
        """Subgraph on vertices (k,), ascending, with edges stiffened by the mean stiffness (n,) of both ends."""
        number = places_of(vertices, self.n)
        edges = (number[self.heads] >= 0) & (number[self.tails] >= 0)
        heads, tails = self.heads[edges], self.tails[edges]
        weights = self.weights[edges] * np.sqrt(stiffness[heads] * stiffness[tails])
        rest = self.positions[vertices], self.normals[vertices], self.areas[vertices]
        return ElasticGraph(*rest, number[heads], number[tails], weights)

    def rings(self, vertices: IndexArray, count: int) -> IndexArray:
        """(k,) vertices and those up to ``count`` edges away, ascending."""
        inside = mask_of(vertices, self.n)
        for _ in range(count):
            inside[self.heads[inside[self.tails]]] = True
        return np.flatnonzero(inside)


def _cells(graph: ElasticGraph, count: int, config: GraphConfig) -> IndexArray:
    """(n,) connected grid cell in position and normal, for about ``count`` cells."""
    width = np.sqrt(1.0 / count)
    cell = np.zeros(graph.n, dtype=np.int64)
    least, most = config.cell_counts
    for _ in range(config.cell_rounds):
        features = np.hstack([graph.positions, 0.5 * width * graph.normals]) / width
        keys = np.floor(features - features.min(axis=0)).astype(np.int64)
        counts = keys.max(axis=0) + 1
        _, cell = np.unique(np.ravel_multi_index(tuple(keys.T), tuple(counts)), return_inverse=True)
        cell = connected_cells(graph, cell.ravel(), config)
        cell_count = int(cell.max()) + 1
        if least * count <= cell_count <= most * count or (cell_count == graph.n and count >= graph.n):
            break
        width *= np.sqrt(cell_count / count)
    return cell


def connected_cells(graph: ElasticGraph, cell: IndexArray, config: GraphConfig = GraphConfig()) -> IndexArray:
    """(n,) connected pieces of cells; tiny ones, which would be stiff, join the neighbour with the longest border."""
    inside = cell[graph.heads] == cell[graph.tails]
    piece = label_components(graph.heads[inside], graph.tails[inside], graph.n)
    for _ in range(config.joining_rounds):
        k = int(piece.max()) + 1
        areas = np.bincount(piece, graph.areas, minlength=k)
        across = (piece[graph.heads] != piece[graph.tails]) & (areas < config.min_cell * areas.mean())[
            piece[graph.heads]
        ]
        if not across.any():
            break
        heads, tails = graph.heads[across], graph.tails[across]
        # Edge weights times squared lengths count the area along the common border, normals the sides of a thin part.
        agree = 1.0 + np.einsum("ed,ed->e", graph.normals[heads], graph.normals[tails])
        border = graph.weights[across] * ((graph.positions[heads] - graph.positions[tails]) ** 2).sum(axis=1) * agree
        shared = sparse.coo_array((border, (piece[heads], piece[tails])), shape=(k, k)).tocsr().tocoo()
        order = np.lexsort((shared.data, shared.row))
        last = np.flatnonzero(np.diff(shared.row[order], append=k))
        small, joined = (shared.coords[side][order][last].astype(np.int64) for side in (0, 1))
        piece = label_components(small, joined, k)[piece]
    return piece


def mesh_graph(mesh: TriangleSurface, faces: IndexArray, config: GraphConfig = GraphConfig()) -> ElasticGraph:
    """Graph of a mesh's edges with cotangent weights."""
    upper = sparse.triu(stiffness(mesh.positions, faces), 1).tocoo()
    weights = np.maximum(-upper.data, config.min_weight * np.median(np.abs(upper.data)))
    heads, tails = (np.concatenate(ends).astype(np.int64) for ends in (upper.coords, upper.coords[::-1]))
    areas = vertex_areas(mesh.positions, faces)
    shares = areas / areas.sum()
    return ElasticGraph(mesh.positions, mesh.vertex_normals, shares, heads, tails, np.tile(weights, 2))


def cluster_graph(
    fine: ElasticGraph, count: int, required: IndexArray, config: GraphConfig = GraphConfig()
) -> tuple[ElasticGraph, IndexArray]:
    """Coarser graph on the most central vertices of grid cells in position and normal.

    Required vertices (q,) have cells of their own and come first. Returns the fine numbers of all its vertices too. An
    edge between two cells gets the sum of the fine edges' weights, scaled by squared lengths so that a linear function
    keeps its energy.
    """
    cell = fine.cells(min(count, fine.n), config).copy()
    # Smallest numbers, so that np.unique puts them first, in order.
    cell[required] = -1 - np.arange(len(required))[::-1]
    _, cell = np.unique(cell, return_inverse=True)
    k = int(cell.max()) + 1
    areas = np.bincount(cell, fine.areas, minlength=k)
    centres = grouped_sums(cell, fine.areas[:, None] * fine.positions, k) / areas[:, None]
    normals = normalize_rows(grouped_sums(cell, fine.areas[:, None] * fine.normals, k))
    distance = np.linalg.norm(fine.positions - centres[cell], axis=1)
    order = np.lexsort((distance, cell))
    vertices = order[np.searchsorted(cell[order], np.arange(k))]
    across = cell[fine.heads] != cell[fine.tails]
    lengths = fine.lengths[across]
    heads, tails = cell[fine.heads[across]], cell[fine.tails[across]]
    summed = sparse.coo_array((fine.weights[across] * lengths**2, (heads, tails)), shape=(k, k)).tocsr().tocoo()
    coarse_lengths = np.linalg.norm(fine.positions[vertices[summed.row]] - fine.positions[vertices[summed.col]], axis=1)
    weights = summed.data / np.maximum(coarse_lengths, EPSILON) ** 2
    # A cell's fine edges cover a strip as wide as a fine edge, not the cell: rescale, so that coordinates keep their
    # energy.
    scale = 2.0 * fine.areas.sum() / max(float((weights * coarse_lengths**2).sum() / 2), 1e-30)
    heads, tails = (side.astype(np.int64) for side in summed.coords)
    graph = ElasticGraph(fine.positions[vertices], normals, areas.astype(np.float64), heads, tails, scale * weights)
    return graph, vertices.astype(np.int64)


def extrapolate(
    coarse: ElasticGraph, positions: FloatArray, maps: FloatArray, fine: ElasticGraph, config: GraphConfig
) -> FloatArray:
    """(n, 3) positions of a finer graph's vertices: blended affine extrapolations from coarse vertices.

    ``y_v = sum_k b_k (x_k + A_k (p_v - p_k))``, weights falling to zero at the last neighbour. Exact for affine maps.
    """
    size = np.sqrt(1.0 / coarse.n)
    tree = cKDTree(np.hstack([coarse.positions, size * coarse.normals]))
    count = min(config.neighbours, coarse.n)
    queried = tree.query(np.hstack([fine.positions, size * fine.normals]), k=count)
    distance, nearest = (np.asarray(part).reshape(fine.n, count) for part in queried)
    # The radius is a little larger than the last distance: all neighbours may be equally far.
    blend = np.maximum(1.0 - (distance / (1.0001 * distance[:, -1:] + 1e-12)) ** 2, EPSILON) ** 2
    blend /= blend.sum(axis=1, keepdims=True)
    offsets = fine.positions[:, None] - coarse.positions[nearest]
    moved = positions[nearest] + np.einsum("vkab,vkb->vka", maps[nearest], offsets)
    return np.einsum("vk,vka->va", blend, moved)
