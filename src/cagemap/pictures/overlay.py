"""Marks on top of a rendered picture."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.geometry.polylines import Polyline
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures.camera import Camera
from cagemap.pictures.render import Image, Model, visible

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


def draw_line(
    image: Image, model: Model, camera: Camera, line: Polyline, color: FloatArray, *, width: float = 3.0
) -> Image:
    """Return the picture with a rimmed line along what the camera sees of a polyline on the surface.

    Parameters
    ----------
    line : Polyline
        In the surface's own unit.
    color : (3,) sRGB in [0, 1]
    width : float
        Pixels.
    """
    height, across = image.shape[:2]
    dense = line.finer(DOTS_A_PIECE)
    spots = camera.project(dense, across, height)[visible(model, camera, dense)]
    if not len(spots):
        return image
    shown = image.astype(np.float64)
    y, x = np.mgrid[:height, :across] + 0.5
    distance = cKDTree(spots).query(np.column_stack([x.ravel(), y.ravel()]), distance_upper_bound=width + 3.0)[0]
    for reach, paint in ((0.5 * width + 1.5, np.full(3, 255.0)), (0.5 * width, np.asarray(color) * 255)):
        cover = np.clip(reach - distance + 0.5, 0.0, 1.0).reshape(height, across, 1)
        shown = shown * (1 - cover) + paint * cover
    return np.round(shown).astype(np.uint8)
