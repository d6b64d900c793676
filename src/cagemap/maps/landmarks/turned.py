"""Limbs whose turn about their axis the landmarks leave open: another end of the fit that costs hardly more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import AS_GIVEN, LOOK, TURNED, Confidence, Reading, cost_signs

# An end that costs up to this many times the best one is as good as it; measured ones of turned limbs cost 1.06 to 1.7.
AS_GOOD = 1.15
# How far apart, of sqrt(area), two ends put vertices of a turned limb, thin ones being as wide, and the least share of
# the area that does so. In right maps of posed bodies and animals it is up to 2.4 % (docs/lab/accuracy.md).
TURNED_BY, TURNED_SHARE = 0.05, 0.025


def turned_limbs(ends: Sequence[Placement], prepared: PreparedPair) -> Confidence | None:
    """Two answers that meet the same landmarks, and where they differ most; None where only one is good.

    Parameters
    ----------
    ends : sequence of Placement
        Cheapest first; the first became the map.
    prepared : PreparedPair
    """
    best, target = ends[0], prepared.target
    for other in ends[1:]:
        apart = np.linalg.norm(best.positions - other.positions, axis=1)
        share = prepared.rest.graph.areas[apart >= TURNED_BY].sum()
        if other.cost <= AS_GOOD * best.cost and share >= TURNED_SHARE:
            readings = (Reading(AS_GIVEN, best.cost, best.answer), Reading(TURNED, other.cost, other.positions))
            farthest = apart[: target.control.n_vertices].argmax()
            return Confidence(LOOK, readings, cost_signs(readings), int(prepared.vertices[farthest]))
    return None
