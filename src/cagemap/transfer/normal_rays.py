"""Intersections of the source's normals with a detailed mesh over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray
from cagemap.surface.surface_points import SurfacePoints, nearest_facing
from cagemap.surface.triangle_surface import TriangleSurface

# Detail further from the source than this, in units of sqrt(area), belongs to something else.
REACH = 0.1
# Steps of Newton's method along a normal.
_STEPS = 5
# A normal meets the detail where it comes nearer than this, in units of sqrt(area).
_MET = 1e-6
# A normal that leaves the detailed surface more flatly than this never meets it.
_GRAZING = 0.2


@dataclass(frozen=True, eq=False)
class Met:
    """Where the detail is, seen from points of the source; lengths at unit area of the source.

    Attributes
    ----------
    points, normals : (s, 3) float64
        Of the source.
    foot : SurfacePoints
        Where the normal meets the detail; the nearest point that faces the same way where it does not.
    heights : (s,) float64
        How far along the normal that is.
    near : (s,) bool
        Whether it is in reach.
    """

    points: FloatArray
    normals: FloatArray
    foot: SurfacePoints
    heights: FloatArray
    near: NDArray[np.bool_]


def meet(surface: TriangleSurface, points: FloatArray, normals: FloatArray) -> Met:
    """Follow normals to the detail: Newton's method from the nearest points that face the same way.

    Each step goes on to where the normal meets the plane of the triangle that is nearest now.

    Parameters
    ----------
    surface : TriangleSurface
        The detailed mesh, in the source's place and unit.
    points, normals : (s, 3) float64
        Of the source at unit area; unit length.
    """
    first, distance = nearest_facing(surface, points, normals, REACH)
    triangle, barycentric = first.triangle.copy(), first.barycentric.copy()
    heights, met = np.zeros(len(points)), np.zeros(len(points), dtype=np.bool_)
    open_, foot = np.arange(len(points)), first
    for _ in range(_STEPS):
        across, origin, along = foot.normals, points[open_], normals[open_]
        slope = np.einsum("sd,sd->s", along, across)
        ahead = np.einsum("sd,sd->s", foot.positions - origin, across) / np.where(slope > _GRAZING, slope, np.inf)
        ahead = np.clip(ahead, -REACH, REACH)
        foot, missed = nearest_facing(surface, origin + ahead[:, None] * along, along, REACH, foot.triangle)
        here = (missed < _MET) & (slope > _GRAZING)
        done = open_[here]
        heights[done], triangle[done], barycentric[done] = ahead[here], foot.triangle[here], foot.barycentric[here]
        met[done] = True
        open_, foot = open_[~here], foot.at(~here)
        if not len(open_):
            break
    aside = np.einsum("sd,sd->s", first.positions - points, normals)
    place = SurfacePoints(surface, triangle, barycentric)
    return Met(points, normals, place, np.where(met, heights, aside), distance <= REACH)
