"""The door of the command line: every problem becomes one message and an exit code."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any, NoReturn

from cagemap.cli.words import set_verbosity, tolerate_odd_names
from cagemap.errors import CagemapError, ParameterError, in_options

WRONG_INPUT, INTERNAL, SIGNALLED = 2, 70, 128

# New objects after which Python looks for cycles of garbage among all there are: loading makes many that stay.
COLLECTED_AFTER = 100_000
# Seconds for which a thread that works in Python may keep those waiting that come back from a kernel; 0.005 by default.
TURN = 0.0005
# Of glibc's malloc (see mallopt(3)): M_ARENA_MAX, M_TRIM_THRESHOLD and M_MMAP_THRESHOLD, the last at most 32 MB.
MALLOC = {-8: 2, -1: 1 << 30, -3: 32 << 20}


class Stop:
    """Turns Ctrl-C and a polite kill into an interrupt of the main thread, once; the next one ends the process.

    Attributes
    ----------
    signal : int or None
        The signal that came.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Stop:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        for known in self._before:
            signal.signal(known, signal.SIG_DFL)
        raise KeyboardInterrupt


def main() -> None:
    """Run the command line; problems become one message and an exit code, never a traceback."""
    _collect_seldom()
    keep_memory()
    sys.setswitchinterval(TURN)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before it is loaded, or its threads spin
    tolerate_odd_names()
    set_verbosity(0, quiet=False)
    with Stop() as stop:
        try:
            _run()
        except (KeyboardInterrupt, SystemExit) as ended:
            code = getattr(ended, "code", None)
            if stop.signal is None or code == 0:
                raise
            _fail("stopped; outputs that were not finished are as they were before.", SIGNALLED + stop.signal)


def _collect_seldom() -> None:
    """Look for cycles of garbage seldom, and not once more when the process ends."""
    gc.set_threshold(COLLECTED_AFTER, *gc.get_threshold()[1:])
    atexit.register(_leave)


def keep_memory() -> None:
    """Have freed memory used again, by any thread: to take a new page costs more than the arithmetic on it."""
    mallopt: Any = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    for parameter, value in MALLOC.items() if mallopt else ():  # musl has none
        mallopt(parameter, value)


def _leave() -> None:
    """Spare the last look for garbage; OpenImageIO takes what is left then for leaks, and says so."""
    if "OpenImageIO" not in sys.modules:
        gc.freeze()


def _run() -> None:
    try:
        from cagemap.cli.app import app  # here, so that Ctrl-C while commands are loaded is no traceback

        _require_words(sys.argv[1:])
        app()
    except CagemapError as error:
        _fail(str(error), WRONG_INPUT)
    except MemoryError:
        _fail("not enough memory for surfaces of this size. Use a lower --level or fewer --vertices.", WRONG_INPUT)
    except OSError as error:
        _fail(_of_system(error), WRONG_INPUT)
    except Exception as error:
        if os.environ.get("CAGEMAP_DEBUG"):
            raise
        _fail(
            f"internal error, {type(error).__name__}: {error}. This is a fault of cagemap, please report it; "
            "CAGEMAP_DEBUG=1 shows where it happened.",
            INTERNAL,
        )


def _of_system(error: OSError) -> str:
    """What to say of an error of the operating system; one that names no file is of a library's own files."""
    reason = error.strerror or error
    if error.filename:
        return f"{error.filename}: {reason}. Check the path and the space left on the disk."
    return (
        f"a file that a library keeps could not be read or written: {reason}. Is there room in the temporary folder "
        "(TMPDIR), and where compiled code is kept (NUMBA_CACHE_DIR, else beside cagemap or in ~/.cache)?"
    )


def _require_words(words: list[str]) -> None:
    """Refuse empty words, which as names of files would be the folder one stands in, and ``-`` as an output."""
    for before, word in zip(["the command line", *words], words, strict=False):
        option, equals, value = word.partition("=") if word.startswith("--") else (before, "=", word)
        if equals and not value:
            raise ParameterError(
                f"{option}: expected a value, got an empty one. Give one; is a variable of the shell not set?"
            )
        if value == "-" and option in ("-o", "--output"):
            raise ParameterError(
                f"{option}: expected a name, got '-', and nothing is written to standard output. Give a name."
            )


def _fail(message: str, code: int) -> NoReturn:
    sys.stderr.write(f"cagemap: error: {in_options(message)}\n")
    raise SystemExit(code)
