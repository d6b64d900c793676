"""The smoother: a fast polynomial that is what its slow twin is, and a bound that it needs."""

from __future__ import annotations

import numpy as np
import pytest
from examples import shapes
from scipy import sparse
from scipy.sparse import linalg

from cagemap.basis import exact_basis
from cagemap.basis.constants import CONDITION
from cagemap.basis.smoothing import _chebyshev_rows, residuals, smoother
from cagemap.operators import build_operators
from cagemap.refinement import refine


@pytest.fixture(scope="module")
def creature():
    """The step from level 2, 2434 vertices, to level 3; pairs of the coarser."""
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    return refinement.matrices[2], operators.stiffness[3], operators.mass[3], exact_basis(operators, 2, 12)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_smoother_agrees_with_its_slow_twin(creature, dtype):
    subdivision, matrix, mass, coarse = creature
    right = residuals(matrix, mass, subdivision @ coarse.vectors[:, 5:9], coarse.values[5:9])
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
    matrix = creature[1]
    root = sparse.diags_array(1.0 / np.sqrt(matrix.diagonal()))
    largest = linalg.eigsh(root @ matrix @ root, 1, which="LA", return_eigenvectors=False)[0]
    assert largest <= smoother(matrix).highest <= 1.1 * largest
