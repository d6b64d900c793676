"""The map of a pair that few landmarks or none decide, and how sure it is."""

from __future__ import annotations

from dataclasses import replace

from scipy.spatial import cKDTree

from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.confidence import SURE, Confidence, MapShape
from cagemap.maps.hypotheses.jumps import Jumps
from cagemap.maps.hypotheses.mirror import mirrored_gain
from cagemap.maps.hypotheses.search import found_readings
from cagemap.maps.pair import Pair, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.surface.closest_points import build_tree, closest_points

# Distance from the map's image, of sqrt(area), from which on nothing came to a point of the source.
FAR = 0.05


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
    readings = found_readings(problem, progress)
    progress("closest points")
    found = map_of_places(prepared, readings[0].positions, pair.landmarks)
    jumps, controls = Jumps.of(prepared, found), pair.target.control.n_vertices
    shape = MapShape.of(found, unreached_share(prepared, found), jumps.share)
    confidence = Confidence.of(readings, controls, shape)
    if jumps.many:  # decided there, whatever other answers differ in
        places = prepared.mesh.positions
        confidence = replace(confidence, deciding=int(cKDTree(places[:controls]).query(places[jumps.vertex])[1]))
    if confidence.verdict == SURE:
        confidence = confidence.seen_mirrored(mirrored_gain(problem, readings[0].positions))
    if confidence.deciding is not None:
        confidence = replace(confidence, deciding=int(prepared.vertices[confidence.deciding]))
    return found, confidence


def unreached_share(prepared: PreparedPair, found: PointMap) -> float:
    """Share of the source's area, where it is not masked, that lies `FAR` or farther from what the map leads to."""
    mesh, samples = prepared.mesh, prepared.source_samples
    image = build_tree(found.images.at(prepared.vertices).positions, mesh.triangles)
    far = closest_points(image, samples.points)[2] > FAR
    return float(samples.areas[far].sum() / max(samples.areas.sum(), 1e-12))
