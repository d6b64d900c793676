"""Progress on the command line: a line per stage; without a terminal only where a stage takes long."""

from __future__ import annotations

import logging
import sys
import threading
from types import TracebackType
from typing import Any, Self

from cagemap.cli.console import say_aside
from cagemap.tasks.progress import Stages

_log = logging.getLogger("cagemap.cli")

# Seconds after which a command without a terminal says its stages: short ones leave a log empty.
SILENT = 5.0


class ShownStages(Stages):
    """Stages of a command, used as a context manager around it.

    On a terminal it shows the running stage on standard error and leaves one line for every finished one. Anywhere else
    it writes a line as a stage begins, once it has run for `SILENT` seconds. It is silent where silence or more words
    were asked for.
    """

    def __init__(self) -> None:
        super().__init__()
        self._status: Any = None
        self._lock, self._says_lines = threading.Lock(), False
        self._timer: threading.Timer | None = None
        if _log.getEffectiveLevel() != logging.WARNING:
            return
        if not sys.stderr.isatty():
            self._timer = threading.Timer(SILENT, self._say_lines)
            self._timer.daemon = True
        else:
            from rich.console import Console

            self._console = Console(stderr=True)
            self._status = self._console.status("")

    def __call__(self, stage: str) -> None:
        """End the running stage, begin the next."""
        with self._lock:
            super().__call__(stage)
            self._write_line()
        self.show(f"{stage} ...")

    def show(self, text: str) -> None:
        """Say how far the running stage is."""
        if self._status is not None:
            self._status.update(text)

    def note(self, text: str) -> None:
        """Say something that stays on the terminal; in the log in any case."""
        super().note(text)
        if self._status is not None:
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        if self._timer is not None:
            self._timer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().__exit__(kind, error, at)
        if self._status is not None:
            self._status.stop()

    def _say_lines(self) -> None:
        """From now on, write a line per stage."""
        with self._lock:
            self._says_lines = True
            self._write_line()

    def _write_line(self) -> None:
        if self._says_lines and self._name is not None:
            say_aside(f"stage: {self._name}")

    def _finished(self, stage: str, seconds: float) -> None:
        if self._status is not None:
            self._console.print(f"[green]✓[/green] {stage} [dim]{seconds:.1f} s[/dim]", highlight=False)
