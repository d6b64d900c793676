"""Functional maps: eq. 13, eqs. 14-16, and their agreement with a plain dense least-squares solve."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.functional_map import (
    Commutator,
    OperatorWeights,
    SpectralData,
    coarse_functional_map,
    extend_functional_map,
    laplacian_penalties,
    solve_functional_map,
)

RNG = np.random.default_rng(20190)


def tridiagonal(k: int) -> np.ndarray:
    return np.triu(np.tril(RNG.standard_normal((k, k)), 1), -1)


def dense_solution(f2, f1, penalties, commutators):
    """Minimise the energy of eq. 13 through its k1 k2 x k1 k2 normal equations."""
    k1, k2 = len(f1), len(f2)
    eye1 = np.eye(k1)
    system = np.kron(eye1, f2 @ f2.T) + np.diag(penalties.ravel())
    scale = np.trace(f2 @ f2.T) / k2
    for c in commutators:
        operator = np.kron(eye1, c.source.T) - np.kron(c.target, np.eye(k2))  # row-major vec of C O2 - O1 C
        system += c.weight * scale * operator.T @ operator
    return np.linalg.solve(system, (f1 @ f2.T).ravel()).reshape(k1, k2)


@pytest.mark.parametrize("k1", [1, 2, 7, 8])
@pytest.mark.parametrize("coupled", [False, True])
def test_solution_is_the_dense_least_squares_solution(k1, coupled):
    """Rows decouple, or couple in a band; either way the answer is that of the full normal equations."""
    k2, q = 6, 15
    f1, f2 = RNG.standard_normal((k1, q)), RNG.standard_normal((k2, q))
    lambda1, lambda2 = np.sort(RNG.random(k1)), np.sort(RNG.random(k2))
    commutators = (Commutator(tridiagonal(k1), tridiagonal(k2), 0.3),) if coupled else ()
    penalties = laplacian_penalties(lambda1, lambda2, 0.1, f2 @ f2.T)
    expected = dense_solution(f2, f1, penalties, commutators)
    found = solve_functional_map(f2, f1, lambda1, lambda2, 0.1, commutators)
    # The ridge of 1e-10 of the data is the only difference.
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_exact_map_is_recovered():
    """Descriptors and operators that a map satisfies exactly give that map back."""
    k = 12
    eigenvalues = np.sort(RNG.random(k))
    signs = np.diag(RNG.choice([-1.0, 1.0], k))  # an isometry of a shape with simple spectrum
    f2 = RNG.standard_normal((k, 30))
    found = solve_functional_map(f2, signs @ f2, eigenvalues, eigenvalues, 0.1)
    np.testing.assert_allclose(found, signs, atol=1e-8)


def test_few_descriptors_and_the_laplacian_still_decide():
    """With fewer descriptors than functions the commutativity alone fixes what the data leave open."""
    k = 10
    eigenvalues = np.arange(k, dtype=float)
    f2 = RNG.standard_normal((k, 3))
    found = solve_functional_map(f2, f2, eigenvalues, eigenvalues, 10.0)
    np.testing.assert_allclose(found, np.diag(np.diag(found)), atol=0.2)
    np.testing.assert_allclose(np.diag(found), 1.0, atol=0.05)


def test_penalties_do_not_depend_on_scale():
    """Eigenvalues and descriptors in other units weigh the same (eq. 13's alpha is relative)."""
    lambda1, lambda2 = np.sort(RNG.random(5)), np.sort(RNG.random(6))
    gram = np.diag(RNG.random(6))
    reference = laplacian_penalties(lambda1, lambda2, 0.1, gram)
    np.testing.assert_allclose(laplacian_penalties(1e4 * lambda1, 1e4 * lambda2, 0.1, gram), reference, rtol=1e-12)
    np.testing.assert_allclose(laplacian_penalties(lambda1, lambda2, 0.1, 9.0 * gram), 9.0 * reference, rtol=1e-12)


@pytest.mark.parametrize("symmetric", [False, True])
def test_extension_keeps_the_coarse_block_and_solves_the_others(symmetric):
    """Eq. 14: C_l stays; eq. 16 gives C_lh; the high rows are one joint problem."""
    k1, k2, low1, low2, q = 9, 8, 5, 4, 25
    weights = OperatorWeights(laplacian=0.1, symmetry=0.2 if symmetric else 0.0)

    def data(k, low):
        operator = tridiagonal(k)
        operator[low:, :low] = operator[:low, low:] = 0.0  # eq. 15: block diagonal
        return SpectralData(np.sort(RNG.random(k)), RNG.standard_normal((k, q)), operator)

    target, source = data(k1, low1), data(k2, low2)
    coarse = RNG.standard_normal((low1, low2))
    extended = extend_functional_map(coarse, target, source, weights)
    np.testing.assert_array_equal(extended[:low1, :low2], coarse)

    def block(rows, columns, wanted):
        f2 = source.descriptors[columns]
        penalties = laplacian_penalties(target.eigenvalues[rows], source.eigenvalues[columns], 0.1, f2 @ f2.T)
        commutators = ()
        if symmetric:
            commutators = (Commutator(target.symmetry[rows, rows], source.symmetry[columns, columns], 0.2),)
        return dense_solution(f2, wanted, penalties, commutators)

    low, high = slice(0, low1), slice(low1, k1)
    remainder = target.descriptors[low] - coarse @ source.descriptors[:low2]
    np.testing.assert_allclose(extended[low, low2:], block(low, slice(low2, k2), remainder), atol=1e-6)
    np.testing.assert_allclose(extended[high], block(high, slice(0, k2), target.descriptors[high]), atol=1e-6)


def test_extension_of_an_exact_map_is_exact():
    """Solving level by level loses nothing when the data are those of a true map."""
    k, low, q = 14, 6, 40
    eigenvalues = np.arange(k, dtype=float)
    signs = np.diag(RNG.choice([-1.0, 1.0], k))
    f2 = RNG.standard_normal((k, q))
    target, source = SpectralData(eigenvalues, signs @ f2), SpectralData(eigenvalues, f2)
    weights = OperatorWeights()
    low_target = SpectralData(eigenvalues[:low], target.descriptors[:low])
    low_source = SpectralData(eigenvalues[:low], source.descriptors[:low])
    coarse = coarse_functional_map(low_target, low_source, weights)
    np.testing.assert_allclose(extend_functional_map(coarse, target, source, weights), signs, atol=1e-7)


@pytest.mark.parametrize("grown", ["target", "source", "neither"])
def test_extension_with_one_empty_band(grown):
    """A level may add functions on one side only; the coarse block is still kept."""
    k1, k2 = (7, 5) if grown == "target" else (5, 7) if grown == "source" else (5, 5)
    target = SpectralData(np.arange(k1, dtype=float), RNG.standard_normal((k1, 20)))
    source = SpectralData(np.arange(k2, dtype=float), RNG.standard_normal((k2, 20)))
    coarse = RNG.standard_normal((5, 5))
    extended = extend_functional_map(coarse, target, source, OperatorWeights())
    assert extended.shape == (k1, k2)
    np.testing.assert_array_equal(extended[:5, :5], coarse)


def test_descriptors_must_agree():
    with pytest.raises(ParameterError, match="as many target as source descriptors, got 4 and 5"):
        solve_functional_map(np.zeros((3, 5)), np.zeros((3, 4)), np.zeros(3), np.zeros(3), 0.1)
