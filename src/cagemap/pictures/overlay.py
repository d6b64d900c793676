"""Dots and lines on top of a rendered picture."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.numerics.arrays import FloatArray
from cagemap.pictures.camera import Camera
from cagemap.pictures.render import Image, Model, visible_points
from cagemap.surface.polylines import Polyline

# Points that a segment of a line is drawn with.
POINTS_PER_SEGMENT = 12


def draw_dots(
    image: Image, model: Model, camera: Camera, points: FloatArray, colors: FloatArray, *, radius: float = 6.0
) -> Image:
    """Draw a dot of ``radius`` pixels at every visible point (p, 3) of the surface, in its unit; colours are sRGB."""
    height, width = image.shape[:2]
    pixels = image.astype(np.float64)
    positions = camera.project(points, width, height)
    is_visible = visible_points(model, camera, points)
    for position, color in zip(positions[is_visible], colors[is_visible], strict=True):
        reach = radius + 3.0
        x0, y0 = np.maximum(np.floor(position - reach).astype(int), 0)
        x1, y1 = np.minimum(np.ceil(position + reach).astype(int) + 1, [width, height])
        if x0 >= x1 or y0 >= y1:
            continue
        y, x = np.mgrid[y0:y1, x0:x1] + 0.5
        distance = np.hypot(x - position[0], y - position[1])
        tile = pixels[y0:y1, x0:x1]
        rings = (radius + 2.0, np.full(3, 255.0)), (radius + 0.6, np.full(3, 40.0)), (radius, color * 255)
        for disc, pixel_color in rings:
            cover = np.clip(disc - distance + 0.5, 0.0, 1.0)[..., None]
            tile[:] = tile * (1 - cover) + pixel_color * cover
    return np.round(pixels).astype(np.uint8)


def draw_line(image: Image, model: Model, camera: Camera, line: Polyline, color: FloatArray) -> Image:
    """Draw the visible parts of a polyline on the surface, in its unit."""
    return _draw_stroke(image, model, camera, line.finer(POINTS_PER_SEGMENT), color, width=3.0, rim=1.0)


def draw_segments(image: Image, model: Model, camera: Camera, segments: FloatArray, color: FloatArray) -> Image:
    """Draw the visible parts of segments (s, 2, 3) on the surface, in its unit, as thin lines."""
    height, columns = image.shape[:2]
    ends = camera.project(segments.reshape(-1, 3), columns, height).reshape(-1, 2, 2)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    # Points less than a pixel apart; their number is rounded up to a power of two, so that segments form few groups.
    counts = 2 ** np.ceil(np.log2(np.maximum(2.0 * np.nan_to_num(lengths, posinf=1.0), 2.0))).astype(np.int64)
    points = []
    for count in np.unique(np.minimum(counts, 1024)).tolist():
        shares = ((np.arange(count) + 0.5) / count)[:, None]
        group = segments[np.minimum(counts, 1024) == count]
        points.append((group[:, None, 0] * (1 - shares) + group[:, None, 1] * shares).reshape(-1, 3))
    return _draw_stroke(image, model, camera, np.concatenate(points), color, width=1.0, rim=0.0) if points else image


def _draw_stroke(
    image: Image, model: Model, camera: Camera, points: FloatArray, color: FloatArray, width: float, rim: float
) -> Image:
    """Draw a line through the visible ones of dense points, with a white rim."""
    height, columns = image.shape[:2]
    positions = camera.project(points, columns, height)[visible_points(model, camera, points)]
    if not len(positions):
        return image
    pixels = image.astype(np.float64)
    y, x = np.mgrid[:height, :columns] + 0.5
    reach = 0.5 * width + rim + 1.5
    distance = cKDTree(positions).query(np.column_stack([x.ravel(), y.ravel()]), distance_upper_bound=reach)[0]
    rims = ((0.5 * width + rim + 0.5, np.full(3, 255.0)),) if rim else ()
    for radius, pixel_color in (*rims, (0.5 * width, np.asarray(color) * 255)):
        cover = np.clip(radius - distance + 0.5, 0.0, 1.0).reshape(height, columns, 1)
        pixels = pixels * (1 - cover) + pixel_color * cover
    return np.round(pixels).astype(np.uint8)
