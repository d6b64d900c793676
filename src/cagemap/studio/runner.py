"""Runs the commands of a finish one after the other, in a process of their own."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from cagemap.studio.finish import MAP, Command
from cagemap.studio.state import Message, Output, RunningJob
from cagemap.studio.wrote import command_line, ended

CANCELLED = "cancelled"
_CALL = (sys.executable, "-m", "cagemap.cli.told")
# Share of what is left of a command that each of its stages is taken for: how many there are is not known.
_STAGE = 0.15
_ERROR, _WARNING = "cagemap: error: ", "cagemap: warning: "


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
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._cancelled = False

    def start(self, todo: tuple[Command, ...]) -> None:
        """Begin; returns at once. Where the map cannot be made, there is nothing to do for the others."""
        self._cancelled = False
        self._on_job(RunningJob("finish", "starting", 0.0, can_cancel=True))
        threading.Thread(target=self._work, args=(todo,), name="studio finish", daemon=True).start()

    def cancel(self) -> None:
        """End the running command; what it has not finished writing leaves no trace."""
        self._cancelled = True
        self._hang_up()

    def _work(self, todo: tuple[Command, ...]) -> None:
        failed: list[str] = []
        try:
            for number, command in enumerate(todo):
                done = self._run(command, number, len(todo))
                failed += [] if done else [command.title]
                if self._cancelled or (not done and command.makes == MAP):
                    break
        except Exception as error:  # whatever happens, the finish has an end
            failed.append(f"{type(error).__name__}: {error}")
        self._hang_up()
        if self._cancelled:
            end = Message("note", f"finish: {CANCELLED}")
        elif failed:
            end = Message("error", f"finish: not everything could be made: {', '.join(failed)}")
        else:
            end = Message("note", "finish: done")
        self._on_job(None)  # from here on another run may begin
        self._on_end(end)

    def _run(self, command: Command, number: int, count: int) -> bool:
        """Run one command to its end; whether it did what it should."""
        left = 1.0

        def tell(stage: str) -> None:
            self._on_job(
                RunningJob(f"finish {number + 1}/{count}", stage, (number + 1 - left) / count, can_cancel=True)
            )

        tell(command.title)
        process, lines = self._begun(command), list[str]()
        if process is None:
            return False
        assert process.stdout is not None
        code: int | None = None
        for line in map(str.rstrip, process.stdout):
            if (end := ended(line)) is not None:
                code, written = end
                for output in outputs_of(command, written):
                    self._on_output(output)
                break
            lines += [line] if line else []
            if (stage := stage_of(line)) is not None:
                left *= 1 - _STAGE
                tell(f"{command.title}: {stage}")
            elif line.startswith(_WARNING):
                self._on_message(Message("note", f"{command.title}: {line.removeprefix(_WARNING)}"))
        if code is None or self._cancelled:  # it is ending, in the midst of its work or after
            code = process.wait() or 1
        if code and not self._cancelled:
            self._on_message(Message("error", f"{command.title}: {_reason(lines, code)}"))
        return code == 0

    def _begun(self, command: Command) -> subprocess.Popen[str] | None:
        """The process, once it is told the command; None where the run is cancelled."""
        with self._lock:
            if self._cancelled:
                return None
            if self._process is None or self._process.poll() is not None or not _takes(self._process, command):
                pipe, said = subprocess.PIPE, subprocess.STDOUT
                self._process = subprocess.Popen(
                    _CALL, stdin=pipe, stdout=pipe, stderr=said, text=True, errors="backslashreplace"
                )
                _takes(self._process, command)  # if not, its end says why
            return self._process

    def _hang_up(self) -> None:
        """The process ends when its input does."""
        with self._lock:
            process, self._process = self._process, None
            if process is not None and process.stdin is not None:
                with contextlib.suppress(OSError):  # it has ended by itself
                    process.stdin.close()


def _takes(process: subprocess.Popen[str], command: Command) -> bool:
    """Tell a process its next command; whether it listens, since it may have ended after the one before."""
    assert process.stdin is not None
    try:
        process.stdin.write(f"{command_line(('-v', *command.arguments))}\n")
        process.stdin.flush()
    except OSError:
        return False
    return True


def outputs_of(command: Command, files: tuple[Path, ...]) -> tuple[Output, ...]:
    """Files that a command wrote, and folders in place of what is in them."""
    folder = command.output.parent.resolve()
    found = (file.relative_to(folder).parts[0] for file in files if file.is_relative_to(folder))
    return tuple(Output(folder / name, command.makes or command.title) for name in dict.fromkeys(found))


def stage_of(line: str) -> str | None:
    """The stage that a line of a verbose command announces."""
    head, separator, stage = line.partition("stage:")
    return stage.strip() if separator and head.startswith("cagemap") else None


def _reason(lines: list[str], code: int) -> str:
    """Why a command failed, in its own words: its error is the last that it says."""
    at = next((number for number, line in enumerate(lines) if line.startswith(_ERROR)), None)
    words = lines[-3:] if at is None else [lines[at].removeprefix(_ERROR), *lines[at + 1 :]]
    return "\n".join(words) or f"exit code {code}"
