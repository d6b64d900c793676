"""Limbs whose rotation about their axis the landmarks leave open: another map costs hardly more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import AS_GIVEN, LOOK, TURNED, Confidence, Reading, cost_signs
from cagemap.maps.hypotheses.signs import SIGNS, turned_share


def turned_limbs(ends: Sequence[Placement], prepared: PreparedPair) -> Confidence | None:
    """Two answers with the same landmarks, and the vertex where they differ most; None where only one is good.

    Parameters
    ----------
    ends : sequence of Placement
        Cheapest first; the first became the map.
    prepared : PreparedPair
    """
    best = ends[0]
    for other in ends[1:]:
        share = turned_share(prepared.mesh, best.positions, other.positions)
        if other.cost <= prepared.elastic.landmarks.as_good * best.cost and share > SIGNS["limb_turned"].bound:
            readings = (Reading(AS_GIVEN, best.cost, best.answer), Reading(TURNED, other.cost, other.positions))
            apart = np.linalg.norm(best.positions - other.positions, axis=1)
            deciding = int(prepared.vertices[apart[: prepared.target.control.n_vertices].argmax()])
            return Confidence(LOOK, readings, cost_signs(readings) | {"limb_turned": share}, deciding)
    return None
