"""sRGB encoding of linear colours (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray


def encode_srgb(linear: FloatArray) -> FloatArray:
    """Encode linear values from 0 to 1 as sRGB."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def decode_srgb(encoded: FloatArray) -> FloatArray:
    """Linear values of sRGB values."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
