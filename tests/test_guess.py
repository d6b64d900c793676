"""Eigenpairs from those of the level below: as exact as asked for, and never incomplete."""

from __future__ import annotations

import numpy as np
import pytest
from examples import shapes

from cagemap.basis import (
    BasisConfig,
    band_pairs,
    construction,
    exact_basis,
    guess,
    hierarchical_basis,
    pairs_from_guess,
)
from cagemap.basis.ritz import Ritz, extended
from cagemap.operators import build_operators
from cagemap.refinement import refine

KEPT, GUARDS = 60, 20


def from_guess(stiffness, mass, start, values, **window):
    """In the precision that the accuracy needs, as the basis calls it; pairs given from the first one on."""
    window = {"first_index": 0, "dtype": guess.working_type(window["tolerance"]), **window}
    return pairs_from_guess(stiffness, mass, start, values, **window)


@pytest.fixture(scope="module")
def creature():
    """Level 2 has 2434 vertices; its pairs refined to level 3, and what they should become."""
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    coarse = exact_basis(operators, 2, KEPT + GUARDS)
    start = refinement.matrices[2] @ coarse.vectors
    return operators.stiffness[3], operators.mass[3], start, coarse.values, exact_basis(operators, 3, KEPT + 1)


@pytest.fixture(scope="module")
def far(creature):
    """An eigenvector of level 3 that is not among those started from."""
    stiffness, mass, *_ = creature
    return band_pairs(stiffness, mass, KEPT + GUARDS + 5, KEPT + GUARDS + 6).vectors[:, 0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-9])
@pytest.mark.parametrize("first", [0, 30])
def test_a_good_guess_becomes_exact(creature, tolerance, first):
    stiffness, mass, start, values, exact = creature
    found = from_guess(stiffness, mass, start, values, kept=(first, KEPT), tolerance=tolerance)
    assert found.first_index == first
    kept = slice(max(1, first), KEPT)
    errors = np.abs(found.values[kept.start - first : KEPT - first] - exact.values[kept]) / exact.values[kept]
    # Single precision, in which all but the tightest is computed, sums W X to about 1e-6 of the smallest eigenvalues.
    assert errors.max() < max(tolerance, 1e-9)
    assert found.vectors.dtype == (np.float32 if tolerance > 1e-6 else np.float64)
    gram = found.vectors.T @ (mass @ found.vectors)
    np.testing.assert_allclose(gram, np.eye(len(gram)), rtol=0, atol=1e-5 if tolerance > 1e-6 else 1e-10)


def test_pairs_that_are_not_good_enough_get_directions_of_their_own(creature, monkeypatch):
    """A guess spoilt in a few places: one inverse iteration does not do."""
    stiffness, mass, start, values, exact = creature
    rng = np.random.default_rng(61)
    spoilt = start.copy()
    spoilt[:, 40:50] += 0.3 * np.abs(start).mean() * rng.standard_normal((len(start), 10))
    rounds = []
    honest = guess.extended
    monkeypatch.setattr(guess, "extended", lambda *a: rounds.append(a[1].shape[1]) or honest(*a))
    for end, tolerance in ((KEPT + GUARDS, 1e-7), (KEPT, 1e-3)):  # with guards above, and without
        rounds.clear()
        found = from_guess(stiffness, mass, spoilt[:, :end], values[:end], kept=(0, KEPT), tolerance=tolerance)
        assert rounds
        assert max(rounds) < KEPT
        np.testing.assert_allclose(found.values[1:KEPT], exact.values[1:KEPT], rtol=tolerance)


@pytest.mark.parametrize(("start", "tolerance"), [(0, 1e-7), (15, 1e-5)])
def test_a_window_does_not_drift_to_the_pairs_below_it(creature, start, tolerance):
    """Those below are neither iterated nor returned, and further directions have to stay clear of them.

    Where some below are not even given, noise along them cannot be removed: less accuracy can be asked for.
    """
    stiffness, mass, guessed, values, exact = creature
    first, spoilt = 30, guessed.copy()
    rng = np.random.default_rng(62)
    spoilt[:, 40:50] += 0.1 * np.abs(guessed).mean() * rng.standard_normal((len(guessed), 10))
    window = {"first_index": start, "kept": (first, KEPT), "tolerance": tolerance}
    found = from_guess(stiffness, mass, spoilt[:, start:], values[start:], **window)
    assert found is not None
    assert found.first_index == first
    np.testing.assert_allclose(found.values[: KEPT - first], exact.values[first:KEPT], rtol=tolerance)


def test_a_window_starts_where_it_should_although_values_fall(creature, far):
    """The pair below it is so rough that it seems to lie inside: the first of the window must not be lost for it."""
    stiffness, mass, guessed, values, exact = creature
    rough = guessed.copy()
    rough[:, 29] += far
    found = from_guess(stiffness, mass, rough, values, kept=(30, KEPT), tolerance=1e-5)
    assert found.vectors.shape[1] == KEPT + GUARDS - 30
    np.testing.assert_allclose(found.values[: KEPT - 30], exact.values[30:KEPT], rtol=1e-5)


@pytest.mark.parametrize("first", [0, 30])
@pytest.mark.parametrize("missing", [[43], [40, 41, 55]])
def test_missing_pairs_are_found(creature, first, missing):
    """A coarse level may not know a function of a finer one at all, on a part that it resolves badly."""
    stiffness, mass, start, values, exact = creature
    kept = ~np.isin(np.arange(len(values)), missing)
    found = from_guess(stiffness, mass, start[:, kept], values[kept], kept=(first, KEPT), tolerance=1e-4)
    assert found.first_index == first
    wanted = slice(max(first, 1), KEPT)
    np.testing.assert_allclose(found.values[wanted.start - first : KEPT - first], exact.values[wanted], rtol=1e-4)


