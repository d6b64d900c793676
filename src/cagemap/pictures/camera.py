"""Cameras that frame a surface that faces +Z with +Y up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray

# Vertical opening angle in degrees, and free border as a share of the image.
OPENING_DEGREES, MARGIN = 28.0, 0.06


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera."""

    eye: FloatArray  # its position, in the mesh's unit
    axes: FloatArray  # rows: right, up, and backward (towards the eye). Orthonormal.
    half_height: float  # tangent of half the vertical opening angle

    def rays(self, width: int, height: int, offset: tuple[float, float] = (0.5, 0.5)) -> FloatArray:
        """(height * width, 3) directions, not of unit length, through one point of every pixel.

        Row 0 is the top. ``offset`` is the point in the pixel, (column, row) from 0 to 1.
        """
        right = (2.0 * (np.arange(width) + offset[0]) / width - 1.0) * self.half_height * width / height
        up = (1.0 - 2.0 * (np.arange(height) + offset[1]) / height) * self.half_height
        columns = right[:, None] * self.axes[0] - self.axes[2]  # (width,3)
        return (up[:, None, None] * self.axes[1] + columns).reshape(-1, 3)

    def project(self, points: FloatArray, width: int, height: int) -> FloatArray:
        """(p, 2) image position (column, row) in pixels of points (p, 3) in front of the camera."""
        right, up, back = ((points - self.eye) @ self.axes.T).T
        depth = np.maximum(-back, np.finfo(np.float64).tiny)
        return np.stack(
            [
                (right / depth / self.half_height * height / width + 1.0) * width / 2,
                (1.0 - up / depth / self.half_height) * height / 2,
            ],
            axis=1,
        )


@dataclass(frozen=True)
class View:
    """A named viewing direction."""

    name: str
    # `azimuth`, `elevation`: degrees; azimuth 0 looks at the front (+Z), 90 at the figure's own left (+X)
    azimuth: float
    elevation: float


def turn_angle(from_points: FloatArray, to_points: FloatArray) -> float:
    """Angle, in degrees, of the least-squares rotation about Y between centred points (p, 3).

    0 where the points do not determine it.
    """
    a, b = from_points - from_points.mean(0), to_points - to_points.mean(0)
    sine = float(np.sum(a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]))
    cosine = float(np.sum(a[:, 0] * b[:, 0] + a[:, 2] * b[:, 2]))
    return float(np.degrees(np.arctan2(sine, cosine)))


FRONT = View("three-quarter view", 35.0, 12.0)
SIDE = View("side view", 90.0, 6.0)
BACK = View("from the other side", 215.0, 14.0)
VIEWS = (FRONT, SIDE, BACK)


def frame(positions: FloatArray, view: View = FRONT, *, aspect: float = 4 / 3) -> Camera:
    """Camera whose image holds the whole surface, seen from ``view``.

    Parameters
    ----------
    positions : (n, 3) float64
    aspect : float
        Image width / height.

    Raises
    ------
    ParameterError
        If there are no points, or some are not finite.
    """
    if len(positions) == 0 or not np.isfinite(positions).all():
        raise ParameterError("frame: expected finite positions (n, 3) with n > 0; nothing to look at otherwise.")
    azimuth, elevation = np.radians([view.azimuth, view.elevation])
    back = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    local = positions @ axes.T  # (n,3) in camera axes
    centre = (local.min(0) + local.max(0)) / 2
    local = local - centre
    tangent = float(np.tan(np.radians(OPENING_DEGREES) / 2))
    usable = tangent * (1.0 - MARGIN)
    # |x| <= (distance - z) * usable * aspect for every point, and the same upwards.
    distance = float(np.max(local[:, 2] + np.maximum(np.abs(local[:, 0]) / aspect, np.abs(local[:, 1])) / usable))
    distance = max(distance, 1e-12 * (1.0 + float(np.abs(centre).max())))
    return Camera(axes.T @ (centre + np.array([0.0, 0.0, distance])), axes, tangent)
