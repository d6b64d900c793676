"""Output of commands: results on standard output, warnings and progress on standard error."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterable

from cagemap.errors import in_options

_log = logging.getLogger("cagemap.cli")


class _StandardError(logging.Handler):
    """``cagemap: warning: ...`` for warnings, ``cagemap: ...`` for what is only said when asked for.

    A command opens some files several times: each warning is said once.
    """

    def __init__(self) -> None:
        super().__init__()
        self.warned: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = in_options(self.format(record))
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        if level and text in self.warned:
            return
        self.warned |= {text} if level else set()
        say_aside(f"{level}{text}")


def say_aside(text: str) -> None:
    """Write a line to standard error; a reader who has gone is no error."""
    try:
        sys.stderr.write(f"cagemap: {text}\n")
        sys.stderr.flush()
    except BrokenPipeError:
        _forget(sys.stderr.fileno())


def set_verbosity(verbose: int, quiet: bool) -> None:
    """Choose what is said: errors only, warnings too (the default), steps and what they fell back to, or everything.

    Parameters
    ----------
    verbose : int
        How often ``-v`` was given.
    quiet : bool
    """
    logger = logging.getLogger("cagemap")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _StandardError)]:
        logger.removeHandler(handler)
    logger.addHandler(_StandardError())
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    logger.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])


def say(text: str, *, always: bool = False) -> None:
    """Write a command's result, unless asked to be quiet of what went well; a reader who has gone is no error."""
    if not always and not _log.isEnabledFor(logging.WARNING):
        return
    try:
        sys.stdout.write(f"{in_options(text)}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        _forget(sys.stdout.fileno())


def warn(messages: Iterable[str]) -> None:
    """Write warnings, one a line."""
    for message in messages:
        _log.warning("%s", message)


def tolerate_odd_names() -> None:
    """File names that are no text, and signs that a terminal lacks, are written as escapes; closed outputs are none."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _forget(descriptor: int) -> None:
    """Send what is still written to a closed pipe nowhere, so that the interpreter ends without a complaint."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
