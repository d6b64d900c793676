"""Rigid starts without landmarks: align bounding boxes or principal axes, or keep the files' positions.

A start is a rough position on the source for every vertex of the target's coarse graph. All preserve orientation: the
elastic fit cannot undo a mirrored start.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.deform.config import SearchConfig
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair
from cagemap.deform.refit import common_rotation
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.surface.alignment import principal_frame, rotations_onto
from cagemap.surface.triangle_surface import TriangleSurface

AS_FILED = "as the files stand"
# The first so many of `rigid_starts` keep the files' axes.
AS_FILED_STARTS = 2
# Least extent of a box; a box that is flat along an axis is not stretched along it.
LEAST_EXTENT = 1e-6


def axis_rotations() -> list[FloatArray]:
    """The 24 rotations of coordinate axes to coordinate axes, sorted by angle; the identity first."""
    rotations = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[np.arange(3), order] = signs
            if np.linalg.det(matrix) > 0:
                rotations.append(matrix)
    return sorted(rotations, key=lambda matrix: -np.trace(matrix))


def rotation_name(matrix: FloatArray) -> str:
    """Description of a rotation (3, 3) for a user."""
    vector = Rotation.from_matrix(matrix).as_rotvec(degrees=True)
    angle = round(float(np.linalg.norm(vector)))
    if angle == 0:
        return AS_FILED
    axis = np.round(vector / np.abs(vector).max()).astype(int)
    if np.count_nonzero(axis) == 1:
        sign = "-" if axis.sum() < 0 and angle != 180 else ""
        return f"turned {angle} degrees about {sign}{'xyz'[int(np.flatnonzero(axis)[0])]}"
    return f"turned {angle} degrees about ({', '.join(map(str, axis))})"


def axis_rotation(areas: FloatArray, maps: FloatArray) -> FloatArray:
    """The one of `axis_rotations` nearest to the differentials (n, 3, 3) of a placement with areas (n,)."""
    common = common_rotation(areas, nearest_rotations(maps))
    return max(axis_rotations(), key=lambda rotation: float((rotation * common).sum()))


def rotation_penalty(matrix: FloatArray, config: SearchConfig) -> float:
    """Factor on the cost of a placement that is rotated by one of `axis_rotations`: files seldom differ in axes."""
    if matrix[1, 1] < 0.5:
        return config.tilted_penalty
    return 1.0 if matrix[0, 0] > 0.5 else config.turned_penalty


def rigid_starts(points: FloatArray, areas: FloatArray, source: TriangleSurface) -> list[Placement]:
    """Placements of points (k, 3) with areas (k,) that align bounding boxes or principal frames with the source's.

    Boxes in all 24 axis rotations, with equal diagonals (one scale) or equal extents (three scales). Principal frames
    in four rotations, not scaled.
    """
    starts = []
    for matrix in axis_rotations():
        turned = points @ matrix.T
        starts += [Placement(_fit_to_box(turned, source.positions, stretched)) for stretched in (False, True)]
    centre, axes, _ = principal_frame(points, areas)
    source_centre, source_axes, _ = principal_frame(source.positions, source.vertex_areas)
    for rotation in rotations_onto(axes, source_axes):
        starts.append(Placement((points - centre) @ rotation.T + source_centre))
    return starts


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
