"""Vertex colours as files hold them: shares from 0 to 1, or numbers up to what a byte holds."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray

_BYTE = 255.0
# No light is so many times as bright as white, and bytes that end below are all but black.
_BRIGHTEST = 16.0


def as_shares(colors: FloatArray, largest: float | None = None) -> FloatArray:
    """Colours where 1 is full.

    Parameters
    ----------
    colors : (n, 3)
        NaN where a vertex has none.
    largest : float, optional
        What stands for 1, where the file says it. Otherwise whole numbers that go beyond 1, and all that go far beyond
        (means of bytes), are taken for bytes.
    """
    known = colors[np.isfinite(colors)]
    if largest is None:
        most = known.max(initial=0.0)
        bytes_ = most > _BRIGHTEST or bool(most > 1.0 and np.all(known == np.rint(known)))
        largest = _BYTE if bytes_ else 1.0
    return colors / largest
