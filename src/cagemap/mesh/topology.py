"""Connectivity of a control mesh as arrays: edges, fans around vertices, boundary loops, components, orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import IndexArray, components


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """Edges of a mesh and how face corners refer to them.

    Corner c stands for the half-edge from its own vertex to that of the next corner of its face.
    """

    vertices: IndexArray  #: (e, 2) end points, the lower number first; sorted
    corner_edges: IndexArray  #: (c,) edge of every corner's half-edge
    #: (e,) number of faces at every edge: 2 inside, 1 on the boundary, more where the mesh is not manifold
    face_counts: IndexArray

    def boundary_corners(self) -> IndexArray:
        """Corners whose half-edge lies on the boundary."""
        return np.flatnonzero(self.face_counts[self.corner_edges] == 1)


def edge_table(mesh: ControlMesh) -> EdgeTable:
    """Find the edges of a mesh: corners that join the same two vertices share one."""
    tails = mesh.face_indices
    first, corner_edges, counts = numbered_edges(tails, tails[mesh.next_corners], mesh.n_vertices)
    vertices = np.sort(np.column_stack([tails[first], tails[mesh.next_corners[first]]]), axis=1)
    return EdgeTable(vertices, corner_edges, counts)


def numbered_edges(tails: IndexArray, heads: IndexArray, n_vertices: int) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Number the edges of half-edges (c,) between vertices, ascending by (smaller, larger) vertex.

    Returns the first half-edge of every edge (e,), the edge of every half-edge (c,), and how many each edge has (e,).
    """
    keys = np.minimum(tails, heads) * n_vertices + np.maximum(tails, heads)
    _, *numbers = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    first, edges, counts = (array.astype(np.int64) for array in numbers)
    return first, edges, counts


def adjacent_corners(edges: EdgeTable) -> tuple[IndexArray, IndexArray]:
    """Pair the half-edges that share an edge: two for an inner edge, a chain where more faces meet."""
    order = np.argsort(edges.corner_edges, kind="stable")
    same = np.diff(edges.corner_edges[order]) == 0
    return order[:-1][same], order[1:][same]


def corner_fans(mesh: ControlMesh, edges: EdgeTable) -> IndexArray:
    """(c,) fan of every corner: corners around one vertex are of one fan where inner edges join their faces.

    A vertex is manifold when all its corners are of one fan. Numbered from 0.
    """
    first, second = adjacent_corners(edges)
    following = mesh.next_corners
    parallel = mesh.face_indices[first] == mesh.face_indices[second]
    tail_mate = np.where(parallel, second, following[second])
    head_mate = np.where(parallel, following[second], second)
    rows = np.concatenate([first, following[first]])
    columns = np.concatenate([tail_mate, head_mate])
    return components(rows, columns, len(mesh.face_indices))


def boundary_loops(mesh: ControlMesh, edges: EdgeTable, fans: IndexArray) -> tuple[IndexArray, ...] | None:
    """Vertices along every boundary loop, in the direction of the faces' half-edges (surface on the left).

    None where the faces' orientations, or edges of more than two faces, leave the loops undefined. Loops follow the
    fans of `corner_fans`, and so a vertex is passed once for each of its fans.
    """
    if np.any(edges.face_counts > 2):
        return None
    corners = edges.boundary_corners()
    tails, heads = fans[corners], fans[mesh.next_corners[corners]]
    order = np.argsort(tails)
    place = np.minimum(np.searchsorted(tails[order], heads), max(len(order) - 1, 0))
    successors = order[place]
    if not np.array_equal(tails[successors], heads) or len(np.unique(successors)) != len(successors):
        return None
    loops = []
    seen = np.zeros(len(corners), dtype=bool)
    for start in range(len(corners)):  # boundary edges only, each visited once
        loop = []
        corner = start
        while not seen[corner]:
            seen[corner] = True
            loop.append(mesh.face_indices[corners[corner]])
            corner = successors[corner]
        if loop:
            loops.append(np.array(loop, dtype=np.int64))
    return tuple(loops)


