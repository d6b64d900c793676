"""Fill what lies outside the UV islands with the nearest texel inside.

A renderer filters across island borders, at coarser mip levels over many texels; with the nearest texel's colour there,
borders do not show. Distances are exact and Euclidean, in time linear in the number of texels: Meijster, Roerdink,
Hesselink, *A general algorithm for computing distance transforms in linear time* (2000).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.threads import ThreadPool

_STRIP = 512
_NOWHERE = np.int16(-1)
LARGEST_SIDE = int(np.iinfo(np.int16).max)


def dilate(image: NDArray[Any], covered: NDArray[np.bool_], *, distance: int | None = None, threads: int = 1) -> None:
    """Give texels that are not covered, in place, the value of the nearest covered one.

    ``image``: (h, w, c), any number type; contiguous; sides up to 32767. ``covered``: (h, w). ``distance``: how far to
    fill, in texels; the whole background by default.
    """
    height, width = covered.shape
    if not covered.any():
        return
    reach = -1 if distance is None else int(distance)
    texels = image.view(np.uint8).reshape(height, width, -1)
    nearest_row = np.empty((height, width), dtype=np.int16)

    def fill(begin: int, end: int) -> None:
        _fill_rows(texels, nearest_row, reach, begin, end, *np.empty((2, width), dtype=np.int64))

    with ThreadPool(threads) as pool:
        _each(pool, lambda begin, end: _nearest_rows(covered, nearest_row, begin, end), width)
        _each(pool, fill, height)


def _each(pool: ThreadPool, work: Callable[[int, int], None], size: int) -> None:
    starts = range(0, size, _STRIP)
    for future in [pool.submit(work, start, min(start + _STRIP, size)) for start in starts]:
        future.result()


@numba.njit(cache=True, nogil=True)
def _nearest_rows(covered, nearest_row, begin, end):  # type: ignore[no-untyped-def]
    """For the columns ``begin`` to ``end``: row of the nearest covered texel of the same column, or _NOWHERE."""
    height = len(covered)
    for r in range(height):
        for c in range(begin, end):
            if covered[r, c]:
                nearest_row[r, c] = r
            elif r > 0:
                nearest_row[r, c] = nearest_row[r - 1, c]
            else:
                nearest_row[r, c] = _NOWHERE
    for r in range(height - 2, -1, -1):
        for c in range(begin, end):
            below = nearest_row[r + 1, c]
            above = nearest_row[r, c]
            if below != _NOWHERE and (above == _NOWHERE or below - r < r - above):
                nearest_row[r, c] = below


@numba.njit(cache=True, nogil=True)
def _fill_rows(texels, nearest_row, reach, begin, end, site, since):  # type: ignore[no-untyped-def]
    """For the rows ``begin`` to ``end``: lower envelope of the columns' parabolas, then copy from the nearest texel.

    Column i holds the parabola (c - i)^2 + h_i^2, h_i being the distance along the column. Only texels that are not
    covered are written, and only covered ones are read, so rows may be done in any order. ``site`` has room for the
    columns whose parabolas make the envelope, ``since`` for the first texel where each of them is the lowest.
    """
    width = texels.shape[1]
    for r in range(begin, end):
        top = -1
        open_texels = False
        for c in range(width):
            row = nearest_row[r, c]
            if row != r:
                open_texels = True
            if row == _NOWHERE:
                continue
            height2 = np.int64(row - r) * np.int64(row - r)
            first = np.int64(0)
            while top >= 0:
                other = site[top]
                other_height = np.int64(nearest_row[r, other] - r)
                # Where this parabola falls below the other one.
                numerator = c * c - other * other + height2 - other_height * other_height
                first = numerator // (2 * (c - other)) + 1
                if first > since[top]:
                    break
                top -= 1
            if top < 0:
                first = np.int64(0)
            if first < width:
                top += 1
                site[top], since[top] = c, first
        if top < 0 or not open_texels:
            continue
        current = 0
        for c in range(width):
            while current < top and since[current + 1] <= c:
                current += 1
            if nearest_row[r, c] == r:
                continue
            column = site[current]
            row = nearest_row[r, column]
            if reach >= 0:
                dr, dc = np.int64(row - r), c - column
                if dr * dr + dc * dc > reach * reach:
                    continue
            for k in range(texels.shape[2]):
                texels[r, c, k] = texels[row, column, k]
