"""Who uses the cores: one BLAS thread for each Python thread, and Python threads over surfaces and row ranges.

OpenBLAS splits every product among all cores and lets its threads spin while they wait for each other. On tall, narrow
blocks that gains little, and as soon as anything else runs on the machine it costs four times the processor time.

How many threads there are is set in one place: `thread_limit` for what runs inside it, the environment variable
CAGEMAP_THREADS for a process, and otherwise the cores that the process may use.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cached_property
from typing import Any, ParamSpec, Self, TypeVar, overload

from threadpoolctl import OpenBLASController, threadpool_limits

from cagemap.errors import ParameterError

Item = TypeVar("Item")
Value = TypeVar("Value")
Arguments = ParamSpec("Arguments")

THREADS_VARIABLE = "CAGEMAP_THREADS"

_thread_limit: ContextVar[int | None] = ContextVar("cagemap_thread_limit", default=None)


class _BlasLimit:
    """The process's BLAS libraries, held at one thread from the first that asks until the last one has left.

    The setting belongs to the process: were every caller to restore what it found, then of two whose stays overlap
    the one that ends last would restore the other's limit, and it would stay for ever.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._limits: threadpool_limits | None = None

    def enter(self) -> None:
        with self._lock:
            if self._users == 0:
                _any_thread_may_set()
                self._limits = threadpool_limits(limits=1, user_api="blas")
                _any_thread_may_set()
            self._users += 1

    def leave(self) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0 and self._limits is not None:
                _any_thread_may_set()
                self._limits.restore_original_limits()
                self._limits = None
                _any_thread_may_set()


def _any_thread_may_set() -> None:
    """Let this thread, and any after it, set the number of OpenBLAS threads.

    From 3.7 on threadpoolctl heeds the thread that has set it first and silently ignores all others while it lives.
    """
    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


_blas_limit = _BlasLimit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to the calling thread while the block runs; any number of threads may be inside at once.

    The setting belongs to the process: where several threads work, enter it before they start. What was set before is
    restored when the last one leaves.
    """
    _blas_limit.enter()
    try:
        yield
    finally:
        _blas_limit.leave()


@contextmanager
def thread_limit(count: int) -> Iterator[None]:
    """Spread work over at most this many threads inside the block, and in the threads that cagemap starts there.

    Other threads of the caller keep their own setting. Work within work may be spread once more, so that only 1 is a
    limit of the whole.

    Parameters
    ----------
    count : int
        At least 1.

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
    """Threads to spread work over: `thread_limit`, else CAGEMAP_THREADS, else the cores that this process may use.

    Raises
    ------
    ParameterError
        If the environment variable is no positive integer.
    """
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
    """A thread pool whose work sees its caller's `thread_limit`; under a limit of 1 the caller does it at once."""

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


def in_threads(work: Callable[[Item], Value], items: Sequence[Item], threads: int | None = None) -> list[Value]:
    """Apply a function to every item, in threads; results in order. The first error is raised, once all have ended.

    Every thread, the asking one among them, takes the next item when it has done one: handing over single items costs
    more than a small one takes.
    """
    threads = min(len(items), threads or core_count())
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


class kept(cached_property[Value]):  # noqa: N801, named as the decorators that it stands beside
    """A property that is worked out once, when it is first asked for; who asks meanwhile waits.

    `functools.cached_property` has one lock for all values of a class, so that the threads of two surfaces wait for
    each other; from Python 3.12 on it has none, and two threads may each make one. Here a value has a lock of its own,
    while it is worked out.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...

    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> Value: ...

    def __get__(self, instance: object | None, owner: type[Any] | None = None) -> Self | Value:
        """Return what is kept, or work it out."""
        if instance is None:
            return self
        known, name, lock = vars(instance), str(self.attrname), f"lock of {self.attrname}"
        with known.setdefault(lock, threading.RLock()):
            try:
                if name not in known:
                    known[name] = self.func(instance)
            finally:
                known.pop(lock, None)
            made: Value = known[name]
            return made


def parts(count: int, size: int) -> list[slice]:
    """All rows or columns, ``size`` at a time: pieces to work on in threads, or one after the other within a cache."""
    return [slice(start, min(count, start + size)) for start in range(0, count, size)]
