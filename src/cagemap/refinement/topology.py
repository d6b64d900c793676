"""Who touches whom: corner tables of a mesh, and their split by one step of subdivision.

A corner is one face's use of one vertex; corner ``c`` also stands for the edge that leaves it towards the next corner
of its face. Only the control mesh is sorted; every finer level is written down from the coarser one by index
arithmetic. All arrays are int32, as the indices of the matrices made from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.topology import numbered_edges
from cagemap.numerics.arrays import IndexArray

IntArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class CornerTable:
    """Faces, edges and vertices seen from the c corners. Serves the mesh and, separately, its UV layout.

    Attributes
    ----------
    n_vertices, n_edges, n_faces : int
    vertices : (c,) int32
        Vertex of every corner; corners of a face are consecutive.
    edges : (c,) int32
        Edge from every corner to the next.
    forward : (c,) bool
        Whether the corner runs along its edge in the edge's own direction; in an oriented manifold each edge has one
        corner that does, and, unless it is on the boundary, one that does not.
    faces : (c,) int32
        Face of every corner.
    following, previous : (c,) int32
        Neighbouring corners around the face.
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
    """A corner table of an oriented manifold mesh, with the order of the faces around every vertex.

    Attributes
    ----------
    table : CornerTable
    ranks : (c,) int32
        Place of the corner among those of its vertex, counter-clockwise; on the boundary the first corner is the one
        whose own edge lies on the boundary.
    valences : (n,) int32
        Number of faces around every vertex.
    edge_corners : (e, 2) int32
        The corner that runs forward along every edge, and the one that runs backward, or -1 on the boundary.
    boundary : (n,) bool
        Whether a vertex is on the boundary.
    """

    table: CornerTable
    ranks: IntArray
    valences: IntArray
    edge_corners: IntArray
    boundary: BoolArray

    @property
    def boundary_corners(self) -> IntArray:
        """(b,) the corner of every boundary edge: it runs from one boundary vertex to the next."""
        return self.edge_corners[self.edge_corners[:, 1] < 0, 0]


def _edge_corners(table: CornerTable) -> IntArray:
    corners = np.full((table.n_edges, 2), -1, dtype=np.int32)
    numbers = np.arange(table.n_corners, dtype=np.int32)
    corners[table.edges[table.forward], 0] = numbers[table.forward]
    corners[table.edges[~table.forward], 1] = numbers[~table.forward]
    return corners


def table_of(
    vertices: IndexArray | IntArray, n_vertices: int, faces: IntArray, following: IntArray, previous: IntArray
) -> CornerTable:
    """Corner table of faces on any vertex numbers.

    Edges are numbered as by `numbered_edges`; their direction is that of their first corner.
    """
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


def cut_table(table: CornerTable, labels: IndexArray) -> tuple[CornerTable, IndexArray]:
    """The same faces with a vertex for every label of their corners, and the label of every new vertex."""
    present, vertices = np.unique(labels, return_inverse=True)
    return table_of(vertices, len(present), table.faces, table.following, table.previous), present


def _refuse(mesh: ControlMesh, problem: str, where: Sequence[object]) -> InvalidMeshError:
    return InvalidMeshError(
        f"{mesh.name}: expected an oriented manifold mesh, got {len(where)} {problem}: {first_few(where)}; "
        "`cagemap check` lists everything that needs repair"
    )


