"""The same surface on both sides, a cage with a new layout, say: its map is the identity, to the last bit."""

from __future__ import annotations

import numpy as np

from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import Confidence, Reading
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap

# Places that differ by less, in units of sqrt(area), are one: what six digits in a file leave.
_SAME = 1e-5
ONE_SURFACE = "vertex on vertex: they are one surface"


def same_surface(pair: Pair, masks: Masks = WHOLE) -> bool:
    """Whether both finest surfaces have the same faces and vertices, in their order, and nobody says anything else.

    Landmarks, curves and masks may: the left arm alone of the target and the right arm alone of the source differ.
    """
    target, source = pair.target.triangles(pair.target.finest), pair.source.triangles(pair.source.finest)
    if target.n != source.n or not np.array_equal(target.triangles, source.triangles):
        return False
    if masks.target is not None and masks.source is not None and not np.array_equal(masks.target, masks.source):
        return False
    # Moved in its file, a surface is still the same one.
    moved = target.positions - source.positions
    marks = pair.landmarks.target.positions - pair.landmarks.source.positions
    rest = np.concatenate([moved, marks]) - moved.mean(axis=0)
    return not pair.landmarks.curves and bool(np.abs(rest).max() < _SAME)


def identity_map(prepared: PreparedPair, pair: Pair) -> tuple[PointMap, Confidence]:
    """Every vertex to itself, and how sure that is."""
    target, source = pair.target.triangles(pair.target.finest), pair.source.triangles(pair.source.finest)
    found = PointMap.from_vertices(target, source, np.arange(target.n))
    moved = (source.positions - target.positions).mean(axis=0)
    reading = Reading(ONE_SURFACE, 0.0, prepared.mesh.positions + moved)
    return found, Confidence.of((reading,), pair.target.control.n_vertices)
