"""Runs the commands of a finish one after the other, in their own process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from cagemap.studio.finish import MAP_TITLE, Command
from cagemap.studio.finish_process import RequestResult, serve
from cagemap.studio.state import Message, Output, RunningJob
from cagemap.studio.worker import Failure, Worker

# Share of a command's remaining progress that each stage counts for; the number of stages is unknown.
_STAGE_SHARE = 0.15


class Runner:
    """Runs the commands of one finish at a time in a thread.

    ``on_job``: called at every command and stage, and with None at the end.
    ``on_output``: called with every written file.
    ``on_message``: called with warnings and errors of commands.
    ``on_end``: called with a summary, and whether the run was cancelled.
    """

    def __init__(
        self,
        on_job: Callable[[RunningJob | None], None],
        on_output: Callable[[Output], None],
        on_message: Callable[[Message], None],
        on_end: Callable[[Message, bool], None],
    ) -> None:
        self._on_job, self._on_output, self._on_message, self._on_end = on_job, on_output, on_message, on_end
        self._worker = Worker(self._on_stage, serve)
        self._title, self._number, self._count = "", 0, 1  # of the running command
        self._remaining, self._begun = 1.0, 0.0
        self._cancelled = False

    def start(self, commands: tuple[Command, ...]) -> None:
        """Start the commands and return; if the map fails, the others are not run."""
        self._cancelled = False
        self._begun = time.monotonic()
        self._on_job(RunningJob("finish", "starting", 0.0, self._begun))
        threading.Thread(target=self._run_commands, args=(commands,), name="studio finish", daemon=True).start()

    def cancel(self) -> None:
        """End the running command; unfinished files are removed."""
        self._cancelled = True
        self._worker.end()

    def _run_commands(self, commands: tuple[Command, ...]) -> None:
        failures: list[str] = []
        try:
            self._count = len(commands)
            for number, command in enumerate(commands):
                self._title, self._number, self._remaining = command.title, number, 1.0
                succeeded = self._run_command(command)
                failures += [] if succeeded else [command.title]
                if self._cancelled or (not succeeded and command.output_title == MAP_TITLE):
                    break
        except Exception as error:  # also after a bug, the page must show an end
            failures.append(f"{type(error).__name__}: {error}")
        self._worker.end()
        is_cancelled = self._cancelled
        if is_cancelled:
            summary = Message("note", "Bake: cancelled")
        elif failures:
            summary = Message("error", f"Bake: not everything could be made: {', '.join(failures)}")
        else:
            summary = Message("note", "Bake: done")
        self._on_job(None)  # from here on another run can start
        self._on_end(summary, is_cancelled)

    def _run_command(self, command: Command) -> bool:
        """Run a command; return whether it succeeded."""
        self._report_stage(command.title)
        result = self._worker.run(command, is_cancelled=lambda: self._cancelled)
        if isinstance(result, Failure):
            result = RequestResult(failure=result.message)
        for output in command_outputs(command, result.files):
            self._on_output(output)
        for warning in result.warnings:
            self._on_message(Message("note", f"{command.title}: {warning}"))
        if result.failure and not self._cancelled:
            self._on_message(Message("error", f"{command.title}: {result.failure}"))
        return not result.failure

    def _on_stage(self, stage: str) -> None:
        self._remaining *= 1 - _STAGE_SHARE
        self._report_stage(f"{self._title}: {stage}")

    def _report_stage(self, stage: str) -> None:
        fraction = (self._number + 1 - self._remaining) / self._count
        self._on_job(RunningJob(f"finish {self._number + 1}/{self._count}", stage, fraction, self._begun))


def command_outputs(command: Command, files: tuple[Path, ...]) -> tuple[Output, ...]:
    """Files that a command wrote; a folder stands for the files in it."""
    folder = command.output.parent.resolve()
    names = (file.relative_to(folder).parts[0] for file in files if file.is_relative_to(folder))
    return tuple(Output(folder / name, command.output_title or command.title) for name in dict.fromkeys(names))
