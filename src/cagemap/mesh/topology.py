"""Connectivity of a mesh as arrays: edges, fans around vertices, boundary loops, components, orientation.

A corner is a vertex of a face; corner ``c`` also stands for the half-edge to the next corner of its face. Arrays of a
`Topology` are int32, as are the indices of the matrices made from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import IndexArray, label_components, mask_of, places_of
from cagemap.numerics.threads import kept

IntArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Topology:
    """Faces, edges and vertices by corner (c,), of a mesh or of its UV layout.

    Corners of a face are consecutive. ``edges`` is the edge from a corner to the ``following`` one of its face;
    ``forward`` is True where the half-edge has that edge's direction, as one of the two of an inner edge has.
    """

    n_vertices: int
    n_edges: int
    n_faces: int
    vertices: IntArray
    edges: IntArray
    forward: BoolArray
    faces: IntArray
    following: IntArray
    previous: IntArray

    @property
    def n_corners(self) -> int:
        """Number of corners."""
        return len(self.vertices)

    @kept
    def face_counts(self) -> IndexArray:
        """(e,) number of faces at every edge: 2 inside, 1 on the boundary, more if non-manifold."""
        return np.bincount(self.edges, minlength=self.n_edges).astype(np.int64)

    @kept
    def edge_corners(self) -> IntArray:
        """(e, 2) forward and backward corner of every edge; -1 if missing, as on the boundary."""
        corners = np.full((self.n_edges, 2), -1, dtype=np.int32)
        corners[self.edges, (~self.forward).astype(np.int64)] = np.arange(self.n_corners, dtype=np.int32)
        return corners

    @property
    def edge_ends(self) -> IndexArray:
        """(e, 2) vertices at the start and the end of every edge."""
        forward = self.edge_corners[:, 0]
        return np.column_stack([self.vertices[forward], self.vertices[self.following[forward]]]).astype(np.int64)

    @property
    def edge_vertices(self) -> IndexArray:
        """(e, 2) vertices of every edge of a control mesh, the lower number first; sorted."""
        return np.sort(self.edge_ends, axis=1)

    @kept
    def outer_edges(self) -> BoolArray:
        """(e,) whether an edge is on the boundary."""
        return np.asarray(self.face_counts == 1)

    @kept
    def boundary_corners(self) -> IndexArray:
        """(b,) the corner of every boundary edge."""
        return np.flatnonzero(self.outer_edges[self.edges])

    @kept
    def boundary(self) -> BoolArray:
        """(n,) whether a vertex is on the boundary."""
        curve = self.boundary_corners
        return mask_of(self.vertices[np.concatenate([curve, self.following[curve]])], self.n_vertices)

    @kept
    def valences(self) -> IntArray:
        """(n,) number of faces around every vertex."""
        return np.bincount(self.vertices, minlength=self.n_vertices).astype(np.int32)

    @kept
    def ranks(self) -> IntArray:
        """(c,) index of a corner around its vertex, from the boundary if any; -1 in all but one of several fans."""
        ranks = np.full(self.n_corners, -1, dtype=np.int32)
        twin = self.edge_corners[self.edges, self.forward.astype(np.int64)]
        numbers = np.arange(self.n_corners, dtype=np.int32)
        start = np.full(self.n_vertices, -1, dtype=np.int32)  # -1: unused, as a UV of no face
        start[self.vertices[::-1]] = numbers[::-1]
        unpaired = twin < 0
        start[self.vertices[unpaired]] = numbers[unpaired]
        corners, rank = np.unique(start[start >= 0]), 0
        while len(corners):  # around all vertices at once
            ranks[corners] = rank
            corners = twin[self.previous[corners]]
            corners = corners[corners >= 0]
            corners = corners[ranks[corners] < 0]
            rank += 1
        return ranks


def mesh_topology(mesh: ControlMesh) -> Topology:
    """Topology of a mesh, which need not be manifold."""
    return layout_topology(mesh, mesh.face_indices, mesh.n_vertices)


def layout_topology(mesh: ControlMesh, indices: IndexArray, n_vertices: int) -> Topology:
    """Topology of the control mesh's faces on the vertex numbers ``indices`` (c,), such as those of UVs.

    Edges ascend by their vertices and have their first corner's direction.
    """
    following = mesh.next_corners
    previous = places_of(following, len(following))
    tails = indices.astype(np.int64)
    heads = tails[following]
    keys = np.minimum(tails, heads) * n_vertices + np.maximum(tails, heads)
    _, first, edges = np.unique(keys, return_index=True, return_inverse=True)
    return Topology(
        n_vertices=n_vertices,
        n_edges=len(first),
        n_faces=mesh.n_faces,
        vertices=tails.astype(np.int32),
        edges=edges.astype(np.int32),
        forward=tails == tails[first][edges],
        faces=mesh.corner_faces.astype(np.int32),
        following=following.astype(np.int32),
        previous=previous.astype(np.int32),
    )


def adjacent_corners(topology: Topology) -> tuple[IndexArray, IndexArray]:
    """Pairs of half-edges of the same edge: one pair, or a chain at edges of more faces."""
    order = np.argsort(topology.edges, kind="stable")
    adjacent = np.diff(topology.edges[order]) == 0
    return order[:-1][adjacent], order[1:][adjacent]


def corner_fans(topology: Topology) -> IndexArray:
    """(c,) fan of every corner: corners of one vertex joined by inner edges. A manifold vertex has one fan."""
    first, second = adjacent_corners(topology)
    following = topology.following
    parallel = topology.vertices[first] == topology.vertices[second]
    tail_mate = np.where(parallel, second, following[second])
    head_mate = np.where(parallel, following[second], second)
    rows = np.concatenate([first, following[first]])
    columns = np.concatenate([tail_mate, head_mate])
    return label_components(rows, columns, topology.n_corners)


def boundary_loops(topology: Topology, fans: IndexArray) -> tuple[IndexArray, ...] | None:
    """Vertices along boundary loops of the fans, surface on the left; None where orientations leave them undefined."""
    if np.any(topology.face_counts > 2):
        return None
    corners = topology.boundary_corners
    tails, heads = fans[corners], fans[topology.following[corners]]
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
            loop.append(topology.vertices[corners[corner]])
            corner = successors[corner]
        if loop:
            loops.append(np.array(loop, dtype=np.int64))
    return tuple(loops)


def handle_count(mesh: ControlMesh, labels: IndexArray | None = None) -> int:
    """Genus g, also if cut between labels (m,) of faces: V - E + F = 2 c - 2 g - b of c pieces with b loops."""
    topology = mesh_topology(mesh)
    if labels is not None:
        sides = topology.edges.astype(np.int64) * (int(labels.max(initial=0)) + 1) + labels[topology.faces]
        known, cut = np.unique(sides, return_inverse=True)
        topology = replace(topology, n_edges=len(known), edges=cut.astype(np.int32))
    fans, (first, second) = corner_fans(topology), adjacent_corners(topology)
    loops = boundary_loops(topology, fans) if len(topology.boundary_corners) else ()
    euler = int(fans.max(initial=-1)) + 1 - topology.n_edges + mesh.n_faces
    joined = label_components(topology.faces[first], topology.faces[second], mesh.n_faces)
    pieces = int(joined.max(initial=-1)) + 1
    return (2 * pieces - euler - len(loops or ())) // 2


def label_cells(mesh: ControlMesh, size: float, offset: float) -> IndexArray:
    """(m,) labels of faces by the nearest seed along edges: the first vertices in grid cubes, shifted by ``offset``."""
    cubes = np.floor(mesh.positions / size + offset)
    seeds = np.unique(cubes, axis=0, return_index=True)[1]
    heads, tails = mesh_topology(mesh).edge_vertices.T
    lengths = np.linalg.norm(mesh.positions[heads] - mesh.positions[tails], axis=1)
    graph = sparse.csr_array((lengths, (heads, tails)), shape=(mesh.n_vertices, mesh.n_vertices))
    nearest = dijkstra(graph, directed=False, indices=seeds, return_predecessors=True, min_only=True)[2]
    return np.asarray(nearest[mesh.face_indices[mesh.face_offsets[:-1]]], dtype=np.int64)


def used_vertices(mesh: ControlMesh) -> NDArray[np.bool_]:
    """(n,) whether a vertex belongs to a face."""
    return mask_of(mesh.face_indices, mesh.n_vertices)


def face_pieces(mesh: ControlMesh, nodes: IndexArray, count: int) -> IndexArray:
    """(m,) piece of every face; faces with a corner of the same node (c,) are of one piece."""
    return label_components(nodes, nodes[mesh.next_corners], count)[nodes[mesh.face_offsets[:-1]]]


def face_components(mesh: ControlMesh) -> IndexArray:
    """(m,) connected component of every face; faces that share a vertex are of one component."""
    return _renumber(face_pieces(mesh, mesh.face_indices, mesh.n_vertices))


def vertex_pieces(mesh: ControlMesh) -> IndexArray:
    """(n,) connected component of every vertex, by the edges of faces; a vertex of no face is one of its own."""
    return label_components(mesh.face_indices, mesh.face_indices[mesh.next_corners], mesh.n_vertices)


def uv_islands(mesh: ControlMesh) -> IndexArray | None:
    """(m,) UV island of every face, connected by shared texture vertices; None without UVs."""
    if mesh.uvs is None or mesh.uv_indices is None:
        return None
    return _renumber(face_pieces(mesh, mesh.uv_indices, len(mesh.uvs)))


def turned_faces(topology: Topology) -> NDArray[np.bool_] | None:
    """(m,) faces to reverse so that neighbours agree, the smaller set of each piece; None if one-sided.

    Two faces agree if they pass their edge in opposite directions. Every face is two nodes of a graph, as it is and
    reversed; edges join the nodes that agree. If both nodes of a face are connected, the surface is one-sided.
    """
    first, second = adjacent_corners(topology)
    manifold = topology.face_counts[topology.edges[first]] == 2
    first, second = first[manifold], second[manifold]
    agree = topology.vertices[first] != topology.vertices[second]
    f, g, m = topology.faces[first], topology.faces[second], topology.n_faces
    shift = np.where(agree, 0, m)
    labels = label_components(np.concatenate([f, f + m]), np.concatenate([g + shift, g + m - shift]), 2 * m)
    upright, turned = labels[:m], labels[m:]
    if np.any(upright == turned):
        return None
    counts = np.bincount(upright, minlength=int(labels.max(initial=-1)) + 1)
    # The larger set stays; of two equally large ones, the set of the lowest face, which has the lower label.
    smaller, equal = counts[upright] < counts[turned], counts[upright] == counts[turned]
    return np.asarray(smaller | (equal & (upright > turned)))


def _renumber(labels: IndexArray) -> IndexArray:
    """Number labels from 0 in the order of their first appearance."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return places_of(np.argsort(first), len(first))[inverse]
