"""Closest points by trying every triangle: the reference of the kernel, for small inputs."""

from __future__ import annotations

import numpy as np

from cagemap.geometry.triangles import normalized, triangle_normals
from cagemap.numerics.arrays import FloatArray, IndexArray


def closest_points_slowly(
    positions: FloatArray,
    triangles: IndexArray,
    points: FloatArray,
    normals: FloatArray,
    *,
    normal_weight: float = 0.0,
    minimum_cosine: float = -2.0,
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Do what :func:`closest_points` does by trying every triangle: the reference of the kernel, for small inputs."""
    a, b, c = (positions[triangles[:, k]][None] for k in range(3))
    q = points[:, None]
    candidates = [_plane_foot(q, a, b, c)]
    for first, second, slots in ((a, b, (0, 1)), (b, c, (1, 2)), (c, a, (2, 0))):
        edge = second - first
        t = np.clip(np.einsum("mtd,mtd->mt", q - first, edge) / np.einsum("mtd,mtd->mt", edge, edge), 0, 1)
        weights = np.zeros((*t.shape, 3))
        weights[..., slots[0]], weights[..., slots[1]] = 1 - t, t
        candidates.append(weights)
    stacked = np.stack(candidates, axis=2)  # (m, t, 4, 3)
    feet = np.einsum("mtsk,tkd->mtsd", stacked, positions[triangles])
    squared = np.where(stacked.min(axis=-1) < 0, np.inf, ((feet - q[:, :, None]) ** 2).sum(axis=-1))
    best = squared.argmin(axis=2)
    rows, columns = np.indices(best.shape)
    squared, stacked = squared[rows, columns, best], stacked[rows, columns, best]
    cosine = normals @ normalized(triangle_normals(positions, triangles)).T
    cost = np.where(cosine >= minimum_cosine, squared + normal_weight**2 * 2 * (1 - cosine), np.inf)
    triangle = cost.argmin(axis=1)
    m = np.arange(len(points))
    return triangle, stacked[m, triangle], np.sqrt(squared[m, triangle])


def _plane_foot(q: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """(m, t, 3) barycentric coordinates of the foot of the perpendicular on every triangle's plane."""
    normal = np.cross(b - a, c - a)
    area = np.einsum("mtd,mtd->mt", normal, normal)
    beta = np.einsum("mtd,mtd->mt", np.cross(q - a, c - a), normal) / area
    gamma = np.einsum("mtd,mtd->mt", np.cross(b - a, q - a), normal) / area
    return np.stack([1 - beta - gamma, beta, gamma], axis=-1)
