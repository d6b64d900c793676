"""Functional maps as linear least squares: eq. 13 at level 0 and its blocks, eqs. 14-16, above.

Every block is the same problem, min ||C F2 - F1||^2 + sum_O alpha ||C O2 - O1 C||^2, with other data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Commutator:
    """One commutativity constraint C O2 = O1 C with tridiagonal operators.

    Attributes
    ----------
    target : (k1, k1) array
        O1, at most tridiagonal.
    source : (k2, k2) array
        O2.
    weight : float
        alpha(O), relative to the data: 1 weighs the mean squared entry as much as one descriptor coefficient.
    """

    target: FloatArray
    source: FloatArray
    weight: float


def solve_functional_map(
    source_descriptors: FloatArray,
    target_descriptors: FloatArray,
    target_eigenvalues: FloatArray,
    source_eigenvalues: FloatArray,
    laplacian_weight: float,
    commutators: tuple[Commutator, ...] = (),
) -> FloatArray:
    """Solve eq. 13: argmin ||C F2 - F1||^2 + sum_O alpha(O) ||C O2 - O1 C||^2.

    Parameters
    ----------
    source_descriptors : (k2, q) array
        F2.
    target_descriptors : (k1, q) array
        F1.
    target_eigenvalues, source_eigenvalues : (k1,), (k2,) arrays
        The Laplacian operators O_i = Lambda~_i (paper, section 5.2), diagonal.
    laplacian_weight : float
        alpha(Lambda~), relative to the data term (see `laplacian_penalties`).
    commutators : tuple of Commutator
        Further operators, tridiagonal ones such as self-symmetries.

    Returns
    -------
    (k1, k2) array
        C12, takes source coefficients to target coefficients.

    Raises
    ------
    ParameterError
        If the descriptor matrices disagree in their number of columns.
    """
    if source_descriptors.shape[1] != target_descriptors.shape[1]:
        raise ParameterError(
            "expected as many target as source descriptors, got "
            f"{target_descriptors.shape[1]} and {source_descriptors.shape[1]}"
        )
    gram = source_descriptors @ source_descriptors.T  # (k2, k2)
    cross = target_descriptors @ source_descriptors.T  # (k1, k2)
    penalties = laplacian_penalties(target_eigenvalues, source_eigenvalues, laplacian_weight, gram)
    if not commutators:
        return _solve_rows(gram, cross, penalties)
    return _solve_coupled_rows(gram, cross, penalties, commutators)


def laplacian_penalties(
    target_eigenvalues: FloatArray, source_eigenvalues: FloatArray, weight: float, gram: FloatArray
) -> FloatArray:
    """Weights of C_ij^2 that stand for alpha ||C Lambda2 - Lambda1 C||^2.

    The entries (lambda2_j - lambda1_i)^2 are divided by their mean and scaled by the mean squared descriptor
    coefficient, so that `weight` means the same for every k and every shape.

    Returns
    -------
    (k1, k2) array
    """
    differences = (source_eigenvalues[None, :] - target_eigenvalues[:, None]) ** 2
    mean = float(differences.mean())
    scale = float(np.trace(gram)) / len(gram)
    return weight * scale * differences / (mean if mean > 0.0 else 1.0)


def _solve_rows(gram: FloatArray, cross: FloatArray, penalties: FloatArray) -> FloatArray:
    """Diagonal operators only: each row of C is its own k2 x k2 positive definite system."""
    solution = np.empty_like(cross)
    ridge = _ridge(gram)
    for i in range(len(cross)):
        system = gram + np.diag(penalties[i] + ridge)
        solution[i] = linalg.solve(system, cross[i], assume_a="pos", overwrite_a=True, check_finite=False)
    return solution


def _solve_coupled_rows(
    gram: FloatArray, cross: FloatArray, penalties: FloatArray, commutators: tuple[Commutator, ...]
) -> FloatArray:
    """Tridiagonal operators couple row i of C with rows i - 2 to i + 2: block Cholesky over pairs of rows."""
    k1, k2 = cross.shape
    ridge = _ridge(gram)
    scale = float(np.trace(gram)) / k2
    identity = np.eye(k2)
    terms = [
        (weight * scale, o1, o1.T @ o1, o2, o2 @ o2.T)
        for o1, o2, weight in ((c.target, c.source, c.weight) for c in commutators)
    ]

    def block(i: int, j: int) -> FloatArray:
        """Coefficient of c_j in the normal equation of row c_i (as column vectors)."""
        total = np.zeros((k2, k2))
        if i == j:
            total += gram + np.diag(penalties[i] + ridge)
        for alpha, o1, o1_gram, o2, o2_gram in terms:
            if i == j:
                total += alpha * o2_gram
            total += alpha * (o1_gram[i, j] * identity - o1[j, i] * o2.T - o1[i, j] * o2)
        return total

    def paired(p: int, q: int) -> FloatArray:
        rows = range(2 * p, min(2 * p + 2, k1))
        columns = range(2 * q, min(2 * q + 2, k1))
        return np.block([[block(i, j) for j in columns] for i in rows])

    pairs = (k1 + 1) // 2
    right = [cross[2 * p : 2 * p + 2].ravel() for p in range(pairs)]
    factors: list[tuple[FloatArray, bool]] = []
    lower: list[FloatArray] = []
    for p in range(pairs):  # block forward elimination of a block tridiagonal system
        diagonal = paired(p, p)
        if p > 0:
            off = paired(p, p - 1)
            lower.append(off)
            diagonal -= off @ linalg.cho_solve(factors[-1], off.T)
            right[p] = right[p] - off @ linalg.cho_solve(factors[-1], right[p - 1])
        factors.append(linalg.cho_factor(0.5 * (diagonal + diagonal.T)))
    solution = [np.zeros(0)] * pairs
    for p in range(pairs - 1, -1, -1):
        value = right[p] if p == pairs - 1 else right[p] - lower[p].T @ solution[p + 1]
        solution[p] = linalg.cho_solve(factors[p], value)
    return np.concatenate(solution).reshape(k1, k2)


def _ridge(gram: FloatArray) -> float:
    """Keep systems definite where neither a descriptor nor an operator says anything."""
    return 1e-10 * float(np.trace(gram)) / len(gram) + np.finfo(float).tiny
