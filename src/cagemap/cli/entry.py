"""Entry point of the command line; every error becomes one message and an exit code."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from cagemap.cli.console import escape_unprintable_output, say, set_verbosity, write_status
from cagemap.errors import CagemapError, ParameterError, explain_error
from cagemap.numerics.process import set_up_process

# Text of `cagemap --help`, since importing typer and all requests takes 0.2 s. A test says how to renew it.
HELP_FILE = Path(__file__).with_name("help.txt")
EXIT_WRONG_INPUT, EXIT_INTERNAL_ERROR, EXIT_SIGNAL = 2, 70, 128


class Interruption:
    """Turns the first SIGINT or SIGTERM into a KeyboardInterrupt; the next one ends the process."""

    def __init__(self) -> None:
        self.signal: int | None = None  # received
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._handlers = {
                number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)
            }
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        for handled in self._handlers:
            signal.signal(handled, signal.SIG_DFL)
        raise KeyboardInterrupt


def main() -> None:
    """Run the command line; errors become one message and an exit code, not a traceback."""
    set_up_process()
    escape_unprintable_output()
    set_verbosity(0, quiet=False)
    with Interruption() as interruption:
        try:
            _run()
        except (KeyboardInterrupt, SystemExit) as error:
            code = getattr(error, "code", None)
            if interruption.signal is None or code == 0:
                raise
            _fail("stopped; outputs that were not finished are as they were before.", EXIT_SIGNAL + interruption.signal)


def _run() -> None:
    try:
        if sys.argv[1:] in (["--help"], ["-h"]) and shutil.get_terminal_size().columns >= 80:
            say(HELP_FILE.read_text(encoding="utf-8").rstrip("\n"), always=True)
            raise SystemExit(0)
        from cagemap.cli.app import app  # here, so that Ctrl-C during imports gives no traceback

        _check_words(sys.argv[1:])
        app()
    except Exception as error:
        is_known = isinstance(error, CagemapError | MemoryError | OSError)
        if not is_known and os.environ.get("CAGEMAP_DEBUG"):
            raise
        _fail(explain_error(error), EXIT_WRONG_INPUT if is_known else EXIT_INTERNAL_ERROR)


def _check_words(words: list[str]) -> None:
    """Raise for empty values, which would name the current folder, and for ``-`` as output."""
    for previous, word in zip(["the command line", *words], words, strict=False):
        option, equals, value = word.partition("=") if word.startswith("--") else (previous, "=", word)
        if equals and not value:
            raise ParameterError(
                f"{option}: expected a value, got an empty one. Give one; is a variable of the shell not set?"
            )
        if value == "-" and option in ("-o", "--output"):
            raise ParameterError(
                f"{option}: expected a name, got '-', and nothing is written to standard output. Give a name."
            )


def _fail(message: str, code: int) -> NoReturn:
    write_status(f"error: {message}")
    raise SystemExit(code)