def handle_count(mesh: ControlMesh, labels: IndexArray | None = None) -> int:
    """Genus g of a mesh, or of what is left after a cut between faces of different labels (m,).

    For c manifold pieces with b boundary loops in all: V - E + F = 2 c - 2 g - b.
    """
    edges = edge_table(mesh)
    if labels is not None:
        sides = edges.corner_edges * (int(labels.max(initial=0)) + 1) + labels[mesh.corner_faces]
        _, first, cut, counts = np.unique(sides, return_index=True, return_inverse=True, return_counts=True)
        edges = EdgeTable(edges.vertices[edges.corner_edges[first]], cut, counts)
    fans, (first, second) = corner_fans(mesh, edges), adjacent_corners(edges)
    loops = boundary_loops(mesh, edges, fans) if len(edges.boundary_corners()) else ()
    euler = int(fans.max(initial=-1)) + 1 - len(edges.vertices) + mesh.n_faces
    joined = components(mesh.corner_faces[first], mesh.corner_faces[second], mesh.n_faces)
    pieces = int(joined.max(initial=-1)) + 1
    return (2 * pieces - euler - len(loops or ())) // 2


def cells(mesh: ControlMesh, size: float, offset: float) -> IndexArray:
    """(m,) labels of faces by the nearest of vertices that lie about so far apart, along edges.

    The vertices are the first ones in the cubes of a lattice, moved by a share of their side.
    """
    cubes = np.floor(mesh.positions / size + offset)
    seeds = np.unique(cubes, axis=0, return_index=True)[1]
    heads, tails = edge_table(mesh).vertices.T
    lengths = np.linalg.norm(mesh.positions[heads] - mesh.positions[tails], axis=1)
    ways = sparse.csr_array((lengths, (heads, tails)), shape=(mesh.n_vertices, mesh.n_vertices))
    nearest = dijkstra(ways, directed=False, indices=seeds, return_predecessors=True, min_only=True)[2]
    return np.asarray(nearest[mesh.face_indices[mesh.face_offsets[:-1]]], dtype=np.int64)


def used_vertices(mesh: ControlMesh) -> NDArray[np.bool_]:
    """(n,) whether a vertex belongs to a face."""
    used = np.zeros(mesh.n_vertices, dtype=bool)
    used[mesh.face_indices] = True
    return used


def face_pieces(mesh: ControlMesh, nodes: IndexArray, count: int) -> IndexArray:
    """(m,) label of the piece of every face; faces are of one piece where corners have the same node (c,)."""
    return components(nodes, nodes[mesh.next_corners], count)[nodes[mesh.face_offsets[:-1]]]


def face_components(mesh: ControlMesh) -> IndexArray:
    """(m,) connected component of every face; faces that share a vertex are of one component."""
    return _renumber(face_pieces(mesh, mesh.face_indices, mesh.n_vertices))


def uv_islands(mesh: ControlMesh) -> IndexArray | None:
    """(m,) UV island of every face: faces that share a texture vertex are of one island. None without UVs."""
    if mesh.uvs is None or mesh.uv_indices is None:
        return None
    return _renumber(face_pieces(mesh, mesh.uv_indices, len(mesh.uvs)))


def turned_faces(mesh: ControlMesh, edges: EdgeTable) -> NDArray[np.bool_] | None:
    """(m,) faces to turn so that neighbours agree, the smaller set of each piece; None for one-sided surfaces.

    Two faces agree where they run along their edge in opposite ways. Every face appears twice in a graph, as it is and
    turned round; edges join the copies that agree. Where the two copies of a face are connected, the surface is
    one-sided.
    """
    first, second = adjacent_corners(edges)
    manifold = edges.face_counts[edges.corner_edges[first]] == 2
    first, second = first[manifold], second[manifold]
    corner_faces = mesh.corner_faces
    agree = mesh.face_indices[first] != mesh.face_indices[second]
    f, g = corner_faces[first], corner_faces[second]
    m = mesh.n_faces
    other = np.where(agree, 0, m)
    labels = components(np.concatenate([f, f + m]), np.concatenate([g + other, g + m - other]), 2 * m)
    upright, turned = labels[:m], labels[m:]
    if np.any(upright == turned):
        return None
    counts = np.bincount(upright, minlength=int(labels.max(initial=-1)) + 1)
    # The larger set stays; of two equal ones that of the lowest face, whose label is the lower one.
    smaller, equal = counts[upright] < counts[turned], counts[upright] == counts[turned]
    return np.asarray(smaller | (equal & (upright > turned)))


def _renumber(labels: IndexArray) -> IndexArray:
    """Number labels from 0 in the order of their first appearance."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]
