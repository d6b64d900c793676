"""Colour scales, colours that show a map; sRGB in [0, 1]."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray

POSITION_CELLS = 24  # default of `position_colors`
# Evenly spaced anchors of colour scales: like viridis for amounts, blue-white-red for signed values.
AMOUNT_SCALE = np.array(
    [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99],
     [170, 220, 50], [253, 231, 37]]
) / 255.0  # fmt: skip
BALANCE_SCALE = np.array(
    [[33, 78, 146], [67, 133, 190], [146, 197, 222], [222, 232, 238], [247, 246, 244], [249, 221, 205], [240, 160, 128],
     [205, 82, 75], [150, 22, 45]]
) / 255.0  # fmt: skip

# From red to the grey of clay: only low trust is noticeable.
TRUST_SCALE = (
    np.array([[140, 20, 40], [196, 60, 60], [232, 132, 100], [240, 190, 160], [228, 218, 208], [216, 216, 212]]) / 255.0
)


def scalar_colors(values: FloatArray, low: float, high: float, scale: FloatArray = AMOUNT_SCALE) -> FloatArray:
    """(n, 3) colours of values (n,) on a scale from ``low`` to ``high``; NaN becomes grey."""
    span = high - low if high > low else 1.0
    steps = (np.nan_to_num(values, nan=low) - low) / span * (len(scale) - 1)  # np.interp clamps
    anchors = np.arange(len(scale))
    colors = np.stack([np.interp(steps, anchors, scale[:, channel]) for channel in range(3)], axis=1)
    colors[np.isnan(values)] = 0.6
    return colors


def position_colors(points: FloatArray, reference: FloatArray, cells: int = POSITION_CELLS) -> FloatArray:
    """Colours of positions: x, y, z as red, green, blue, with a faint checker.

    They show a map when the source gets its own positions and the target the positions its vertices map to.
    ``reference``: (m, 3) positions that define the range; colours of others are those of its borders.
    ``cells``: number of squares of the checker along the longest side of the range; 0: no checker.
    """
    low, high = reference.min(0), reference.max(0)
    span = np.maximum(high - low, 1e-9 * max(float((high - low).max()), np.finfo(np.float64).tiny))
    unit = np.clip((points - low) / span, 0.0, 1.0)
    colors = 0.16 + 0.78 * unit
    steps = np.floor((points - low) * (cells / float(span.max()))).astype(np.int64)
    return colors * np.where(steps.sum(1) % 2 == 0, 1.0, 0.86)[:, None]


def distinct_colors(count: int) -> FloatArray:
    """(count, 3) colours that differ for neighbouring indices; hues by the golden ratio."""
    hue = (np.arange(count) * 0.61803398875 + 0.02) % 1.0
    lightness = np.where(np.arange(count) % 2 == 0, 0.92, 0.72)
    channel = (hue[:, None] * 6 + np.array([0.0, 4.0, 2.0])) % 6
    pure = np.clip(np.abs(channel - 3.0) - 1.0, 0.0, 1.0)
    return lightness[:, None] * (1.0 - 0.78 * (1.0 - pure))
