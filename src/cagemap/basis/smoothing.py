"""Chebyshev iteration: what a level adds to functions refined from the level below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.basis.constants import BOUND_STEPS, CONDITION, SEED
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.products import in_row_shares, multiply

Block = NDArray[Any]  # (n, q), float64 or float32


@dataclass(frozen=True, eq=False)
class Smoother:
    """Fixed polynomials in D^{-1} W, D the diagonal of W, near W^{-1} on functions of high frequency.

    Attributes
    ----------
    matrix : (n, n) CSR array
        W.
    inverse : (n,) array
        1 / diagonal of W.
    highest : float
        Largest eigenvalue of D^{-1} W, a few percent high.
    """

    matrix: sparse.csr_array
    inverse: FloatArray
    highest: float

    def __call__(self, right_sides: Block, steps: int) -> Block:
        """Z near W^{-1} R for R of high frequency.

        The momentum is a little below Chebyshev's own, which leaves less after few steps. One fixed polynomial for all
        columns keeps R^T Z symmetric and, but for a ripple, not above R^T W^{-1} R.

        Parameters
        ----------
        right_sides : (n, q) array of float64 or float32
        steps : int
            At least 1, Chebyshev steps.

        Returns
        -------
        (n, q) array of the same type
        """
        right_sides = np.ascontiguousarray(right_sides)
        kind = right_sides.dtype.type
        lowest = self.highest / CONDITION
        centre, radius = 0.5 * (self.highest + lowest), 0.5 * (self.highest - lowest)
        factor = 1.0 / centre
        inverse = self.inverse.astype(kind, copy=False)
        scaled = sparse.csr_array((self.matrix.data.astype(kind, copy=False), self.matrix.indices, self.matrix.indptr))
        before = np.zeros_like(right_sides)
        now = right_sides * (inverse[:, None] * kind(factor))
        for iteration in range(1, steps):
            momentum = 0.5 * (radius * factor) ** 2 if iteration == 1 else (0.5 * radius * factor) ** 2
            factor = 1.0 / (centre - momentum / factor)
            _chebyshev_step(scaled, inverse, right_sides, now, before, momentum, factor)
            before, now = now, before
        return now


def smoother(matrix: sparse.csr_array) -> Smoother:
    """The smoother of a stiffness matrix; a few Lanczos steps bound its largest scaled eigenvalue."""
    root = 1.0 / np.sqrt(matrix.diagonal())
    vector = np.random.default_rng(SEED).standard_normal(matrix.shape[0])
    vector, before = vector / np.linalg.norm(vector), np.zeros(matrix.shape[0])
    diagonal, beside = np.zeros(BOUND_STEPS), np.zeros(BOUND_STEPS)
    for step in range(BOUND_STEPS):
        image = root * (matrix @ (root * vector)) - beside[step - 1] * before
        diagonal[step] = vector @ image
        image -= diagonal[step] * vector
        beside[step] = np.linalg.norm(image)
        vector, before = image / max(beside[step], np.finfo(float).tiny), vector
    highest, ends = linalg.eigh_tridiagonal(diagonal, beside[:-1], select="i", select_range=(len(diagonal) - 1,) * 2)
    return Smoother(matrix, root**2, float(highest[0] + beside[-1] * abs(ends[-1, 0])))


def residuals(stiffness: sparse.csr_array, mass: sparse.csr_array, vectors: Block, values: FloatArray) -> Block:
    """(n, q) W X - M X Lambda, in the type of X."""
    residual = multiply(mass, vectors)
    residual *= -values.astype(vectors.dtype)
    residual += multiply(stiffness, vectors)
    return residual


def _chebyshev_step(
    matrix: sparse.csr_array,
    inverse: NDArray[Any],
    right_sides: Block,
    now: Block,
    before: Block,
    momentum: float,
    factor: float,
) -> None:
    """Put X + momentum (X - before) + factor D^{-1} (R - W X), X the present iterate, in place of the one before."""
    keep, scale = now.dtype.type(momentum), now.dtype.type(factor)
    columns = now.shape[1]

    def share(first: int, last: int) -> None:
        sides = (matrix.indptr, matrix.indices, matrix.data, inverse, right_sides, now, before)
        _chebyshev_rows(*sides, keep, scale, first, last)

    in_row_shares(matrix, columns, share)


@njit(cache=True, nogil=True, fastmath=True)
def _chebyshev_rows(  # type: ignore[no-untyped-def]
    indptr, indices, data, inverse, right_sides, now, before, keep, scale, first, last
):
    """Rows first..last of a Chebyshev step; all blocks in C order, so that the inner loops are contiguous."""
    columns = now.shape[1]
    residual = np.empty(columns, now.dtype)
    for row in range(first, last):
        for j in range(columns):
            residual[j] = right_sides[row, j]
        for entry in range(indptr[row], indptr[row + 1]):
            a, p = data[entry], indices[entry]
            for j in range(columns):
                residual[j] -= a * now[p, j]
        weight = scale * inverse[row]
        for j in range(columns):
            before[row, j] = now[row, j] + keep * (now[row, j] - before[row, j]) + weight * residual[j]
