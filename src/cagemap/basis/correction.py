"""Eigenpairs of one level from those of the level below without a solve: what is missing is of high frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.basis.eigen import EigenPairs, counts_agree
from cagemap.basis.guess import working_type
from cagemap.basis.products import multiply
from cagemap.basis.ritz import Ritz, extended, rayleigh_quotients, rayleigh_ritz, squared_residuals
from cagemap.basis.smoothing import Block, Smoother, residuals, smoother
from cagemap.errors import SolverError
from cagemap.mesh import FloatArray, IndexArray
from cagemap.operators import lumped_areas

# Steps of the smoother in a correction: of what it can reach they leave under a hundredth.
STEPS = 8
# What is left after a correction is gained only in part by the next: a factor of 2 was measured.
_SAFETY = 3.0
# Columns corrected at once: bounds the memory.
_COLUMNS = 64
# Most pairs that are corrected once more in a round.
_MOST_AGAIN = 96
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrections of functions of level l within level l + 1.

    Attributes
    ----------
    subdivision, restriction : (n_{l+1}, n_l) and (n_l, n_{l+1}) CSR arrays
        S^l and its transpose.
    mass : (n_{l+1}, n_{l+1}) CSR array
        Of level l + 1.
    smooth : Smoother
        Of the stiffness matrix of level l + 1.
    """

    subdivision: sparse.csr_array
    restriction: sparse.csr_array
    mass: sparse.csr_array
    smooth: Smoother

    @classmethod
    def between(cls, subdivision: sparse.csr_array, stiffness: sparse.csr_array, mass: sparse.csr_array) -> Correction:
        """From S^l and the operators of level l + 1."""
        return cls(subdivision, sparse.csr_array(subdivision.T), mass, smoother(stiffness))

    @property
    def stiffness(self) -> sparse.csr_array:
        """W of level l + 1."""
        return self.smooth.matrix

    def gains(self, vectors: Block, values: FloatArray, steps: int) -> FloatArray:
        """(m,) r^T Z: by how much a correction lowers each eigenvalue of level l, its own only."""
        gains = np.empty(len(values))
        for part in column_parts(len(values)):
            residual = residuals(self.stiffness, self.mass, multiply(self.subdivision, vectors[:, part]), values[part])
            gains[part] = np.einsum("ij,ij->j", residual, self.smooth(residual, steps))
        return gains

    def corrected(self, vectors: Block, values: FloatArray, fixed: Block) -> Block:
        """(n_{l+1}, m) S X - Z, M-orthogonal to the refined ``fixed`` functions of level l, as S X is."""
        block = np.empty((self.subdivision.shape[0], len(values)), dtype=vectors.dtype)
        for part in column_parts(len(values)):
            prolonged = multiply(self.subdivision, vectors[:, part])
            residual = residuals(self.stiffness, self.mass, prolonged, values[part])
            block[:, part] = prolonged - self.without(fixed, self.smooth(residual, STEPS))
        return block

    def without(self, fixed: Block, block: Block) -> Block:
        """A block of level l + 1 less its part along orthonormal functions of level l."""
        if not fixed.shape[1]:
            return block
        parts = fixed.T @ multiply(self.restriction, multiply(self.mass, block))
        return block - multiply(self.subdivision, fixed @ parts)


def corrected_pairs(
    correction: Correction, coarse: EigenPairs, fixed: Block, *, kept: tuple[int, int], tolerance: float
) -> EigenPairs | None:
    """Consecutive eigenpairs of level l + 1 from those of level l, where these are close already.

    The inertia of W - tau M, tau in a gap near the last pair kept, proves that none was missed.

    Parameters
    ----------
    correction : Correction
    coarse : EigenPairs
        Of level l; those above ``kept`` are guards.
    fixed : (n_l, q) array
        The pairs below, which stay as they are.
    kept : (int, int)
        Range of indices that must be accurate.
    tolerance : float
        Relative accuracy of the eigenvalues kept.

    Returns
    -------
    EigenPairs or None
        With the same indices as ``coarse``; None if the pairs were not close enough.
    """
    dtype = working_type(tolerance)
    inside = np.arange(kept[0], kept[1]) - coarse.first_index
    try:
        pairs = improved(
            correction, coarse.vectors.astype(dtype, copy=False), coarse.values, fixed.astype(dtype), inside, tolerance
        )
        if pairs is None or not counts_agree(
            correction.stiffness, correction.mass, pairs.values, coarse.first_index, None, kept[1]
        ):
            return None
    except SolverError:  # on an eigenvalue, or dependent columns
        return None
    values, areas = pairs.values, lumped_areas(correction.mass)
    norms = np.sqrt(squared_residuals(pairs, areas)) / np.maximum(values, 4.0 * np.pi / float(areas.sum()))
    if dtype == np.float32:
        values = rayleigh_quotients(correction.stiffness, correction.mass, pairs.vectors)
    return EigenPairs(values, pairs.vectors, norms, coarse.first_index)


def improved(
    correction: Correction,
    vectors: Block,
    values: FloatArray,
    fixed: Block,
    inside: IndexArray,
    tolerance: float,
) -> Ritz | None:
    """Eigenpairs of level l + 1 near some of level l, by corrections and Rayleigh-Ritz.

    The residuals R of the prolonged pairs S X are orthogonal to the image of S (paper, eq. 2), so that Z near W^{-1} R
    takes a few steps of smoothing, and the eigenvalues of S X - Z, after Rayleigh-Ritz, are wrong by the square of
    what those of S X were. Pairs for which another correction would still gain too much get it as a further direction.

    Parameters
    ----------
    correction : Correction
    vectors : (n_l, m) array
    values : (m,) array
        Eigenpairs of level l, M-orthonormal, ascending.
    fixed : (n_l, q) array
        Other eigenvectors of level l that the result is to be orthogonal to.
    inside : (k,) int64 array
        Which pairs must be accurate.
    tolerance : float
        Relative.

    Returns
    -------
    Ritz or None
        None if after a few rounds a correction would still gain too much.
    """
    stiffness, mass = correction.stiffness, correction.mass
    block = correction.corrected(vectors, values, fixed)
    pairs = rayleigh_ritz(block, multiply(stiffness, block), multiply(mass, block))
    scale = np.maximum(pairs.values, 1e-3 * pairs.values[-1])
    for _ in range(_ROUNDS):
        # The residual itself, cheap for all pairs, says which to look at.
        squares = squared_residuals(pairs, stiffness.diagonal())
        worst = inside[np.argsort(-(squares / scale)[inside])[:_MOST_AGAIN]]
        residual = pairs.residuals(worst)
        added = correction.smooth(residual, STEPS)
        again = _SAFETY * np.einsum("ij,ij->j", residual, added) > tolerance * scale[worst]
        if not again.any():
            return pairs
        pairs = extended(pairs, correction.without(fixed, added[:, again]), stiffness, mass)
    return None


def column_parts(columns: int) -> list[slice]:
    """All columns, some at a time."""
    return [slice(start, min(columns, start + _COLUMNS)) for start in range(0, columns, _COLUMNS)]
