"""Runs the commands of a finish one after the other, in a process of their own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from cagemap.studio.finish import MAP, Command
from cagemap.studio.finish_process import Made, serve
from cagemap.studio.state import Message, Output, RunningJob
from cagemap.studio.worker import Failure, Worker

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
    on_message : callable
        Told of warnings, and of what went wrong with a command, in its own words.
    on_end : callable
        Told what there is to say of the whole.
    """

    def __init__(
        self,
        on_job: Callable[[RunningJob | None], None],
        on_output: Callable[[Output], None],
        on_message: Callable[[Message], None],
        on_end: Callable[[Message], None],
    ) -> None:
        self._on_job, self._on_output, self._on_message, self._on_end = on_job, on_output, on_message, on_end
        self._worker = Worker(self._stage, serve)
        self._running = ("", 0, 1)  # title, number and count of commands
        self._left = 1.0
        self._cancelled = False

    def start(self, todo: tuple[Command, ...]) -> None:
        """Begin; returns at once. Where the map cannot be made, there is nothing to do for the others."""
        self._cancelled = False
        self._on_job(RunningJob("finish", "starting", 0.0))
        threading.Thread(target=self._work, args=(todo,), name="studio finish", daemon=True).start()

    def cancel(self) -> None:
        """End the running command; what it has not finished writing leaves no trace."""
        self._cancelled = True
        self._worker.end()

    def _work(self, todo: tuple[Command, ...]) -> None:
        failed: list[str] = []
        try:
            for number, command in enumerate(todo):
                self._running, self._left = (command.title, number, len(todo)), 1.0
                done = self._run(command)
                failed += [] if done else [command.title]
                if self._cancelled or (not done and command.makes == MAP):
                    break
        except Exception as error:  # whatever happens, the finish has an end
            failed.append(f"{type(error).__name__}: {error}")
        self._worker.end()
        if self._cancelled:
            end = Message("note", f"Bake: {CANCELLED}")
        elif failed:
            end = Message("error", f"Bake: not everything could be made: {', '.join(failed)}")
        else:
            end = Message("note", "Bake: done")
        self._on_job(None)  # from here on another run may begin
        self._on_end(end)

    def _run(self, command: Command) -> bool:
        """Run one command to its end; whether it did what it should."""
        self._tell(command.title)
        made = self._worker.run(command.request, unless=lambda: self._cancelled)
        if isinstance(made, Failure):  # its process has ended
            made = Made(failure=made.message)
        for output in outputs_of(command, made.files):
            self._on_output(output)
        for warning in made.warnings:
            self._on_message(Message("note", f"{command.title}: {warning}"))
        if made.failure and not self._cancelled:
            self._on_message(Message("error", f"{command.title}: {made.failure}"))
        return not made.failure

    def _stage(self, stage: str) -> None:
        self._left *= 1 - _STAGE
        self._tell(f"{self._running[0]}: {stage}")

    def _tell(self, stage: str) -> None:
        _, number, count = self._running
        done = (number + 1 - self._left) / count
        self._on_job(RunningJob(f"finish {number + 1}/{count}", stage, done))


def outputs_of(command: Command, files: tuple[Path, ...]) -> tuple[Output, ...]:
    """Files that a command wrote, and folders in place of what is in them."""
    folder = command.output.parent.resolve()
    found = (file.relative_to(folder).parts[0] for file in files if file.is_relative_to(folder))
    return tuple(Output(folder / name, command.makes or command.title) for name in dict.fromkeys(found))