@pytest.mark.parametrize("missing", [range(31, 42), [17]])
def test_missing_pairs_that_cannot_be_found_are_noticed(creature, missing):
    """Too many of them, or one that belongs below the window."""
    stiffness, mass, start, values, _ = creature
    kept = ~np.isin(np.arange(len(values)), missing)
    window = {"kept": (30, KEPT), "tolerance": 1e-3}
    assert from_guess(stiffness, mass, start[:, kept], values[kept], **window) is None


def test_directions_nearly_alike_leave_pairs_orthonormal(creature):
    """Solves next to a missing eigenvalue answer with nearly the same function for every pair."""
    stiffness, mass, start, _, exact = creature
    others = np.arange(KEPT) != 43
    vectors = exact.vectors[:, :KEPT][:, others].astype(np.float32)
    pairs = Ritz(exact.values[:KEPT][others], vectors, stiffness @ vectors, mass @ vectors)
    added = exact.vectors[:, [43]] + 2e-4 * start[:, KEPT + 2 : KEPT + 12]
    found = extended(pairs, added.astype(np.float32), stiffness, mass)
    gram = found.vectors.T.astype(np.float64) @ (mass @ found.vectors.astype(np.float64))
    np.testing.assert_allclose(gram, np.eye(KEPT - 1), rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.values[1:], exact.values[1 : KEPT - 1], rtol=1e-4)


def test_the_same_function_twice_is_refused(creature):
    stiffness, mass, start, values, _ = creature
    doubled, twice = start.copy(), values.copy()
    doubled[:, 11], twice[11] = doubled[:, 10], twice[10]
    assert from_guess(stiffness, mass, doubled, twice, kept=(0, KEPT), tolerance=1e-9) is None


@pytest.mark.parametrize(
    ("control", "level", "count"),
    [(shapes.cube, 4, 16), (shapes.icosahedron, 4, 25), (lambda: shapes.torus(6, 4), 4, 35), (shapes.creature, 3, 90)],
)
@pytest.mark.parametrize("tolerance", [1e-2, 1e-5])
def test_a_basis_that_starts_levels_from_guesses_is_complete(control, level, count, tolerance, monkeypatch):
    """Repeated eigenvalues and all: from 100 vertices on every level starts from the one below."""
    used = []
    monkeypatch.setattr(construction, "GUESS_ROWS", 100)
    honest = construction.pairs_from_guess
    monkeypatch.setattr(construction, "pairs_from_guess", lambda *a, **k: used.append(honest(*a, **k)) or used[-1])
    refinement = refine(control(), level)
    operators = build_operators(refinement)
    basis = hierarchical_basis(refinement, operators, BasisConfig(count=count, tolerance=tolerance))
    if tolerance < 1e-3:  # else coarse levels may do
        assert any(pairs is not None for pairs in used)
    exact = exact_basis(operators, level, count).values
    errors = np.abs(np.sort(basis.eigenvalues) - exact)[1:] / exact[1:]
    assert errors.max() < tolerance
    assert np.linalg.cond(basis.gram) < 2.0
    own = np.eye(basis.count)[basis.band_levels[:, None] == basis.band_levels]
    np.testing.assert_allclose(basis.gram[basis.band_levels[:, None] == basis.band_levels], own, rtol=0, atol=1e-10)


def test_a_fixed_schedule_starts_large_levels_from_the_pairs_of_the_one_below(monkeypatch):
    """As exact as its own words say, complete, and no different where every level starts from nothing."""
    used = []
    monkeypatch.setattr(construction, "GUESS_ROWS", 100)
    honest = construction.pairs_from_guess
    monkeypatch.setattr(construction, "pairs_from_guess", lambda *a, **k: used.append(honest(*a, **k)) or used[-1])
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    schedule = (20, 10, 10, 10)
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=schedule))
    assert sum(pairs is not None for pairs in used) >= 2
    assert basis.schedule == schedule
    monkeypatch.setattr(construction, "GUESS_ROWS", 10**9)
    calls = len(used)
    from_nothing = hierarchical_basis(refinement, operators, BasisConfig(schedule=schedule))
    assert len(used) == calls
    np.testing.assert_allclose(basis.eigenvalues[1:], from_nothing.eigenvalues[1:], rtol=construction.FIXED_GUESS)
    assert np.linalg.cond(basis.gram) < 1.01 * np.linalg.cond(from_nothing.gram)


def test_a_schedule_that_is_to_be_exact_computes_no_pairs_that_it_does_not_keep(monkeypatch):
    """Pairs ahead are a guess for the next level, which starts from nothing where the accuracy asked for is high."""
    asked = []
    monkeypatch.setattr(construction, "GUESS_ROWS", 100)
    honest = construction.band_pairs
    monkeypatch.setattr(construction, "band_pairs", lambda *a, **k: asked.append(a[3]) or honest(*a, **k))
    refinement = refine(shapes.creature(), 2)
    operators = build_operators(refinement)
    for one in ({"accuracy": 1e-9}, {"literal": True}):
        asked.clear()
        hierarchical_basis(refinement, operators, BasisConfig(schedule=(4, 2, 2), **one))
        assert asked[0] == 4
        assert max(asked) < 16
    asked.clear()
    hierarchical_basis(refinement, operators, BasisConfig(schedule=(4, 2, 2)))
    assert asked[0] == 4 + 2 + 2 + construction.GUARDS
