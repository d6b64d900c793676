"""Process settings for computing, and import of optional libraries."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import sys
from importlib import import_module
from typing import Any

from cagemap.errors import MissingLibraryError

# New objects between garbage collections: a command makes 240 000 that stay while it loads.
GC_THRESHOLD = 1_000_000
# Seconds that a thread returning from a kernel waits at most for one that runs Python; Python's default is 0.005.
SWITCH_INTERVAL = 0.0005
# Parameters of glibc's malloc (mallopt(3)): M_ARENA_MAX, M_TRIM_THRESHOLD, M_MMAP_THRESHOLD. Larger arrays go back to
# the system when they are freed.
MALLOC = {-8: 2, -1: 1 << 30, -3: 16 << 20}


def set_up_process() -> None:
    """Apply the process settings; call it before libraries are loaded."""
    gc.set_threshold(GC_THRESHOLD, *gc.get_threshold()[1:])
    atexit.register(_leave)
    keep_memory()
    sys.setswitchinterval(SWITCH_INTERVAL)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before it is loaded, or its threads spin


def keep_memory() -> None:
    """Set glibc malloc to reuse freed memory: new pages cost more than the arithmetic on them."""
    mallopt: Any = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    for parameter, value in MALLOC.items() if mallopt else ():  # musl has none
        mallopt(parameter, value)


def _leave() -> None:
    """Skip the last garbage collection, except with OpenImageIO, which would report leaks."""
    if "OpenImageIO" not in sys.modules:
        gc.freeze()


def import_library(module: str, purpose: str) -> Any:
    """Import an optional module; ``purpose``, such as "pictures", is named in MissingLibraryError."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        raise MissingLibraryError(
            f"{purpose}: expected the library {name}, which is not installed ({error}); `pip install {name}` where it "
            "has a wheel for this platform and version of Python, or do this step where it has: everything else works "
            "without it"
        ) from error
