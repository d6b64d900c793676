"""Entry point of the command line: every error becomes one message and an exit code."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from cagemap.cli.console import say, set_verbosity, tolerate_odd_names
from cagemap.errors import CagemapError, ParameterError, explained
from cagemap.numerics.process import set_up_process

# What `cagemap --help` writes, as text: typer and all requests cost 0.2 s. A test compares; it says how to renew it.
HELP = Path(__file__).with_name("help.txt")
WRONG_INPUT, INTERNAL, SIGNALLED = 2, 70, 128


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
    set_up_process()
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


def _run() -> None:
    try:
        if sys.argv[1:] in (["--help"], ["-h"]) and shutil.get_terminal_size().columns >= 80:
            say(HELP.read_text(encoding="utf-8").rstrip("\n"), always=True)
            raise SystemExit(0)
        from cagemap.cli.app import app  # here, so that Ctrl-C while commands are loaded is no traceback

        _require_words(sys.argv[1:])
        app()
    except Exception as error:
        known = isinstance(error, CagemapError | MemoryError | OSError)
        if not known and os.environ.get("CAGEMAP_DEBUG"):
            raise
        _fail(explained(error), WRONG_INPUT if known else INTERNAL)


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
    sys.stderr.write(f"cagemap: error: {message}\n")
    raise SystemExit(code)
