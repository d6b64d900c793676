"""Progress on the command line: one line a stage."""

from __future__ import annotations

import logging
import sys
import threading
from types import TracebackType
from typing import Any, Self

from cagemap.cli.console import write_status
from cagemap.tasks.progress import Stages

_log = logging.getLogger("cagemap.cli")

# A command without a terminal writes its stages after this time: short ones leave logs empty.
SILENT_SECONDS = 5.0


class ConsoleStages(Stages):
    """Stages of a command on standard error, as a context manager.

    A terminal shows the running stage and one line for every finished one. Elsewhere each stage is written as it
    begins, after `SILENT_SECONDS`. With -q or -v nothing is shown.
    """

    def __init__(self) -> None:
        super().__init__()
        self._status: Any = None
        self._lock, self._writes_lines = threading.Lock(), False
        self._timer: threading.Timer | None = None
        if _log.getEffectiveLevel() != logging.WARNING:
            return
        if not sys.stderr.isatty():
            self._timer = threading.Timer(SILENT_SECONDS, self._start_lines)
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
        if self._status is not None:
            self._status.start()
        self.show(f"{stage} ...")

    def show(self, text: str) -> None:
        """Show the progress of the running stage."""
        if self._status is not None:
            self._status.update(text)

    def note(self, text: str) -> None:
        """Print a note on the terminal and log it."""
        super().note(text)
        if self._status is not None:
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._timer is not None:
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().__exit__(kind, error, traceback)
        if self._status is not None:
            self._status.stop()

    def _start_lines(self) -> None:
        """Write the running stage and all later ones."""
        with self._lock:
            self._writes_lines = True
            self._write_line()

    def _write_line(self) -> None:
        if self._writes_lines and self._name is not None:
            write_status(f"stage: {self._name}")

    def _finished(self, stage: str, seconds: float) -> None:
        if self._status is not None:
            self._console.print(f"[green]✓[/green] {stage} [dim]{seconds:.1f} s[/dim]", highlight=False)
