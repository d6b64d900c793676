"""Eigenpairs of one level from those of the level below without a solve: what is missing is of high frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from cagemap.basis.eigen import EigenPairs, shifted_matrix
from cagemap.basis.guess import gap_after, working_type
from cagemap.basis.ritz import Ritz, extended, rayleigh_quotients, ritz_rotation, rotated
from cagemap.basis.smoothing import Block, Smoother, residuals, smoother
from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Analysis, Factorization, analyze, factor
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import ThreadPool, parts

# Steps of the smoother in a correction: of what it can reach they leave under a hundredth.
STEPS = 8
# Columns corrected at once: bounds the memory.
_COLUMNS = 64
# Pairs looked at after the correction, the worst; where one is not good enough yet, as many as this at a time.
_CHECKED = 24
_MOST_AGAIN = 96
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Bound:
    """W - tau M of level l + 1, factored, tau in a gap near the last pair wanted."""

    shift: float
    shifted: Factorization


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
    rank : (n_{l+1},) array
        Row of every vertex of level l + 1 in all these: neighbours are near each other, for the cache.
    """

    subdivision: sparse.csr_array
    restriction: sparse.csr_array
    mass: sparse.csr_array
    smooth: Smoother
    rank: IndexArray

    @classmethod
    def between(cls, subdivision: sparse.csr_array, stiffness: sparse.csr_array, mass: sparse.csr_array) -> Correction:
        """From S^l and the operators of level l + 1."""
        order = csgraph.reverse_cuthill_mckee(stiffness, symmetric_mode=True)
        rows = sparse.csr_array(subdivision[order])
        stiffness, mass = (sparse.csr_array(matrix[order][:, order]) for matrix in (stiffness, mass))
        return cls(rows, sparse.csr_array(rows.T), mass, smoother(stiffness), np.argsort(order))

    @property
    def stiffness(self) -> sparse.csr_array:
        """W of level l + 1."""
        return self.smooth.matrix

    def like(self, block: Block) -> Correction:
        """The same with matrices of a block's type, which are then not converted for every part of its columns."""
        dtype: Any = block.dtype
        subdivision, restriction, mass, stiffness = (
            sparse.csr_array((matrix.data.astype(dtype, copy=False), matrix.indices, matrix.indptr), shape=matrix.shape)
            for matrix in (self.subdivision, self.restriction, self.mass, self.stiffness)
        )
        return Correction(subdivision, restriction, mass, replace(self.smooth, matrix=stiffness), self.rank)

    def prolonged(self, vectors: Block, values: FloatArray) -> tuple[Block, Block]:
        """(n_{l+1}, m) S X, and its residuals W S X - M S X Lambda."""
        block = multiply(self.subdivision, vectors)
        return block, residuals(self.stiffness, self.mass, block, values)

    def gains(self, vectors: Block, values: FloatArray, steps: int) -> FloatArray:
        """(m,) r^T Z: by how much a correction lowers each eigenvalue of level l, its own only."""
        alike, gains = self.like(vectors), np.empty(len(values))
        for part in parts(len(values), _COLUMNS):
            _, residual = alike.prolonged(vectors[:, part], values[part])
            gains[part] = np.einsum("ij,ij->j", residual, alike.smooth(residual, steps))
        return gains

    def corrected(self, vectors: Block, values: FloatArray, fixed: Block) -> tuple[Block, FloatArray]:
        """(n_{l+1}, m) S X - Z, M-orthogonal to the refined ``fixed`` functions of level l, as S X is; (m,) r^T Z."""
        block, gains = np.empty((self.subdivision.shape[0], len(values)), dtype=vectors.dtype), np.empty(len(values))
        alike = self.like(vectors)
        for part in parts(len(values), _COLUMNS):
            prolonged, residual = alike.prolonged(vectors[:, part], values[part])
            change = alike.smooth(residual, STEPS)
            gains[part] = np.einsum("ij,ij->j", residual, change)
            block[:, part] = prolonged - alike.without(fixed, change)
        return block, gains

    def analyzed(self) -> Analysis:
        """Of W - tau M, whatever tau."""
        return analyze(shifted_matrix(self.stiffness, self.mass, -1.0))

    def bound(self, values: FloatArray, end: int, analysis: Analysis) -> Bound:
        """Of eigenvalues in any order, where index ``end`` is the first that is not wanted."""
        shift = gap_after(np.sort(values), end)
        return Bound(shift, factor(shifted_matrix(self.stiffness, self.mass, shift), like=analysis))

    def errors(self, vectors: Block, values: FloatArray, bound: Bound) -> FloatArray:
        """(m,) how far each eigenvalue of level l is from level l + 1, by solves."""
        if not len(values):
            return np.zeros(0)
        _, residual = self.prolonged(vectors, values)
        return np.abs(np.einsum("ij,ij->j", residual, bound.shifted.solve(residual)))

    def without(self, fixed: Block, block: Block) -> Block:
        """A block of level l + 1 less its part along orthonormal functions of level l."""
        if not fixed.shape[1]:
            return block
        along = fixed.T @ multiply(self.restriction, multiply(self.mass, block))
        return block - multiply(self.subdivision, fixed @ along)


