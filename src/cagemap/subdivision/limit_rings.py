"""Limit positions and tangents of vertices whose rule no longer changes, from their ring.

Boundary formulas are derived for these rules: published ones (also OpenSubdiv's) belong to modified boundary rules and
are up to 10 degrees off.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cagemap.mesh.schemes import CREASE_LIMIT, CatmullClark, Loop
from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision.matrices import RowFiller, put_boundary_rows, put_inner_rows, rings_of, vertex_row_lengths
from cagemap.subdivision.topology import BoolArray, Topology

SmoothScheme: TypeAlias = CatmullClark | Loop
# Rows, columns and weights of some entries of a matrix.
Entries: TypeAlias = tuple[NDArray[np.integer], NDArray[np.integer], FloatArray]


def matrix_of(entries: list[Entries], n: int) -> csr_array:
    """(n, n) matrix of all entries."""
    rows, columns, weights = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return csr_array((weights, (rows, columns)), shape=(n, n))


def ring_limits(topology: Topology, scheme: SmoothScheme, corner: BoolArray) -> csr_array:
    """Weights of limit positions, (n, n): smooth inside, 1/6, 2/3, 1/6 on the boundary, a corner itself."""
    own, *each = scheme.limit_weights(topology.valences)
    rows = RowFiller(vertex_row_lengths(topology, corner, len(each)))
    put_inner_rows(rows, topology, own, *zip(rings_of(topology, scheme), each, strict=True))
    put_boundary_rows(rows, topology, corner, CREASE_LIMIT)
    return rows.matrix(topology.table.n_vertices)


def ring_tangents(
    topology: Topology, scheme: SmoothScheme, corner: BoolArray, positions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Two tangents of every vertex, (n, 3) each; on the boundary the first follows the curve."""
    n = topology.table.n_vertices
    tangents = []
    for number, interior in enumerate(_interior_tangents(topology, scheme)):
        on_boundary = matrix_of(_boundary_tangents(topology, scheme, corner, number), n)
        tangents.append(interior @ positions + on_boundary @ positions)
    return tangents[0], tangents[1]


def _interior_tangents(topology: Topology, scheme: SmoothScheme) -> list[csr_array]:
    """Weights of the two tangents of interior vertices, (n, n) each; boundary rows are empty."""
    table = topology.table
    rings = rings_of(topology, scheme)
    # Few (valence, rank) pairs occur: their trigonometry is done once each.
    present = np.flatnonzero(np.bincount(topology.valences))
    first_of = np.zeros(present[-1] + 1, dtype=np.int64)
    first_of[present] = np.cumsum(present) - present
    valences = np.repeat(present, present)
    ranks = np.arange(len(valences)) - first_of[valences]
    masks: tuple[FloatArray, ...] = scheme.tangent_weights(valences, ranks)
    if isinstance(scheme, CatmullClark):  # at valence 2, where no tangent plane exists, those of the ring's polygon
        sign, none = np.where(ranks == 0, 1.0, -1.0), np.zeros(len(ranks))
        polygon = sign, none, none, sign
        masks = tuple(np.where(valences == 2, new, old) for new, old in zip(polygon, masks, strict=True))
    inside = np.flatnonzero(~topology.boundary[table.vertices])
    centres, rank = table.vertices[inside], topology.ranks[inside]
    mask = first_of[topology.valences[centres]] + rank
    result = []
    for tangent in (masks[: len(rings)], masks[len(rings) :]):
        rows = RowFiller(np.where(topology.boundary, 0, len(rings) * topology.valences))
        for offset, (ring, weights) in enumerate(zip(rings, tangent, strict=True)):
            rows.put(centres, len(rings) * rank + offset, ring[inside], weights[mask])
        result.append(csr_array((rows.data, rows.indices, rows.indptr), shape=(table.n_vertices, table.n_vertices)))
    return result


def _boundary_tangents(topology: Topology, scheme: SmoothScheme, corner: BoolArray, number: int) -> list[Entries]:
    """Entries of tangent ``number`` of boundary vertices: along the curve (0), inwards (1)."""
    table = topology.table
    curve = topology.boundary_corners
    # The curve leaves vertex `here` towards `after`, and came from `before`; faces lie on its left.
    here, after = table.vertices[curve], table.vertices[table.following[curve]]
    before = np.empty(table.n_vertices, dtype=np.int32)
    before[after] = here
    before = before[here]
    stays = corner[here].astype(np.float64)
    if number == 0:
        return [(here, after, np.ones(len(here))), (here, before, stays - 1), (here, here, -stays)]
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
        for ring, ring_weight in zip(rings_of(topology, scheme), ring_weights, strict=False):
            entries.append((table.vertices[corners], ring[corners], ring_weight[topology.ranks[corners]]))
    return entries
