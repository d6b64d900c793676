"""State of one level of subdivision: connectivity, fixed corners and sharpness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Scheme
from cagemap.numerics.arrays import IndexArray
from cagemap.subdivision.sharpness import Sharpness, control_sharpness, next_sharpness
from cagemap.subdivision.topology import BoolArray, Topology, control_topology, split_topology


@dataclass(frozen=True, eq=False)
class MeshState:
    """One level without positions, of the mesh or of its UVs.

    ``corner`` (n,) are boundary vertices that stay in place; ``sharpness`` is None where nothing is sharp beyond the
    boundary; ``follows`` (n,) is of UVs only, see `vertex_rules`.
    """

    topology: Topology
    corner: BoolArray
    sharpness: Sharpness | None = None
    follows: IndexArray | None = None


def boundary_corners(topology: Topology, scheme: Scheme) -> BoolArray:
    """(n,) boundary vertices that stay in place: those with a single face, if the boundary rule says so."""
    if scheme.boundary != "edge_and_corner":
        return np.zeros(topology.table.n_vertices, dtype=bool)
    return topology.boundary & (topology.valences == 1)


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
    sharpness = None if state.sharpness is None else next_sharpness(state.sharpness, topology, scheme.creasing)
    return MeshState(topology, corner, sharpness)
