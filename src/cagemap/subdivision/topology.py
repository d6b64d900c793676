"""Connectivity and sharpness of a control mesh for subdivision, and of the next level after one step.

Only the edges of the control mesh are sorted; finer levels follow by index arithmetic. A step subtracts 1 from every
sharpness between 0 and infinity (10). Where this changes the rule, for example from crease to smooth, the weights of
both rules are blended by the sharpness that disappears [DKT98]_. Rules are OpenSubdiv's.

.. [DKT98] T. DeRose, M. Kass, T. Truong. Subdivision surfaces in character animation. 1998.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.schemes import INFINITE_SHARPNESS, Creasing, Loop, Scheme
from cagemap.mesh.topology import BoolArray, IntArray, Topology, mesh_topology
from cagemap.numerics.arrays import Array, FloatArray, IndexArray, pair_keys

SMOOTH, CREASE, CORNER = 0, 2, 3  # vertex rules; smooth includes darts, where a single crease ends
_no_sharpness = partial(np.zeros, 0)  # sharpness of a smooth mesh


@dataclass(frozen=True, eq=False)
class MeshState:
    """Connectivity of one level, of the mesh or of its UVs, and sharpness: empty without creases and corners inside."""

    topology: Topology
    corner: BoolArray  # (n,) fixed boundary vertices
    edges: FloatArray = field(default_factory=_no_sharpness)  # (e,) sharpness, 0 where smooth, infinite on the boundary
    halves: FloatArray = field(default_factory=_no_sharpness)  # (e, 2) sharpness of both child edges, start first
    vertices: FloatArray = field(default_factory=_no_sharpness)  # (n,) sharpness
    after: FloatArray = field(default_factory=_no_sharpness)  # (n,) sharpness of vertices after a step
    follows: IndexArray | None = None  # (n,) of UVs: i has the edge sharpness around vertex follows[i]; None: its own

    @property
    def is_sharp(self) -> bool:
        """Whether there are creases or corners inside."""
        return len(self.vertices) > 0


def control_state(control: ControlMesh, scheme: Scheme) -> MeshState:
    """State of level 0."""
    topology = control_topology(control)
    corner = fixed_boundary_vertices(topology, scheme)
    edges, vertices = np.zeros(topology.n_edges), np.zeros(control.n_vertices)
    if control.crease_edges is not None and control.crease_sharpness is not None:
        keys, creases = (pair_keys(ends, control.n_vertices) for ends in (topology.edge_ends, control.crease_edges))
        # Edges ascend, see `layout_topology`.
        edges[np.searchsorted(keys, creases)] = np.clip(control.crease_sharpness, 0.0, INFINITE_SHARPNESS)
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        vertices[control.corner_vertices] = np.clip(control.corner_sharpness, 0.0, INFINITE_SHARPNESS)
    if not (edges > 0).any() and not (vertices > 0).any():
        return MeshState(topology, corner)
    edges[topology.outer_edges] = INFINITE_SHARPNESS
    vertices[corner] = INFINITE_SHARPNESS
    return _sharp_state(topology, corner, edges, vertices, scheme.creasing)


def control_topology(mesh: ControlMesh) -> Topology:
    """Topology of a mesh of sound arrays; InvalidMeshError unless an oriented manifold without loose vertices."""

    def check(bad: NDArray[np.integer], problem: str) -> None:
        if len(bad):
            shown = first_few([tuple(row) if bad.ndim == 2 else row for row in bad.tolist()])
            raise InvalidMeshError(
                f"{mesh.name}: expected an oriented manifold mesh, got {len(bad)} {problem}: {shown}; "
                "`cagemap check` lists everything that needs repair"
            )

    topology = mesh_topology(mesh)
    ends = topology.vertices[topology.following]
    pairs = np.column_stack([np.minimum(topology.vertices, ends), np.maximum(topology.vertices, ends)])
    forward_uses = np.bincount(topology.edges[topology.forward], minlength=topology.n_edges)[topology.edges]
    check(np.unique(pairs[pairs[:, 0] == pairs[:, 1]], axis=0), "edges from a vertex to itself")
    check(np.unique(pairs[topology.face_counts[topology.edges] > 2], axis=0), "edges with more than two faces")
    check(np.unique(pairs[forward_uses > 1], axis=0), "edges that both faces run along in the same direction")
    check(np.flatnonzero(topology.valences == 0), "vertices without a face")
    check(np.unique(topology.vertices[topology.ranks < 0]), "vertices where separate fans of faces touch")
    return topology


def fixed_boundary_vertices(topology: Topology, scheme: Scheme) -> BoolArray:
    """(n,) fixed boundary vertices: those with a single face, under ``edge_and_corner``."""
    if scheme.boundary != "edge_and_corner":
        return np.zeros(topology.n_vertices, dtype=bool)
    return topology.boundary & (topology.valences == 1)


def next_state(state: MeshState, scheme: Scheme) -> MeshState:
    """State of the next finer level."""
    topology = split_topology(state.topology, scheme)
    corner = np.zeros(topology.n_vertices, dtype=bool)
    corner[: len(state.corner)] = state.corner
    if not state.is_sharp:
        return MeshState(topology, corner)
    edges, vertices = np.zeros(topology.n_edges), np.zeros(topology.n_vertices)  # new elements are smooth
    edges[: state.halves.size] = state.halves.ravel()  # edge e becomes 2e and 2e + 1
    edges[topology.outer_edges] = INFINITE_SHARPNESS
    vertices[: len(state.after)] = state.after
    return _sharp_state(topology, corner, edges, vertices, scheme.creasing)


def split_topology(parent: Topology, scheme: Scheme) -> Topology:
    """Topology of the next level.

    Edge e becomes 2e (its first half) and 2e + 1, both in e's direction. One new edge per corner follows: from its edge
    point to its face point, or under Loop to its previous edge point.
    """
    loop, count, previous = isinstance(scheme, Loop), parent.n_corners, parent.previous
    outgoing, incoming = 2 * parent.edges + ~parent.forward, (2 * parent.edges + parent.forward)[previous]
    new = np.arange(count, dtype=np.int32) + 2 * parent.n_edges
    new_forward, incoming_forward = np.ones(count, dtype=bool), parent.forward[previous]
    if loop:
        edges = _with_middle(np.stack([outgoing, new, incoming], axis=1), np.roll(new.reshape(-1, 3), -1, axis=1))
        forward = _with_middle(
            np.stack([parent.forward, new_forward, incoming_forward], axis=1), np.zeros((parent.n_faces, 3), bool)
        )
    else:
        edges = np.stack([outgoing, new, new[previous], incoming], axis=1)
        forward = np.stack([parent.forward, new_forward, ~new_forward, incoming_forward], axis=1)
    corners = np.arange(edges.size, dtype=np.int32).reshape(edges.shape)
    return Topology(
        parent.n_vertices + parent.n_edges + (0 if loop else parent.n_faces),
        2 * parent.n_edges + count,
        len(edges),
        children(parent, scheme).ravel(),
        edges.ravel(),
        forward.ravel(),
        np.repeat(np.arange(len(edges), dtype=np.int32), edges.shape[1]),
        np.roll(corners, -1, axis=1).ravel(),
        np.roll(corners, 1, axis=1).ravel(),
    )


def children(parent: Topology, scheme: Scheme) -> IntArray:
    """(c, 4), under Loop (4 m, 3), faces of the next level in its vertex numbers.

    Corner k gives the quad (vertex k, edge point k, face point, edge point k - 1), under Loop the triangle without the
    face point. Under Loop every three corner triangles are followed by the middle triangle of their edge points.
    """
    edge_points = parent.edges + parent.n_vertices
    if isinstance(scheme, Loop):
        tips = np.stack([parent.vertices, edge_points, edge_points[parent.previous]], axis=1)
        return _with_middle(tips, edge_points.reshape(-1, 3))
    face_points = parent.faces + (parent.n_vertices + parent.n_edges)
    return np.stack([parent.vertices, edge_points, face_points, edge_points[parent.previous]], axis=1)


def _with_middle(tips: Array, middle: Array) -> Array:
    """(4 m, 3) corner values of every triangle's three corner triangles (3 m, 3) and middle one (m, 3)."""
    return np.concatenate([tips.reshape(-1, 3, 3), middle[:, None]], axis=1).reshape(-1, 3)  # type: ignore[return-value]


