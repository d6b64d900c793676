"""Places on a model: points of its control mesh, and where they lie on the smooth surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.maps.places import LANDMARK_NORMAL_WEIGHT, on_surface
from cagemap.mesh.landmarks import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.landmarks import Place
from cagemap.studio.shape import Hit, Shape, line_hits
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangles import normalized

# Lines that are tried from a place to the control mesh at most, and how close, of sqrt(area), is there.
_STEPS = 10
_CLOSE = 1e-7


def place_of(shape: Shape, hit: Hit) -> Place:
    """Place of a hit."""
    return place_at(shape, hit.position, hit.barycentric @ shape.normals[shape.triangles[hit.triangle]])


def place_at(shape: Shape, position: FloatArray, normal: FloatArray | None = None) -> Place:
    """Place whose point of the smooth surface is the nearest to a position, in file units.

    The inverse of `on_surface`, which goes from a point of the control mesh along the mean of its corners' normals: the
    line through the position meets the control mesh's triangles, spanned between points of the smooth surface, where
    that mean is the line's direction.
    """
    cage, wanted = shape.cage, shape.surface.scale * np.asarray(position, dtype=np.float64)
    if normal is None:
        near = SurfacePoints.nearest(shape.surface, wanted[None])
        wanted, normal = near.positions[0], shape.surface.normals[near.triangle[0]]
    direction = normalized(np.asarray(normal, dtype=np.float64))
    held = SurfacePoints.nearest(cage, wanted[None], direction[None], normal_weight=LANDMARK_NORMAL_WEIGHT)
    tried = [CagePoints(held.corners, held.barycentric)]
    for _ in range(_STEPS):
        triangles, weights, along = line_hits(cage.positions, cage.triangles, wanted, direction)
        facing = np.flatnonzero(cage.normals[triangles] @ direction > 0)
        if not len(facing):
            break
        hit = facing[np.argmin(np.abs(along[facing]))]
        tried.append(CagePoints(cage.triangles[triangles[hit]][None], weights[hit][None]))
        before, direction = direction, normalized(tried[-1].of(shape.surface.vertex_normals)[0])
        if np.linalg.norm(direction - before) < _CLOSE:
            break
    every = CagePoints(*(np.concatenate([getattr(one, name) for one in tried]) for name in ("corners", "weights")))
    missed = np.linalg.norm(on_surface(shape.surface, every).positions - wanted, axis=1)
    return places_of(shape, every.at(missed.argmin(keepdims=True)))[0]


def vertex_place(shape: Shape, vertex: int) -> Place:
    """Place of a control vertex."""
    return places_of(shape, CagePoints.of_vertices(np.array([vertex])))[0]


def places_of(shape: Shape, points: CagePoints) -> tuple[Place, ...]:
    """Places of points of the control mesh."""
    positions = on_surface(shape.surface, points).positions / shape.surface.scale
    rows = zip(positions.tolist(), points.corners.tolist(), points.weights.tolist(), strict=True)
    return tuple(Place((x, y, z), (a, b, c), (u, v, w)) for (x, y, z), (a, b, c), (u, v, w) in rows)


def cage_points(places: Sequence[Place]) -> CagePoints:
    """Points of the control mesh of places."""
    corners = np.array([place.corners for place in places], dtype=np.int64).reshape(-1, 3)
    return CagePoints(corners, np.array([place.weights for place in places], dtype=np.float64).reshape(-1, 3))
