"""Python threads over surfaces and row ranges, each with one BLAS thread.

BLAS threads gain little on tall, narrow blocks, and spin while they wait: four times the processor time on a busy
machine. The number of threads comes from `thread_limit`, else from the environment variable CAGEMAP_THREADS, else from
the cores that the process may use.
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
# Number of rows of a dense matrix that one thread processes at a time.
ROWS = 65_536

_thread_limit: ContextVar[int | None] = ContextVar("cagemap_thread_limit", default=None)


# The limit of the process' BLAS libraries, once for every user: the first sets it, the last one to leave restores it.
# If each restored what it found, two whose stays overlap could leave the limit for ever.
_blas_limits: list[threadpool_limits] = []
_blas_lock = threading.Lock()


@contextmanager
def _controlling_blas() -> Iterator[None]:
    """Let this thread set the number of OpenBLAS threads, and then any other.

    From 3.7 on threadpoolctl ignores all threads but the first that has set it, while that one lives.
    """
    release = getattr(OpenBLASController, "clear_controlling_thread", lambda force: None)
    release(force=True)
    yield
    release(force=True)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK to the calling thread inside the block; several threads may be inside at once.

    The limit belongs to the process: enter the block before threads start. The last to leave restores what was set.
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

    Other threads of the caller keep their own limit. Nested work may start as many again: only 1 limits the whole.

    Raises
    ------
    ParameterError
        If the count is not a positive integer.
    """
    token = _thread_limit.set(_checked_count(count, "threads"))
    try:
        yield
    finally:
        _thread_limit.reset(token)


def core_count() -> int:
    """Number of threads: `thread_limit`, else CAGEMAP_THREADS, else the cores that this process may use."""
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
        raise ParameterError(
            f"{name}: expected a number of threads from 1, got {count!r}; leave it out to use all cores"
        )
    return number


class ThreadPool(ThreadPoolExecutor):
    """A thread pool that keeps its caller's `thread_limit`; under a limit of 1 the caller does the work at once."""

    def submit(
        self, work: Callable[Arguments, Value], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Value]:
        """Schedule work(*args, **kwargs)."""
        if core_count() > 1:
            context = copy_context()
            return super().submit(lambda: context.run(work, *args, **kwargs))
        future: Future[Any] = Future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:  # raised where the result is asked for, as from a thread
            future.set_exception(error)
        return future


def in_threads(work: Callable[[Item], Value], items: Sequence[Item]) -> list[Value]:
    """Apply a function to every item, in threads; results in order. The first error is raised once all have ended.

    Every thread, the caller among them, takes the next item when it is done: submitting small items costs too much.
    """
    threads = min(len(items), core_count())
    if threads <= 1:
        return [work(item) for item in items]
    waiting = iter(enumerate(items))  # one for all: under the interpreter's lock none gets an item twice
    made: dict[int, Value] = {}
    failed: dict[int, Exception] = {}

    def share() -> None:
        for place, item in waiting:
            try:
                made[place] = work(item)
            except Exception as error:
                failed[place] = error

    with ThreadPool(threads - 1) as pool:
        shares = [pool.submit(share) for _ in range(threads - 1)]
        try:
            share()
            for ended in shares:
                ended.result()
        except BaseException:  # stopped: no thread takes another item
            for _ in waiting:
                pass
            raise
    if failed:
        raise failed[min(failed)]
    return [made[place] for place in range(len(items))]


if TYPE_CHECKING:
    kept = cached_property
else:

    class kept(cached_property):  # noqa: N801, a decorator
        """A cached property: computed once, when first read; other threads wait.

        `functools.cached_property` has one lock for all values of a class, and none from Python 3.12 on. Here every
        value has its own lock while it is computed.
        """

        def __get__(self, instance, owner=None):
            """Return the cached value, or compute it."""
            if instance is None:
                return self
            known, name, lock = vars(instance), self.attrname, f"lock of {self.attrname}"
            with known.setdefault(lock, threading.RLock()):
                try:
                    if name not in known:
                        known[name] = self.func(instance)
                finally:
                    known.pop(lock, None)
                return known[name]


def row_slices(count: int, size: int) -> list[slice]:
    """Slices of ``size`` that cover ``count`` rows, for threads or for a core's cache."""
    return [slice(start, min(count, start + size)) for start in range(0, count, size)]
