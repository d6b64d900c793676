"""Connectivity of a mesh as arrays: edges, fans around vertices, boundary loops, components, orientation.

A corner is one face's use of one vertex; corner ``c`` also stands for the edge that leaves it towards the next corner
of its face. Arrays of a `Topology` are int32, as the indices of the matrices made from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import IndexArray, label_components
from cagemap.numerics.threads import kept

IntArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Topology:
    """Faces, edges and vertices by corner (c,), of a mesh or of its UV layout.

    Corners of a face are consecutive. ``edges`` is the edge from a corner to the ``following`` one of its face;
    ``forward`` tells whether the corner runs in that edge's direction, as one of an inner edge's two corners does.
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

    @property
    def has_quads_only(self) -> bool:
        """Whether every face has four corners."""
        return self.n_corners == 4 * self.n_faces and bool(np.all(self.faces[::4] == np.arange(self.n_faces)))

    @kept
    def face_counts(self) -> IndexArray:
        """(e,) number of faces at every edge: 2 inside, 1 on the boundary, more where the mesh is not manifold."""
        return np.bincount(self.edges, minlength=self.n_edges).astype(np.int64)

    @kept
    def edge_corners(self) -> IntArray:
        """(e, 2) forward and backward corner of every edge, -1 where there is none, as on the boundary."""
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
        """(e,) which edges lie on the boundary."""
        return np.asarray(self.face_counts == 1)

    @kept
    def boundary_corners(self) -> IndexArray:
        """(b,) the corner of every boundary edge: it runs from one boundary vertex to the next."""
        return np.flatnonzero(self.outer_edges[self.edges])

    @kept
    def boundary(self) -> BoolArray:
        """(n,) which vertices lie on the boundary."""
        boundary, curve = np.zeros(self.n_vertices, dtype=bool), self.boundary_corners
        boundary[self.vertices[curve]] = True
        boundary[self.vertices[self.following[curve]]] = True
        return boundary

    @kept
    def valences(self) -> IntArray:
        """(n,) number of faces around every vertex."""
        return np.bincount(self.vertices, minlength=self.n_vertices).astype(np.int32)

    @kept
    def ranks(self) -> IntArray:
        """(c,) place of a corner around its vertex, counter-clockwise; at the boundary from the first edge there on.

        Separate fans of faces may touch in a boundary vertex; the corners of all but one then have rank -1.
        """
        ranks = np.full(self.n_corners, -1, dtype=np.int32)
        twin = self.edge_corners[self.edges, self.forward.astype(np.int64)]
        numbers = np.arange(self.n_corners, dtype=np.int32)
        start = np.empty(self.n_vertices, dtype=np.int32)
        start[self.vertices[::-1]] = numbers[::-1]
        alone = twin < 0
        start[self.vertices[alone]] = numbers[alone]
        corners, rank = np.unique(start), 0
        while len(corners):  # around all vertices at once
            ranks[corners] = rank
            corners = twin[self.previous[corners]]
            corners = corners[corners >= 0]
            corners = corners[ranks[corners] < 0]
            rank += 1
        return ranks


def topology_of(
    vertices: IndexArray | IntArray, n_vertices: int, faces: IntArray, following: IntArray, previous: IntArray
) -> Topology:
    """Topology of faces; edges are numbered by `numbered_edges` and run as their first corner does."""
    indices = vertices.astype(np.int64)
    first, edges, _ = numbered_edges(indices, indices[following], n_vertices)
    forward = indices == indices[first][edges]
    numbers = indices.astype(np.int32), edges.astype(np.int32)
    n_faces = int(faces.max(initial=-1)) + 1
    return Topology(n_vertices, len(first), n_faces, *numbers, forward, faces, following, previous)


def mesh_topology(mesh: ControlMesh) -> Topology:
    """Topology of a mesh, whatever is wrong with it."""
    return layout_topology(mesh, mesh.face_indices, mesh.n_vertices)


