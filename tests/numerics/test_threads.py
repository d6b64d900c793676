"""Threads: BLAS keeps to one, surfaces get one each, and neither changes a result."""

import copy
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from examples import shapes
from threadpoolctl import threadpool_info, threadpool_limits

from cagemap.errors import ParameterError
from cagemap.numerics.threads import ThreadPool, core_count, in_threads, kept, one_blas_thread, thread_limit
from cagemap.pipeline import prepare_surface, prepare_surfaces
from cagemap.spectral import BasisConfig

from refusals import refuses

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


def test_blas_is_as_before_however_the_stays_of_two_threads_overlap():
    np.linalg.eigh(np.eye(3))
    with threadpool_limits(limits=2, user_api="blas"):
        first_left, second_in = threading.Event(), threading.Event()

        def second():
            with one_blas_thread():
                second_in.set()
                assert first_left.wait(timeout=60)
                return set(blas_threads().values())

        with ThreadPoolExecutor(1) as pool:
            with one_blas_thread():  # enters first, leaves first
                inside = pool.submit(second)
                assert second_in.wait(timeout=60)
            first_left.set()
            assert inside.result() == {1}
        assert set(blas_threads().values()) == {2}


def test_blas_is_as_before_after_many_threads_and_errors():
    with threadpool_limits(limits=2, user_api="blas"):

        def stay(i):
            with one_blas_thread():
                if i % 3 == 0:
                    raise ParameterError("stop")
                return np.linalg.eigvalsh(np.eye(20))[0]

        with ThreadPoolExecutor(8) as pool:
            stays = [pool.submit(stay, i) for i in range(60)]
        assert sum(stay.exception() is not None for stay in stays) == 20
        assert set(blas_threads().values()) == {2}


def test_a_thread_limit_holds_inside_and_in_the_threads_started_there():
    before = core_count()
    with thread_limit(3):
        assert core_count() == 3
        assert in_threads(lambda _: core_count(), range(3)) == [3, 3, 3]
        with thread_limit(1):
            assert in_threads(lambda _: threading.get_ident(), range(4)) == [threading.get_ident()] * 4
            with ThreadPool(2) as pool:
                assert pool.submit(threading.get_ident).result() == threading.get_ident()
                refuses(ParameterError, "item 2", pool.submit(fail_at_two, 2).result)
        assert core_count() == 3
        with ThreadPoolExecutor(1) as foreign:  # a user's own thread has its own setting
            assert foreign.submit(core_count).result() == before
    assert core_count() == before


def test_an_environment_variable_limits_threads(monkeypatch):
    monkeypatch.setenv("CAGEMAP_THREADS", "5")
    assert core_count() == 5
    with thread_limit(2):
        assert core_count() == 2
    for wrong in ("0", "many", "1.5"):
        monkeypatch.setenv("CAGEMAP_THREADS", wrong)
        refuses(ParameterError, "CAGEMAP_THREADS", core_count)


@pytest.mark.parametrize("wrong", [0, -1, 1.5, "two"])
def test_a_thread_limit_is_a_positive_number(wrong):
    with pytest.raises(ParameterError, match="threads: expected"), thread_limit(wrong):
        pass


def test_results_come_in_order_and_the_first_error_is_raised():
    with thread_limit(3):
        assert in_threads(lambda i: i * i, range(10)) == [i * i for i in range(10)]
    assert in_threads(lambda i: i, []) == []
    with thread_limit(2), pytest.raises(ParameterError, match="item 2"):
        in_threads(fail_at_two, range(5))


def fail_at_two(i):
    if i >= 2:
        raise ParameterError(f"item {i}")
    return i


@pytest.mark.slow
def test_a_pair_prepared_at_once_is_what_each_is_alone():
    meshes, levels = (shapes.creature(), shapes.icosahedron()), (1, 2)
    together = prepare_surfaces(*meshes, levels, CONFIG)
    for surface, mesh, level in zip(together, meshes, levels, strict=True):
        alone = prepare_surface(mesh, level, CONFIG)
        np.testing.assert_array_equal(surface.basis.eigenvalues, alone.basis.eigenvalues)
        np.testing.assert_array_equal(surface.basis.bands[0], alone.basis.bands[0])


def test_a_bad_mesh_of_a_pair_is_refused_as_it_is_alone():
    refuses(ParameterError, "level", prepare_surfaces, shapes.creature(), shapes.creature(), (1, 0), CONFIG)


class Kept:
    """A value that meets others, or waits, while its property is worked out."""

    def __init__(self, meet):
        self.meet, self.times = meet, 0

    @kept
    def made(self):
        """How often this was worked out."""
        self.times += 1
        self.meet()
        return self.times


def test_two_values_are_worked_out_at_the_same_time():
    barrier = threading.Barrier(2, timeout=60)
    values = [Kept(barrier.wait), Kept(barrier.wait)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda value: value.made, values)) == [1, 1]


def test_a_value_is_worked_out_once_and_nothing_is_left_of_waiting_for_it():
    begun, may_end = threading.Event(), threading.Event()

    def slowly():
        begun.set()
        assert may_end.wait(timeout=60)

    value = Kept(slowly)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(lambda: value.made)
        assert begun.wait(timeout=60)
        second = pool.submit(lambda: value.made)
        may_end.set()
        assert (first.result(), second.result()) == (1, 1)
    assert set(vars(value)) == {"meet", "times", "made"}


def test_a_copy_while_a_value_is_worked_out_leaves_it_and_its_lock_out():
    value = Kept(lambda: None)
    value.meet = lambda: copies.append(copy.copy(value))
    copies = []
    assert value.made == 1
    assert set(vars(copies[0])) == {"meet", "times"}
    assert copies[0].made == 2


def test_a_value_that_fails_is_worked_out_again():
    value = Kept(lambda: 1 / 0)
    for times in (1, 2):
        with pytest.raises(ZeroDivisionError):
            _ = value.made
        assert value.times == times
    value.meet = lambda: None
    assert value.made == 3
    assert Kept.made.__doc__ == "How often this was worked out."
