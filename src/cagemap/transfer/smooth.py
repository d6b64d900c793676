"""Where the smooth lookup of a texture is possible, and differs from a bilinear one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray

Pixels = NDArray[Any]

# Texels on either side of a point that the smooth lookup needs.
_REACH = 3


def smooth_cells(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h, w) where the 6 x 6 texels around a point between a texel and its right lower neighbours are all covered."""
    height, width = covered.shape
    inside = np.zeros((height, width), dtype=np.bool_)
    rows, columns = height - 2 * _REACH + 1, width - 2 * _REACH + 1
    if rows < 1 or columns < 1:
        return inside
    whole_columns = reduce(np.logical_and, [covered[k : k + rows] for k in range(2 * _REACH)])
    whole = reduce(np.logical_and, [whole_columns[:, k : k + columns] for k in range(2 * _REACH)])
    inside[_REACH - 1 : height - _REACH, _REACH - 1 : width - _REACH] = whole
    return inside


def channel_range(pixels: Pixels) -> tuple[Pixels, Pixels]:
    """(c,) the least and the largest number of every channel."""
    # NumPy reduces over whole rows fast, over rows and columns at once a hundred times slower.
    return np.fmin.reduce(np.fmin.reduce(pixels)), np.fmax.reduce(np.fmax.reduce(pixels))


@dataclass(frozen=True, eq=False)
class SmoothTile:
    """Where a tile is looked up smoothly, and the range of its channels."""

    cells: NDArray[np.bool_]  # (h, w) where all six by six texels are covered, see `smooth_cells`, and not all equal
    # `lowest`, `highest`: (c,) range of every channel, to which values are limited
    lowest: FloatArray
    highest: FloatArray

    @classmethod
    def of(cls, pixels: Pixels, covered: NDArray[np.bool_]) -> SmoothTile:
        """Prepare a tile (h, w, c) whose layout covers some texels (h, w).

        NaN and infinite texels count as uncovered. Where all texels are equal, the bilinear lookup gives the same.
        """
        if pixels.dtype.kind == "f" and not (numbers := np.isfinite(pixels)).all():
            covered = covered & numbers.all(axis=2)
        cells = smooth_cells(covered)
        _leave_even(pixels.view(np.uint16) if pixels.dtype == np.float16 else pixels, cells)
        return cls(cells, *(end.astype(np.float64) for end in channel_range(pixels)))


@numba.njit(cache=True, nogil=True)
def _leave_even(pixels, cells):  # type: ignore[no-untyped-def]
    """Take out of ``cells`` those around which all texels are the same, by the largest even square at each texel.

    That at (r, c) is one larger than the smallest of those to the right, below and across, if their texels are equal.
    """
    height, width, channels = pixels.shape
    below = np.zeros(width + 1, dtype=np.uint8)
    for r in range(height - 1, -1, -1):
        right, across = np.uint8(0), np.uint8(0)  # at (r, c + 1) and (r + 1, c + 1)
        for c in range(width - 1, -1, -1):
            square = np.uint8(1)
            if right > 0 and below[c] > 0 and across > 0:
                same = True
                for k in range(channels):
                    value = pixels[r, c, k]
                    if value != pixels[r, c + 1, k] or value != pixels[r + 1, c, k] or value != pixels[r + 1, c + 1, k]:
                        same = False
                        break
                if same:
                    square = np.uint8(min(min(right, below[c], across) + 1, 2 * _REACH))
            across, below[c], right = below[c], square, square
            if square == 2 * _REACH:
                cells[r + _REACH - 1, c + _REACH - 1] = False
