"""Who uses the cores: one BLAS thread for each Python thread, and Python threads over surfaces and row ranges.

OpenBLAS splits every product among all cores and lets its threads spin while they wait for each other. On tall, narrow
blocks that gains little, and as soon as anything else runs on the machine it costs four times the processor time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Value = TypeVar("Value")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to the calling thread while the block runs.

    The setting belongs to the process: where several threads work, enter it before they start.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(work: Callable[[Item], Value], items: Sequence[Item], threads: int | None = None) -> list[Value]:
    """Apply a function to every item, in threads; results in order. The first error is raised, once all have ended."""
    threads = min(len(items), threads or core_count())
    if threads <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))


def parts(count: int, size: int) -> list[slice]:
    """All rows or columns, ``size`` at a time: pieces to work on in threads, or one after the other within a cache."""
    return [slice(start, min(count, start + size)) for start in range(0, count, size)]
