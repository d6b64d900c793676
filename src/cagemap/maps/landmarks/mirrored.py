"""Landmarks that are mirrored as a whole: the other reading, in which left and right are exchanged, is offered."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.fit import with_cost
from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.confidence import AS_GIVEN, EXCHANGED, TWO, Confidence, MapShape, Reading
from cagemap.maps.hypotheses.search import found_readings
from cagemap.maps.pair import Pair, PointPairs, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangle_surface import TriangleSurface

# How far, of sqrt(area), shapes alone may put a landmark from the one that it is exchanged with.
NEAR_ENOUGH = 0.08


def mirrored_readings(
    prepared: PreparedPair, pair: Pair, given: PointMap, progress: Progress = silent
) -> Confidence | None:
    """Two answers: the map that meets landmarks as they are, and one with those exchanged that shapes alone suggest.

    None where the shapes put too few landmarks near others.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With the landmarks.
    given : PointMap
        Of these landmarks.
    progress : callable
    """
    free = Pair(pair.target, pair.source, pair.landmarks.only(np.zeros(0, dtype=np.int64)))
    best = found_readings(Problem(prepared, free), progress)[0]
    exchange = exchanged_pairs(prepared.mesh, pair.landmarks, best.positions)
    if len(exchange) < FEWEST_LANDMARKS:
        return None
    places = given.images.at(prepared.vertices).positions
    cost = with_cost(prepared, places).cost
    readings = (
        Reading(AS_GIVEN, cost, places),
        Reading(EXCHANGED, best.cost, best.positions, exchange=tuple(map(tuple, exchange.tolist()))),
    )
    return Confidence(TWO, 1e4 * cost, best.cost / max(cost, 1e-12), readings, None, MapShape.of(given))


def exchanged_pairs(mesh: TriangleSurface, landmarks: PointPairs, images: FloatArray) -> IndexArray:
    """(q, 2) places of landmarks whose target points lie near the source points of others, one to one.

    Where the vertices of the target's mesh have images (n, 3).
    """
    near = cKDTree(mesh.positions).query(landmarks.target.positions)[1]
    images, wanted = images[near], landmarks.source.positions
    distance, there = cKDTree(wanted).query(images)
    back = np.asarray(cKDTree(images).query(wanted)[1])
    there = np.asarray(there)
    rows = np.flatnonzero((distance < NEAR_ENOUGH) & (back[there] == np.arange(len(there))))
    return np.column_stack([rows, there[rows]]).astype(np.int64)
