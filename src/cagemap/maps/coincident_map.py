"""Point map of coincident surfaces, which need no fit."""

from __future__ import annotations

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.deform.update import linear_update
from cagemap.maps.coincidence import SAME, angle_of
from cagemap.maps.hypotheses.confidence import Confidence, median_distortion
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs, curve_miss
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import snap_landmarks
from cagemap.maps.quality import landmark_errors

LEAST_JOINT = 0.5  # least share of the target's unmasked area whose image is unmasked
ONE_SURFACE = "vertex on vertex: they are one surface"


def coincident_map(problem: Problem) -> tuple[PointMap, Confidence] | None:
    """Map of coincident surfaces and its confidence; None if they do not coincide, or landmarks or masks differ."""
    prepared, landmarks, masks = problem.prepared, problem.landmarks, problem.prepared.masks
    target, source = prepared.target.finest_triangles, prepared.source.finest_triangles
    if same_surface(landmarks, masks):
        moved = (source.positions - target.positions).mean(axis=0)
        answer = Placement(prepared.mesh.positions + moved, 0.0, name=ONE_SURFACE)
        point_map = PointMap.from_vertices(target, source, np.arange(target.n))
        return point_map, Confidence.of((answer,), prepared.control_vertices)
    coincidence = prepared.coincidence
    if coincidence is None:
        return None
    point_map = PointMap(target, coincidence.images(source))
    curve_misses = [curve_miss(curve, point_map).worst for curve in landmarks.curves]
    missed = float(max([*landmark_errors(point_map, landmarks), *curve_misses], default=0.0))
    if missed > prepared.elastic.landmarks.max_confirmed_miss:
        return None
    if masks.target is not None and masks.source is not None:
        areas = target.vertex_areas
        if areas @ masks.joint(point_map) < LEAST_JOINT * (areas @ masks.target):
            return None
    if missed > SAME:
        moved = linear_update(problem, point_map)
        shifts = moved - point_map.images.at(prepared.vertices).positions
        shifts = prepared.target.hierarchy.prolong(shifts, prepared.levels[0], prepared.target.finest_level)
        point_map = PointMap(
            target, snap_landmarks(coincidence.images(source, shifts), landmarks, prepared.elastic.projection)
        )
    gap = f"{100 * coincidence.gap:.2f} % of the model's size apart"
    rotation, scale, shift = coincidence.motion
    place = f"turned by {angle_of(rotation):.0f} degrees and moved" if np.any(shift) else "as it stands"
    size = "" if np.isclose(scale, 1.0, rtol=1e-5) else f", at {scale:.6g} times its size"
    name = f"{place}{size}, {gap}: vertices go to the closest points of the same side"
    answer = Placement(point_map.images.at(prepared.vertices).positions, coincidence.gap**2, name=name)
    ratio = coincidence.source.scale / coincidence.target.scale
    signs = {"squeezed": median_distortion(point_map, masks.target, ratio)}
    return point_map, Confidence.of((answer,), prepared.control_vertices, signs)


def same_surface(landmarks: PointPairs, masks: Masks = WHOLE) -> bool:
    """Whether both finest surfaces have equal faces and vertices, and landmarks, curves and masks agree."""
    target, source = landmarks.target.surface, landmarks.source.surface
    if target.n != source.n or not np.array_equal(target.triangles, source.triangles):
        return False
    if masks.target is not None and masks.source is not None and not np.array_equal(masks.target, masks.source):
        return False
    # A translation in the file does not matter.
    moved = target.positions - source.positions
    marks = landmarks.target.positions - landmarks.source.positions
    rest = np.concatenate([moved, marks]) - moved.mean(axis=0)
    return not landmarks.curves and bool(np.abs(rest).max() < SAME)
