"""The as-affine-as-possible energy of a surface that is carried onto another one, on a weighted graph.

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
from scipy.spatial import cKDTree

from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import normalized
from cagemap.maps.elastic.constants import FLAT, JOINING_ROUNDS, LEAST_STRETCH, LEAST_WEIGHT, NORMAL_SPREAD, TINY
from cagemap.maps.elastic.system import BlockSystem
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums
from cagemap.numerics.factorization import Factorization
from cagemap.numerics.graphs import components
from cagemap.operators.laplacian import stiffness, vertex_areas


@dataclass(frozen=True, eq=False)
class ElasticGraph:
    """Rest shape of the energy.

    Attributes
    ----------
    positions, normals : (n, 3) float64
        Rest positions at unit surface area, unit normals.
    areas : (n,) float64
        Shares of the surface's area, sum 1.
    heads, tails : (2 m,) int64
        Every edge in both directions.
    weights : (2 m,) float64, positive
    """

    positions: FloatArray
    normals: FloatArray
    areas: FloatArray
    heads: IndexArray
    tails: IndexArray
    weights: FloatArray

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.positions)

    @property
    def edges(self) -> FloatArray:
        """(2 m, 3) rest differences p_head - p_tail."""
        return np.asarray(self.positions[self.heads] - self.positions[self.tails])

    def laplacian(self) -> sparse.csr_array:
        """(n, n) weighted graph Laplacian, positive semi-definite."""
        weights = sparse.csr_array((self.weights, (self.heads, self.tails)), shape=(self.n, self.n))
        return sparse.csr_array(sparse.diags_array(np.asarray(weights.sum(axis=1)).ravel()) - weights)

    def energies(self, positions: FloatArray, maps: FloatArray, epsilon: float) -> FloatArray:
        """(n,) shares of E(x, A): of every edge a half at each end."""
        means = 0.5 * (maps[self.heads] + maps[self.tails])
        residual = positions[self.heads] - positions[self.tails] - np.einsum("eab,eb->ea", means, self.edges)
        change = ((maps[self.heads] - maps[self.tails]) ** 2).sum(axis=(1, 2))
        of_edges = 0.5 * self.weights * ((residual**2).sum(axis=1) + epsilon * change)
        return np.asarray(np.bincount(self.heads, of_edges, self.n), dtype=np.float64)

    def moments(self) -> sparse.csr_array:
        """(3 n, n) matrix B: row 3 i + b of B x holds ``sum_j w_ij e_ij,b (x_i - x_j)``."""
        weighted = (self.weights[:, None] * self.edges).ravel()
        rows = (3 * self.heads[:, None] + np.arange(3)).ravel()
        at_heads, at_tails = np.repeat(self.heads, 3), np.repeat(self.tails, 3)
        return sparse.csr_array(
            (np.concatenate([weighted, -weighted]), (np.tile(rows, 2), np.concatenate([at_heads, at_tails]))),
            shape=(3 * self.n, self.n),
        )


def mesh_graph(mesh: TriangleSurface, faces: IndexArray) -> ElasticGraph:
    """Graph of a mesh: its edges with cotangent weights.

    Parameters
    ----------
    mesh : TriangleSurface
    faces : (m, 4) or (m, 3) int64
        What was split into the mesh's triangles; quads count as the mean of both triangulations.
    """
    upper = sparse.triu(stiffness(mesh.positions, faces), 1).tocoo()
    weights = np.maximum(-upper.data, LEAST_WEIGHT * np.median(np.abs(upper.data)))
    heads, tails = np.concatenate([upper.row, upper.col]), np.concatenate([upper.col, upper.row])
    areas = vertex_areas(mesh.positions, faces)
    return ElasticGraph(
        mesh.positions,
        mesh.vertex_normals,
        areas / areas.sum(),
        heads.astype(np.int64),
        tails.astype(np.int64),
        np.tile(weights, 2),
    )


def cluster_graph(fine: ElasticGraph, count: int, kept: IndexArray) -> tuple[ElasticGraph, IndexArray]:
    """Coarser graph on some of a graph's vertices.

    Vertices are gathered in the cells of a grid in position and normal, so that the two sides of a thin part stay
    apart; a cell's most central vertex stands for it. An edge between two cells takes the sum of the fine edges'
    weights, scaled by squared lengths so that a linear function keeps its energy.

    Parameters
    ----------
    fine : ElasticGraph
    count : int
        About how many vertices to keep.
    kept : (p,) int64
        Vertices that get a cell of their own (landmarks).

    Returns
    -------
    graph : ElasticGraph
    vertices : (k,) int64
        Fine vertex of every coarse one; the kept ones come first, in their order.
    """
    cell = _cells(fine, count)
    cell[kept] = -1 - np.arange(len(kept))[::-1]  # smallest numbers, so that np.unique puts them first, in order
    _, cell = np.unique(cell, return_inverse=True)
    k = int(cell.max()) + 1
    areas = np.bincount(cell, fine.areas, minlength=k)
    centres = grouped_sums(cell, fine.areas[:, None] * fine.positions, k) / areas[:, None]
    normals = normalized(grouped_sums(cell, fine.areas[:, None] * fine.normals, k))
    distance = np.linalg.norm(fine.positions - centres[cell], axis=1)
    order = np.lexsort((distance, cell))
    vertices = order[np.searchsorted(cell[order], np.arange(k))]
    across = cell[fine.heads] != cell[fine.tails]
    lengths = np.linalg.norm(fine.edges, axis=1)[across]
    heads, tails = cell[fine.heads[across]], cell[fine.tails[across]]
    summed = sparse.coo_array((fine.weights[across] * lengths**2, (heads, tails)), shape=(k, k)).tocsr().tocoo()
    coarse_lengths = np.linalg.norm(fine.positions[vertices[summed.row]] - fine.positions[vertices[summed.col]], axis=1)
    weights = summed.data / np.maximum(coarse_lengths, 1e-9) ** 2
    # A cell's fine edges cover a strip as wide as a fine edge, not the cell: give the coordinates their energy back.
    scale = 2.0 * fine.areas.sum() / max(float((weights * coarse_lengths**2).sum() / 2), 1e-30)
    graph = ElasticGraph(
        fine.positions[vertices],
        normals,
        areas.astype(np.float64),
        np.asarray(summed.row, dtype=np.int64),
        np.asarray(summed.col, dtype=np.int64),
        scale * weights,
    )
    return graph, vertices.astype(np.int64)


@dataclass(frozen=True, eq=False)
class DifferentialField:
    """Solver for the maps A that minimise the energy for given positions.

    The normal equations ``(G_i + epsilon L) a = c``, ``G_i = sum_j w_ij e_ij e_ij^T``, are those of the energy with A_i
    instead of A_ij in its first term; they decouple into the three rows of A, with one matrix for all.

    Attributes
    ----------
    system : BlockSystem
        Of L: positions need matrices of the same pattern.
    factors : Factorization
        Of ``G + epsilon L``.
    moments : (3 n, n) csr_array
        The graph's own, B of ``c = B x``.
    """

    system: BlockSystem
    factors: Factorization
    moments: sparse.csr_array

    @classmethod
    def build(cls, graph: ElasticGraph, laplacian: sparse.csr_array, epsilon: float) -> DifferentialField:
        """Factor the (3 n, 3 n) matrix once for all iterations."""
        edges = graph.edges
        outer = graph.weights[:, None, None] * edges[:, :, None] * edges[:, None, :]
        blocks = grouped_sums(graph.heads, outer.reshape(-1, 9), graph.n).reshape(-1, 3, 3)
        # A flat ring leaves its normal direction open: lean on the neighbours, and a trace of ridge for safety.
        blocks += 1e-9 * float(np.einsum("naa->n", blocks).mean()) * np.eye(3)
        system = BlockSystem.build(laplacian)
        return cls(system, system.factor(epsilon, blocks), graph.moments())

    def solve(self, positions: FloatArray) -> FloatArray:
        """(n, 3, 3) maps A for positions x."""
        transposed = self.factors.solve(self.moments @ positions)  # rows (i, b), columns a: A_i[a, b]
        return np.ascontiguousarray(transposed.reshape(-1, 3, 3).transpose(0, 2, 1))

    def divergence(self, maps: FloatArray) -> FloatArray:
        """(n, 3) right side of the position solve: ``sum_j w_ij A_ij e_ij``."""
        return divergence(self.moments, maps)


def divergence(moments: sparse.csr_array, maps: FloatArray) -> FloatArray:
    """(n, 3) ``B^T A / 2`` of a graph's moments B and maps A (n, 3, 3): ``sum_j w_ij A_ij e_ij``."""
    return np.asarray(0.5 * (moments.T @ maps.transpose(0, 2, 1).reshape(-1, 3)))


