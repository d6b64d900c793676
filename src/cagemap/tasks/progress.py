"""Progress of a running task, and its outcome."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import TracebackType
from typing import Any, Self

from cagemap.errors import ParameterError

_log = logging.getLogger("cagemap.cli")

# Summary and warnings of a task.
SummaryAndWarnings = tuple[str, list[str]]


class Stages:
    """Times the stages of a task: call it with the name of each stage that begins.

    As a context manager it also ends the last stage. It shows nothing, but passes names of stages to ``tell``.
    """

    def __init__(self, tell: Callable[[str], None] | None = None) -> None:
        if tell is not None and not callable(tell):
            raise ParameterError(f"progress: expected a function of a text, got {tell!r}")
        self._tell = tell
        self.timings: dict[str, float] = {}  # seconds of every finished stage; a repeated one adds to its time
        self.figures: dict[str, Any] = {}  # figures of the task's result, by name
        self._name: str | None = None
        self._start = 0.0

    def __call__(self, stage: str) -> None:
        """End the running stage, begin the next."""
        self._finish()
        self._name, self._start = stage, time.perf_counter()
        _log.info("stage: %s", stage)
        if self._tell is not None:
            self._tell(stage)

    def record(self, figures: Mapping[str, Any], of: str = "") -> None:
        """Add figures of the task's result, or of one of its files: numbers, texts, lists and tables.

        `cagemap.tasks.run` returns them.
        """
        self.figures |= {of: dict(figures)} if of else figures

    def show(self, text: str) -> None:
        """Show the progress of the running stage; nothing by default."""

    def note(self, text: str) -> None:
        """Show a permanent message, and log it."""
        _log.info("%s", text)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self._finish()

    def _finish(self) -> None:
        if self._name is None:
            return
        seconds = time.perf_counter() - self._start
        self.timings[self._name] = self.timings.get(self._name, 0.0) + seconds
        self._finished(self._name, seconds)
        self._name = None

    def _finished(self, stage: str, seconds: float) -> None:
        """Show a finished stage; nothing by default."""


class _WarningCollector(logging.Handler):
    """Collects the texts of warnings that its thread logs, and the threads of its `ThreadPool`s."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if self in _collectors.get():
            self.texts.append(record.getMessage())


# Collectors of the blocks that the thread is in: workers of a job may be threads of one process.
_collectors: ContextVar[tuple[_WarningCollector, ...]] = ContextVar("cagemap_collectors", default=())


@contextmanager
def logged_warnings() -> Iterator[list[str]]:
    """A list to which every warning is added that the block logs."""
    collector, log = _WarningCollector(), logging.getLogger("cagemap")
    log.addHandler(collector)
    token = _collectors.set((*_collectors.get(), collector))
    try:
        yield collector.texts
    finally:
        _collectors.reset(token)
        log.removeHandler(collector)
