"""Vertex colours as files hold them: shares from 0 to 1, or whole numbers up to what a byte holds."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray

_BYTE = 255.0


def as_shares(colors: FloatArray, largest: float | None = None) -> FloatArray:
    """Colours where 1 is full.

    Parameters
    ----------
    colors : (n, 3)
        NaN where a vertex has none.
    largest : float, optional
        What stands for 1, where the file says it. Otherwise whole numbers that go beyond 1 are taken for bytes.
    """
    known = colors[np.isfinite(colors)]
    if largest is None:
        bytes_ = bool(known.max(initial=0.0) > 1.0 and np.all(known == np.rint(known)))
        largest = _BYTE if bytes_ else 1.0
    return colors / largest
