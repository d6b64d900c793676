"""Point maps by the elastic method: search, project, unfold; coincident surfaces need no fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.deform.shared_area import SharedArea
from cagemap.deform.update import linear_update
from cagemap.maps.coincidence import SAME
from cagemap.maps.hypotheses.confidence import SURE, Confidence
from cagemap.maps.hypotheses.search import find_answers, search
from cagemap.maps.hypotheses.signs import SIGNS, jump_lengths, jump_share, median_distortion, mirrored_gain
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import Pair, Progress, no_progress
from cagemap.maps.places import curve_miss
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places, snap_landmarks
from cagemap.maps.quality import landmark_errors
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked

# Least share of the target's unmasked area whose image is unmasked on the source.
LEAST_JOINT = 0.5
ONE_SURFACE = "vertex on vertex: they are one surface"


def known_map(problem: Problem) -> tuple[PointMap, Confidence] | None:
    """Map of coincident surfaces, and its confidence; None if they do not coincide.

    Landmarks and curves move closest points a little. None as well if landmarks, curves or masks contradict the map.
    """
    prepared, pair = problem.prepared, problem.pair
    masks, landmarks, count = prepared.masks, pair.landmarks, pair.target.control.n_vertices
    target, source = pair.target.finest_triangles, pair.source.finest_triangles
    if same_surface(pair, masks):
        moved = (source.positions - target.positions).mean(axis=0)
        answer = Placement(prepared.mesh.positions + moved, 0.0, name=ONE_SURFACE)
        return PointMap.from_vertices(target, source, np.arange(target.n)), Confidence.of((answer,), count)
    coincidence = prepared.coincidence
    if coincidence is None:
        return None
    point_map = PointMap(target, coincidence.images(source))
    missed = _largest_miss(point_map, pair)
    if missed > prepared.elastic.landmarks.confirmed or not _joint(point_map, masks):
        return None
    if missed > SAME:
        moved = linear_update(problem, point_map)
        shifts = moved - point_map.images.at(prepared.vertices).positions
        shifts = pair.target.hierarchy.prolong(shifts, prepared.levels[0], pair.target.finest)
        point_map = PointMap(
            target, snap_landmarks(coincidence.images(source, shifts), landmarks, prepared.elastic.projection)
        )
    apart = f"{100 * coincidence.gap:.2f} % of the model's size apart"
    name = f"as it stands, {apart}: vertices go to the closest points of the same side"
    answer = Placement(point_map.images.at(prepared.vertices).positions, coincidence.gap**2, name=name)
    return point_map, Confidence.of((answer,), count)


def same_surface(pair: Pair, masks: Masks = WHOLE) -> bool:
    """Whether both finest surfaces have equal faces and vertices, and landmarks, curves and masks agree."""
    target, source = pair.target.finest_triangles, pair.source.finest_triangles
    if target.n != source.n or not np.array_equal(target.triangles, source.triangles):
        return False
    if masks.target is not None and masks.source is not None and not np.array_equal(masks.target, masks.source):
        return False
    # A translation in the file does not matter.
    moved = target.positions - source.positions
    marks = pair.landmarks.target.positions - pair.landmarks.source.positions
    rest = np.concatenate([moved, marks]) - moved.mean(axis=0)
    return not pair.landmarks.curves and bool(np.abs(rest).max() < SAME)


def _largest_miss(point_map: PointMap, pair: Pair) -> float:
    """Largest distance by which a map misses a landmark or curve."""
    misses = [curve_miss(curve, point_map).worst for curve in pair.landmarks.curves]
    return float(max([*landmark_errors(point_map, pair.landmarks), *misses], default=0.0))


def _joint(point_map: PointMap, masks: Masks) -> bool:
    """Whether most of the target's unmasked area maps to unmasked area of the source."""
    if masks.target is None or masks.source is None:
        return True
    areas = point_map.target.vertex_areas
    return bool(areas @ masks.joint(point_map) >= LEAST_JOINT * (areas @ masks.target))


def elastic_map(
    problem: Problem, progress: Progress = no_progress, start: FloatArray | None = None
) -> tuple[PointMap, list[Placement]]:
    """Point map T12 of the finest levels, and the placements of `search`, the map's first."""
    placements = search(problem, progress, start)
    progress("closest points")
    return map_of_places(problem.prepared, placements[0].answer, problem.pair.landmarks), placements


@kinds_checked
def fit(prepared: PreparedPair, pair: Pair, progress: Progress = no_progress) -> FloatArray:
    """(n, 3) fitted positions of the target's deformed level near the source: the first of `search`.

    In the unit in which the source has area 1.
    """
    return search(Problem(prepared, pair), progress)[0].answer


def hypothesis_map(
    problem: Problem, progress: Progress, preview: Callable[[PointMap], None] | None
) -> tuple[PointMap, Confidence]:
    """Map of the cheapest alignment, and its confidence; ``preview`` gets approximate maps during the search."""
    prepared, pair = problem.prepared, problem.pair

    def show(rough: Placement) -> None:
        if preview is not None:
            places = rough.on(prepared.rest.graph, prepared.elastic.graph)
            preview(map_of_places(prepared, places, pair.landmarks))

    answers = find_answers(problem, progress, show)
    progress("closest points")
    point_map = map_of_places(prepared, answers[0].positions, pair.landmarks)
    shared, counts = SharedArea.of_fit(prepared, answers[0].positions), None
    if shared is not None:  # area without a counterpart tells nothing about the map
        counts = shared.within(prepared.masks).of_target(point_map.target.n)
    farthest, controls = jump_lengths(prepared, point_map, counts), pair.target.control.n_vertices
    signs = {"jumps": jump_share(prepared, farthest), "stretched": median_distortion(point_map, counts)}
    confidence = Confidence.of(answers, controls, signs)
    if confidence.verdict == SURE:  # takes as long as all other signs
        signs["mirrored"] = mirrored_gain(problem, answers[0].positions)
        confidence = Confidence.of(answers, controls, signs)
    if signs["jumps"] > SIGNS["jumps"].bound:  # a landmark at the jump decides, not where answers differ
        places = prepared.mesh.positions
        confidence = replace(confidence, deciding=int(cKDTree(places[:controls]).query(places[farthest.argmax()])[1]))
    if confidence.deciding is not None:
        confidence = replace(confidence, deciding=int(prepared.vertices[confidence.deciding]))
    return point_map, confidence
