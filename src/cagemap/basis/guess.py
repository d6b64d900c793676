"""Lowest eigenpairs of one level from those of the level below: inverse iteration, Rayleigh-Ritz and a proof."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.basis.eigen import EigenPairs, counts_agree, relative_residuals, shifted_matrix
from cagemap.basis.factorization import Factorization, Precision, factor
from cagemap.basis.products import multiply
from cagemap.basis.ritz import Ritz, extended, rayleigh_quotients, rayleigh_ritz, squared_residuals
from cagemap.basis.smoothing import Block
from cagemap.basis.threads import parts
from cagemap.errors import SolverError
from cagemap.mesh import FloatArray
from cagemap.operators import lumped_areas

# Single precision disturbs eigenvectors by 1e-6, and Rayleigh quotients taken of them in double by its square.
SINGLE_TOLERANCE = 1e-6
# Below this the values found in single precision, good to 1e-5 for the lowest, are taken once more in double.
_QUOTIENT_TOLERANCE = 1e-4
# Columns solved for at once: what fits a cache.
_COLUMNS = 64
# Most pairs that get a direction of their own in one round.
_MOST_ADDED = 96


def working_type(tolerance: float) -> Precision:
    """The precision that eigenvalues of a relative accuracy need while they are iterated on."""
    return np.float32 if tolerance >= SINGLE_TOLERANCE else np.float64


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
        pairs = rayleigh_ritz(images, multiply(stiffness, images), multiply(mass, images))
        for _ in range(max_rounds):
            residuals = squared_residuals(pairs, areas)
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
        values = rayleigh_quotients(stiffness, mass, pairs.vectors)
    return EigenPairs(values, pairs.vectors, relative_residuals(residuals, values, areas), 0)


def _inverse_iterates(shifted: Factorization, mass_vectors: Block, scale: FloatArray) -> Block:
    """(W - sigma M)^{-1} M X, columns scaled by lambda - sigma to keep them of one size; in place of M X."""
    floor = 1e-12 * float(np.abs(scale).max())
    factors = np.where(np.abs(scale) < floor, floor, scale).astype(mass_vectors.dtype)
    for part in parts(mass_vectors.shape[1], _COLUMNS):
        mass_vectors[:, part] = shifted.solve(mass_vectors[:, part]) * factors[part]
    return mass_vectors


def _add_directions(
    pairs: Ritz,
    chosen: NDArray[np.int64],
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    shifted: Factorization,
    shift: float,
) -> Ritz:
    """Rayleigh-Ritz on the pairs and one more inverse iterate of the chosen ones."""
    mass_vectors = np.ascontiguousarray(pairs.mass_vectors[:, chosen])
    return extended(pairs, _inverse_iterates(shifted, mass_vectors, pairs.values[chosen] - shift), stiffness, mass)


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
