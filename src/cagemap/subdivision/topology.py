"""Corner tables of a mesh, and their split by one step of subdivision.

A corner is one face's use of one vertex; corner ``c`` also stands for the edge that leaves it towards the next corner
of its face. Only the control mesh is sorted; finer levels follow by index arithmetic. All arrays are int32, as the
indices of the matrices made from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.mesh.topology import numbered_edges
from cagemap.numerics.arrays import Array, IndexArray

IntArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class CornerTable:
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

    def has_only(self, size: int) -> bool:
        """Whether every face has ``size`` corners."""
        if self.n_corners != size * self.n_faces:
            return False
        return bool(np.all(self.faces[::size] == np.arange(self.n_faces)))


@dataclass(frozen=True, eq=False)
class Topology:
    """A corner table of an oriented manifold mesh, with the order of the faces around every vertex."""

    table: CornerTable
    #: (c,) place of the corner around its vertex, counter-clockwise; at the boundary from the first boundary edge on
    ranks: IntArray
    valences: IntArray  #: (n,) number of faces around every vertex
    #: (e, 2) forward and backward corner of every edge; -1 instead of the latter on the boundary
    edge_corners: IntArray
    boundary: BoolArray  #: (n,)

    @property
    def boundary_corners(self) -> IntArray:
        """(b,) the corner of every boundary edge: it runs from one boundary vertex to the next."""
        return self.edge_corners[self.edge_corners[:, 1] < 0, 0]


def _edge_corners(table: CornerTable) -> IntArray:
    """(e, 2) forward and backward corner of every edge, -1 where there is none."""
    corners = np.full((table.n_edges, 2), -1, dtype=np.int32)
    corners[table.edges, (~table.forward).astype(np.int64)] = np.arange(table.n_corners, dtype=np.int32)
    return corners


def table_of(
    vertices: IndexArray | IntArray, n_vertices: int, faces: IntArray, following: IntArray, previous: IntArray
) -> CornerTable:
    """Corner table of faces; edges are numbered by `numbered_edges` and run as their first corner does."""
    indices = vertices.astype(np.int64)
    first, edges, _ = numbered_edges(indices, indices[following], n_vertices)
    return CornerTable(
        n_vertices=n_vertices,
        n_edges=len(first),
        n_faces=int(faces[-1]) + 1,
        vertices=indices.astype(np.int32),
        edges=edges.astype(np.int32),
        forward=indices == indices[first][edges],
        faces=faces,
        following=following,
        previous=previous,
    )


def control_table(mesh: ControlMesh, indices: IndexArray, n_vertices: int) -> CornerTable:
    """Corner table of the control mesh's faces on the vertex numbers ``indices``."""
    following = mesh.next_corners
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    faces = mesh.corner_faces.astype(np.int32)
    return table_of(indices, n_vertices, faces, following.astype(np.int32), previous.astype(np.int32))


def topology_of_table(table: CornerTable) -> Topology:
    """Topology of faces known to be oriented and to share every edge at most two by two.

    Separate fans of faces may touch in a boundary vertex; the corners of all but one then have rank -1.
    """
    edge_corners = _edge_corners(table)
    boundary = np.zeros(table.n_vertices, dtype=bool)
    curve = edge_corners[edge_corners[:, 1] < 0, 0]
    boundary[table.vertices[curve]] = True
    boundary[table.vertices[table.following[curve]]] = True
    valences = np.bincount(table.vertices, minlength=table.n_vertices).astype(np.int32)
    return Topology(table, _control_ranks(table, edge_corners), valences, edge_corners, boundary)


def control_topology(mesh: ControlMesh) -> Topology:
    """Topology of a control mesh.

    Raises
    ------
    InvalidMeshError
        If an edge has more than two faces, two faces run along an edge in the same direction, an edge joins a vertex
        to itself, a vertex has no face, or the faces around a vertex form more than one fan.
    """

    def check(bad: NDArray[np.integer], problem: str) -> None:
        if len(bad):
            shown = first_few([tuple(row) if bad.ndim == 2 else row for row in bad.tolist()])
            raise InvalidMeshError(
                f"{mesh.name}: expected an oriented manifold mesh, got {len(bad)} {problem}: {shown}; "
                "`cagemap check` lists everything that needs repair"
            )

    indices, n = mesh.face_indices, mesh.n_vertices
    if len(indices) == 0:
        raise InvalidMeshError(f"{mesh.name}: expected at least one face, got none; give a polygon mesh")
    check(np.unique(indices[(indices < 0) | (indices >= n)]), f"vertex numbers outside 0..{n - 1}")
    table = control_table(mesh, indices, n)
    ends = table.vertices[table.following]
    pairs = np.column_stack([np.minimum(table.vertices, ends), np.maximum(table.vertices, ends)])
    uses = np.bincount(table.edges, minlength=table.n_edges)[table.edges]
    forward_uses = np.bincount(table.edges[table.forward], minlength=table.n_edges)[table.edges]
    check(np.unique(pairs[table.vertices == ends], axis=0), "edges from a vertex to itself")
    check(np.unique(pairs[uses > 2], axis=0), "edges with more than two faces")
    check(np.unique(pairs[forward_uses > 1], axis=0), "edges that both faces run along in the same direction")
    check(np.flatnonzero(np.bincount(table.vertices, minlength=n) == 0), "vertices without a face")
    topology = topology_of_table(table)
    check(np.unique(table.vertices[topology.ranks < 0]), "vertices where separate fans of faces touch")
    return topology


