"""Descriptors as operators: multiplication by a function, projected on the basis [NO17: Nogneng, Ovsjanikov 2017].

A map that carries f2 to f1 carries g f2 to the image of g times f1: it commutes with both multiplications, which says
more than C f2 = f1 does.
"""

from __future__ import annotations

import numpy as np

from cagemap.basis import HierarchicalBasis
from cagemap.descriptors.symmetry import projected_operator
from cagemap.numerics.arrays import FloatArray


def multiplication_operator(basis: HierarchicalBasis, coefficients: FloatArray) -> FloatArray:
    """O~ = Phi~^+ diag(f) Phi~ with |f| at most 1 (paper, 5.2; [NO17], eq. 6).

    Parameters
    ----------
    basis : HierarchicalBasis
    coefficients : (k,) array
        f, in the basis. Scaled to a largest absolute value of 1, for the scale of a descriptor says nothing.

    Returns
    -------
    (k, k) array, dense
        Its leading blocks are near the operators of the coarser levels.
    """
    level = basis.last_level
    function = _at_vertices(basis, coefficients, level)
    function /= max(float(np.abs(function).max()), np.finfo(float).tiny)
    return projected_operator(basis, lambda values: function[:, None] * values)


def _at_vertices(basis: HierarchicalBasis, coefficients: FloatArray, level: int) -> FloatArray:
    """Values of a function (k,) at the vertices of the last level that has all bands."""
    values = np.empty(basis.refinement.levels[level].n_vertices)
    for part, rows in basis.row_blocks(level):
        values[part] = rows @ coefficients
    return values
