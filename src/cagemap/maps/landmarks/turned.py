"""Limbs whose turn about their axis the landmarks leave open: another end of the fit that costs hardly more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.basis import Surface
from cagemap.maps.elastic.ends import FineFit
from cagemap.maps.hypotheses.confidence import AS_GIVEN, LOOK, TURNED, Confidence, MapShape, Reading
from cagemap.maps.point_map import PointMap

# An end that costs up to this many times the best one is as good as it; measured ones of turned limbs cost 1.06 to 1.7.
AS_GOOD = 1.15
# How far apart, of sqrt(area), two ends put some control vertex for limbs to be turned: thin ones are as wide.
TURNED_BY = 0.05


def turned_limbs(ends: Sequence[FineFit], found: PointMap, target: Surface) -> Confidence | None:
    """Two answers that meet the same landmarks, and where they differ most; None where only one is good.

    Parameters
    ----------
    ends : sequence of FineFit
        Cheapest first; the first became the map.
    found : PointMap
    target : Surface
    """
    best, count = ends[0], target.control.n_vertices
    for other in ends[1:]:
        apart = np.linalg.norm(best.positions[:count] - other.positions[:count], axis=1)
        if other.cost <= AS_GOOD * best.cost and apart.max() >= TURNED_BY:
            readings = (Reading(AS_GIVEN, best.cost, best.answer), Reading(TURNED, other.cost, other.positions))
            gap = other.cost / max(best.cost, 1e-12)
            deciding = int(target.refinement.outer(np.array([apart.argmax()]))[0])
            return Confidence(LOOK, 1e4 * best.cost, gap, readings, deciding, MapShape.of(found))
    return None