def layout_topology(mesh: ControlMesh, indices: IndexArray, n_vertices: int) -> Topology:
    """Topology of the control mesh's faces on the vertex numbers ``indices`` (c,), such as those of UVs."""
    following = mesh.next_corners
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    faces = mesh.corner_faces.astype(np.int32)
    return topology_of(indices, n_vertices, faces, following.astype(np.int32), previous.astype(np.int32))


def numbered_edges(tails: IndexArray, heads: IndexArray, n_vertices: int) -> tuple[IndexArray, IndexArray, IndexArray]:
    """First half-edge (e,) of every edge, edge of every half-edge (c,), and counts (e,); edges ascend by vertices."""
    keys = np.minimum(tails, heads) * n_vertices + np.maximum(tails, heads)
    _, *numbers = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    first, edges, counts = (array.astype(np.int64) for array in numbers)
    return first, edges, counts


def adjacent_corners(topology: Topology) -> tuple[IndexArray, IndexArray]:
    """Pair the half-edges that share an edge: two for an inner edge, a chain where more faces meet."""
    order = np.argsort(topology.edges, kind="stable")
    same = np.diff(topology.edges[order]) == 0
    return order[:-1][same], order[1:][same]


def corner_fans(topology: Topology) -> IndexArray:
    """(c,) fan of every corner: corners around one vertex are of one fan where inner edges join their faces.

    A vertex is manifold when all its corners are of one fan. Numbered from 0.
    """
    first, second = adjacent_corners(topology)
    following = topology.following
    parallel = topology.vertices[first] == topology.vertices[second]
    tail_mate = np.where(parallel, second, following[second])
    head_mate = np.where(parallel, following[second], second)
    rows = np.concatenate([first, following[first]])
    columns = np.concatenate([tail_mate, head_mate])
    return label_components(rows, columns, topology.n_corners)


def boundary_loops(topology: Topology, fans: IndexArray) -> tuple[IndexArray, ...] | None:
    """Vertices along every boundary loop, in the direction of the faces' half-edges (surface on the left).

    None where the faces' orientations, or edges of more than two faces, leave the loops undefined. Loops follow the
    fans of `corner_fans`, and so a vertex is passed once for each of its fans.
    """
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
    """Genus g of a mesh, or of what is left after a cut between faces of different labels (m,).

    For c manifold pieces with b boundary loops in all: V - E + F = 2 c - 2 g - b.
    """
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
    """(m,) labels of faces by the nearest of vertices that lie about so far apart, along edges.

    The vertices are the first ones in the cubes of a lattice, moved by a share of their side.
    """
    cubes = np.floor(mesh.positions / size + offset)
    seeds = np.unique(cubes, axis=0, return_index=True)[1]
    heads, tails = mesh_topology(mesh).edge_vertices.T
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
    return label_components(nodes, nodes[mesh.next_corners], count)[nodes[mesh.face_offsets[:-1]]]


def face_components(mesh: ControlMesh) -> IndexArray:
    """(m,) connected component of every face; faces that share a vertex are of one component."""
    return _renumber(face_pieces(mesh, mesh.face_indices, mesh.n_vertices))


def uv_islands(mesh: ControlMesh) -> IndexArray | None:
    """(m,) UV island of every face: faces that share a texture vertex are of one island. None without UVs."""
    if mesh.uvs is None or mesh.uv_indices is None:
        return None
    return _renumber(face_pieces(mesh, mesh.uv_indices, len(mesh.uvs)))


def turned_faces(topology: Topology) -> NDArray[np.bool_] | None:
    """(m,) faces to turn so that neighbours agree, the smaller set of each piece; None for one-sided surfaces.

    Two faces agree where they run along their edge in opposite ways. Every face appears twice in a graph, as it is and
    turned round; edges join the copies that agree. Where the two copies of a face are connected, the surface is
    one-sided.
    """
    first, second = adjacent_corners(topology)
    manifold = topology.face_counts[topology.edges[first]] == 2
    first, second = first[manifold], second[manifold]
    agree = topology.vertices[first] != topology.vertices[second]
    f, g, m = topology.faces[first], topology.faces[second], topology.n_faces
    other = np.where(agree, 0, m)
    labels = label_components(np.concatenate([f, f + m]), np.concatenate([g + other, g + m - other]), 2 * m)
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
