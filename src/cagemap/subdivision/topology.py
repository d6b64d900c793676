"""Topology of a control mesh for subdivision, and of the next level after one step.

Only the edges of the control mesh are sorted; finer levels follow by index arithmetic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.mesh.topology import IntArray, Topology, mesh_topology
from cagemap.numerics.arrays import Array


def control_topology(mesh: ControlMesh) -> Topology:
    """Topology of a control mesh; InvalidMeshError unless an oriented manifold without loose vertices."""

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


def corner_neighbours(n_faces: int, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Face, following and previous corner of every corner, for faces of ``size`` corners."""
    corners = np.arange(n_faces * size, dtype=np.int32).reshape(n_faces, size)
    faces = np.repeat(np.arange(n_faces, dtype=np.int32), size)
    return faces, np.roll(corners, -1, axis=1).ravel(), np.roll(corners, 1, axis=1).ravel()


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
    return Topology(
        parent.n_vertices + parent.n_edges + (0 if loop else parent.n_faces),
        2 * parent.n_edges + count,
        len(edges),
        children(parent, scheme).ravel(),
        edges.ravel(),
        forward.ravel(),
        *corner_neighbours(*edges.shape),
    )
