"""Intersect the source's normals with a detailed mesh; compute ambient occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.process import import_library
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface, nearest_facing
from cagemap.transfer.textured_surface import plane_basis

# Largest distance of detail from the source, in units of sqrt(area); farther detail is ignored.
MAX_DETAIL_DISTANCE = 0.1
_NEWTON_STEPS = 5
# Distance, in units of sqrt(area), below which a point of the normal is on the detail.
_HIT_TOLERANCE = 1e-6
# Least cosine between the normals of source and detail for which Newton's method is tried.
_MIN_COSINE = 0.2


@dataclass(frozen=True, eq=False)
class NormalHits:
    """Intersections of source normals with the detail; lengths at unit area of the source."""

    # `points`, `normals`: (s, 3) of the source
    points: FloatArray
    normals: FloatArray
    # intersection of the normal with the detail, or without one the nearest point with an agreeing normal
    foot: SurfacePoints
    heights: FloatArray  # (s,) signed distance of ``foot`` along the normal
    near: NDArray[np.bool_]  # (s,) whether the detail is closer than `MAX_DETAIL_DISTANCE`


def intersect_normals(surface: TriangleSurface, points: FloatArray, normals: FloatArray) -> NormalHits:
    """Intersect unit normals (s, 3) at source points (s, 3) with the detail, both at the source's unit area.

    By Newton's method from nearest points with agreeing normals: each step intersects the normal with the plane of the
    triangle that is nearest to the last point.
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
        reached = (gap < _HIT_TOLERANCE) & (slope > _MIN_COSINE)
        done = open_[reached]
        heights[done], triangle[done], barycentric[done] = (
            height[reached],
            foot.triangle[reached],
            foot.barycentric[reached],
        )
        hit[done] = True
        open_, foot = open_[~reached], foot.at(~reached)
        if not len(open_):
            break
    nearest_height = np.einsum("sd,sd->s", first.positions - points, normals)
    feet = SurfacePoints(surface, triangle, barycentric)
    return NormalHits(points, normals, feet, np.where(hit, heights, nearest_height), distance <= MAX_DETAIL_DISTANCE)


# Height above the surface at which rays start, in units of sqrt(area): Embree computes in single precision.
_LIFT = 1e-4
# Rays at a time: 40 bytes each.
_RAYS_AT_ONCE = 1 << 20
# Golden ratio: angle between directions of one vertex, and between the patterns of two vertices (no pattern shows).
_GOLDEN = 0.618033988749895


def ambient_occlusion(surface: TriangleSurface, rays: int = 128) -> FloatArray:
    """(n,) visible share of the cosine-weighted hemisphere over every vertex, from 0 to 1.

    ``rays``: number per vertex; directions are the same in every run.
    """
    if rays < 1:
        raise ParameterError(f"occlusion: expected 1 ray or more, got {rays}")
    scene = import_library("embreex.rtcore_scene", "ambient occlusion").EmbreeScene()
    middle = surface.positions.mean(axis=0)
    places = surface.positions - middle
    meshes = import_library("embreex.mesh_construction", "ambient occlusion")
    meshes.TriangleMesh(scene, places.astype(np.float32), surface.triangles.astype(np.int32))
    normals = surface.vertex_normals
    sky = _sky(rays)
    open_part = np.empty(surface.n)
    step = max(1, _RAYS_AT_ONCE // rays)
    for begin in range(0, surface.n, step):
        part = slice(begin, min(surface.n, begin + step))
        basis = plane_basis(normals[part], np.broadcast_to([1.0, 0.0, 0.0], normals[part].shape))
        angle = 2 * np.pi * ((np.arange(part.start, part.stop) * _GOLDEN) % 1.0)
        cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
        across = basis[:, :, 0] * cosine + basis[:, :, 1] * sine
        along = basis[:, :, 1] * cosine - basis[:, :, 0] * sine
        frames = np.stack([across, along, normals[part]], axis=1)  # rows
        directions = np.einsum("rk,nkd->nrd", sky, frames).reshape(-1, 3).astype(np.float32)
        origins = np.repeat(places[part] + _LIFT * normals[part], rays, axis=0).astype(np.float32)
        hidden = np.asarray(scene.run(origins, directions, query="OCCLUDED")) >= 0
        open_part[part] = 1.0 - hidden.reshape(-1, rays).mean(axis=1)
    return open_part


def _sky(rays: int) -> FloatArray:
    """(rays, 3) cosine-weighted directions about the axis z: a golden-angle spiral on the disk, projected up."""
    index = np.arange(rays) + 0.5
    squared_radius = index / rays
    angle = 2 * np.pi * _GOLDEN * index
    radius = np.sqrt(squared_radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - squared_radius)])
