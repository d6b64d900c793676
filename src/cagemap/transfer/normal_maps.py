"""Detect tangent-space normal maps among colour images."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.numerics.arrays import FloatArray
from cagemap.transfer.baking import unit
from cagemap.transfer.texture import Pixels

# What of the painted texels decode to unit vectors that point outwards, and how nearly.
_SHARE = 0.9
_LENGTH = 0.08
_TEXELS = 100_000


def looks_like_normal_map(pixels: Pixels) -> bool:
    """Whether nearly all texels are unit vectors (r, g, b) = (n + 1) / 2 that point out of the surface.

    Every colour counts once: a large even background does not decide. Black and transparent texels do not count.

    Parameters
    ----------
    pixels : (h, w, c) array
        Integers stand for 0 to 1.
    """
    normals = _normals(pixels)
    if not len(normals):
        return False
    outwards = _unit(normals) & (normals[:, 2] > 0)
    return bool(outwards.mean() > _SHARE and np.median(normals[:, 2]) > 0.5)


def share_of_normals(pixels: Pixels) -> float:
    """Share of the colours that are unit vectors of any direction; 1 where nothing is painted.

    Parameters
    ----------
    pixels : (h, w, c) array
        Integers stand for 0 to 1.
    """
    normals = _normals(pixels)
    return float(_unit(normals).mean()) if len(normals) else 1.0


def _unit(normals: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.asarray(np.abs(np.linalg.norm(normals, axis=1) - 1.0) < _LENGTH)


def _normals(pixels: Pixels) -> FloatArray:
    """The different colours of painted texels as vectors 2 c - 1; none of images with fewer than three channels."""
    if pixels.ndim != 3 or pixels.shape[2] < 3:
        return np.zeros((0, 3))
    step = max(1, int(np.sqrt(pixels.shape[0] * pixels.shape[1] / _TEXELS)))
    values = pixels[::step, ::step].reshape(-1, pixels.shape[2]).astype(np.float64) / unit(pixels.dtype)
    painted = values[:, :3].max(axis=1) > 0
    if pixels.shape[2] > 3:
        painted &= values[:, 3] > 0
    return np.asarray(2.0 * np.unique(values[painted, :3], axis=0) - 1.0)
