"""Maps that need no fit: of one surface on both sides, and of surfaces that lie on each other."""

from __future__ import annotations

import numpy as np

from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.update import linear_update
from cagemap.maps.coincidence import SAME
from cagemap.maps.curves import curve_miss
from cagemap.maps.hypotheses.confidence import Confidence, Reading
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import snap_landmarks
from cagemap.maps.quality import landmark_errors

# Least share of what the target's mask keeps that goes to what the source's mask keeps.
LEAST_JOINT = 0.5
ONE_SURFACE = "vertex on vertex: they are one surface"


def known_map(prepared: PreparedPair, pair: Pair) -> tuple[PointMap, Confidence] | None:
    """The map of surfaces that lie on each other, and how sure it is; None of all others.

    Landmarks and curves move closest points a little, and landmarks are met exactly. Where they are missed by more than
    `LandmarkConfig.confirmed`, or masks keep different parts, they contradict: a map is fitted then.
    """
    masks, landmarks = prepared.masks, pair.landmarks
    if same_surface(pair, masks):
        return identity_map(prepared, pair)
    found = prepared.coincidence
    if found is None:
        return None
    target, source = pair.target.finest_triangles, prepared.source.finest_triangles
    point_map = PointMap(target, found.images(source))
    missed = _missed(point_map, pair)
    if missed > prepared.elastic.landmarks.confirmed or not _joint(point_map, masks):
        return None
    if missed > SAME:
        moved = linear_update(Problem(prepared, pair), point_map)
        shifts = moved - point_map.images.at(prepared.vertices).positions
        shifts = pair.target.hierarchy.prolong(shifts, prepared.levels[0], pair.target.finest)
        point_map = PointMap(target, snap_landmarks(found.images(source, shifts), landmarks))
    apart = f"{100 * found.gap:.2f} % of the model's size apart"
    name = f"as it stands, {apart}: vertices go to the closest points of the same side"
    reading = Reading(name, found.gap**2, point_map.images.at(prepared.vertices).positions)
    return point_map, Confidence.of((reading,), pair.target.control.n_vertices)


def same_surface(pair: Pair, masks: Masks = WHOLE) -> bool:
    """Whether both finest surfaces have the same faces and vertices, in their order, and nobody says anything else.

    Landmarks, curves and masks may: the left arm alone of the target and the right arm alone of the source differ.
    """
    target, source = pair.target.finest_triangles, pair.source.finest_triangles
    if target.n != source.n or not np.array_equal(target.triangles, source.triangles):
        return False
    if masks.target is not None and masks.source is not None and not np.array_equal(masks.target, masks.source):
        return False
    # Moved in its file, a surface is still the same one.
    moved = target.positions - source.positions
    marks = pair.landmarks.target.positions - pair.landmarks.source.positions
    rest = np.concatenate([moved, marks]) - moved.mean(axis=0)
    return not pair.landmarks.curves and bool(np.abs(rest).max() < SAME)


def identity_map(prepared: PreparedPair, pair: Pair) -> tuple[PointMap, Confidence]:
    """Every vertex to itself, and how sure that is."""
    target, source = pair.target.finest_triangles, pair.source.finest_triangles
    found = PointMap.from_vertices(target, source, np.arange(target.n))
    moved = (source.positions - target.positions).mean(axis=0)
    reading = Reading(ONE_SURFACE, 0.0, prepared.mesh.positions + moved)
    return found, Confidence.of((reading,), pair.target.control.n_vertices)


def _missed(point_map: PointMap, pair: Pair) -> float:
    """By how much a map misses the landmark or curve that it misses most."""
    misses = [curve_miss(curve, point_map).worst for curve in pair.landmarks.curves]
    return float(max([*landmark_errors(point_map, pair.landmarks), *misses], default=0.0))


def _joint(point_map: PointMap, masks: Masks) -> bool:
    """Whether what the target's mask keeps goes to what the source's mask keeps."""
    if masks.target is None or masks.source is None:
        return True
    areas = point_map.target.vertex_areas
    return bool(areas @ masks.joint(point_map) >= LEAST_JOINT * (areas @ masks.target))
