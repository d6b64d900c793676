"""Settings of a process that computes, and import of libraries that it may lack."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import sys
from importlib import import_module
from typing import Any

from cagemap.errors import MissingLibraryError

# New objects after which Python looks for cycles of garbage among all there are: loading makes many that stay.
GC_THRESHOLD = 100_000
# Seconds for which a thread that works in Python may keep those waiting that come back from a kernel; 0.005 by default.
SWITCH_INTERVAL = 0.0005
# Of glibc's malloc (see mallopt(3)): M_ARENA_MAX, M_TRIM_THRESHOLD and M_MMAP_THRESHOLD, the last at most 32 MB.
MALLOC = {-8: 2, -1: 1 << 30, -3: 32 << 20}


def set_up_process() -> None:
    """Make this process one that computes; before libraries are loaded."""
    gc.set_threshold(GC_THRESHOLD, *gc.get_threshold()[1:])
    atexit.register(_leave)
    keep_memory()
    sys.setswitchinterval(SWITCH_INTERVAL)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before it is loaded, or its threads spin


def keep_memory() -> None:
    """Have freed memory used again, by any thread: to take a new page costs more than the arithmetic on it."""
    mallopt: Any = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    for parameter, value in MALLOC.items() if mallopt else ():  # musl has none
        mallopt(parameter, value)


def _leave() -> None:
    """Spare the last look for garbage; OpenImageIO takes what is left then for leaks, and says so."""
    if "OpenImageIO" not in sys.modules:
        gc.freeze()


def import_library(module: str, purpose: str) -> Any:
    """Import a module that has no wheel for every platform; ``purpose`` needs it, such as "pictures"."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        raise MissingLibraryError(
            f"{purpose}: expected the library {name}, which is not installed ({error}); `pip install {name}` where it "
            "has a wheel for this platform and version of Python, or do this step where it has: everything else works "
            "without it"
        ) from error