def _sharp_state(
    topology: Topology, corner: BoolArray, edges: FloatArray, vertices: FloatArray, creasing: Creasing
) -> MeshState:
    """State with the sharpness of edges and vertices before and after one subdivision step."""
    halves = _reduced(np.column_stack([edges, edges]))
    if creasing == "chaikin":
        halves = _chaikin_halves(topology, edges, halves)
    return MeshState(topology, corner, edges, halves, vertices, _reduced(vertices))


def _reduced(sharpness: FloatArray) -> FloatArray:
    return np.where(sharpness >= INFINITE_SHARPNESS, INFINITE_SHARPNESS, np.maximum(sharpness - 1.0, 0.0))


def _chaikin_halves(topology: Topology, edges: FloatArray, halves: FloatArray) -> FloatArray:
    """Chaikin's rule: 3/4 own sharpness, 1/4 mean of the other semi-sharp edges at that end."""
    ends, n = topology.edge_ends, topology.n_vertices
    semi = (edges > 0) & (edges < INFINITE_SHARPNESS)
    count = np.bincount(ends[semi].ravel(), minlength=n)
    total = np.bincount(ends[semi].ravel(), np.repeat(edges[semi], 2), minlength=n)
    shared = semi[:, None] & (count[ends] > 1)
    mean_of_others = (total[ends] - edges[:, None]) / np.maximum(count[ends] - 1, 1)
    return np.where(shared, np.maximum(0.75 * edges[:, None] + 0.25 * mean_of_others - 1.0, 0.0), halves)


