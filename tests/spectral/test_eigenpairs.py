"""Eigenpairs of one level: against SciPy, on repeated eigenvalues, and with nothing lost."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from examples import shapes
from scipy import sparse
from scipy.sparse.linalg import eigsh

from cagemap.errors import ParameterError, SolverError
from cagemap.numerics import sparse_algebra
from cagemap.numerics.sparse_algebra import _multiply_rows, multiply
from cagemap.operators import build_operators
from cagemap.spectral import band_pairs, eigenpairs, exact_basis
from cagemap.spectral.eigenpairs import SOLVER
from cagemap.subdivision import refine

from refusals import refuses

# Eigenvalues are quadratic in the residuals, which the solver brings below 1e-9.
EXACT = 1e-10


@pytest.fixture(scope="module")
def creature():
    """Level 1 has 610 vertices (dense path), level 2 has 2434 (Lanczos)."""
    return build_operators(refine(shapes.creature(), 3))


@pytest.fixture(scope="module")
def reference(creature):
    """Eigenpairs of level 2 by ARPACK, converged to rounding."""
    values, vectors = eigsh(creature.stiffness[2].tocsc(), 90, creature.mass[2].tocsc(), sigma=-10.0)
    order = np.argsort(values)
    return values[order], vectors[:, order]


def residuals_of(pairs, stiffness, mass):
    x = pairs.vectors
    return eigenpairs.residual_norms(pairs.values, stiffness @ x, mass @ x, mass @ np.ones(len(x)))


def relative(values, exact):
    return np.abs(values - exact) / np.maximum(exact, 4 * np.pi)


def test_lanczos_agrees_with_arpack(creature, reference):
    pairs = band_pairs(creature.stiffness[2], creature.mass[2], 0, 80)
    values, vectors = reference
    assert relative(pairs.values, values[:80]).max() < EXACT
    assert residuals_of(pairs, creature.stiffness[2], creature.mass[2]).max() < 1e-6
    mass = creature.mass[2]
    np.testing.assert_allclose(pairs.vectors.T @ (mass @ pairs.vectors), np.eye(80), rtol=0, atol=1e-11)
    # The same space, whatever the rotation inside a cluster; the reference's next pairs keep the last cluster whole.
    inside = vectors.T @ (mass @ pairs.vectors)
    np.testing.assert_allclose(np.linalg.norm(inside, axis=0), 1.0, rtol=0, atol=1e-9)


def test_a_krylov_space_in_single_precision(creature, reference, monkeypatch):
    """Low accuracies store it so; eigenvalues keep five digits, those far from the shift too."""
    honest, stored = eigenpairs.shift_invert_lanczos, []

    def noting(*arguments, **options):
        values, vectors = honest(*arguments, **options)
        stored.append(vectors.dtype)
        return values, vectors

    monkeypatch.setattr(eigenpairs, "shift_invert_lanczos", noting)
    pairs = band_pairs(creature.stiffness[2], creature.mass[2], 0, 80, accuracy=SOLVER.single_accuracy)
    assert stored == [np.float32]
    assert relative(pairs.values, reference[0][:80]).max() < 1e-5
    gram = pairs.vectors.T @ (creature.mass[2] @ pairs.vectors)
    np.testing.assert_allclose(gram, np.eye(80), rtol=0, atol=1e-5)


def test_residuals_are_what_they_say(creature):
    stiffness, mass = creature.stiffness[1], creature.mass[1]
    pairs = band_pairs(stiffness, mass, 0, 30)
    areas = mass.toarray().sum(axis=1)
    for j in (0, 3, 29):
        x = pairs.vectors[:, j] + 1e-3 * pairs.vectors[:, (j + 1) % 30]
        r = stiffness @ x - pairs.values[j] * (mass @ x)
        slow = np.sqrt(np.sum(r**2 / areas)) / max(pairs.values[j], 4 * np.pi)
        fast = eigenpairs.residual_norms(pairs.values[[j]], stiffness @ x[:, None], mass @ x[:, None], areas)
        np.testing.assert_allclose(fast, slow, rtol=1e-9)


@pytest.mark.parametrize(("first", "last"), [(0, 20), (30, 70), (55, 56)])
def test_band_is_a_slice_of_the_spectrum(creature, reference, first, last):
    pairs = band_pairs(creature.stiffness[2], creature.mass[2], first, last)
    assert len(pairs.values) == last - first
    assert relative(pairs.values, reference[0][first:last]).max() < EXACT


def forget_a_pair(monkeypatch, widest=np.inf):
    """Lanczos skips an eigenvalue, with blocks up to a width."""
    honest = eigenpairs.shift_invert_lanczos

    def forgetful(shifted, mass, shift, below, above, **options):
        if options["block_size"] > widest:
            return honest(shifted, mass, shift, below, above, **options)
        values, vectors = honest(shifted, mass, shift, below, above + 1, **options)
        kept = np.arange(len(values)) != below + 2
        return values[kept], vectors[:, kept]

    monkeypatch.setattr(eigenpairs, "shift_invert_lanczos", forgetful)


@pytest.mark.slow
def test_a_wider_block_follows_where_a_pair_was_missed(creature, reference, monkeypatch):
    forget_a_pair(monkeypatch, widest=16)
    pairs = band_pairs(creature.stiffness[2], creature.mass[2], 0, 40, accuracy=1e-5)
    assert relative(pairs.values, reference[0][:40]).max() < EXACT


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [True, False])
def test_without_rslab(creature, reference, monkeypatch, caplog, inertia):
    """SuperLU serves too, with inertia read off its diagonal, or without any."""

    def without(matrix, *, like=None, dtype=np.float64):
        factors = sparse_algebra._factor_superlu(matrix, dtype)
        return factors if inertia else replace(factors, negative_eigenvalues=None)

    monkeypatch.setattr(eigenpairs, "factor", without)
    pairs = band_pairs(creature.stiffness[2], creature.mass[2], 30, 50)
    assert relative(pairs.values, reference[0][30:50]).max() < EXACT
    # Without inertia nothing proves that no pair is missing, and that is said.
    assert ("could not be proven complete" in caplog.text) == (not inertia)


@pytest.mark.parametrize(
    ("control", "level", "multiplicities"),
    [
        # Harmonics of degree 0, 1, 2, 3 split as the symmetry groups of the cube (1, 3, 3 + 2) and of the icosahedron
        # (1, 3, 5, 3 + 4) split them; the torus has pairs, cosine and sine around its axis.
        (shapes.cube, 4, [1, 3, 3, 2]),
        (shapes.icosahedron, 4, [1, 3, 5, 3, 4]),
        (lambda: shapes.torus(8, 5), 3, [1, 2, 2, 2]),
    ],
)
def test_repeated_eigenvalues_are_complete(control, level, multiplicities):
    operators = build_operators(refine(control(), level))
    stiffness, mass = operators.stiffness[-1], operators.mass[-1]
    assert stiffness.shape[0] > SOLVER.dense_rows, "this must run Lanczos"
    pairs = band_pairs(stiffness, mass, 0, sum(multiplicities) + 1)
    ends = np.cumsum(multiplicities)
    clusters = np.split(pairs.values, ends)
    for values, multiplicity in zip(clusters, multiplicities, strict=False):
        assert len(values) == multiplicity
        assert np.ptp(values) < 1e-8 * max(values[-1], 1.0)
    gaps = pairs.values[ends] - pairs.values[ends - 1]
    assert gaps.min() > 1e-4 * pairs.values[-1]


@pytest.mark.slow
def test_a_lost_pair_is_noticed(creature, monkeypatch):
    """If Lanczos skipped an eigenvalue the inertia would tell."""
    forget_a_pair(monkeypatch)
    refuses(SolverError, "inertia", band_pairs, creature.stiffness[2], creature.mass[2], 0, 40)


@pytest.mark.slow
@pytest.mark.parametrize(("control", "count"), [(shapes.creature, 20), (shapes.icosahedron, 9), (shapes.cube, 7)])
def test_eigenvalues_never_increase_with_level(control, count):
    """The spaces are nested, and Rayleigh quotients do not depend on the level (min-max principle)."""
    operators = build_operators(refine(control(), 3))
    spectra = [exact_basis(operators, level, count).values for level in range(4)]
    for coarse, fine in pairwise(spectra):
        assert np.all(fine <= coarse + 1e-9 * coarse[-1])
        assert fine[-1] < coarse[-1]


def test_square_converges_to_its_neumann_eigenvalues():
    """pi^2 (a^2 + b^2) on the unit square, with second order in the finest spacing (linear elements, lumped mass)."""
    exact = np.sort([np.pi**2 * (a * a + b * b) for a in range(6) for b in range(6)])[:12]
    errors = []
    for levels in (2, 3, 4):
        operators = build_operators(refine(shapes.grid(4, 4), levels))
        values = exact_basis(operators, levels, 12).values
        errors.append(np.max(np.abs(values - exact)[1:] / exact[1:]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.8)
    assert errors[-1] < 0.01


def test_a_function_that_subdivision_averages_away_is_none():
    """The cube's level 0 has 8 vertices but only 7 functions: +1 and -1 in turn becomes zero."""
    operators = build_operators(refine(shapes.cube(), 2))
    pairs = exact_basis(operators, 0, 7)
    assert residuals_of(pairs, operators.stiffness[0], operators.mass[0]).max() < 1e-10
    refuses(ParameterError, "7", exact_basis, operators, 0, 8)


def test_refusals(creature):
    refuses(ParameterError, "level from 0 to 3", exact_basis, creature, 4, 10)
    refuses(ParameterError, "154", exact_basis, creature, 0, 155)
    refuses(ParameterError, "range", band_pairs, creature.stiffness[1], creature.mass[1], 5, 5)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("columns", [1, 7, 300])
def test_product_kernel_agrees_with_its_slow_twin(dtype, columns):
    """300 columns are enough work for several threads."""
    rng = np.random.default_rng(23)
    matrix = sparse.random_array((900, 700), density=0.02, rng=rng, format="csr")
    block = rng.standard_normal((700, columns)).astype(dtype)
    product = multiply(matrix, block)
    assert product.dtype == dtype
    np.testing.assert_allclose(product, matrix @ block, rtol=0, atol=1e-12 if dtype == np.float64 else 1e-4)
    slow = np.empty((900, columns))
    _multiply_rows.py_func(matrix.indptr, matrix.indices, matrix.data, block[:, :1], 0, 900, slow[:, :1])
    np.testing.assert_allclose(slow[:, 0], matrix @ block[:, 0], rtol=0, atol=1e-12 if dtype == np.float64 else 1e-4)