def control_topology(mesh: ControlMesh) -> Topology:
    """Topology of a control mesh.

    Raises
    ------
    InvalidMeshError
        If an edge has more than two faces, two faces run along an edge in the same direction, an edge joins a vertex
        to itself, a vertex has no face, or the faces around a vertex form more than one fan.
    """
    indices = mesh.face_indices
    if len(indices) == 0:
        raise InvalidMeshError(f"{mesh.name}: expected at least one face, got none; give a polygon mesh")
    if indices.min() < 0 or indices.max() >= mesh.n_vertices:
        outside = np.unique(indices[(indices < 0) | (indices >= mesh.n_vertices)])
        raise _refuse(mesh, f"vertex numbers outside 0..{mesh.n_vertices - 1}", outside.tolist())
    table = control_table(mesh, indices, mesh.n_vertices)
    ends = table.vertices[table.following]
    pairs = np.column_stack([np.minimum(table.vertices, ends), np.maximum(table.vertices, ends)])
    counts = np.bincount(table.edges, minlength=table.n_edges)

    def offending(corners: BoolArray) -> Sequence[object]:
        return [tuple(pair) for pair in np.unique(pairs[corners], axis=0).tolist()]

    if np.any(table.vertices == ends):
        raise _refuse(mesh, "edges from a vertex to itself", offending(table.vertices == ends))
    if np.any(counts > 2):
        raise _refuse(mesh, "edges with more than two faces", offending(counts[table.edges] > 2))
    forward = np.bincount(table.edges[table.forward], minlength=table.n_edges)
    if np.any(forward > 1):
        bad = offending(forward[table.edges] > 1)
        raise _refuse(mesh, "edges that both faces run along in the same direction", bad)

    alone = np.flatnonzero(np.bincount(table.vertices, minlength=mesh.n_vertices) == 0)
    if len(alone):
        raise _refuse(mesh, "vertices without a face", alone.tolist())
    topology = topology_of_table(table)
    if np.any(topology.ranks < 0):
        bad = np.unique(table.vertices[topology.ranks < 0]).tolist()
        raise _refuse(mesh, "vertices where separate fans of faces touch", bad)
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


