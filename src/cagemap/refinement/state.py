"""The state that subdivision hands from level to level: connectivity, fixed corners and sharpness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.refinement.matrices import boundary_corners, subdivision_matrix
from cagemap.refinement.sharpness import Sharpness, control_sharpness, next_sharpness
from cagemap.refinement.topology import (
    BoolArray,
    CornerTable,
    IntArray,
    Topology,
    control_topology,
    quad_children,
    split_quad_topology,
    split_quads,
    split_triangle_topology,
    split_triangles,
    triangle_children,
)


@dataclass(frozen=True, eq=False)
class MeshState:
    """All of one level but its positions: what the next subdivision matrix is made from.

    Attributes
    ----------
    topology : Topology
    corner : (n,) bool
        Boundary vertices that stay in place.
    sharpness : Sharpness or None
        None where nothing is sharp beyond the boundary.
    """

    topology: Topology
    corner: BoolArray
    sharpness: Sharpness | None


def control_state(control: ControlMesh, scheme: Scheme) -> MeshState:
    """State of level 0."""
    topology = control_topology(control)
    corner = boundary_corners(topology, scheme)
    return MeshState(topology, corner, control_sharpness(control, topology, corner, scheme.creasing))


def next_state(state: MeshState, scheme: Scheme) -> MeshState:
    """State one level finer."""
    topology = split_topology(state.topology, scheme)
    corner = np.zeros(topology.table.n_vertices, dtype=bool)
    corner[: len(state.corner)] = state.corner
    if state.sharpness is None:
        return MeshState(topology, corner, None)
    return MeshState(topology, corner, next_sharpness(state.sharpness, topology, scheme.creasing))


def state_matrix(state: MeshState, scheme: Scheme) -> csr_array:
    """S of the step from this level to the next."""
    return subdivision_matrix(state.topology, scheme, state.corner, state.sharpness)


def split_topology(topology: Topology, scheme: Scheme) -> Topology:
    """Topology of the next level."""
    return split_triangle_topology(topology) if isinstance(scheme, Loop) else split_quad_topology(topology)


def split_table(table: CornerTable, scheme: Scheme) -> CornerTable:
    """Corner table of the next level."""
    return split_triangles(table) if isinstance(scheme, Loop) else split_quads(table)


def children(table: CornerTable, scheme: Scheme) -> IntArray:
    """Faces of the next level, (m, 4) or (m, 3), in its numbers."""
    return triangle_children(table) if isinstance(scheme, Loop) else quad_children(table)
