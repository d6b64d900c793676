"""Lowest eigenpairs of one level from those of the level below: inverse iteration, Rayleigh-Ritz and a proof."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.basis.constants import (
    DIVERGED,
    MOST_ADDED,
    MOST_MISSED,
    MOST_ROUNDS,
    NEAR,
    NEARLY_GOOD,
    QUOTIENT_TOLERANCE,
    SEARCH_STEPS,
    SEED,
    SINGLE_TOLERANCE,
    STRANGERS,
)
from cagemap.basis.eigen import EigenPairs, missed_pairs, shifted_matrix
from cagemap.basis.ritz import (
    Ritz,
    extended,
    gram,
    rayleigh_quotients,
    ritz_rotation,
    rotated,
    squared_residuals,
    subtract,
)
from cagemap.basis.smoothing import Block
from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import Factorization, Precision, factor
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import parts
from cagemap.operators import lumped_areas

# Columns solved for at once: what fits a cache.
_COLUMNS = 64


def working_type(tolerance: float) -> Precision:
    """The precision that eigenvalues of a relative accuracy need while they are iterated on."""
    return np.float32 if tolerance >= SINGLE_TOLERANCE else np.float64


def pairs_from_guess(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    guess: Block,
    guess_values: FloatArray,
    *,
    first_index: int,
    kept: tuple[int, int],
    tolerance: float,
    dtype: Precision,
) -> EigenPairs | None:
    """Lowest eigenpairs from prolonged ones.

    One block inverse iteration (W - sigma M)^{-1} M with Rayleigh-Ritz; then Rayleigh-Ritz again with a further
    direction (W - tau M)^{-1} r, tau in a gap near the last pair kept, for each pair that is not good enough yet. A
    bound of Kato and Temple ends it, and the inertia of W - tau M proves that none was missed; a few that were are
    looked for among what is orthogonal to all the others. Vectors well below the pairs wanted take part in
    Rayleigh-Ritz as they are: without them the window would drift down to them.

    Parameters
    ----------
    stiffness, mass : (n, n) CSR arrays
    guess : (n, m) array
        Approximate lowest eigenvectors, guards at the upper end included.
    guess_values : (m,) array
        Their approximate eigenvalues, ascending.
    first_index : int
        Index of the first of them in the spectrum; those that are not given should be far from the ones wanted.
    kept : (int, int)
        Range of indices that must be accurate; those above are guards, those below are not returned.
    tolerance : float
        Relative accuracy of the eigenvalues kept.
    dtype : numpy.float64 or numpy.float32
        Precision of all but the proof.

    Returns
    -------
    EigenPairs or None
        None if the guess was not good enough: the iteration has not converged, or the inertia says that eigenvalues
        are missing still. Compute that level from nothing instead.
    """
    start, end = first_index, first_index + len(guess_values)
    first, last = kept
    # Values still fall: which of them is the first is known at the end only.
    low = max(start, first - NEAR)
    iterated, asked = slice(low - start, None), slice(first - low, last - low)
    shift = _widest_gap(guess_values, first - start, last - start)
    areas = lumped_areas(mass)
    try:
        shifted = factor(shifted_matrix(stiffness, mass, shift), dtype=dtype)
        block = guess.astype(dtype)
        mass_vectors = multiply(mass, np.ascontiguousarray(block[:, iterated]))
        block[:, iterated] = _inverse_iterates(shifted, mass_vectors, guess_values[iterated] - shift)
        blocks = (block, multiply(stiffness, block), multiply(mass, block))
        values, rotation = ritz_rotation(*blocks)
        pairs = Ritz(values[iterated], *(rotated(part, rotation[:, iterated]) for part in blocks))
        del block, blocks
        upper: Factorization | None = None
        bound, before, searched = -np.inf, np.inf, False
        for _ in range(MOST_ROUNDS):
            residuals = squared_residuals(pairs, areas)
            errors = _kato_temple(residuals, pairs.values)[asked]
            if np.all(errors <= tolerance):
                counted = upper is not None and upper.negative_eigenvalues == low + np.sum(pairs.values < bound)
                if last == end or counted:
                    break
                missed = missed_pairs(stiffness, mass, pairs.values, low, shifted, last)
                if missed == 0:
                    break
                if searched or start > 0 or not 0 < missed <= MOST_MISSED:
                    return None
                lowest = pairs.values[0]
                strangers = _strangers(shifted, mass, pairs, guess[:, :low])
                pairs, before, searched = extended(pairs, strangers, stiffness, mass), np.inf, True
                if low > 0 and pairs.values[0] < (1.0 - tolerance) * lowest:  # it belongs below the window
                    return None
                continue
            if errors.max() > DIVERGED * before:  # rounding has taken over
                return None
            before = errors.max()
            if upper is None:
                # What is not good enough yet mostly lies next to the guards, far from the first shift.
                bound = gap_after(pairs.values, min(last - low, len(pairs.values) - 1))
                upper = factor(shifted_matrix(stiffness, mass, bound), like=shifted)
            # Pairs that are nearly good enough come along.
            worst = asked.start + np.argsort(-errors)[: min(MOST_ADDED, int(np.sum(errors > NEARLY_GOOD * tolerance)))]
            added = upper.solve(pairs.residuals(worst)).astype(dtype)
            pairs = extended(pairs, added, stiffness, mass)
        else:
            return None
    except SolverError:  # on an eigenvalue, or a guess with the same function twice
        return None
    values = pairs.values
    if dtype == np.float32 and tolerance < QUOTIENT_TOLERANCE:
        values = rayleigh_quotients(stiffness, mass, pairs.vectors)
    found = EigenPairs(values, pairs.vectors, low)
    return found.part(first, found.last_index)


def _inverse_iterates(shifted: Factorization, mass_vectors: Block, scale: FloatArray) -> Block:
    """(W - sigma M)^{-1} M X, columns scaled by lambda - sigma to keep them of one size; in place of M X."""
    floor = 1e-12 * float(np.abs(scale).max())
    factors = np.where(np.abs(scale) < floor, floor, scale).astype(mass_vectors.dtype)
    for part in parts(mass_vectors.shape[1], _COLUMNS):
        mass_vectors[:, part] = shifted.solve(mass_vectors[:, part]) * factors[part]
    return mass_vectors


def _strangers(shifted: Factorization, mass: sparse.csr_array, pairs: Ritz, below: Block) -> Block:
    """(n, q) functions rich in eigenvectors that are neither among the pairs nor, about, among those below them.

    Inverse iteration of a random block that is kept M-orthogonal to all of these, and well conditioned, so that
    single precision leaves it so.
    """
    dtype = pairs.vectors.dtype
    block = np.random.default_rng(SEED).standard_normal((len(below), STRANGERS)).astype(dtype)
    below = below.astype(dtype, copy=False)
    for _ in range(SEARCH_STEPS):
        block = shifted.solve(multiply(mass, block))
        subtract(block, pairs.vectors, gram(pairs.mass_vectors, block, symmetric=False))
        subtract(block, below, gram(below, multiply(mass, block), symmetric=False))
        block = np.linalg.qr(block)[0]
    return block


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


def gap_after(values: FloatArray, end: int) -> float:
    """A place in the widest gap from just before index ``end`` to a few pairs on."""
    low, high = max(0, end - 1), min(len(values), end + NEAR)
    gap = low + int(np.argmax(np.diff(values[low:high])))
    return float(0.5 * (values[gap] + values[gap + 1]))