def corrected_pairs(
    correction: Correction, coarse: EigenPairs, fixed: Block, *, kept: tuple[int, int], tolerance: float
) -> EigenPairs | None:
    """Consecutive eigenpairs of level l + 1 from those of level l, where these are close already.

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
    vectors, fixed = (block.astype(dtype, copy=False) for block in (coarse.vectors, fixed))
    found = improved(
        correction, vectors, coarse.values, fixed, np.zeros(0), inside, coarse.first_index, kept[1], tolerance
    )
    if found is None:
        return None
    values = rayleigh_quotients(correction.stiffness, correction.mass, found[1])
    return EigenPairs(values, found[1][correction.rank], coarse.first_index)


def improved(
    correction: Correction,
    vectors: Block,
    values: FloatArray,
    fixed: Block,
    others: FloatArray,
    inside: IndexArray,
    first_index: int,
    end: int,
    tolerance: float,
    known: Bound | None = None,
) -> tuple[FloatArray, Block] | None:
    """Eigenpairs of level l + 1 near some of level l, by corrections and Rayleigh-Ritz.

    The residuals R of the prolonged pairs S X are orthogonal to the image of S (paper, eq. 2), so that Z near W^{-1} R
    takes a few steps of smoothing, and the eigenvalues of S X - Z, after Rayleigh-Ritz, are wrong by the square of
    what those of S X were. W - tau M, tau in a gap near the last pair wanted, is factored once: its inertia proves that
    no pair was missed, and pairs that are not good enough yet get (W - tau M)^{-1} r as a further direction.

    Parameters
    ----------
    correction : Correction
    vectors : (n_l, m) array
    values : (m,) array
        Eigenpairs of level l, M-orthonormal, ascending.
    fixed : (n_l, q) array
        Other eigenvectors of level l that the result is to be orthogonal to.
    others : (o,) array
        Eigenvalues of level l + 1 that are known well enough to be counted, from ``first_index`` on.
    inside : (k,) int64 array
        Which pairs must be accurate.
    first_index : int
        How many eigenvalues lie below all these.
    end : int
        Index after the last pair wanted.
    tolerance : float
        Relative.
    known : Bound, optional
        W - tau M, if it is factored already.

    Returns
    -------
    (m,) array and (n_{l+1}, m) array, or None
        Eigenvalues and eigenvectors, rows in the order of the correction. None if the pairs do not get accurate within
        a few rounds, or the inertia counts other eigenvalues.
    """
    stiffness, mass = correction.stiffness, correction.mass
    with ThreadPool(1) as aside:
        analysis = aside.submit(correction.analyzed if known is None else Analysis)
        block, errors = correction.corrected(vectors, values, fixed)
        try:
            images = multiply(stiffness, block), multiply(mass, block)
            found, rotation = ritz_rotation(block, *images)
            bound = known or correction.bound(np.concatenate([others, found]), end - first_index, analysis.result())
        except SolverError:  # on an eigenvalue, or dependent columns
            return None
    vectors = rotated(block, rotation)
    scale = np.maximum(found, 1e-3 * found[-1])
    errors /= scale
    pairs: Ritz | None = None
    for batch in (_CHECKED,) + (_MOST_AGAIN,) * _ROUNDS:
        # Those that were worst to begin with are looked at first.
        worst = inside[np.argsort(-errors[inside])[:batch]]
        residual = residuals(stiffness, mass, vectors[:, worst], found[worst])
        added = bound.shifted.solve(residual).astype(residual.dtype)
        errors[worst] = np.abs(np.einsum("ij,ij->j", residual, added)) / scale[worst]
        again = errors[worst] > tolerance
        if not again.any():
            below = first_index + np.sum(others < bound.shift) + np.sum(found < bound.shift)
            return (found, vectors) if bound.shifted.negative_eigenvalues in (None, below) else None
        if pairs is None:  # W X and M X are seldom needed
            pairs = Ritz(found, vectors, *(rotated(image, rotation) for image in images))
        pairs = extended(pairs, correction.without(fixed, added[:, again]), stiffness, mass)
        found, vectors = pairs.values, pairs.vectors
    return None
