"""Rigid starts without landmarks: align bounding boxes or principal axes, or keep the files' positions.

A start is a rough position on the source for every vertex of the target's coarse graph. None is mirrored: the elastic
fit cannot undo that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair
from cagemap.deform.refit import common_rotation
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.surface.alignment import Y_UP, axis_rotations, nearest_axis_rotation, principal_frame, rotations_onto
from cagemap.surface.triangle_surface import TriangleSurface

AS_FILED, BY_FILE_AXES = "as the files stand", "by the axes that the files state"
# Starts of `rigid_starts` for each rotation: boxes with one scale and with three.
STARTS_PER_ROTATION = 2
# Least extent of a box; a box that is flat along an axis is not stretched along it.
LEAST_EXTENT = 1e-6


def rotation_name(matrix: FloatArray, usual: Sequence[FloatArray] = ()) -> str:
    """Description for a user of a rotation (3, 3), which may be one of the `usual_rotations`."""
    vector = Rotation.from_matrix(matrix).as_rotvec(degrees=True)
    angle = round(float(np.linalg.norm(vector)))
    if angle == 0:
        return AS_FILED
    if _is_among(matrix, usual):
        return BY_FILE_AXES
    axis = np.round(vector / np.abs(vector).max()).astype(int)
    if np.count_nonzero(axis) == 1:
        sign = "-" if axis.sum() < 0 and angle != 180 else ""
        return f"turned {angle} degrees about {sign}{'xyz'[int(np.flatnonzero(axis)[0])]}"
    return f"turned {angle} degrees about ({', '.join(map(str, axis))})"


def axis_rotation(areas: FloatArray, maps: FloatArray) -> FloatArray:
    """The one of `axis_rotations` nearest to the differentials (n, 3, 3) of a placement with areas (n,)."""
    return nearest_axis_rotation(common_rotation(areas, nearest_rotations(maps)))


def up_rotations(prepared: PreparedPair) -> tuple[FloatArray, FloatArray]:
    """Rotations (3, 3) for rows of target and source to +Y up, to the nearest axes; the identity if it is unknown."""
    given = (side.control.upright for side in (prepared.target, prepared.source))
    target, source = (Y_UP if upright is None else nearest_axis_rotation(upright) for upright in given)
    return target, source


def usual_rotations(prepared: PreparedPair) -> list[FloatArray]:
    """Rotations (3, 3) without a penalty: the identity, and the one from the target's up axis to the source's."""
    target, source = up_rotations(prepared)
    onto_source = source @ target.T
    return [np.eye(3)] if np.array_equal(onto_source, np.eye(3)) else [np.eye(3), onto_source]


def rotation_penalty(matrix: FloatArray, prepared: PreparedPair) -> float:
    """Factor on the cost of a placement that is rotated by one of `axis_rotations`; 1 for `usual_rotations`.

    A rotation about the up axis has the factor ``turned_penalty``, others ``tilted_penalty``. If the files' up axes
    differ, one of the files may be wrong: the smaller factor counts, with these axes and with +Y up in both.
    """
    config, (target, source) = prepared.elastic.search, up_rotations(prepared)
    between_upright = source.T @ matrix @ target

    def penalty(rotation: FloatArray) -> float:  # +Y up; entries are -1, 0 or 1
        if rotation[1, 1] < 0.5:
            return config.tilted_penalty
        return 1.0 if rotation[0, 0] > 0.5 else config.turned_penalty

    penalties = penalty(between_upright), penalty(matrix)
    return penalties[0] if np.array_equal(target, source) else min(penalties)


def rigid_starts(
    points: FloatArray, areas: FloatArray, source: TriangleSurface, usual: Sequence[FloatArray] = ()
) -> list[Placement]:
    """Placements of points (k, 3) with areas (k,) that align bounding boxes or principal frames with the source's.

    Boxes in all 24 axis rotations, the ``usual`` ones first, with equal diagonals (one scale) or equal extents (three
    scales). Principal frames in four rotations, not scaled.
    """
    starts = []
    for matrix in sorted(axis_rotations(), key=lambda one: not _is_among(one, usual)):
        turned = points @ matrix.T
        starts += [Placement(_fit_to_box(turned, source.positions, stretched)) for stretched in (False, True)]
    centre, axes, _ = principal_frame(points, areas)
    source_centre, source_axes, _ = principal_frame(source.positions, source.vertex_areas)
    for rotation in rotations_onto(axes, source_axes):
        starts.append(Placement((points - centre) @ rotation.T + source_centre))
    return starts


def _is_among(matrix: FloatArray, others: Sequence[FloatArray]) -> bool:
    return any(np.array_equal(matrix, other) for other in others)


def _fit_to_box(points: FloatArray, source_points: FloatArray, stretched: bool) -> FloatArray:
    """Points moved and scaled so that their bounding box agrees with the source's."""
    low, high = points.min(axis=0), points.max(axis=0)
    source_low, source_high = source_points.min(axis=0), source_points.max(axis=0)
    extent, wanted = np.maximum(high - low, LEAST_EXTENT), np.maximum(source_high - source_low, LEAST_EXTENT)
    scale = wanted / extent if stretched else np.linalg.norm(wanted) / np.linalg.norm(extent)
    return np.asarray((points - (low + high) / 2) * scale + (source_low + source_high) / 2)


def file_ratio(prepared: PreparedPair) -> float:
    """Factor from the target's unit, sqrt(area), to the source's, in file lengths; 1 for closed surfaces."""
    target, source = prepared.target.finest_triangles, prepared.source.finest_triangles
    if not (target.is_open or source.is_open):
        return 1.0
    ratio, most = source.scale / target.scale, prepared.elastic.search.max_unit_ratio
    return ratio if 1.0 / most <= ratio <= most else 1.0


def units_of_larger(prepared: PreparedPair) -> tuple[float, float]:
    """Units of target and source, as multiples of the larger surface's unit."""
    ratio = file_ratio(prepared)
    return min(ratio, 1.0), min(1.0 / ratio, 1.0)


def unmoved_start(prepared: PreparedPair, points: FloatArray) -> list[Placement]:
    """Start of points (k, 3) at their position in the files; none for closed surfaces or unrelated units."""
    ratio = file_ratio(prepared)
    return [] if ratio == 1.0 else [Placement(np.asarray(ratio * points))]
