"""Semi-sharp creases and corners: how sharp edges and vertices are, and what one step of subdivision leaves of it.

A step takes 1 from every sharpness between 0 and infinity (10). A vertex or edge whose rule changes in the step, say
from crease to smooth, gets both masks, blended by what disappears [DKT98]_. The rules are OpenSubdiv's.

.. [DKT98] T. DeRose, M. Kass, T. Truong. Subdivision surfaces in character animation. 1998.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.schemes import CREASE_VERTEX, INFINITE_SHARPNESS, Creasing
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement.topology import BoolArray, Topology

# Vertex rules by what is sharp there: smooth also stands for darts, where a single crease ends.
SMOOTH, CREASE, CORNER = 0, 2, 3


@dataclass(frozen=True, eq=False)
class Sharpness:
    """Sharpness before and after one step.

    Attributes
    ----------
    edges : (e,) float64
        0 where smooth, `INFINITE_SHARPNESS` for ever and on the boundary.
    halves : (e, 2) float64
        What the edge's two halves have after the step: at the start of the edge, at its end.
    vertices, after : (n,) float64
        Of the vertices, before and after the step.
    """

    edges: FloatArray
    halves: FloatArray
    vertices: FloatArray
    after: FloatArray


def edge_ends(topology: Topology) -> IndexArray:
    """(e, 2) vertices at the start and the end of every edge."""
    table = topology.table
    forward = topology.edge_corners[:, 0]
    return np.column_stack([table.vertices[forward], table.vertices[table.following[forward]]]).astype(np.int64)


def control_sharpness(
    control: ControlMesh, topology: Topology, corner: BoolArray, creasing: Creasing
) -> Sharpness | None:
    """Sharpness of a control mesh as its file gives it, or None where there is none beyond the boundary.

    Parameters
    ----------
    corner : (n,) bool
        Boundary vertices that stay in place.

    Raises
    ------
    InvalidMeshError
        If a crease is not an edge of the mesh.
    """
    edges = np.zeros(topology.table.n_edges)
    vertices = np.zeros(control.n_vertices)
    if control.crease_edges is not None and control.crease_sharpness is not None:
        edges[_edge_numbers(control, topology)] = control.crease_sharpness
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        vertices[control.corner_vertices] = control.corner_sharpness
    if not (edges > 0).any() and not (vertices > 0).any():
        return None
    edges[topology.edge_corners[:, 1] < 0] = INFINITE_SHARPNESS
    vertices[corner] = INFINITE_SHARPNESS
    limits = 0.0, INFINITE_SHARPNESS
    return with_halves(topology, np.clip(edges, *limits), np.clip(vertices, *limits), creasing)


def _edge_numbers(control: ControlMesh, topology: Topology) -> IndexArray:
    assert control.crease_edges is not None
    n = control.n_vertices
    ends = edge_ends(topology)
    keys = ends.min(axis=1) * n + ends.max(axis=1)
    asked = control.crease_edges.min(axis=1) * n + control.crease_edges.max(axis=1)
    order = np.argsort(keys)
    numbers = order[np.minimum(np.searchsorted(keys[order], asked), len(keys) - 1)]
    missing = keys[numbers] != asked
    if missing.any():
        shown = first_few([tuple(pair) for pair in control.crease_edges[missing].tolist()])
        raise InvalidMeshError(
            f"{control.name}: expected creases on edges of the mesh, got {missing.sum()} between vertices that no edge "
            f"joins: {shown}; export the mesh again, or take these creases out"
        )
    return numbers


def with_halves(topology: Topology, edges: FloatArray, vertices: FloatArray, creasing: Creasing) -> Sharpness:
    """Work out what the next step leaves of the sharpness of edges and vertices."""
    halves = _faded(np.column_stack([edges, edges]))
    if creasing == "chaikin":
        halves = _evened_out(topology, edges, halves)
    return Sharpness(edges, halves, vertices, _faded(vertices))


def _faded(sharpness: FloatArray) -> FloatArray:
    return np.where(sharpness >= INFINITE_SHARPNESS, INFINITE_SHARPNESS, np.maximum(sharpness - 1.0, 0.0))


def _evened_out(topology: Topology, edges: FloatArray, halves: FloatArray) -> FloatArray:
    """Chaikin's rule: 3/4 of an edge's own sharpness and 1/4 of the mean of the other semi-sharp edges at that end."""
    ends, n = edge_ends(topology), topology.table.n_vertices
    semi = (edges > 0) & (edges < INFINITE_SHARPNESS)
    count = np.bincount(ends[semi].ravel(), minlength=n)
    total = np.bincount(ends[semi].ravel(), np.repeat(edges[semi], 2), minlength=n)
    shared = semi[:, None] & (count[ends] > 1)
    others = (total[ends] - edges[:, None]) / np.maximum(count[ends] - 1, 1)
    return np.where(shared, np.maximum(0.75 * edges[:, None] + 0.25 * others - 1.0, 0.0), halves)


def next_sharpness(sharpness: Sharpness, child: Topology, creasing: Creasing) -> Sharpness:
    """Sharpness of the next level: edge e became 2e and 2e + 1, and all other edges and vertices are new and smooth."""
    edges = np.zeros(child.table.n_edges)
    edges[: sharpness.halves.size] = sharpness.halves.ravel()
    edges[child.edge_corners[:, 1] < 0] = INFINITE_SHARPNESS
    vertices = np.zeros(child.table.n_vertices)
    vertices[: len(sharpness.after)] = sharpness.after
    return with_halves(child, edges, vertices, creasing)


@dataclass(frozen=True, eq=False)
class VertexRules:
    """Shares of the smooth, the crease and the corner mask at every vertex, (n,) each; they sum to 1.

    ``crease`` is the rule before the step, along the edges sharp then, ``crease_after`` the rule after it.
    """

    smooth: FloatArray
    crease: FloatArray
    crease_after: FloatArray
    corner: FloatArray


def vertex_rules(topology: Topology, sharpness: Sharpness, follows: IndexArray | None = None) -> VertexRules:
    """Rules of all vertices in one step, and how they are blended where the rule changes [DKT98]_.

    Parameters
    ----------
    follows : (n,) int64, optional
        Vertices that take the sharpness around another vertex for their own; UVs need it.
    """
    ends, n = edge_ends(topology), topology.table.n_vertices

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
    return VertexRules(
        smooth=share * (before == SMOOTH) + (1 - share) * (after == SMOOTH),
        crease=share * (before == CREASE),
        crease_after=(1 - share) * (after == CREASE),
        corner=share * (before == CORNER) + (1 - share) * (after == CORNER),
    )


def _rule(count: FloatArray, sharpness: FloatArray) -> IndexArray:
    """Rule of every vertex by the number of sharp edges there, and its own sharpness."""
    rule = np.where(count > 2, CORNER, np.where(count == 2, CREASE, SMOOTH))
    return np.asarray(np.where(sharpness > 0, CORNER, rule), dtype=np.int64)


def sharpened(
    matrix: csr_array, topology: Topology, sharpness: Sharpness, follows: IndexArray | None = None
) -> csr_array:
    """S of one step with creases and corners, from the S without any.

    Parameters
    ----------
    matrix : (n_fine, n) csr_array
        Smooth, crease and corner masks as the boundary alone asks for them.
    follows : (n,) int64, optional
        See `vertex_rules`.
    """
    n = topology.table.n_vertices
    ends, vertices = edge_ends(topology), np.arange(n)
    rules = vertex_rules(topology, sharpness, follows)
    # An edge of sharpness between 0 and 1 is half way to smooth, unless both its halves are still creases.
    hard = np.where(np.all(sharpness.halves > 0, axis=1), 1.0, sharpness.edges)
    hard[topology.edge_corners[:, 1] < 0] = 0.0  # boundary edges have their midpoint already
    # Boundary curves too: their row in the matrix is the whole of their smooth part only if nothing else is sharp.
    as_it_was = topology.boundary & (rules.crease == 1)
    kept = np.ones(matrix.shape[0])
    kept[:n] = np.where(as_it_was, 1.0, rules.smooth)
    kept[n : n + len(ends)] = 1.0 - hard
    own, other = CREASE_VERTEX
    crease, crease_after = np.where(as_it_was, 0.0, rules.crease), rules.crease_after
    along = (sharpness.edges[:, None] > 0) * crease[ends] + (sharpness.halves > 0) * crease_after[ends]
    sharp_edges = np.flatnonzero(hard)
    parts = [
        (vertices, vertices, rules.corner + own * (crease + crease_after)),
        (ends[:, 0], ends[:, 1], other * along[:, 0]),
        (ends[:, 1], ends[:, 0], other * along[:, 1]),
        (n + sharp_edges, ends[sharp_edges, 0], hard[sharp_edges] / 2),
        (n + sharp_edges, ends[sharp_edges, 1], hard[sharp_edges] / 2),
    ]
    rows, columns, weights = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    some = weights != 0
    added = coo_array((weights[some], (rows[some].astype(np.int32), columns[some].astype(np.int32))), matrix.shape)
    result = csr_array(diags_array(kept) @ matrix + added)
    result.eliminate_zeros()
    result.sort_indices()
    return result