def bounded_maps(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Linear maps without those that flatten a surface or turn it over.

    The energy alone lets a differential pass through zero and come out mirrored: limbs that have to shrink fold like an
    accordion. A map whose two stretches in the tangent plane have a ratio below `FLAT`, or whose determinant is not
    positive, gets its singular values s_1 >= s_2 >= +-s_3 bounded from below by ``LEAST_STRETCH * s_1``; the last of
    them has the determinant's sign before. All others stay as they are: a part that is thin on the other shape, flat
    along its normal, is no fold.

    Parameters
    ----------
    maps : (n, 3, 3) float64
    normals : (n, 3) float64
        Unit normals of the rest shape.

    Returns
    -------
    maps : (n, 3, 3) float64
    bounded : (b,) int64
        Which of them have changed.
    """
    across, turned = np.einsum("nab,nb->na", maps, normals), transformed_normals(maps, normals)
    # With stretches s and t in the tangent plane: s t, and s^2 + t^2.
    product = np.linalg.norm(turned, axis=1)
    squares = np.einsum("nab,nab->n", maps, maps) - np.einsum("na,na->n", across, across)
    determinant = np.einsum("na,na->n", turned, across)
    bounded = np.flatnonzero((determinant <= 0) | (product < FLAT / (1.0 + FLAT**2) * squares))
    if not len(bounded):
        return maps, bounded
    left, stretches, right = np.linalg.svd(maps[bounded])
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= sign[:, None]
    stretches[:, 2] *= sign
    stretches = np.maximum(stretches, LEAST_STRETCH * stretches[:, :1])
    changed = maps.copy()
    changed[bounded] = (left * stretches[:, None, :]) @ right
    return changed, bounded


def transformed_normals(maps: FloatArray, normals: FloatArray) -> FloatArray:
    """(n, 3) normals after linear maps (n, 3, 3), as long as areas are stretched: cofactor matrices times normals."""
    # Rows of the cofactor matrix are cross products of the map's rows.
    cofactors = np.stack([np.cross(maps[:, (k + 1) % 3], maps[:, (k + 2) % 3]) for k in range(3)], axis=1)
    return np.asarray(np.einsum("nab,nb->na", cofactors, normals))


def extrapolate(
    coarse: ElasticGraph, positions: FloatArray, maps: FloatArray, fine: ElasticGraph, neighbours: int = 6
) -> FloatArray:
    """(n, 3) positions of a finer graph's vertices: blended affine extrapolations of the nearest coarse vertices.

    ``y_v = sum_k b_k (x_k + A_k (p_v - p_k))`` with weights falling to zero at the last neighbour's distance, distances
    counting position and normal. Exact for affine deformations.
    """
    size = np.sqrt(1.0 / coarse.n)
    tree = cKDTree(np.hstack([coarse.positions, NORMAL_SPREAD * size * coarse.normals]))
    count = min(neighbours, coarse.n)
    queried = tree.query(np.hstack([fine.positions, NORMAL_SPREAD * size * fine.normals]), k=count)
    distance, nearest = (np.asarray(part).reshape(fine.n, count) for part in queried)
    blend = np.maximum(1.0 - (distance / (1.0001 * distance[:, -1:] + 1e-12)) ** 2, 1e-9) ** 2
    blend /= blend.sum(axis=1, keepdims=True)
    offsets = fine.positions[:, None] - coarse.positions[nearest]
    moved = positions[nearest] + np.einsum("vkab,vkb->vka", maps[nearest], offsets)
    return np.einsum("vk,vka->va", blend, moved)


def _cells(graph: ElasticGraph, count: int) -> IndexArray:
    """(n,) connected cell of a grid over position and normal, of a width that gives about ``count`` cells."""
    width = np.sqrt(1.0 / count)
    cell = np.zeros(graph.n, dtype=np.int64)
    for _ in range(8):
        features = np.hstack([graph.positions, 0.5 * NORMAL_SPREAD * width * graph.normals]) / width
        keys = np.floor(features - features.min(axis=0)).astype(np.int64)
        counts = keys.max(axis=0) + 1
        _, cell = np.unique(np.ravel_multi_index(tuple(keys.T), tuple(counts)), return_inverse=True)
        cell = connected_cells(graph, cell.ravel())
        found = int(cell.max()) + 1
        if 0.85 * count <= found <= 1.2 * count or (found == graph.n and count >= graph.n):
            break
        width *= np.sqrt(found / count)
    return cell


def connected_cells(graph: ElasticGraph, cell: IndexArray) -> IndexArray:
    """(n,) cells split into their connected pieces, tiny pieces joined to a neighbour.

    Parts of a body that touch, a hand on a thigh, share cells of a grid though nothing joins them: such a cell would
    hold them together, and shorten the ways between them. A piece with less than `TINY` of the mean area goes to the
    neighbour that it shares most edge weight with: what a cell's border cuts off would else be a stiff dot.

    Parameters
    ----------
    graph : ElasticGraph
    cell : (n,) int64
    """
    inside = cell[graph.heads] == cell[graph.tails]
    piece = components(graph.heads[inside], graph.tails[inside], graph.n)
    for _ in range(JOINING_ROUNDS):
        k = int(piece.max()) + 1
        areas = np.bincount(piece, graph.areas, minlength=k)
        across = (piece[graph.heads] != piece[graph.tails]) & (areas < TINY * areas.mean())[piece[graph.heads]]
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
        piece = components(small, joined, k)[piece]
    return piece
