"""Runs the commands of a finish one after the other, each in a process of its own."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

from cagemap.studio.finish import Command
from cagemap.studio.state import Job, Output

CANCELLED = "cancelled"
# Share of what is left of a command that each of its stages is taken for: how many there are is not known.
_STAGE = 0.15


class Runner:
    """Runs commands in a thread; one run at a time.

    Parameters
    ----------
    on_job : callable
        Told of every command and stage, and None at the end.
    on_output : callable
        Told of everything that was written.
    on_end : callable
        Told what went wrong, in the command's own words, or None.
    """

    def __init__(
        self,
        on_job: Callable[[Job | None], None],
        on_output: Callable[[Output], None],
        on_end: Callable[[str | None], None],
    ) -> None:
        self._on_job, self._on_output, self._on_end = on_job, on_output, on_end
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._cancelled = False

    def start(self, todo: tuple[Command, ...]) -> None:
        """Begin; returns at once."""
        self._cancelled = False
        self._on_job(Job("finish", "starting", 0.0, can_cancel=True))
        threading.Thread(target=self._work, args=(todo,), name="studio finish", daemon=True).start()

    def cancel(self) -> None:
        """End the running command; what it has not finished writing leaves no trace."""
        with self._lock:
            self._cancelled = True
            if self._process is not None and self._process.poll() is None:
                self._process.terminate()

    def _work(self, todo: tuple[Command, ...]) -> None:
        try:
            words = next((words for words in self._all(todo) if words is not None), None)
        except Exception as error:  # whatever happens, the finish has an end
            words = f"finish: {type(error).__name__}: {error}"
        self._on_job(None)
        self._on_end(words)

    def _all(self, todo: tuple[Command, ...]) -> Iterator[str | None]:
        """What went wrong with each command."""
        for number, command in enumerate(todo):
            words = self._run(command, number, len(todo))
            for output in command.written() if words is None else ():
                self._on_output(output)
            yield words

    def _run(self, command: Command, number: int, count: int) -> str | None:
        """Run one command to its end; what went wrong."""
        left = 1.0

        def tell(stage: str) -> None:
            self._on_job(Job(f"finish {number + 1}/{count}", stage, (number + 1 - left) / count, can_cancel=True))

        tell(command.title)
        call = [sys.executable, "-c", "from cagemap.cli import main; main()", "-v", *command.arguments]
        with self._lock:
            if self._cancelled:
                return CANCELLED
            self._process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        lines: list[str] = []
        assert self._process.stdout is not None
        for line in self._process.stdout:
            lines.append(line.rstrip())
            if (stage := stage_of(line)) is not None:
                left *= 1 - _STAGE
                tell(f"{command.title}: {stage}")
        code = self._process.wait()
        if code == 0:
            return None
        if self._cancelled:
            return CANCELLED
        errors = [line for line in lines if "error" in line] or lines[-3:] or [f"exit code {code}"]
        return f"{command.title}: " + "\n".join(errors)


def stage_of(line: str) -> str | None:
    """The stage that a line of a verbose command announces."""
    head, separator, stage = line.partition("stage:")
    return stage.strip() if separator and head.startswith("cagemap") else None
