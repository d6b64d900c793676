"""Lowest eigenpairs of one level from those of the level below: inverse iteration, Rayleigh-Ritz and a proof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.basis.eigen import EigenPairs, counts_agree, shifted_matrix
from cagemap.basis.factorization import Factorization, Precision, factor
from cagemap.basis.products import multiply
from cagemap.errors import SolverError
from cagemap.mesh import FloatArray
from cagemap.operators import lumped_areas

Block = NDArray[Any]  # (n, q), float64 or float32

# Single precision disturbs eigenvectors by 1e-6, and Rayleigh quotients taken of them in double by its square.
SINGLE_TOLERANCE = 1e-6
# Below this the values found in single precision, good to 1e-5 for the lowest, are taken once more in double.
_QUOTIENT_TOLERANCE = 1e-4
# Columns solved for at once, and rows multiplied at once: what fits a cache, and bounds the memory.
_COLUMNS = 64
_ROWS = 8192
# Most pairs that get a direction of their own in one round.
_MOST_ADDED = 96
# Smallest eigenvalue of the Gram matrix of unit columns below which one of them is no direction of its own.
_DEPENDENT = 1e-5
# Part of a new direction that must be new.
_NEW = 1e-4


def working_type(tolerance: float) -> Precision:
    """The precision that eigenvalues of a relative accuracy need while they are iterated on."""
    return np.float32 if tolerance >= SINGLE_TOLERANCE else np.float64


@dataclass(frozen=True, eq=False)
class _Ritz:
    """Approximate eigenpairs X with W X and M X; X is M-orthonormal and X^T W X the diagonal matrix of values."""

    values: FloatArray
    vectors: Block
    stiffness_vectors: Block
    mass_vectors: Block


def pairs_from_guess(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    guess: Block,
    guess_values: FloatArray,
    *,
    kept: tuple[int, int] | None = None,
    tolerance: float = 1e-6,
    max_rounds: int = 6,
    dtype: Precision | None = None,
) -> EigenPairs | None:
    """Lowest eigenpairs from prolonged ones.

    One block inverse iteration (W - sigma M)^{-1} M with Rayleigh-Ritz; then Rayleigh-Ritz again with an inverse
    iterate more of each pair that is not good enough yet. A bound of Kato and Temple ends it, and the inertia of
    W - tau M, tau in a gap near the last pair kept, proves that none was missed.

    Parameters
    ----------
    stiffness, mass : (n, n) CSR arrays
    guess : (n, m) array
        Approximate lowest eigenvectors, guards at the upper end included.
    guess_values : (m,) array
        Their approximate eigenvalues, ascending.
    kept : (int, int), optional
        Range of indices that must be accurate; those above are guards. Default: all.
    tolerance : float
        Relative accuracy of the eigenvalues kept.
    max_rounds : int
    dtype : numpy.float64 or numpy.float32, optional
        Precision of all but the proof. Default: single for tolerances from 1e-6 on.

    Returns
    -------
    EigenPairs or None
        None if the guess was not good enough: the iteration has not converged, or the inertia says that an eigenvalue
        was missed. Compute that level from nothing instead.
    """
    first, last = (0, len(guess_values)) if kept is None else kept
    dtype = working_type(tolerance) if dtype is None else dtype
    shift = _widest_gap(guess_values, first, last)
    areas = lumped_areas(mass)
    try:
        shifted = factor(shifted_matrix(stiffness, mass, shift), dtype=dtype)
        images = _inverse_iterates(shifted, multiply(mass, guess.astype(dtype, copy=False)), guess_values - shift)
        pairs = _rayleigh_ritz(images, multiply(stiffness, images), multiply(mass, images))
        for _ in range(max_rounds):
            residuals = _residuals(pairs, areas)
            errors = _kato_temple(residuals, pairs.values)[first:last]
            if np.all(errors <= tolerance):
                break
            # Pairs that are nearly good enough come along.
            worst = np.argsort(-errors)[: min(_MOST_ADDED, int(np.sum(errors > 0.3 * tolerance)))]
            pairs = _add_directions(pairs, first + worst, stiffness, mass, shifted, shift)
        else:
            return None
        if last < len(pairs.values) and not counts_agree(stiffness, mass, pairs.values, 0, shifted, last):
            return None
    except SolverError:  # on an eigenvalue, or a guess with the same function twice
        return None
    values = pairs.values
    if dtype == np.float32 and tolerance < _QUOTIENT_TOLERANCE:
        values = _rayleigh_quotients(stiffness, mass, pairs.vectors)
    norms = np.sqrt(residuals) / np.maximum(values, 4.0 * np.pi / float(areas.sum()))
    return EigenPairs(values, pairs.vectors, norms, 0)


def _inverse_iterates(shifted: Factorization, mass_vectors: Block, scale: FloatArray) -> Block:
    """(W - sigma M)^{-1} M X, columns scaled by lambda - sigma to keep them of one size; in place of M X."""
    floor = 1e-12 * float(np.abs(scale).max())
    factors = np.where(np.abs(scale) < floor, floor, scale).astype(mass_vectors.dtype)
    for start in range(0, mass_vectors.shape[1], _COLUMNS):
        part = slice(start, start + _COLUMNS)
        mass_vectors[:, part] = shifted.solve(mass_vectors[:, part]) * factors[part]
    return mass_vectors


def _rayleigh_ritz(block: Block, stiffness_block: Block, mass_block: Block) -> _Ritz:
    """Best approximations of eigenpairs within the span of a block: X^T W X c = theta X^T M X c. Works in place."""
    stiffness_gram, mass_gram = _gram(block, stiffness_block), _gram(block, mass_block)
    sizes = np.sqrt(np.diag(mass_gram))
    # Columns near eigenvectors are nearly orthogonal; whether rounding lets a dependent one pass is chance.
    if linalg.eigvalsh(mass_gram / np.outer(sizes, sizes), subset_by_index=[0, 0])[0] < _DEPENDENT:
        raise SolverError(
            f"expected {block.shape[1]} independent columns in a Rayleigh-Ritz step, got dependent ones; "
            "the guess holds a vector twice"
        )
    values, rotation = linalg.eigh(stiffness_gram, mass_gram, driver="gvd")
    for part in (block, stiffness_block, mass_block):
        _rotate(part, rotation)
    return _Ritz(values, block, stiffness_block, mass_block)


def _add_directions(
    pairs: _Ritz,
    chosen: NDArray[np.int64],
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    shifted: Factorization,
    shift: float,
) -> _Ritz:
    """Rayleigh-Ritz on the pairs and one more inverse iterate of the chosen ones; as many lowest pairs as before."""
    added = _inverse_iterates(
        shifted, np.ascontiguousarray(pairs.mass_vectors[:, chosen]), pairs.values[chosen] - shift
    )
    for _ in range(2):
        added -= pairs.vectors @ (pairs.mass_vectors.T @ added)
    mass_added = multiply(mass, added)
    squares, axes = linalg.eigh(_gram(added, mass_added))
    new = squares > _NEW**2 * max(squares[-1], np.finfo(float).tiny)
    turn = (axes[:, new] / np.sqrt(squares[new])).astype(added.dtype)
    added, mass_added = added @ turn, mass_added @ turn
    stiffness_added = multiply(stiffness, added)
    count = len(pairs.values)
    energy = np.zeros((count + added.shape[1], count + added.shape[1]))
    energy[:count, :count] = np.diag(pairs.values)
    energy[:count, count:] = _gram(pairs.vectors, stiffness_added, symmetric=False)
    energy[count:, :count] = energy[:count, count:].T
    energy[count:, count:] = _gram(added, stiffness_added)
    values, rotation = linalg.eigh(energy, driver="evd")
    parts = (
        (pairs.vectors, added),
        (pairs.stiffness_vectors, stiffness_added),
        (pairs.mass_vectors, mass_added),
    )
    for old, extra in parts:
        _rotate(old, rotation[:count, :count], extra, rotation[count:, :count])
    return _Ritz(values[:count], *(old for old, _ in parts))


def _gram(left: Block, right: Block, *, symmetric: bool = True) -> FloatArray:
    """X^T Y in double precision, some rows at a time."""
    total = np.zeros((left.shape[1], right.shape[1]))
    for start in range(0, len(left), _ROWS):
        total += left[start : start + _ROWS].T @ right[start : start + _ROWS]
    return 0.5 * (total + total.T) if symmetric else total


def _rotate(block: Block, rotation: FloatArray, extra: Block | None = None, extra_rotation: Any = None) -> None:
    """X <- X Q, or X Q + Y P, in place, some rows at a time."""
    turn = rotation.astype(block.dtype)
    extra_turn = None if extra is None else extra_rotation.astype(block.dtype)
    for start in range(0, len(block), _ROWS):
        rows = slice(start, start + _ROWS)
        product = block[rows] @ turn
        if extra is not None:
            product += extra[rows] @ extra_turn
        block[rows] = product


def _residuals(pairs: _Ritz, areas: FloatArray) -> FloatArray:
    """(m,) squares of ||W x - lambda M x|| in the norm of D^{-1}."""
    values, inverse = pairs.values.astype(pairs.vectors.dtype), (1.0 / areas).astype(pairs.vectors.dtype)
    squares = np.zeros(len(values))
    for start in range(0, len(areas), _ROWS):
        rows = slice(start, start + _ROWS)
        residual = pairs.stiffness_vectors[rows] - pairs.mass_vectors[rows] * values
        squares += inverse[rows] @ (residual * residual)
    return squares


def _rayleigh_quotients(stiffness: sparse.csr_array, mass: sparse.csr_array, vectors: Block) -> FloatArray:
    """(m,) ascending x^T W x / x^T M x, in double precision."""
    parts = []
    for start in range(0, vectors.shape[1], _COLUMNS):
        columns = vectors[:, start : start + _COLUMNS].astype(np.float64)
        energy = np.einsum("ij,ij->j", columns, multiply(stiffness, columns))
        parts.append(energy / np.einsum("ij,ij->j", columns, multiply(mass, columns)))
    return np.maximum.accumulate(np.concatenate(parts))


def _kato_temple(squares: FloatArray, values: FloatArray) -> FloatArray:
    """Relative errors of eigenvalues from squared residuals: ||r||^2 / (gap to what lies outside the block)."""
    spacing = (values[-1] - values[0]) / max(1, len(values) - 1)
    distance = np.maximum(values[-1] - values, spacing)
    positive = values[values > 1e-8 * values[-1]]  # all but that of the constant function
    return squares / (distance * np.maximum(values, positive[0] if len(positive) else 1.0))


def _widest_gap(values: FloatArray, first: int, last: int) -> float:
    """A shift in the middle of the widest gap among the middle fifth of a band."""
    middle = 0.5 * (values[first] + values[last - 1])
    centre = int(np.clip(np.searchsorted(values, middle), 1, len(values) - 1))
    reach = max(1, (last - first) // 10)
    low, high = max(0, centre - reach - 1), min(len(values), centre + reach + 1)
    if high - low < 2:
        return float(values[0]) - 1.0
    gap = low + int(np.argmax(np.diff(values[low:high])))
    # Refined eigenvalues lie below their guesses: stay in the lower half of the gap's upper side.
    return float(values[gap] + 0.4 * (values[gap + 1] - values[gap]))
