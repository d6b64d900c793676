"""Processes for long computations, so that the page always answers."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError

# Kinds of `Failure` of a process that ended, and of a cancelled task.
STOPPED_KIND = "Stopped"
CANCELLED_KIND = "Cancelled"
# Of the process that computes maps; the page has 0.
NICENESS = 5
# Seconds until a process that was asked to end is killed.
END_TIMEOUT = 20.0
# Messages of a worker's process are (kind, value): a stage's name, a result before the task is done, or the result.
STAGE, EARLY_RESULT, RESULT = "stage", "early result", "result"
# Sent in place of a task: cancel the running one.
_CANCEL_MESSAGE = "cancel"


@dataclass(frozen=True)
class Failure:
    """An error that ended a task."""

    kind: str  # name of the error's class, `STOPPED_KIND` or `CANCELLED_KIND`
    message: str
    notes: tuple[str, ...] = ()  # added to the error by `BaseException.add_note`


class _CancelledError(Exception):
    """The task was cancelled."""


def without_folders(texts: Iterable[str], folders: Iterable[Path]) -> tuple[str, ...]:
    """Distinct texts, with paths of files relative to the innermost of folders that has them."""
    beginnings = sorted({re.escape(f"{folder}{os.sep}") for folder in folders}, key=len, reverse=True)
    in_folder = re.compile(rf"(?<![\w.\-/\\])(?:{'|'.join(beginnings)})")
    return tuple(dict.fromkeys(in_folder.sub("", text) for text in texts))


class Worker:
    """Runs tasks, one after the other, in a process that can be killed.

    ``on_stage``: called with the name of each stage.
    ``serve``: loop of the process: receives tasks, and sends stages and then the result, which may be a `Failure`; None
        in place of a task ends it.
    ``on_early_result``: called with results before the task is done.
    """

    def __init__(
        self,
        on_stage: Callable[[str], None],
        serve: Callable[[Connection], None],
        on_early_result: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self._on_stage, self._serve, self._on_early_result = on_stage, serve, on_early_result
        self._lock = threading.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: Connection | None = None
        self._send_lock = threading.Lock()
        self._task: Any = None

    def start(self) -> None:
        """Start the process before its first task."""
        with self._lock:
            self._connect()

    def run(self, task: Any, is_cancelled: Callable[[], bool] = lambda: False) -> Any:
        """Run a task and wait for its result: a `Failure` also if the process ended.

        ``is_cancelled``: asked before the task is sent, while `end` waits.
        """
        with self._lock:
            try:
                with self._send_lock:
                    if is_cancelled():
                        return Failure(CANCELLED_KIND, "the computation was cancelled")
                    self._task = task
                    connection = self._send(task)
                while True:
                    kind, value = connection.recv()
                    if kind == RESULT:
                        return value
                    receive = self._on_stage if kind == STAGE else self._on_early_result
                    receive(value)
            except (EOFError, OSError):
                return self._collect_process()

    def cancel(self, task: Any) -> None:
        """End a running task at its next stage; the process keeps what it has prepared."""
        with self._send_lock, contextlib.suppress(OSError):
            if self._task is task and self._connection is not None:
                self._connection.send(_CANCEL_MESSAGE)

    def end(self) -> None:
        """Ask the process to end; files that are being put into place are finished."""
        with self._send_lock, contextlib.suppress(OSError):
            if self._connection is not None:
                self._connection.send(None)
            if self._lock.acquire(blocking=False):  # no task is running
                try:
                    self._collect_process()
                finally:
                    self._lock.release()

    def kill(self) -> None:
        """Kill the process; the next task starts another one."""
        process = self._process
        if process is not None and process.is_alive():
            process.kill()
            process.join(5)

    def _send(self, task: Any) -> Connection:
        """Send a task, if necessary to a new process; return the connection."""
        connection = self._connect()
        try:
            connection.send(task)
        except OSError:
            self._collect_process()
            connection = self._connect()
            connection.send(task)
        return connection

    def _connect(self) -> Connection:
        """Connection to the process, which is started if needed."""
        if self._connection is None or self._process is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            connection, child_connection = context.Pipe()
            self._process = context.Process(
                target=self._serve, args=(child_connection,), daemon=True, name="cagemap studio"
            )
            self._process.start()
            child_connection.close()
            self._connection = connection
        return self._connection

    def _collect_process(self) -> Failure:
        """Wait for the ended process and say how it ended."""
        process, self._connection, self._process = self._process, None, None
        code = None
        if process is not None:
            process.join(END_TIMEOUT + 5)
            code = process.exitcode
        if code is not None and code < 0:
            return Failure(STOPPED_KIND, f"the computation was ended by signal {-code}; there may be too little memory")
        return Failure(STOPPED_KIND, f"the computation's process ended (exit code {code})")


def serve_preview(connection: Connection) -> None:
    """Loop of the preview's process: receives tasks, sends stages and results."""
    from cagemap.studio.compute import run_task
    from cagemap.studio.preview_tasks import OpenModels

    cache = None

    def send_stage(stage: str) -> None:
        connection.send((STAGE, stage))
        if connection.poll():  # during a task the only possible message is to cancel it
            connection.recv()
            raise _CancelledError

    with contextlib.suppress(EOFError, KeyboardInterrupt, BrokenPipeError):
        while True:
            task = connection.recv()
            if task == _CANCEL_MESSAGE:  # the task was done already
                continue
            if not isinstance(task, OpenModels):  # opening comes first: until then the page has nothing to do
                _lower_priority()
            try:
                cache, result = run_task(cache, task, send_stage, lambda early: connection.send((EARLY_RESULT, early)))
                connection.send((RESULT, result))
            except _CancelledError:
                connection.send((RESULT, Failure(CANCELLED_KIND, "the computation was cancelled")))
            except (EOFError, BrokenPipeError, KeyboardInterrupt):
                raise
            except Exception as error:  # a bug must not end the studio
                connection.send((RESULT, _failure_of(error)))


def _failure_of(error: Exception) -> Failure:
    kind, message = type(error).__name__, str(error)
    if isinstance(error, MemoryError):
        message = "not enough memory for surfaces of this size; ask for fewer"
    elif not isinstance(error, CagemapError):
        kind = f"internal error, {kind}"
    return Failure(kind, message, tuple(getattr(error, "__notes__", ())))


def _lower_priority() -> None:
    """Give the page and the browser priority over this process."""
    if not hasattr(os, "setpriority"):
        return
    threads = Path("/proc/self/task")  # on Linux each thread has its own priority, which new ones inherit
    numbers = map(int, os.listdir(threads)) if threads.is_dir() else (0,)
    for number in numbers:
        with contextlib.suppress(OSError):  # a thread that has ended
            os.setpriority(os.PRIO_PROCESS, number, NICENESS)
