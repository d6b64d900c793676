"""Arrays and sparse arrays as tensors of torch."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import read_only
from cagemap.research import tensors


def test_tensors_are_copies_with_the_same_numbers():
    torch = pytest.importorskip("torch")
    values, matrix = read_only(np.arange(6.0)), sparse.csr_array([[0.0, 2.0], [3.0, 0.0]])
    whole, dense, held = tensors(np.arange(3), values, matrix, dtype=torch.float32)
    assert (whole.dtype, dense.dtype, held.dtype) == (torch.int64, torch.float32, torch.float32)
    dense += 1.0  # a copy: no warning, and the array stays
    np.testing.assert_array_equal(values, np.arange(6.0))
    np.testing.assert_array_equal(held.to_dense().numpy(), matrix.toarray())
    assert tensors(values).dtype == torch.float64


def test_without_torch_the_message_says_so(monkeypatch):
    found = builtins.__import__

    def missing(name, *others, **options):
        if name == "torch":
            raise ImportError
        return found(name, *others, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ParameterError, match="pip install torch"):
        tensors(np.zeros(3))
