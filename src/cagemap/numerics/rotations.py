"""Rotations nearest to linear maps."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray


def nearest_rotations(maps: FloatArray) -> FloatArray:
    """(n, 3, 3) rotations nearest to linear maps (n, 3, 3): the orthogonal factors of their polar decompositions.

    Where the factor is a reflection, the axis of least stretch is reversed.
    """
    left, _, right = np.linalg.svd(maps)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
