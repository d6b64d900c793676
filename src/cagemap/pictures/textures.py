"""Values of textures at texture coordinates."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray

UV_TOLERANCE = 1e-6  # UVs outside 0..1 by at most this are rounding errors: the texture does not repeat there


def repeated_uvs(uv: FloatArray) -> FloatArray:
    """UVs of any shape inside the unit square, where the texture repeats outside of it; its borders stay."""
    return np.asarray(np.where((uv < -UV_TOLERANCE) | (uv > 1.0 + UV_TOLERANCE), uv % 1.0, uv))


def sample_texture(texture: FloatArray, uv: FloatArray) -> FloatArray:
    """(r, channels) bilinear texture values at UVs (r, 2); texel centres at half-integers.

    As in bakes, the texture repeats outside the unit square, but texels at its edges do not mix.
    """
    height, width = texture.shape[:2]
    uv = repeated_uvs(uv)
    x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0.0, height - 1.0)
    column, row = x.astype(np.int64), y.astype(np.int64)
    next_column, next_row = np.ceil(x).astype(np.int64), np.ceil(y).astype(np.int64)
    s, t = (x - column)[:, None], (y - row)[:, None]
    upper = texture[row, column] * (1 - s) + texture[row, next_column] * s
    lower = texture[next_row, column] * (1 - s) + texture[next_row, next_column] * s
    return np.asarray(upper * (1 - t) + lower * t, dtype=np.float64)
