"""One placement of the best parts of several: one may be right about an arm, another about a leg."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import SearchConfig
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement
from cagemap.numerics.arrays import FloatArray, IndexArray, components


def best_parts(graph: ElasticGraph, ranked: Sequence[Placement], config: SearchConfig) -> FloatArray | None:
    """(n, 3) the first of some placements with those parts of the others that cost less; None if there are none.

    A part is a connected piece of the surface where two placements are apart, a limb most often; around it they agree,
    so that one fits into the other.

    Parameters
    ----------
    graph : ElasticGraph
        Of the target's mesh.
    ranked : sequence of Placement
        Cheapest first, with `Placement.costs`.
    config : SearchConfig
    """
    positions, costs, changed = ranked[0].positions, ranked[0].costs, False
    for other in ranked[1:]:
        apart = np.linalg.norm(positions - other.positions, axis=1) > config.part_distance
        part, share = _parts(graph, apart, config.part_rings)
        inside, count = part >= 0, int(part.max()) + 1
        gains = np.bincount(part[inside], (costs - other.costs)[inside], count)
        areas = np.bincount(part[apart], graph.areas[apart], count)
        better = np.append((gains > 0) & (areas >= config.part_area), False)
        share = share * better[part]
        positions = positions + share[:, None] * (other.positions - positions)
        costs, changed = np.where(share > 0, other.costs, costs), changed or bool(better.any())
    return positions if changed else None


def _parts(graph: ElasticGraph, apart: NDArray[np.bool_], rings: int) -> tuple[IndexArray, FloatArray]:
    """Number (n,) of the connected piece that vertices are of, rings around it included, -1 elsewhere; share (n,)."""
    both = apart[graph.heads] & apart[graph.tails]
    _, numbers = np.unique(components(graph.heads[both], graph.tails[both], graph.n)[apart], return_inverse=True)
    part, share = np.full(graph.n, -1), apart.astype(np.float64)
    part[apart] = numbers
    for ring in range(rings):
        reached = np.full(graph.n, -1)
        np.maximum.at(reached, graph.heads, part[graph.tails])
        new = (part < 0) & (reached >= 0)
        part[new], share[new] = reached[new], 1.0 - (ring + 1) / (rings + 1)
    return part, share