def _uniform_neighbours(n_faces: int, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Face, following and previous corner of every corner when all faces have ``size`` corners."""
    corners = np.arange(n_faces * size, dtype=np.int32).reshape(n_faces, size)
    faces = np.repeat(np.arange(n_faces, dtype=np.int32), size)
    return faces, np.roll(corners, -1, axis=1).ravel(), np.roll(corners, 1, axis=1).ravel()


def quad_children(table: CornerTable) -> IntArray:
    """(c, 4) the child quad of every corner k: vertex k, edge point k, face point, edge point k - 1."""
    children = np.empty((table.n_corners, 4), dtype=np.int32)
    children[:, 0] = table.vertices
    children[:, 1] = table.edges + table.n_vertices
    children[:, 2] = table.faces + (table.n_vertices + table.n_edges)
    children[:, 3] = children[table.previous, 1]
    return children


def triangle_children(table: CornerTable) -> IntArray:
    """(4 m, 3) the children of every triangle: one per corner k (vertex k, edge point k, edge point k - 1), the middle.

    The middle triangle is (edge point 0, edge point 1, edge point 2).
    """
    vertices = table.vertices.reshape(-1, 3)
    edges = (table.edges + table.n_vertices).reshape(-1, 3)
    children = np.empty((table.n_faces, 4, 3), dtype=np.int32)
    children[:, :3, 0] = vertices
    children[:, :3, 1] = edges
    children[:, :3, 2] = np.roll(edges, 1, axis=1)
    children[:, 3] = edges
    return children.reshape(-1, 3)


def split_quads(table: CornerTable) -> CornerTable:
    """Corner table after one step of Catmull-Clark.

    Edge e becomes 2e (its first half) and 2e + 1, both in e's direction; then comes one edge per corner, from its edge
    point to its face point.
    """
    spokes = np.arange(table.n_corners, dtype=np.int32) + 2 * table.n_edges
    outgoing = 2 * table.edges + ~table.forward
    incoming = (2 * table.edges + table.forward)[table.previous]
    edges = np.stack([outgoing, spokes, spokes[table.previous], incoming], axis=1)
    forward = np.empty((table.n_corners, 4), dtype=bool)
    forward[:, 0], forward[:, 1], forward[:, 2] = table.forward, True, False
    forward[:, 3] = table.forward[table.previous]
    faces, following, previous = _uniform_neighbours(table.n_corners, 4)
    return CornerTable(
        n_vertices=table.n_vertices + table.n_edges + table.n_faces,
        n_edges=2 * table.n_edges + table.n_corners,
        n_faces=table.n_corners,
        vertices=quad_children(table).ravel(),
        edges=edges.ravel(),
        forward=forward.ravel(),
        faces=faces,
        following=following,
        previous=previous,
    )


def split_triangles(table: CornerTable) -> CornerTable:
    """Corner table after one step of Loop.

    Edge e becomes 2e (its first half) and 2e + 1, both in e's direction; then comes one edge per corner, across it.
    """
    across = (np.arange(table.n_corners, dtype=np.int32) + 2 * table.n_edges).reshape(-1, 3)
    edges = np.empty((table.n_faces, 4, 3), dtype=np.int32)
    edges[:, :3, 0] = (2 * table.edges + ~table.forward).reshape(-1, 3)
    edges[:, :3, 1] = across
    edges[:, :3, 2] = (2 * table.edges + table.forward)[table.previous].reshape(-1, 3)
    edges[:, 3] = np.roll(across, -1, axis=1)
    forward = np.empty((table.n_faces, 4, 3), dtype=bool)
    forward[:, :3, 0] = table.forward.reshape(-1, 3)
    forward[:, :3, 1] = True
    forward[:, :3, 2] = table.forward[table.previous].reshape(-1, 3)
    forward[:, 3] = False
    faces, following, previous = _uniform_neighbours(4 * table.n_faces, 3)
    return CornerTable(
        n_vertices=table.n_vertices + table.n_edges,
        n_edges=2 * table.n_edges + table.n_corners,
        n_faces=4 * table.n_faces,
        vertices=triangle_children(table).ravel(),
        edges=edges.ravel(),
        forward=forward.ravel(),
        faces=faces,
        following=following,
        previous=previous,
    )


def _split_topology(parent: Topology, table: CornerTable, ranks: IntArray, face_points: IntArray) -> Topology:
    interior = parent.edge_corners[:, 1] >= 0
    per_side = 2 if len(face_points) else 3
    edge_points = np.where(interior, 2 * per_side, per_side).astype(np.int32)
    return Topology(
        table=table,
        ranks=ranks,
        valences=np.concatenate([parent.valences, edge_points, face_points]),
        edge_corners=_edge_corners(table),
        boundary=np.concatenate([parent.boundary, ~interior, np.zeros(len(face_points), dtype=bool)]),
    )


def split_quad_topology(parent: Topology) -> Topology:
    """Topology after one step of Catmull-Clark."""
    table = parent.table
    ranks = np.empty((table.n_corners, 4), dtype=np.int32)
    ranks[:, 0] = parent.ranks
    # Around an edge point, counter-clockwise from the edge's end: end and start of the forward side, then of the other.
    ranks[:, 1] = np.where(table.forward, 1, 3)
    sizes = np.bincount(table.faces, minlength=table.n_faces).astype(np.int32)
    starts = np.cumsum(sizes, dtype=np.int32) - sizes
    ranks[:, 2] = np.arange(table.n_corners, dtype=np.int32) - starts[table.faces]
    ranks[:, 3] = np.where(table.forward, 0, 2)[table.previous]
    return _split_topology(parent, split_quads(table), ranks.ravel(), sizes)


def split_triangle_topology(parent: Topology) -> Topology:
    """Topology after one step of Loop."""
    table = parent.table
    side = np.where(table.forward, 0, 3).astype(np.int32)
    ranks = np.empty((table.n_faces, 4, 3), dtype=np.int32)
    ranks[:, :3, 0] = parent.ranks.reshape(-1, 3)
    ranks[:, :3, 1] = (side + 2).reshape(-1, 3)
    ranks[:, :3, 2] = side[table.previous].reshape(-1, 3)
    ranks[:, 3] = (side + 1).reshape(-1, 3)
    return _split_topology(parent, split_triangles(table), ranks.ravel(), np.zeros(0, dtype=np.int32))