def _control_ranks(table: CornerTable, edge_corners: IntArray) -> IntArray:
    """Walk counter-clockwise around all vertices at once; corners that no walk reaches keep -1."""
    ranks = np.full(table.n_corners, -1, dtype=np.int32)
    twin = edge_corners[table.edges, table.forward.astype(np.int64)]
    numbers = np.arange(table.n_corners, dtype=np.int32)
    start = np.empty(table.n_vertices, dtype=np.int32)
    start[table.vertices[::-1]] = numbers[::-1]
    alone = twin < 0
    start[table.vertices[alone]] = numbers[alone]
    corners, rank = np.unique(start), 0
    while len(corners):
        ranks[corners] = rank
        corners = twin[table.previous[corners]]
        corners = corners[corners >= 0]
        corners = corners[ranks[corners] < 0]
        rank += 1
    return ranks


def corner_neighbours(n_faces: int, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Face, following and previous corner of every corner of faces of ``size`` corners."""
    corners = np.arange(n_faces * size, dtype=np.int32).reshape(n_faces, size)
    faces = np.repeat(np.arange(n_faces, dtype=np.int32), size)
    return faces, np.roll(corners, -1, axis=1).ravel(), np.roll(corners, 1, axis=1).ravel()


def children(table: CornerTable, scheme: Scheme) -> IntArray:
    """Faces of the next level, (c, 4), or (4 m, 3) under Loop, in its vertex numbers.

    Corner k gives the quad (vertex k, edge point k, face point, edge point k - 1) or the triangle without the face
    point. Under Loop the middle triangle of the edge points comes after each three of them.
    """
    edge_points = table.edges + table.n_vertices
    if isinstance(scheme, Loop):
        tips = np.stack([table.vertices, edge_points, edge_points[table.previous]], axis=1)
        return _with_middle(tips, edge_points.reshape(-1, 3))
    face_points = table.faces + (table.n_vertices + table.n_edges)
    return np.stack([table.vertices, edge_points, face_points, edge_points[table.previous]], axis=1)


def _with_middle(tips: Array, middle: Array) -> Array:
    """(4 m, 3) values of the corners of every triangle's three tips (3 m, 3) and of its middle (m, 3)."""
    return np.concatenate([tips.reshape(-1, 3, 3), middle[:, None]], axis=1).reshape(-1, 3)  # type: ignore[return-value]


def split_table(table: CornerTable, scheme: Scheme) -> CornerTable:
    """Corner table of the next level.

    Edge e becomes 2e (its first half) and 2e + 1, both in e's direction. Then comes one edge per corner: from its edge
    point to its face point, or under Loop across it.
    """
    loop = isinstance(scheme, Loop)
    outgoing, incoming = 2 * table.edges + ~table.forward, (2 * table.edges + table.forward)[table.previous]
    new = np.arange(table.n_corners, dtype=np.int32) + 2 * table.n_edges
    ahead, behind = np.ones(table.n_corners, dtype=bool), table.forward[table.previous]
    if loop:
        edges = _with_middle(np.stack([outgoing, new, incoming], axis=1), np.roll(new.reshape(-1, 3), -1, axis=1))
        forward = _with_middle(np.stack([table.forward, ahead, behind], axis=1), np.zeros((table.n_faces, 3), bool))
    else:
        edges = np.stack([outgoing, new, new[table.previous], incoming], axis=1)
        forward = np.stack([table.forward, ahead, ~ahead, behind], axis=1)
    faces, following, previous = corner_neighbours(*edges.shape)
    return CornerTable(
        n_vertices=table.n_vertices + table.n_edges + (0 if loop else table.n_faces),
        n_edges=2 * table.n_edges + table.n_corners,
        n_faces=len(edges),
        vertices=children(table, scheme).ravel(),
        edges=edges.ravel(),
        forward=forward.ravel(),
        faces=faces,
        following=following,
        previous=previous,
    )


def split_topology(parent: Topology, scheme: Scheme) -> Topology:
    """Topology of the next level."""
    table, loop = parent.table, isinstance(scheme, Loop)
    # Ranks around an edge point count from the corner at the edge's end, those of the forward side first.
    per_side = 3 if loop else 2
    side = np.where(table.forward, 0, per_side).astype(np.int32)
    at_end, at_start = side[table.previous], side + (per_side - 1)
    if loop:
        ranks = _with_middle(np.stack([parent.ranks, at_start, at_end], axis=1), (side + 1).reshape(-1, 3))
        face_valences = np.zeros(0, dtype=np.int32)
    else:
        face_valences = np.bincount(table.faces, minlength=table.n_faces).astype(np.int32)
        starts = np.cumsum(face_valences, dtype=np.int32) - face_valences
        at_face = np.arange(table.n_corners, dtype=np.int32) - starts[table.faces]
        ranks = np.stack([parent.ranks, at_start, at_face, at_end], axis=1)
    inside = parent.edge_corners[:, 1] >= 0
    edge_valences = np.where(inside, 2 * per_side, per_side).astype(np.int32)
    child = split_table(table, scheme)
    return Topology(
        table=child,
        ranks=ranks.ravel(),
        valences=np.concatenate([parent.valences, edge_valences, face_valences]),
        edge_corners=_edge_corners(child),
        boundary=np.concatenate([parent.boundary, ~inside, np.zeros(len(face_valences), dtype=bool)]),
    )
