"""Where the refined vertices end: limit positions and normals, exact at every vertex of every level.

The local subdivision matrix A maps a vertex and its ring to the vertex and ring one level finer. Its left eigenvectors
give the limit: position from eigenvalue 1, tangents from the two largest that follow [HKD93]_. All are closed formulas
of `schemes`. On the boundary they are our own, worked out for these rules: the known ones (OpenSubdiv's among them)
belong to modified boundary rules and are up to 10 degrees off.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement.matrices import RowFiller, put_sharp_rows, put_smooth_rows, vertex_kinds
from cagemap.refinement.refinement import Refinement, topology_of
from cagemap.refinement.schemes import CREASE_LIMIT, CatmullClark, Loop, Scheme
from cagemap.refinement.topology import BoolArray, IntArray, Topology


def limit_matrix(refinement: Refinement, level: int) -> csr_array:
    """Weights of the limit positions of a level's vertices in that level's positions.

    Smooth: the schemes' ``limit_weights``; boundary: 1/6, 2/3, 1/6; corner: itself.

    Parameters
    ----------
    refinement : Refinement
    level : int
        From 0 to L; 0 only where Loop runs or all control faces are quads.

    Returns
    -------
    (n_level, n_level) csr_array
        Rows sum to 1.

    Raises
    ------
    ParameterError
        If there is no such level, or level 0 has faces that are not quads under Catmull-Clark.
    """
    topology = _checked_topology(refinement, level)
    scheme = refinement.scheme
    crease, corner = vertex_kinds(topology, scheme)
    rows = _ring_rows(topology, scheme, corner)
    own, *each = scheme.limit_weights(topology.valences)
    rings = zip(_rings(topology, scheme), each, strict=True)
    put_smooth_rows(rows, topology, ~topology.boundary, own, *rings)
    put_sharp_rows(rows, topology, crease, corner, CREASE_LIMIT)
    return rows.matrix(topology.table.n_vertices)


def limit_positions(refinement: Refinement, level: int) -> FloatArray:
    """Limit positions of a level's vertices, (n_level, 3): the same point at every level that has the vertex.

    Raises
    ------
    ParameterError
        If there is no such level.
    """
    if level == 0 and not _has_limit_rings(refinement, 0):
        if refinement.n_levels == 0:
            raise ParameterError("level: limits of a control mesh with n-gons need one refinement step; refine once")
        # Vertex i is vertex i one level further, where all faces are quads.
        return limit_positions(refinement, 1)[: refinement.levels[0].n_vertices]
    limits: FloatArray = limit_matrix(refinement, level) @ refinement.levels[level].positions
    return limits


def limit_normals(refinement: Refinement, level: int) -> FloatArray:
    """Unit normals of the limit surface at a level's vertices, (n_level, 3), outwards.

    Exact wherever the surface has one. It has none at interior vertices of valence 2, nor at boundary vertices with so
    many faces (more than 3 under Catmull-Clark, 5 under Loop) that the boundary curve no longer leads their shape;
    there the result is the nearest reasonable direction. It is zero where the surface itself is degenerate.

    Raises
    ------
    ParameterError
        As for `limit_positions`.
    """
    if level == 0 and not _has_limit_rings(refinement, 0) and refinement.n_levels:
        return limit_normals(refinement, 1)[: refinement.levels[0].n_vertices]
    normals = np.cross(*limit_tangents(refinement, level))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def limit_tangents(refinement: Refinement, level: int) -> tuple[FloatArray, FloatArray]:
    """Two directions that span the limit surface's tangent plane at every vertex, each (n_level, 3).

    Their cross product is outward; their lengths mean nothing. On the boundary the first follows the curve.

    Raises
    ------
    ParameterError
        As for `limit_matrix`.
    """
    topology = _checked_topology(refinement, level)
    positions = refinement.levels[level].positions
    n = topology.table.n_vertices
    tangents = []
    for number, interior in enumerate(_interior_tangents(topology, refinement.scheme)):
        rows, columns, weights = _boundary_tangents(topology, refinement.scheme, number)
        on_boundary = csr_array((weights, (rows, columns)), shape=(n, n))
        tangents.append(interior @ positions + on_boundary @ positions)
    return tangents[0], tangents[1]


def _has_limit_rings(refinement: Refinement, level: int) -> bool:
    if level > 0 or isinstance(refinement.scheme, Loop):
        return True
    return bool(np.all(refinement.control.face_sizes == 4))


def _checked_topology(refinement: Refinement, level: int) -> Topology:
    if not 0 <= level <= refinement.n_levels:
        raise ParameterError(f"level: expected 0 to {refinement.n_levels}, got {level}; refine further to have more")
    if not _has_limit_rings(refinement, level):
        raise ParameterError("level: expected quads only, got level 0 of a mesh with other faces; use level 1")
    return topology_of(refinement, level)


def _rings(topology: Topology, scheme: Scheme) -> list[IntArray]:
    """Per corner: the next vertex of its face, and under Catmull-Clark also the opposite one."""
    table = topology.table
    neighbours = table.vertices[table.following]
    return [neighbours] if isinstance(scheme, Loop) else [neighbours, neighbours[table.following]]


def _ring_rows(topology: Topology, scheme: Scheme, corner: BoolArray) -> RowFiller:
    n_rings = 1 if isinstance(scheme, Loop) else 2
    lengths = np.where(topology.boundary, 3, 1 + n_rings * topology.valences)
    lengths[corner] = 1
    return RowFiller(lengths)


def _interior_tangents(topology: Topology, scheme: Scheme) -> list[csr_array]:
    """Weights of the two tangents of interior vertices, (n, n) each; boundary rows are empty."""
    table = topology.table
    rings = _rings(topology, scheme)
    # Few (valence, rank) pairs occur: their trigonometry is done once each.
    present = np.flatnonzero(np.bincount(topology.valences))
    first_of = np.zeros(present[-1] + 1, dtype=np.int64)
    first_of[present] = np.cumsum(present) - present
    valences = np.repeat(present, present)
    ranks = np.arange(len(valences)) - first_of[valences]
    masks: tuple[FloatArray, ...] = scheme.tangent_weights(valences, ranks)
    if isinstance(scheme, CatmullClark):
        masks = _with_valence_2_tangents(valences, ranks, masks)

    indptr = np.zeros(table.n_vertices + 1, dtype=np.int32)
    np.cumsum(np.where(topology.boundary, 0, len(rings) * topology.valences), out=indptr[1:])
    inside = np.flatnonzero(~topology.boundary[table.vertices])
    centres, rank = table.vertices[inside], topology.ranks[inside]
    place = indptr[centres] + len(rings) * rank
    mask = first_of[topology.valences[centres]] + rank
    indices = np.empty(indptr[-1], dtype=np.int32)
    for offset, ring in enumerate(rings):
        indices[place + offset] = ring[inside]
    result = []
    for tangent in (masks[: len(rings)], masks[len(rings) :]):
        data = np.empty(indptr[-1])
        for offset, weights in enumerate(tangent):
            data[place + offset] = weights[mask]
        result.append(csr_array((data, indices, indptr), shape=(table.n_vertices, table.n_vertices)))
    return result


def _with_valence_2_tangents(
    valences: IndexArray, ranks: IndexArray, masks: tuple[FloatArray, ...]
) -> tuple[FloatArray, ...]:
    """At valence 2: along the two edges, and between the two opposite vertices.

    The surface has no tangent plane there; this makes the normal that of the ring's polygon.
    """
    sign, none = np.where(ranks == 0, 1.0, -1.0), np.zeros(len(ranks))
    replaced = (sign, none, none, sign)
    return tuple(np.where(valences == 2, new, old) for new, old in zip(replaced, masks, strict=True))


def _boundary_tangents(topology: Topology, scheme: Scheme, number: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows, columns and weights of tangent ``number`` of boundary vertices: along the curve (0), inwards (1)."""
    _, corner = vertex_kinds(topology, scheme)
    table = topology.table
    curve = topology.boundary_corners
    # The curve leaves vertex `here` towards `after`, and came from `before`; faces lie on its left.
    here, after = table.vertices[curve], table.vertices[table.following[curve]]
    before = np.empty(table.n_vertices, dtype=np.int32)
    before[after] = here
    before = before[here]
    stays = corner[here].astype(np.float64)
    if number == 0:
        return _joined([(here, after, np.ones(len(here))), (here, before, stays - 1), (here, here, -stays)])
    single = topology.valences[here] == 1
    # A corner's surface is spanned by its two edges; a curve through a single face by its two derivatives.
    entries = [
        (here[single], before[single], np.ones(int(single.sum()))),
        (here[single], here[single], stays[single] - 2),
        (here[single], after[single], 1 - stays[single]),
    ]
    corners_at = np.flatnonzero(topology.boundary[table.vertices])
    for valence in np.unique(topology.valences[here[~single]]):
        centre, edges, faces = scheme.inward_tangent(int(valence))
        chosen = topology.valences[here] == valence
        entries.append((here[chosen], here[chosen], np.full(int(chosen.sum()), centre)))
        entries.append((here[chosen], before[chosen], np.full(int(chosen.sum()), edges[-1])))
        corners = corners_at[topology.valences[table.vertices[corners_at]] == valence]
        ring_weights = (edges[:-1], faces)
        for ring, ring_weight in zip(_rings(topology, scheme), ring_weights, strict=False):
            entries.append((table.vertices[corners], ring[corners], ring_weight[topology.ranks[corners]]))
    return _joined(entries)


def _joined(entries: list[tuple[IntArray, IntArray, FloatArray]]) -> tuple[IntArray, IntArray, FloatArray]:
    rows, columns, weights = zip(*entries, strict=True)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)
