"""Threads: BLAS keeps to one, surfaces get one each, and neither changes a result."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cagemap.basis import BasisConfig
from cagemap.errors import ParameterError
from cagemap.mesh import shapes
from cagemap.numerics.threads import in_threads, one_blas_thread
from cagemap.pipeline import prepare_pair, prepare_surface

CONFIG = BasisConfig(count=12)


def blas_threads():
    return {pool["filepath"]: pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_blas_is_limited_inside_and_as_before_outside():
    np.linalg.eigh(np.eye(3))
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        assert set(before.values()) == {2}
        with one_blas_thread():
            assert set(blas_threads().values()) == {1}
        assert blas_threads() == before


def test_results_come_in_order_and_the_first_error_is_raised():
    assert in_threads(lambda i: i * i, range(10), threads=3) == [i * i for i in range(10)]
    assert in_threads(lambda i: i, []) == []
    with pytest.raises(ParameterError, match="item 2"):
        in_threads(fail_at_two, range(5), threads=2)


def fail_at_two(i):
    if i >= 2:
        raise ParameterError(f"item {i}")
    return i


def test_a_pair_prepared_at_once_is_what_each_is_alone():
    meshes, levels = (shapes.creature(), shapes.icosahedron()), (1, 2)
    together = prepare_pair(*meshes, levels, CONFIG)
    for surface, mesh, level in zip(together, meshes, levels, strict=True):
        alone = prepare_surface(mesh, level, CONFIG)
        np.testing.assert_array_equal(surface.basis.eigenvalues, alone.basis.eigenvalues)
        np.testing.assert_array_equal(surface.basis.bands[0], alone.basis.bands[0])


def test_a_bad_mesh_of_a_pair_is_refused_as_it_is_alone():
    with pytest.raises(ParameterError, match="level"):
        prepare_pair(shapes.creature(), shapes.creature(), (1, 0), CONFIG)
