"""Output of commands: results on standard output, warnings and progress on standard error."""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Iterable

from cagemap.errors import FormatError, use_option_names

_log = logging.getLogger("cagemap.cli")
_CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")  # all but the line feed


class _StatusHandler(logging.Handler):
    """Log handler for standard error: ``cagemap: warning: ...``, or ``cagemap: ...`` for information.

    A command reads some files several times: each warning is written once.
    """

    def __init__(self) -> None:
        super().__init__()
        self.shown_warnings: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = use_option_names(self.format(record))
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        if level and text in self.shown_warnings:
            return
        self.shown_warnings |= {text} if level else set()
        write_status(f"{level}{text}")


def write_status(text: str) -> None:
    """Write a line to standard error; a closed pipe or a full disk is no error."""
    try:
        sys.stderr.write(f"cagemap: {_escaped(text)}\n")
        sys.stderr.flush()
    except OSError:
        _discard_output(sys.stderr.fileno())


def set_verbosity(verbose: int, quiet: bool) -> None:
    """Set the log level: errors, warnings (default), steps and fallbacks, or everything."""
    logger = logging.getLogger("cagemap")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _StatusHandler)]:
        logger.removeHandler(handler)
    logger.addHandler(_StatusHandler())
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    logger.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])


def say(text: str, *, always: bool = False) -> None:
    """Write a command's result, unless quiet and not ``always``; a closed pipe is no error."""
    if not always and not _log.isEnabledFor(logging.WARNING):
        return
    try:
        sys.stdout.write(f"{_escaped(use_option_names(text))}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_output(sys.stdout.fileno())
    except OSError as error:
        _discard_output(sys.stdout.fileno())
        raise FormatError(
            f"standard output: cannot be written ({error.strerror}). Check the disk that it goes to."
        ) from None


def warn(messages: Iterable[str]) -> None:
    """Log warnings."""
    for message in messages:
        _log.warning("%s", message)


def escape_unprintable_output() -> None:
    """Make outputs escape characters that they cannot encode; replace closed outputs by the null device."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _escaped(text: str) -> str:
    """Text with control characters as Python writes them: names in foreign files may hold them."""
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


def _discard_output(descriptor: int) -> None:
    """Redirect an output that cannot be written to the null device: the interpreter would fail on it at its end."""
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, descriptor)
    os.close(null_device)
