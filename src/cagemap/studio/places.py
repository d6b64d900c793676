"""Places on a model: points of the control mesh and of the refined surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.maps.pair import LANDMARK_NORMAL_WEIGHT, locate
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.landmarks import Place
from cagemap.studio.shape import Hit, Shape, line_hits
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import normalize_rows

# Iterations of `nearest_place`, and the change of direction that ends them.
_MAX_ITERATIONS = 10
_DIRECTION_TOLERANCE = 1e-7


def hit_place(shape: Shape, hit: Hit) -> Place:
    """Place of a click."""
    return nearest_place(shape, hit.position, hit.barycentric @ shape.normals[shape.triangles[hit.triangle]])


def nearest_place(shape: Shape, position: FloatArray, normal: FloatArray | None = None) -> Place:
    """Place nearest to a position in file units; inverse of `locate`.

    `locate` moves a point of the control mesh along the mean of its corners' normals. The inverse iterates: the
    line through the position along the last direction meets the control mesh, whose mean normal there is the next
    direction.
    """
    cage, point = shape.cage, shape.surface.scale * np.asarray(position, dtype=np.float64)
    if normal is None:
        nearest = SurfacePoints.nearest(shape.surface, point[None])
        point, normal = nearest.positions[0], shape.surface.normals[nearest.triangle[0]]
    direction = normalize_rows(np.asarray(normal, dtype=np.float64))
    start = SurfacePoints.nearest(cage, point[None], direction[None], normal_weight=LANDMARK_NORMAL_WEIGHT)
    candidates = [CagePoints(start.corners, start.barycentric)]
    for _ in range(_MAX_ITERATIONS):
        triangles, weights, distances = line_hits(cage.positions, cage.triangles, point, direction)
        facing = np.flatnonzero(cage.normals[triangles] @ direction > 0)
        if not len(facing):
            break
        hit = facing[np.argmin(np.abs(distances[facing]))]
        candidates.append(CagePoints(cage.triangles[triangles[hit]][None], weights[hit][None]))
        before, direction = direction, normalize_rows(candidates[-1].of(shape.surface.vertex_normals)[0])
        if np.linalg.norm(direction - before) < _DIRECTION_TOLERANCE:
            break
    points = CagePoints(
        np.concatenate([candidate.corners for candidate in candidates]),
        np.concatenate([candidate.weights for candidate in candidates]),
    )
    errors = np.linalg.norm(locate(shape.surface, points).positions - point, axis=1)
    return cage_places(shape, points.at(errors.argmin(keepdims=True)))[0]


def vertex_place(shape: Shape, vertex: int) -> Place:
    """Place of a control vertex."""
    return cage_places(shape, CagePoints.of_vertices(np.array([vertex])))[0]


def cage_places(shape: Shape, points: CagePoints) -> tuple[Place, ...]:
    """Places of points of the control mesh."""
    positions = locate(shape.surface, points).positions / shape.surface.scale
    rows = zip(positions.tolist(), points.corners.tolist(), points.weights.tolist(), strict=True)
    return tuple(Place((x, y, z), (a, b, c), (u, v, w)) for (x, y, z), (a, b, c), (u, v, w) in rows)


def cage_points(places: Sequence[Place]) -> CagePoints:
    """Points of the control mesh at places."""
    corners = np.array([place.corners for place in places], dtype=np.int64).reshape(-1, 3)
    return CagePoints(corners, np.array([place.weights for place in places], dtype=np.float64).reshape(-1, 3))
