"""Run Python threads over surfaces and row ranges, each with one BLAS thread.

BLAS threads gain little on tall, narrow blocks, and spin while they wait: four times the processor time on a busy
machine. The number of threads is set by `thread_limit`, else by the environment variable CAGEMAP_THREADS, else it is
the number of cores available to the process.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cached_property
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from threadpoolctl import OpenBLASController, threadpool_limits

from cagemap.errors import ParameterError

Item = TypeVar("Item")
Value = TypeVar("Value")
Arguments = ParamSpec("Arguments")

THREADS_VARIABLE = "CAGEMAP_THREADS"
ROW_BLOCK = 65_536  # number of rows of a dense matrix that one thread processes at a time

_thread_limit: ContextVar[int | None] = ContextVar("cagemap_thread_limit", default=None)


# The limit of the process's BLAS libraries, once per block inside `one_blas_thread`: the first block sets it, the last
# one restores it. If each block restored the previous value, overlapping blocks could leave the limit set.
_blas_limits: list[threadpool_limits] = []
_blas_lock = threading.Lock()


@contextmanager
def _controlling_blas() -> Iterator[None]:
    """Let any thread set the number of OpenBLAS threads; threadpoolctl 3.7 obeys only the first that did."""
    release = getattr(OpenBLASController, "clear_controlling_thread", lambda force: None)
    release(force=True)
    yield
    release(force=True)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK, globally, to one thread inside the block; enter it before threads start.

    Blocks of several threads may overlap: the last one to end restores the former limit.
    """
    with _blas_lock, _controlling_blas():
        _blas_limits.append(_blas_limits[0] if _blas_limits else threadpool_limits(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _blas_lock, _controlling_blas():
            limit = _blas_limits.pop()
            if not _blas_limits:
                limit.restore_original_limits()


@contextmanager
def thread_limit(count: int) -> Iterator[None]:
    """Use at most ``count`` threads inside the block, and in the threads that cagemap starts there.

    Other threads of the caller keep their own limit. Nested calls may start as many threads again, unless it is 1.
    ParameterError if the count is not a positive integer.
    """
    token = _thread_limit.set(_checked_count(count, "threads"))
    try:
        yield
    finally:
        _thread_limit.reset(token)


def core_count() -> int:
    """Number of threads to use: `thread_limit`, else CAGEMAP_THREADS, else the available cores."""
    limit = _thread_limit.get()
    if limit is not None:
        return limit
    variable = os.environ.get(THREADS_VARIABLE, "").strip()
    if variable:
        return _checked_count(variable, THREADS_VARIABLE)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _checked_count(count: int | str, name: str) -> int:
    try:
        number = int(count)
    except (TypeError, ValueError):
        number = 0
    if number < 1 or (not isinstance(count, str) and number != count):
        raise ParameterError(f"{name}: expected a number of threads from 1, got {count!r}; all cores are the default")
    return number


class ThreadPool(ThreadPoolExecutor):
    """Thread pool with its caller's `thread_limit`; under a limit of 1, work runs in the caller."""

    def submit(
        self, work: Callable[Arguments, Value], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Value]:
        """Schedule work(*args, **kwargs); returns its future."""
        if core_count() > 1:
            context = copy_context()
            return super().submit(lambda: context.run(work, *args, **kwargs))
        future: Future[Any] = Future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:  # raised by ``result()``, as from a thread
            future.set_exception(error)
        return future


def in_threads(work: Callable[[Item], Value], items: Sequence[Item]) -> list[Value]:
    """Apply a function to all items in threads; results in order. Raises the first item's error."""
    threads = min(len(items), core_count())
    if threads <= 1:
        return [work(item) for item in items]
    with ThreadPool(threads) as pool:
        return list(pool.map(work, items))


_LOCK = "lock of "  # prefix of the attribute with the lock of a cached value; names in code have no spaces

if TYPE_CHECKING:
    kept = cached_property
else:

    class kept(cached_property):  # noqa: N801, a decorator
        """Cached property: computed once, when first read; other threads wait.

        `functools.cached_property` has one lock for all instances of a class, and none from Python 3.12 on. Here every
        instance has its own lock during the computation. Pickles and copies leave such values out.
        """

        def __set_name__(self, owner, name):
            """Note the name, and leave the value out of pickles of the owner."""
            super().__set_name__(owner, name)
            if "__getstate__" not in vars(owner):
                owner.__getstate__ = _state_without_kept

        def __get__(self, instance, owner=None):
            """Return the cached value, or compute it."""
            if instance is None:
                return self
            known, name, lock = vars(instance), self.attrname, _LOCK + self.attrname
            with known.setdefault(lock, threading.RLock()):
                try:
                    if name not in known:
                        known[name] = self.func(instance)
                finally:
                    known.pop(lock, None)
                return known[name]

    def _state_without_kept(instance):
        """Attributes of an instance but those that can be computed again, which may hold factorisations, and locks."""
        return {
            name: value
            for name, value in dict(vars(instance)).items()  # a copy: other threads may add values meanwhile
            if not name.startswith(_LOCK) and not isinstance(getattr(type(instance), name, None), kept)
        }


def row_slices(count: int, size: int) -> list[slice]:
    """Consecutive slices of at most ``size`` rows that cover ``count`` rows."""
    return [slice(start, min(count, start + size)) for start in range(0, count, size)]
