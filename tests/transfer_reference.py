"""Slow twins of this room's kernels, written for reading: tests compare the two."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from cagemap.numerics.arrays import FloatArray, IndexArray
from closest_reference import closest_points_slowly


def neighbors_slowly(corners: IndexArray) -> IndexArray:
    """Twin of `surface.triangle_neighbors` on manifold meshes."""
    owner: dict[frozenset[int], list[tuple[int, int]]] = {}
    for t, triangle in enumerate(corners):
        for k in range(3):
            owner.setdefault(frozenset((int(triangle[k - 2]), int(triangle[k - 1]))), []).append((t, k))
    result = np.full(corners.shape, -1)
    for sides in owner.values():
        if len(sides) == 2:
            (t, k), (u, j) = sides
            result[t, k], result[u, j] = u, t
    return result


def rasterize_slowly(corners: FloatArray, height: int, width: int) -> IndexArray:
    """Twin of `texels.rasterize_band` without a gutter: the first triangle over every texel's centre, or -1."""
    rows, columns = np.mgrid[0:height, 0:width] + 0.5
    image = np.full((height, width), -1)
    for t in reversed(range(len(corners))):
        (x0, y0), (x1, y1), (x2, y2) = corners[t]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0:
            continue
        b1 = ((columns - x0) * (y2 - y0) - (x2 - x0) * (rows - y0)) / area
        b2 = ((x1 - x0) * (rows - y0) - (columns - x0) * (y1 - y0)) / area
        image[(b1 >= -1e-7) & (b2 >= -1e-7) & (b1 + b2 <= 1 + 1e-7)] = t
    return image


def border_distance_slowly(corners: FloatArray, neighbors: IndexArray, height: int, width: int) -> FloatArray:
    """(height, width, e) distance of texels' centres to the border edges of a layout: what the gutter measures."""
    triangle, opposite = np.nonzero(neighbors < 0)
    a, b = corners[triangle, (opposite + 1) % 3], corners[triangle, (opposite + 2) % 3]
    rows, columns = np.mgrid[0:height, 0:width] + 0.5
    points = np.stack([columns, rows], axis=2)[:, :, None]
    t = np.clip(np.einsum("rced,ed->rce", points - a, b - a) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return np.asarray(np.linalg.norm(points - a - t[..., None] * (b - a), axis=3))


def closest_slowly(positions: FloatArray, triangles: IndexArray, points: FloatArray) -> FloatArray:
    """(k, 3) closest points of a surface, by trying every triangle: what the walk of `locate` should come to."""
    normals = np.zeros_like(points)
    triangle, barycentric, _ = closest_points_slowly(positions, triangles, points, normals)
    return np.einsum("kc,kcd->kd", barycentric, positions[triangles[triangle]])


def look_up_slowly(pixels: NDArray[Any], uvs: FloatArray) -> FloatArray:
    """(k, c) bilinear lookup of points inside the unit square: twin of `texture.look_up` for one sample a texel."""
    height, width, channels = pixels.shape
    at = [(1 - uvs[:, 1]) * height - 0.5, uvs[:, 0] * width - 0.5]
    return np.stack(
        [map_coordinates(pixels[:, :, k].astype(float), at, order=1, mode="nearest") for k in range(channels)], axis=1
    )


def dilate_slowly(image: NDArray[Any], covered: NDArray[np.bool_]) -> tuple[NDArray[Any], FloatArray]:
    """Image filled from the nearest covered texel, and every texel's distance to it: twin of `dilation.dilate`."""
    distance, (rows, columns) = distance_transform_edt(~covered, return_indices=True)
    return image[rows, columns], distance


def smooth_slowly(pixels: NDArray[Any], uvs: FloatArray) -> FloatArray:
    """(k, c) lookup by six points along each side, unlimited, of points with three texels on every side: slow twin."""
    height, width = pixels.shape[:2]
    found = []
    for u, v in uvs:
        x, y = u * width - 0.5, (1 - v) * height - 0.5
        column, row = int(x), int(y)
        window = pixels[row - 2 : row + 4, column - 2 : column + 4].astype(np.float64)
        across, down = (_keys(np.abs(np.arange(-2, 4) - offset)) for offset in (x - column, y - row))
        found.append(np.einsum("i,j,ijc->c", down, across, window))
    return np.array(found)


def _keys(s: FloatArray) -> FloatArray:
    near = 4 / 3 * s**3 - 7 / 3 * s**2 + 1
    middle = -7 / 12 * s**3 + 3 * s**2 - 59 / 12 * s + 5 / 2
    far = s**3 / 12 - 2 / 3 * s**2 + 7 / 4 * s - 3 / 2
    return np.asarray(np.select([s < 1, s < 2], [near, middle], far))
