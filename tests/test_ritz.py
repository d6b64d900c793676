"""Products of tall blocks, some rows at a time on all cores."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.basis.ritz import gram, rotated, subtract
from cagemap.numerics import threads

ROWS, WIDE, NARROW = 5 * 8192 + 7, 70, 9  # more pieces than shares, the last one small; more than one group of columns


@pytest.fixture(scope="module")
def blocks():
    rng = np.random.default_rng(7)
    return rng.standard_normal((ROWS, WIDE)), rng.standard_normal((ROWS, NARROW)), rng.standard_normal((WIDE, WIDE))


# Sums of 41 000 terms of size 1.
@pytest.mark.parametrize(("dtype", "rounding"), [(np.float64, 1e-10), (np.float32, 0.1)])
def test_against_plain_products(blocks, dtype, rounding):
    left, right, turn = (block.astype(dtype) for block in blocks)
    exact_left, exact_right = left.astype(float), right.astype(float)
    np.testing.assert_allclose(gram(left, left), exact_left.T @ exact_left, rtol=0, atol=rounding)
    np.testing.assert_allclose(gram(left, right, symmetric=False), exact_left.T @ exact_right, rtol=0, atol=rounding)
    less = right.copy()
    subtract(less, left, turn[:, :NARROW])
    np.testing.assert_allclose(less, exact_right - exact_left @ turn[:, :NARROW], rtol=0, atol=1e-3 * rounding)
    both = exact_left @ turn + exact_right @ turn[:NARROW]
    turned = rotated(left, turn, right, turn[:NARROW])
    np.testing.assert_allclose(turned, both, rtol=0, atol=1e-3 * rounding)
    assert turned is left  # in its memory
    np.testing.assert_array_equal(rotated(right, turn[:NARROW, :3]), right @ turn[:NARROW, :3])


def test_cores_change_nothing(blocks, monkeypatch):
    left, right, turn = blocks

    def products(cores):
        monkeypatch.setattr(threads, "core_count", lambda: cores)
        return gram(left, left), rotated(left.copy(), turn, right, turn[:NARROW])

    for one, many in zip(products(1), products(3), strict=True):
        np.testing.assert_array_equal(one, many)