def vertex_rules(state: MeshState) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Blending weights (n,) of four rules, sum 1: smooth, crease before and after the step, corner [DKT98]_."""
    ends, n, follows = state.topology.edge_ends, state.topology.n_vertices, state.follows

    def per_vertex(of_ends: FloatArray | BoolArray) -> FloatArray:
        sums = np.bincount(ends.ravel(), of_ends.ravel().astype(np.float64), minlength=n)
        return np.asarray(sums, dtype=np.float64)

    sharp = np.repeat(state.edges[:, None] > 0, 2, axis=1)
    fading = sharp & (state.halves <= 0)
    vertex_fades = (state.vertices > 0) & (state.after <= 0)
    count, count_after = per_vertex(sharp), per_vertex(state.halves > 0)
    lost = per_vertex(fading * state.edges[:, None]) + vertex_fades * state.vertices
    n_lost = per_vertex(fading) + vertex_fades
    if follows is not None:
        count, count_after, lost, n_lost = count[follows], count_after[follows], lost[follows], n_lost[follows]
    before, after = _rule(count, state.vertices), _rule(count_after, state.after)
    share = np.minimum(lost / np.maximum(n_lost, 1), 1.0)
    share[(before == after) | (before == SMOOTH)] = 1.0
    smooth, corner = (share * (before == rule) + (1 - share) * (after == rule) for rule in (SMOOTH, CORNER))
    return smooth, share * (before == CREASE), (1 - share) * (after == CREASE), corner


def _rule(count: FloatArray, sharpness: FloatArray) -> IndexArray:
    """Rule of every vertex from its number of sharp edges and its sharpness."""
    rule = np.where(count > 2, CORNER, np.where(count == 2, CREASE, SMOOTH))
    return np.asarray(np.where(sharpness > 0, CORNER, rule), dtype=np.int64)
