"""Starts of a part on a whole without landmarks: the files' own units and places, since areas do not tell the scale."""

from __future__ import annotations

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.numerics.arrays import FloatArray


def file_ratio(prepared: PreparedPair) -> float:
    """Factor from the target's unit to the source's by the lengths in the files; 1 where they say nothing.

    Both units are sqrt(area), which of a part is not that of the whole. Of closed surfaces it is 1.
    """
    target, source = prepared.target.finest_triangles, prepared.source.finest_triangles
    if not (target.is_open or source.is_open):
        return 1.0
    ratio, most = source.scale / target.scale, prepared.elastic.hypotheses.max_unit_ratio
    return ratio if 1.0 / most <= ratio <= most else 1.0


def units_of_larger(prepared: PreparedPair) -> tuple[float, float]:
    """Units of target and source, in that of the larger surface."""
    ratio = file_ratio(prepared)
    return min(ratio, 1.0), min(1.0 / ratio, 1.0)


def in_place(prepared: PreparedPair, points: FloatArray) -> list[Placement]:
    """Points (k, 3) of an open pair's target where its file puts them among the source's; none if that is unknown."""
    ratio = file_ratio(prepared)
    return [] if ratio == 1.0 else [Placement(np.asarray(ratio * points))]
