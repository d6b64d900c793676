"""Points of control meshes as points of the finest surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import CagePoints
from cagemap.spectral import Surface
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalized

# Length, of sqrt(area), that opposite normals count when a landmark is put on the surface: thin parts have two sides.
LANDMARK_NORMAL_WEIGHT = 0.01
# Closest points that put a landmark on the surface; each comes nearer to the line by the square of the slope.
LANDMARK_STEPS = 4
# Corrections that find a point of the control mesh for one of the surface.
INVERSE_STEPS = 8


def located(surface: Surface, points: CagePoints) -> SurfacePoints:
    """Points of a control mesh on the finest surface, see `on_surface`."""
    return on_surface(surface.finest_triangles, points)


def on_surface(finest: TriangleSurface, points: CagePoints) -> SurfacePoints:
    """Points of a control mesh on a refined surface, whose first vertices are the control mesh's.

    A point between control vertices lies beside the same mean of their places, along the same mean of their normals:
    the closest point is asked for again from where the last one left that line. From the mean itself, which is inside
    where the surface is convex, whole strips along edges between facets are nearest to nothing.
    """
    vertices = points.vertices
    found = SurfacePoints.from_vertices(finest, np.where(vertices >= 0, vertices, points.corners[:, 0]))
    between = np.flatnonzero(vertices < 0)
    if not len(between):
        return found
    some = points.at(between)
    places, normals = some.of(finest.positions), normalized(some.of(finest.vertex_normals))
    aim = places
    for step in range(LANDMARK_STEPS):
        # The nearer the aim is to its side of a thin part, the less normals have to tell the sides apart.
        weight = LANDMARK_NORMAL_WEIGHT / 4.0**step
        near = SurfacePoints.nearest(finest, aim, normals, normal_weight=weight)
        along = np.einsum("qd,qd->q", near.positions - places, normals)
        aim = places + along[:, None] * normals
    return found.replaced(between, near)


def cage_points_of(surface: Surface, points: SurfacePoints) -> CagePoints:
    """The inverse of `located`: points of the control mesh that lie at, or very near, points of the finest surface.

    The control mesh is laid through its vertices' places on the surface; its nearest point is corrected by what
    `located` misses with it, and the nearest of all steps is kept.
    """
    finest = surface.finest_triangles
    triangles, _ = cage_triangles(surface.control)
    cage = TriangleSurface(finest.positions[: surface.control.n_vertices], triangles, finest.scale)
    aims = points.positions
    best, least = None, np.full(len(points), np.inf)
    for _ in range(INVERSE_STEPS):
        near = SurfacePoints.nearest(cage, aims, points.normals, normal_weight=LANDMARK_NORMAL_WEIGHT)
        tried = CagePoints(near.corners, near.barycentric)
        missed = points.positions - located(surface, tried).positions
        distance = np.linalg.norm(missed, axis=1)
        better = distance < least
        best = tried if best is None else _chosen(better, tried, best)
        least, aims = np.minimum(distance, least), near.positions + missed
    assert best is not None
    return best


def _chosen(better: NDArray[np.bool_], one: CagePoints, other: CagePoints) -> CagePoints:
    """Points of one set where it is better, of the other elsewhere."""
    return CagePoints(
        np.where(better[:, None], one.corners, other.corners), np.where(better[:, None], one.weights, other.weights)
    )
