"""Progress for people: a line per stage while it runs, on a terminal only; times of all stages in any case."""

from __future__ import annotations

import logging
import sys
import time
from types import TracebackType
from typing import Any

_log = logging.getLogger("cagemap.cli")


class Stages:
    """Callable that is told the name of each stage as it begins.

    Used as a context manager around a command. On a terminal it shows the running stage on standard error and leaves
    one line for every finished one; anywhere else it is silent.

    Parameters
    ----------
    shown : bool, optional
        Default: whether standard error is a terminal, and neither silence nor more words were asked for.

    Attributes
    ----------
    timings : dict of str to float
        Seconds of every finished stage, in order; a stage that comes again adds to its time.
    """

    def __init__(self, shown: bool | None = None) -> None:
        self.timings: dict[str, float] = {}
        self._name: str | None = None
        self._start = 0.0
        self._status: Any = None
        if sys.stderr.isatty() and _log.getEffectiveLevel() == logging.WARNING if shown is None else shown:
            from rich.console import Console

            self._console = Console(stderr=True)
            self._status = self._console.status("")

    def __call__(self, stage: str) -> None:
        """End the running stage, begin the next."""
        self._finish()
        self._name, self._start = stage, time.perf_counter()
        _log.info("stage: %s", stage)
        if self._status is not None:
            self._status.update(f"{stage} ...")

    def show(self, text: str) -> None:
        """Say how far the running stage is."""
        if self._status is not None:
            self._status.update(text)

    def note(self, text: str) -> None:
        """Say something that stays on the terminal; in the log in any case."""
        _log.info("%s", text)
        if self._status is not None:
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def __enter__(self) -> Stages:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self._finish()
        if self._status is not None:
            self._status.stop()

    def _finish(self) -> None:
        if self._name is None:
            return
        seconds = time.perf_counter() - self._start
        self.timings[self._name] = self.timings.get(self._name, 0.0) + seconds
        if self._status is not None:
            self._console.print(f"[green]✓[/green] {self._name} [dim]{seconds:.1f} s[/dim]", highlight=False)
        self._name = None
