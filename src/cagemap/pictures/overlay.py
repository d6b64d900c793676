"""Marks on top of a rendered picture."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.numerics.arrays import FloatArray
from cagemap.pictures.camera import Camera
from cagemap.pictures.render import Image, Model, visible
from cagemap.surface.polylines import Polyline

# Points that stand for a straight piece of a line.
DOTS_A_PIECE = 12


def draw_dots(
    image: Image, model: Model, camera: Camera, points: FloatArray, colors: FloatArray, *, radius: float = 6.0
) -> Image:
    """Return the picture with a ringed dot at every point of the surface that the camera sees.

    Parameters
    ----------
    points : (p, 3) float64
        On the surface, in its own unit.
    colors : (p, 3) sRGB in [0, 1]
    radius : float
        Pixels.
    """
    height, width = image.shape[:2]
    shown = image.astype(np.float64)
    spots = camera.project(points, width, height)
    for spot, color in zip(spots[seen := visible(model, camera, points)], colors[seen], strict=True):
        reach = radius + 3.0
        x0, y0 = np.maximum(np.floor(spot - reach).astype(int), 0)
        x1, y1 = np.minimum(np.ceil(spot + reach).astype(int) + 1, [width, height])
        if x0 >= x1 or y0 >= y1:
            continue
        y, x = np.mgrid[y0:y1, x0:x1] + 0.5
        distance = np.hypot(x - spot[0], y - spot[1])
        tile = shown[y0:y1, x0:x1]
        for disc, paint in ((radius + 2.0, np.full(3, 255.0)), (radius + 0.6, np.full(3, 40.0)), (radius, color * 255)):
            cover = np.clip(disc - distance + 0.5, 0.0, 1.0)[..., None]
            tile[:] = tile * (1 - cover) + paint * cover
    return np.round(shown).astype(np.uint8)


def draw_line(image: Image, model: Model, camera: Camera, line: Polyline, color: FloatArray) -> Image:
    """Return the picture with a rimmed line along what the camera sees of a polyline on the surface.

    Parameters
    ----------
    line : Polyline
        In the surface's own unit.
    color : (3,) sRGB in [0, 1]
    """
    return _stroke(image, model, camera, line.finer(DOTS_A_PIECE), color, width=3.0, rim=1.0)


def draw_segments(image: Image, model: Model, camera: Camera, segments: FloatArray, color: FloatArray) -> Image:
    """Return the picture with a thin line along what the camera sees of straight pieces on the surface: a wireframe.

    Parameters
    ----------
    segments : (s, 2, 3) float64
        In the surface's own unit.
    color : (3,) sRGB in [0, 1]
    """
    height, across = image.shape[:2]
    ends = camera.project(segments.reshape(-1, 3), across, height).reshape(-1, 2, 2)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    # Dots less than a pixel apart; all pieces take as many as the one of the next power of two.
    counts = 2 ** np.ceil(np.log2(np.maximum(2.0 * np.nan_to_num(lengths, posinf=1.0), 2.0))).astype(np.int64)
    dense = []
    for count in np.unique(np.minimum(counts, 1024)).tolist():
        at = ((np.arange(count) + 0.5) / count)[:, None]
        piece = segments[np.minimum(counts, 1024) == count]
        dense.append((piece[:, None, 0] * (1 - at) + piece[:, None, 1] * at).reshape(-1, 3))
    return _stroke(image, model, camera, np.concatenate(dense), color, width=1.0, rim=0.0) if dense else image


def _stroke(
    image: Image, model: Model, camera: Camera, dense: FloatArray, color: FloatArray, width: float, rim: float
) -> Image:
    """A line of a width through points that lie close together, where the camera sees them; with a white rim."""
    height, across = image.shape[:2]
    spots = camera.project(dense, across, height)[visible(model, camera, dense)]
    if not len(spots):
        return image
    shown = image.astype(np.float64)
    y, x = np.mgrid[:height, :across] + 0.5
    reach = 0.5 * width + rim + 1.5
    distance = cKDTree(spots).query(np.column_stack([x.ravel(), y.ravel()]), distance_upper_bound=reach)[0]
    rims = ((0.5 * width + rim + 0.5, np.full(3, 255.0)),) if rim else ()
    for radius, paint in (*rims, (0.5 * width, np.asarray(color) * 255)):
        cover = np.clip(radius - distance + 0.5, 0.0, 1.0).reshape(height, across, 1)
        shown = shown * (1 - cover) + paint * cover
    return np.round(shown).astype(np.uint8)
