"""State of a level: connectivity, fixed corners, semi-sharp creases and corners (OpenSubdiv's rules).

A step subtracts 1 from every sharpness between 0 and infinity (10). Where this changes the rule, for example from
crease to smooth, the weights of both rules are blended by the sharpness that disappears [DKT98]_.

.. [DKT98] T. DeRose, M. Kass, T. Truong. Subdivision surfaces in character animation. 1998.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.schemes import INFINITE_SHARPNESS, Creasing, Scheme
from cagemap.mesh.topology import BoolArray, Topology
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys
from cagemap.subdivision.topology import control_topology, split_topology

# Vertex rules; smooth includes darts, where a single crease ends.
SMOOTH, CREASE, CORNER = 0, 2, 3


@dataclass(frozen=True, eq=False)
class Sharpness:
    """Sharpness before and after one step.

    ``edges`` (e,), 0 where smooth and infinite on the boundary, become ``halves`` (e, 2) at start and end of the edge;
    ``vertices`` (n,) become ``after`` (n,).
    """

    edges: FloatArray
    halves: FloatArray
    vertices: FloatArray
    after: FloatArray

    def of_corners(self, topology: Topology, corners: NDArray[np.integer]) -> tuple[FloatArray, FloatArray]:
        """Sharpness of the edges (k,) of corners and of their halves (k, 2), in the corners' direction."""
        edges = topology.edges[corners]
        halves = self.halves[edges]
        return self.edges[edges], np.where(topology.forward[corners][:, None], halves, halves[:, ::-1])


def _edge_numbers(control: ControlMesh, topology: Topology) -> IndexArray:
    """Edge number of every crease; InvalidMeshError if it is not on an edge."""
    assert control.crease_edges is not None
    keys, asked = (pair_keys(ends, control.n_vertices) for ends in (topology.edge_ends, control.crease_edges))
    numbers = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)  # edges ascend, see `topology_of`
    missing = keys[numbers] != asked
    if missing.any():
        shown = first_few([tuple(pair) for pair in control.crease_edges[missing].tolist()])
        raise InvalidMeshError(
            f"{control.name}: expected creases on edges of the mesh, got {missing.sum()} between vertices that no edge "
            f"joins: {shown}; export the mesh again, or take these creases out"
        )
    return numbers


def with_halves(topology: Topology, edges: FloatArray, vertices: FloatArray, creasing: Creasing) -> Sharpness:
    """Sharpness completed by the values after the next step."""
    halves = _reduced(np.column_stack([edges, edges]))
    if creasing == "chaikin":
        halves = _chaikin_halves(topology, edges, halves)
    return Sharpness(edges, halves, vertices, _reduced(vertices))


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


def vertex_rules(
    topology: Topology, sharpness: Sharpness, follows: IndexArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Blending weights (n,) of four rules, sum 1: smooth, crease before and after the step, corner [DKT98]_.

    Vertex i (a UV) uses the edge sharpness around vertex ``follows[i]``.
    """
    ends, n = topology.edge_ends, topology.n_vertices

    def per_vertex(of_ends: FloatArray | BoolArray) -> FloatArray:
        sums = np.bincount(ends.ravel(), of_ends.ravel().astype(np.float64), minlength=n)
        return np.asarray(sums, dtype=np.float64)

    sharp = np.repeat(sharpness.edges[:, None] > 0, 2, axis=1)
    fading = sharp & (sharpness.halves <= 0)
    vertex_fades = (sharpness.vertices > 0) & (sharpness.after <= 0)
    count, count_after = per_vertex(sharp), per_vertex(sharpness.halves > 0)
    lost = per_vertex(fading * sharpness.edges[:, None]) + vertex_fades * sharpness.vertices
    n_lost = per_vertex(fading) + vertex_fades
    if follows is not None:
        count, count_after, lost, n_lost = count[follows], count_after[follows], lost[follows], n_lost[follows]
    before, after = _rule(count, sharpness.vertices), _rule(count_after, sharpness.after)
    share = np.minimum(lost / np.maximum(n_lost, 1), 1.0)
    share[(before == after) | (before == SMOOTH)] = 1.0
    smooth, corner = (share * (before == rule) + (1 - share) * (after == rule) for rule in (SMOOTH, CORNER))
    return smooth, share * (before == CREASE), (1 - share) * (after == CREASE), corner


def _rule(count: FloatArray, sharpness: FloatArray) -> IndexArray:
    """Rule of every vertex from its number of sharp edges and its sharpness."""
    rule = np.where(count > 2, CORNER, np.where(count == 2, CREASE, SMOOTH))
    return np.asarray(np.where(sharpness > 0, CORNER, rule), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class MeshState:
    """Connectivity and sharpness of one level, of the mesh or of its UVs.

    ``corner`` (n,) are fixed boundary vertices; ``sharpness`` is None without creases and corners inside; ``follows``
    (n,) is used for UVs only, see `vertex_rules`.
    """

    topology: Topology
    corner: BoolArray
    sharpness: Sharpness | None = None
    follows: IndexArray | None = None


def boundary_corners(topology: Topology, scheme: Scheme) -> BoolArray:
    """(n,) fixed boundary vertices: those with a single face, under ``edge_and_corner``."""
    if scheme.boundary != "edge_and_corner":
        return np.zeros(topology.n_vertices, dtype=bool)
    return topology.boundary & (topology.valences == 1)


def control_state(control: ControlMesh, scheme: Scheme) -> MeshState:
    """State of level 0."""
    topology = control_topology(control)
    corner = boundary_corners(topology, scheme)
    edges, vertices = np.zeros(topology.n_edges), np.zeros(control.n_vertices)
    if control.crease_edges is not None and control.crease_sharpness is not None:
        edges[_edge_numbers(control, topology)] = np.clip(control.crease_sharpness, 0.0, INFINITE_SHARPNESS)
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        vertices[control.corner_vertices] = np.clip(control.corner_sharpness, 0.0, INFINITE_SHARPNESS)
    if not (edges > 0).any() and not (vertices > 0).any():
        return MeshState(topology, corner)
    edges[topology.outer_edges] = INFINITE_SHARPNESS
    vertices[corner] = INFINITE_SHARPNESS
    return MeshState(topology, corner, with_halves(topology, edges, vertices, scheme.creasing))


def next_state(state: MeshState, scheme: Scheme) -> MeshState:
    """State of the next finer level."""
    topology = split_topology(state.topology, scheme)
    corner = np.zeros(topology.n_vertices, dtype=bool)
    corner[: len(state.corner)] = state.corner
    before = state.sharpness
    if before is None:
        return MeshState(topology, corner)
    edges, vertices = np.zeros(topology.n_edges), np.zeros(topology.n_vertices)  # new elements are smooth
    edges[: before.halves.size] = before.halves.ravel()  # edge e becomes 2e and 2e + 1
    edges[topology.outer_edges] = INFINITE_SHARPNESS
    vertices[: len(before.after)] = before.after
    return MeshState(topology, corner, with_halves(topology, edges, vertices, scheme.creasing))
