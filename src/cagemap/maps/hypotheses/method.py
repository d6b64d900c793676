"""The map of a pair that few landmarks or none decide, and how sure it is."""

from __future__ import annotations

from dataclasses import replace

from scipy.spatial import cKDTree

from cagemap.deform.fit import with_cost
from cagemap.deform.inverse_consistency import inverse_consistent
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.candidates import found_readings
from cagemap.maps.hypotheses.confidence import SURE, Confidence, Reading
from cagemap.maps.hypotheses.mirror import mirrored_gain
from cagemap.maps.hypotheses.signs import SIGNS, jump_share, jumps, median_distortion
from cagemap.maps.hypotheses.tips import AS_CHEAP, OF_ONE_KIND
from cagemap.maps.pair import Pair, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.numerics.arrays import FloatArray

# With fewer landmarks, they only help to choose among hypotheses; from here on they start a map of their own.
FEWEST_LANDMARKS = 3


def hypothesis_map(prepared: PreparedPair, pair: Pair, progress: Progress = silent) -> tuple[PointMap, Confidence]:
    """Point map T12 of the finest levels by the cheapest hypothesis, which meets the landmarks there are.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With any number of landmarks; meant for fewer than `FEWEST_LANDMARKS`.
    progress : callable
        Called with the name of each stage.
    """
    problem = Problem(prepared, pair)
    best, *others = found_readings(problem, progress)
    readings = replace(best, positions=half_way(problem, best)), *others
    progress("closest points")
    found = map_of_places(prepared, readings[0].positions, pair.landmarks)
    farthest, controls = jumps(prepared, found), pair.target.control.n_vertices
    signs = {"jumps": jump_share(prepared, farthest), "stretched": median_distortion(found)}
    confidence = Confidence.of(readings, controls, signs)
    if confidence.verdict == SURE:  # takes as long as all other signs
        signs["mirrored"] = mirrored_gain(problem, readings[0].positions)
        confidence = Confidence.of(readings, controls, signs)
    if signs["jumps"] > SIGNS["jumps"].bound:  # decided there, whatever other answers differ in
        places = prepared.mesh.positions
        confidence = replace(confidence, deciding=int(cKDTree(places[:controls]).query(places[farthest.argmax()])[1]))
    if confidence.deciding is not None:
        confidence = replace(confidence, deciding=int(prepared.vertices[confidence.deciding]))
    return found, confidence


def half_way(problem: Problem, reading: Reading) -> FloatArray:
    """Positions of a reading, made inverse consistent where that costs hardly more.

    As they are between bodies of one kind, whose slides are small, and under masks: what is masked would be fitted back
    as well, and drag what is not with it.
    """
    if problem.prepared.rest.masks.any or reading.cost <= OF_ONE_KIND:
        return reading.positions
    moved = inverse_consistent(problem, reading.positions)
    cost = with_cost(problem.prepared, moved).cost
    return moved if cost <= AS_CHEAP * reading.cost else reading.positions
