"""Factorisations: both libraries behind one interface."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from examples import shapes
from scipy import sparse

from cagemap.errors import ParameterError, SolverError
from cagemap.numerics import sparse_algebra
from cagemap.numerics.sparse_algebra import factor, factor_general
from cagemap.operators import build_operators
from cagemap.subdivision import refine

from refusals import refuses

# Condition number below 1e6 times a few hundred roundings.
SOLVED = 1e-9


@pytest.fixture
def superlu(monkeypatch):
    """As where rslab has no wheel."""
    monkeypatch.setattr(sparse_algebra, "rslab", None)


@pytest.fixture(params=["rslab", "superlu"])
def _either_library(request, monkeypatch):
    if request.param == "superlu":
        monkeypatch.setattr(sparse_algebra, "rslab", None)
    elif sparse_algebra.rslab is None:
        pytest.skip("no rslab wheel here")


@pytest.fixture(scope="module")
def matrices():
    operators = build_operators(refine(shapes.creature(), 2))
    return operators.stiffness[1], operators.mass[1]


@pytest.mark.usefixtures("_either_library")
@pytest.mark.parametrize("shift", [-10.0, 200.0])
def test_solve_and_inertia(matrices, shift):
    stiffness, mass = matrices
    matrix = sparse.csr_array(stiffness - shift * mass)
    factors = factor(matrix)
    right_sides = np.random.default_rng(11).standard_normal((matrix.shape[0], 3))
    solution = factors.solve(right_sides)
    assert solution.shape == right_sides.shape
    assert abs(matrix @ solution - right_sides).max() < SOLVED
    np.testing.assert_allclose(factors.solve(right_sides[:, 0]), solution[:, 0], rtol=0, atol=SOLVED)
    negative = int(np.sum(np.linalg.eigvalsh(matrix.toarray()) < 0))
    assert negative == 0 if shift < 0 else negative > 5
    assert factors.negative_eigenvalues == negative


@pytest.mark.skipif(sparse_algebra.rslab is None, reason="no rslab wheel here")
def test_ordering_is_used_again(matrices, monkeypatch):
    stiffness, mass = matrices
    first = factor(sparse.csr_array(stiffness + mass))
    matrix = sparse.csr_array(stiffness - 50.0 * mass)
    anew = factor(matrix)
    monkeypatch.setattr(sparse_algebra, "_analyzed", lambda *_: pytest.fail("ordered once more"))
    again = factor(matrix, like=first)
    ones = np.ones(matrix.shape[0])
    np.testing.assert_array_equal(again.solve(ones), anew.solve(ones))
    assert again.negative_eigenvalues == anew.negative_eigenvalues


@pytest.mark.usefixtures("_either_library")
def test_entries_that_are_stored_twice_are_summed(matrices):
    matrix = sparse.csr_array(matrices[0] + matrices[1])
    half = sparse.coo_array(0.5 * matrix)
    rows = np.argsort(np.tile(half.row, 2), kind="stable")
    columns, values = np.tile(half.col, 2)[rows], np.tile(half.data, 2)[rows]
    twice = sparse.csr_array((values, columns, 2 * matrix.indptr), shape=matrix.shape)
    ones = np.ones(matrix.shape[0])
    for factored in (factor(twice), factor_general(twice)):
        assert abs(matrix @ factored.solve(ones) - ones).max() < SOLVED


@pytest.mark.usefixtures("_either_library")
def test_general_matrix(matrices):
    stiffness, _ = matrices
    rng = np.random.default_rng(12)
    matrix = sparse.csr_array(abs(stiffness))
    matrix.data *= rng.uniform(-1, 1, matrix.nnz)  # of symmetric pattern only
    rows = np.asarray(abs(matrix).sum(axis=1)).ravel()
    matrix = sparse.csr_array(matrix + sparse.diags_array(1.5 * rows))
    factors = factor_general(matrix)
    right_sides = rng.standard_normal((matrix.shape[0], 2))
    assert abs(matrix @ factors.solve(right_sides) - right_sides).max() < SOLVED
    assert factors.negative_eigenvalues is None


@pytest.mark.parametrize(
    "entries",
    [
        pytest.param([[0.0, 1.0], [1.0, 0.0]], id="no diagonal pivot"),
        pytest.param([[1e-20, 1.0], [1.0, 1e-20]], id="entries grow"),
    ],
)
@pytest.mark.usefixtures("superlu")
def test_superlu_tells_no_inertia_that_it_does_not_know(entries):
    matrix = sparse.csr_array(sparse.block_diag([np.array(entries), 2.0 * np.eye(3)]))
    assert factor(matrix).negative_eigenvalues is None


@pytest.mark.usefixtures("superlu")
def test_superlu_tells_no_inertia_in_single_precision(matrices):
    stiffness, mass = matrices
    assert factor(stiffness + mass, dtype=np.float32).negative_eigenvalues is None


def test_that_rslab_is_missing_is_said_once(matrices, monkeypatch, caplog):
    monkeypatch.setattr(sparse_algebra, "rslab", None)
    sparse_algebra._warn_without_rslab.cache_clear()

    def work(_):
        assert factor(matrices[0] + matrices[1])._symbolic is None

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(8)))
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "rslab is not installed" in caplog.text


def test_refusals(matrices):
    stiffness, mass = matrices
    refuses(ParameterError, "square", factor_general, sparse.csr_array(np.ones((2, 3))))
    refuses(ParameterError, "square", factor, sparse.csr_array(np.ones((2, 3))))
    refuses(ParameterError, "rows", factor(sparse.csr_array(stiffness + mass)).solve, np.ones(3))


@pytest.mark.usefixtures("_either_library")
def test_singular_matrix_is_refused():
    refuses(SolverError, "non-singular", factor, sparse.csr_array(np.zeros((4, 4))))
    refuses(SolverError, "non-singular", factor_general, sparse.csr_array(np.zeros((4, 4))))
