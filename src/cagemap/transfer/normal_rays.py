"""Intersections of the source's normals with a detailed mesh over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray
from cagemap.surface.surface_points import SurfacePoints, nearest_facing
from cagemap.surface.triangle_surface import TriangleSurface

# Detail further from the source than this, in units of sqrt(area), is ignored.
MAX_DETAIL_DISTANCE = 0.1
_NEWTON_STEPS = 5
# Distance, in units of sqrt(area), below which a point of the normal lies on the detail.
_HIT_TOLERANCE = 1e-6
# Least cosine between the normals of source and detail for which Newton's method is tried.
_MIN_COSINE = 0.2


@dataclass(frozen=True, eq=False)
class NormalHits:
    """Points of the detail on the normals of source points; lengths at unit area of the source."""

    # `points`, `normals`: (s, 3) of the source
    points: FloatArray
    normals: FloatArray
    # intersection of the normal with the detail; the nearest point with an agreeing normal where there is none
    foot: SurfacePoints
    heights: FloatArray  # (s,) signed distance of ``foot`` along the normal
    near: NDArray[np.bool_]  # (s,) whether the detail is closer than `MAX_DETAIL_DISTANCE`


def intersect_normals(surface: TriangleSurface, points: FloatArray, normals: FloatArray) -> NormalHits:
    """Intersect normals with the detail by Newton's method, from the nearest points with agreeing normals.

    Each step intersects the normal with the plane of the triangle that is nearest to the last point.

    ``surface``: the detailed mesh, in the source's place and unit. ``points``, ``normals``: (s, 3), of the source at
    unit area; unit length.
    """
    first, distance = nearest_facing(surface, points, normals, MAX_DETAIL_DISTANCE)
    triangle, barycentric = first.triangle.copy(), first.barycentric.copy()
    heights, hit = np.zeros(len(points)), np.zeros(len(points), dtype=np.bool_)
    open_, foot = np.arange(len(points)), first
    for _ in range(_NEWTON_STEPS):
        across, origin, along = foot.normals, points[open_], normals[open_]
        slope = np.einsum("sd,sd->s", along, across)
        height = np.einsum("sd,sd->s", foot.positions - origin, across) / np.where(slope > _MIN_COSINE, slope, np.inf)
        height = np.clip(height, -MAX_DETAIL_DISTANCE, MAX_DETAIL_DISTANCE)
        place = origin + height[:, None] * along
        foot, gap = nearest_facing(surface, place, along, MAX_DETAIL_DISTANCE, foot.triangle)
        here = (gap < _HIT_TOLERANCE) & (slope > _MIN_COSINE)
        done = open_[here]
        heights[done], triangle[done], barycentric[done] = height[here], foot.triangle[here], foot.barycentric[here]
        hit[done] = True
        open_, foot = open_[~here], foot.at(~here)
        if not len(open_):
            break
    nearest_height = np.einsum("sd,sd->s", first.positions - points, normals)
    feet = SurfacePoints(surface, triangle, barycentric)
    return NormalHits(points, normals, feet, np.where(hit, heights, nearest_height), distance <= MAX_DETAIL_DISTANCE)
