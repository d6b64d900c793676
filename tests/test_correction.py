"""Corrections between levels: as exact as asked for, never incomplete, and the finest level only where it is needed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import linalg

from cagemap.basis import construction, exact_basis, finish, hierarchical_basis
from cagemap.basis.correction import Correction, corrected_pairs
from cagemap.basis.eigen import EigenPairs
from cagemap.basis.finish import split_isolated
from cagemap.basis.schedule import BasisConfig
from cagemap.basis.smoothing import CONDITION, _chebyshev_rows, residuals, smoother
from cagemap.mesh import shapes
from cagemap.operators import build_operators
from cagemap.refinement import refine

KEPT, GUARDS = 60, 20


@pytest.fixture(scope="module")
def creature():
    """The step from level 2, 2434 vertices, to level 3; pairs of both."""
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    correction = Correction.between(refinement.matrices[2], operators.stiffness[3], operators.mass[3])
    coarse = exact_basis(operators, 2, KEPT + GUARDS)
    return correction, coarse, exact_basis(operators, 3, KEPT + GUARDS)


def relative(values, exact):
    return ((values - exact) / np.maximum(exact, 1e-3 * exact[-1]))[1:]


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
@pytest.mark.parametrize("first", [0, 30])
def test_corrected_pairs_are_those_of_the_finer_level(creature, tolerance, first):
    correction, coarse, exact = creature
    before = np.abs(relative(coarse.values, exact.values))[first : KEPT - 1]
    start, fixed = coarse.part(first, KEPT + GUARDS), coarse.vectors[:, :first]
    found = corrected_pairs(correction, start, fixed, kept=(first, KEPT), tolerance=tolerance)
    assert found.first_index == first
    values = np.concatenate([exact.values[:first], found.values])
    after = np.abs(relative(values, exact.values))[first : KEPT - 1]
    # Pairs held fixed below the window take a second-order share of it.
    assert after.max() < max(tolerance, 2.0 * before.max() ** 2 if first else 0.0)
    assert before.max() > 10.0 * after.max()
    mass = correction.mass[correction.rank][:, correction.rank]
    gram = found.vectors.T @ (mass @ found.vectors)
    np.testing.assert_allclose(gram, np.eye(len(gram)), rtol=0, atol=1e-5 if tolerance > 1e-6 else 1e-10)
    lower = correction.subdivision[correction.rank] @ fixed
    np.testing.assert_allclose(lower.T @ (mass @ found.vectors), 0.0, rtol=0, atol=1e-5)


def test_a_missing_pair_is_noticed(creature):
    correction, coarse, _ = creature
    there = np.arange(KEPT + GUARDS) != 17
    holed = EigenPairs(coarse.values[there], coarse.vectors[:, there], 0)
    fixed = np.zeros((len(coarse.vectors), 0))
    assert corrected_pairs(correction, holed, fixed, kept=(0, KEPT), tolerance=1e-3) is None


def test_only_isolated_bad_pairs_go_to_the_finest_level(creature):
    correction, coarse, exact = creature
    errors = relative(coarse.values, exact.values)[: KEPT - 1]
    tolerance = float(np.quantile(errors, 0.75))
    split = split_isolated(
        correction, coarse.vectors, coarse.values, np.zeros((len(coarse.vectors), 0)), 0, KEPT, tolerance, 1.0
    )
    assert np.any(np.diff(split.kept) > 1), "bad pairs lie between good ones"
    assert KEPT // 8 < len(split.places) < KEPT // 2
    band = split.vectors[np.argsort(correction.rank)].astype(np.float64)
    corrected = np.diag(band.T @ (correction.stiffness @ band)) / np.diag(band.T @ (correction.mass @ band))
    found = np.sort(np.concatenate([coarse.values[split.kept], corrected]))
    assert np.abs(relative(found, exact.values[:KEPT])).max() < tolerance
    np.testing.assert_array_equal(found[split.places], np.sort(corrected))
    kept = correction.subdivision @ coarse.vectors[:, split.kept]
    np.testing.assert_allclose(kept.T @ (correction.mass @ band), 0.0, rtol=0, atol=1e-5)


def test_errors_that_smoothing_underrates_are_found_by_solves(creature, monkeypatch):
    """As on slivers, where a pair was wrong by 2.4 times the tolerance; here smoothing sees a third of every error.

    The mesh is so coarse that a quarter of the pairs is worse than the check is used for.
    """
    monkeypatch.setattr(finish, "_SECOND_ORDER", 1.0)
    correction, coarse, exact = creature
    errors = relative(coarse.values, exact.values)[: KEPT - 1]
    tolerance = float(np.quantile(errors, 0.75))
    honest = Correction.gains
    monkeypatch.setattr(Correction, "gains", lambda *a: 0.3 * honest(*a))
    fixed = np.zeros((len(coarse.vectors), 0))
    split = split_isolated(correction, coarse.vectors, coarse.values, fixed, 0, KEPT, tolerance, 1.0)
    places = np.setdiff1d(np.arange(KEPT), split.places)
    kept = coarse.values[split.kept] / np.maximum(exact.values[places], 1e-3 * exact.values[-1])
    assert np.max(kept[1:] - 1.0) < tolerance
    assert np.all(split.errors <= tolerance)


def test_pairs_out_of_reach_are_left_to_others(creature):
    correction, coarse, _ = creature
    arguments = correction, coarse.vectors, coarse.values, np.zeros((len(coarse.vectors), 0)), 0, KEPT
    assert split_isolated(*arguments, 1e-6, reach=1e-6) is None


def test_a_tight_basis_has_both_kinds_of_pairs_and_its_tolerance(monkeypatch):
    monkeypatch.setattr(construction, "GUESS_ROWS", 1_000)
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    exact = exact_basis(operators, 3, KEPT).values
    for tolerance in (1e-3, 1e-5):
        basis = hierarchical_basis(refinement, operators, BasisConfig(count=KEPT, tolerance=tolerance))
        errors = relative(np.sort(basis.eigenvalues), exact)
        assert np.abs(errors).max() < tolerance
        assert errors.min() > -1e-8, "a coarse eigenvalue is never below the fine one"
        assert np.linalg.cond(basis.gram) < 1.5
        finest = basis.band_levels == 3
        np.testing.assert_allclose(basis.eigenvalues[finest], exact[basis.indices[finest]], rtol=tolerance)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_smoother_agrees_with_its_slow_twin(creature, dtype):
    correction, coarse, _ = creature
    matrix = correction.stiffness
    right = residuals(matrix, correction.mass, correction.subdivision @ coarse.vectors[:, 5:9], coarse.values[5:9])
    smooth = smoother(matrix)
    inverse, highest = 1.0 / matrix.diagonal()[:, None], smooth.highest
    centre, radius = 0.5 * (highest + highest / CONDITION), 0.5 * (highest - highest / CONDITION)
    factor = 1.0 / centre
    residual, step = right.copy(), right * inverse * factor
    slow = step.copy()
    for iteration in range(1, 6):
        residual -= matrix @ step
        momentum = (0.5 if iteration == 1 else 0.25) * (radius * factor) ** 2
        factor = 1.0 / (centre - momentum / factor)
        step = momentum * step + residual * inverse * factor
        slow += step
    scale = np.abs(slow).max()
    fast = smooth(right.astype(dtype), 6)
    assert fast.dtype == dtype
    np.testing.assert_allclose(fast, slow, rtol=0, atol=(1e-12 if dtype == np.float64 else 1e-5) * scale)
    now, before = slow.copy(), step.copy()
    _chebyshev_rows.py_func(
        matrix.indptr, matrix.indices, matrix.data, inverse[:, 0], right, now, before, 0.3, 0.7, 0, 40
    )
    expected = now + 0.3 * (now - step) + 0.7 * inverse * (right - matrix @ now)
    np.testing.assert_allclose(before[:40], expected[:40], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(before[40:], step[40:])


def test_the_largest_scaled_eigenvalue_is_bounded(creature):
    """Chebyshev steps amplify what lies above it."""
    matrix = creature[0].stiffness
    root = sparse.diags_array(1.0 / np.sqrt(matrix.diagonal()))
    largest = linalg.eigsh(root @ matrix @ root, 1, which="LA", return_eigenvectors=False)[0]
    assert largest <= smoother(matrix).highest <= 1.1 * largest
