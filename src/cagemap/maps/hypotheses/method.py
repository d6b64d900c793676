"""The map of a pair that few landmarks or none decide, and how sure it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from scipy.spatial import cKDTree

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.shared_area import SharedArea
from cagemap.maps.hypotheses.confidence import SURE, Confidence
from cagemap.maps.hypotheses.mirror import mirrored_gain
from cagemap.maps.hypotheses.search import found_readings
from cagemap.maps.hypotheses.signs import SIGNS, jump_share, jumps, median_distortion
from cagemap.maps.pair import Pair, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places


def hypothesis_map(
    prepared: PreparedPair,
    pair: Pair,
    progress: Progress = silent,
    preview: Callable[[PointMap], None] | None = None,
) -> tuple[PointMap, Confidence]:
    """Point map T12 of the finest levels by the cheapest hypothesis, which meets the landmarks there are.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With any number of landmarks; meant for fewer than `FEWEST_LANDMARKS`.
    progress : callable
        Called with the name of each stage.
    preview : callable, optional
        Called during the search with approximate maps: of the alignment in the files, then of the best rough fit.
    """
    problem = Problem(prepared, pair)

    def show(rough: Placement) -> None:
        if preview is not None:
            places = rough.on(prepared.rest.graph, prepared.elastic.graph)
            preview(map_of_places(prepared, places, pair.landmarks))

    readings = found_readings(problem, progress, show)
    progress("closest points")
    found = map_of_places(prepared, readings[0].positions, pair.landmarks)
    shared, counts = SharedArea.of_fit(prepared, readings[0].positions), None
    if shared is not None:  # what has no counterpart says nothing about the map
        counts = shared.within(prepared.masks).of_target(found.target.n)
    farthest, controls = jumps(prepared, found, counts), pair.target.control.n_vertices
    signs = {"jumps": jump_share(prepared, farthest), "stretched": median_distortion(found, counts)}
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
