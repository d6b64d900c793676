"""Tensors with gradients, or on a device, are taken where arrays are; arrays become tensors of torch."""

import builtins
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from tensor import Tensor

import cagemap
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import read_only
from cagemap.research import tensors

from example_result import identity_result

RESULT = identity_result(1)
TRANSFER = cagemap.transfer_of(RESULT)
MESH, REFINEMENT = RESULT.source.control, RESULT.target.refinement
IMAGE = (np.arange(16 * 16 * 3).reshape(16, 16, 3) % 255).astype(np.uint8)
CALLS: dict[str, Callable[[Any], Any]] = {
    "bake": lambda of: cagemap.bake(RESULT, of(IMAGE), size=8),
    "displacement": lambda of: cagemap.bake_displacement(TRANSFER, of(IMAGE[..., :1]), size=8).pixels,
    "blend": lambda of: cagemap.blend(of(IMAGE), of(255 - IMAGE), of(np.full((16, 16, 1), 0.5))),
    "alpha": lambda of: cagemap.with_alpha(of(IMAGE), of(np.full((16, 16, 1), 0.5))),
    "painted mask": lambda of: cagemap.painted_mask(REFINEMENT.finest, of(IMAGE[..., 0])),
    "vertex mask": lambda of: cagemap.vertex_mask(REFINEMENT, of(np.arange(8) / 8)),
    "masks": lambda of: cagemap.Masks(target=of(np.arange(26) / 26)).target,
    "creases": lambda of: MESH.with_creases(of(np.array([[0, 1]])), of(np.ones(1))).crease_edges,
    "corners": lambda of: MESH.with_corners(of(np.array([4])), of(np.ones(1))).corner_vertices,
    "values": lambda of: cagemap.carry_values(RESULT, of(np.arange(8.0))),
    "weights": lambda of: cagemap.carry_weights(RESULT, of(np.ones((8, 1)))),
    "shapes": lambda of: cagemap.carry_shapes(RESULT, of(np.ones((8, 3)))),
    "mesh": lambda of: cagemap.check_mesh((of(MESH.positions), of(MESH.face_indices.reshape(-1, 4)))).n_edges,
    "landmarks": lambda of: (
        cagemap.pair_of(RESULT.target, RESULT.source, of(np.array([[1, 2], [3, 4]]))).source_landmarks
    ),
    "truth": lambda of: cagemap.geodesic_error(RESULT.point_map, of(np.arange(8)[::-1].copy()), of(np.arange(3))),
}


@pytest.mark.parametrize("name", CALLS)
def test_tensors_give_what_arrays_give(name: str) -> None:
    found = CALLS[name](Tensor)
    assert not isinstance(found, Tensor)
    np.testing.assert_array_equal(found, CALLS[name](np.asarray))


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
