"""Processes of their own for everything that takes longer than a click, so that the page always answers."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError

STOPPED = "Stopped"
# Kind of the failure of a task that is not wanted any more: nobody waits to be told.
DROPPED = "Dropped"
# Of a map's computation; the page has 0.
NICENESS = 5
# Seconds after which a process that was asked to end is ended whatever it does.
PATIENCE = 20.0
# In place of a task: the one before is not wanted any more.
_DROP = "drop"


@dataclass(frozen=True)
class Failure:
    """A computation that ended with an error.

    Attributes
    ----------
    kind : str
        The error's class.
    message : str
        What it says.
    """

    kind: str
    message: str


@dataclass(frozen=True)
class Stage:
    """What a task does now, said by its process."""

    name: str


@dataclass(frozen=True)
class Shown:
    """What a task shows before it is done, said by its process."""

    answer: Any


@dataclass(frozen=True)
class Done:
    """What a task gives, said by its process."""

    answer: Any


class _DroppedError(Exception):
    """The task is not wanted any more."""


class Worker:
    """Runs one task after the other in a process that can be killed.

    Parameters
    ----------
    on_stage : callable
        Told what a task does now.
    serve : callable, optional
        Loop of the process: a task in, `Stage` and `Done` or `Failure` out; None in place of a task ends it. That of
        the preview by default.
    on_shown : callable, optional
        Told what a task shows before it is done.
    """

    def __init__(
        self,
        on_stage: Callable[[str], None],
        serve: Callable[[Connection], None] | None = None,
        on_shown: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self._on_stage, self._serve, self._on_shown = on_stage, _serve if serve is None else serve, on_shown
        self._lock = threading.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: Connection | None = None
        self._sending = threading.Lock()
        self._task: Any = None

    def start(self) -> None:
        """Start the process ahead of its first task."""
        with self._lock:
            self._connected()

    def run(self, task: Any, unless: Callable[[], bool] = lambda: False) -> Any:
        """Do a task; blocks, so call it from a thread of its own.

        Parameters
        ----------
        task : value
        unless : callable
            Whether the task is not wanted any more, asked when no `end` can come between.

        Returns
        -------
        answer or Failure
            `Failure` also where the process died or was stopped.
        """
        with self._lock:
            try:
                with self._sending:
                    if unless():
                        return Failure(DROPPED, "the computation is not wanted any more")
                    self._task = task
                    connection = self._sent(task)
                while True:
                    reply = connection.recv()
                    if isinstance(reply, Stage):
                        self._on_stage(reply.name)
                    elif isinstance(reply, Shown):
                        self._on_shown(reply.answer)
                    else:
                        return reply.answer if isinstance(reply, Done) else reply
            except (EOFError, OSError):
                return self._buried()

    def drop(self, task: Any) -> None:
        """End a task at its next stage, where it is the one that runs; what the process has prepared stays."""
        with self._sending, contextlib.suppress(OSError):
            if self._task is task and self._connection is not None:
                self._connection.send(_DROP)

    def end(self) -> None:
        """Have the process end, with what it is doing, but not in the midst of putting files into place."""
        with self._sending, contextlib.suppress(OSError):
            if self._connection is not None:
                self._connection.send(None)
            if self._lock.acquire(blocking=False):  # no task waits for its end
                try:
                    self._buried()
                finally:
                    self._lock.release()

    def stop(self) -> None:
        """Kill the process, with what it is doing; the next task starts another one."""
        process = self._process
        if process is not None and process.is_alive():
            process.kill()
            process.join(5)

    def _sent(self, task: Any) -> Connection:
        """Where the answer to a task comes from; a process that has ended since the task before gets a successor."""
        connection = self._connected()
        try:
            connection.send(task)
        except OSError:
            self._buried()
            connection = self._connected()
            connection.send(task)
        return connection

    def _connected(self) -> Connection:
        if self._connection is None or self._process is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            here, there = context.Pipe()
            self._process = context.Process(target=self._serve, args=(there,), daemon=True, name="cagemap studio")
            self._process.start()
            there.close()
            self._connection = here
        return self._connection

    def _buried(self) -> Failure:
        process, self._connection, self._process = self._process, None, None
        code = None
        if process is not None:
            process.join(PATIENCE + 5)
            code = process.exitcode
        if code is not None and code < 0:
            return Failure(STOPPED, f"the computation was ended by signal {-code}; there may be too little memory")
        return Failure(STOPPED, f"the computation's process ended (exit code {code})")


def _serve(connection: Connection) -> None:
    """Loop of the process: a task in, stages and an answer out."""
    from cagemap.studio.compute import Bench, OpenModels, perform

    bench = Bench()

    def tell(stage: str) -> None:
        connection.send(Stage(stage))
        if connection.poll():  # while a task runs there is no other word than that it is not wanted
            connection.recv()
            raise _DroppedError

    with contextlib.suppress(EOFError, KeyboardInterrupt, BrokenPipeError):
        while True:
            task = connection.recv()
            if task == _DROP:  # it came too late
                continue
            if not isinstance(task, OpenModels):  # nothing can be done on the page before that
                _step_back()
            try:
                bench, answer = perform(bench, task, tell, lambda early: connection.send(Shown(early)))
                connection.send(Done(answer))
            except _DroppedError:
                connection.send(Failure(DROPPED, "the computation is not wanted any more"))
            except CagemapError as error:
                connection.send(Failure(type(error).__name__, str(error)))
            except MemoryError:
                connection.send(Failure("MemoryError", "not enough memory for surfaces of this size; ask for fewer"))
            except (EOFError, BrokenPipeError, KeyboardInterrupt):
                raise
            except Exception as error:  # a fault of ours must not end the studio
                connection.send(Failure(f"internal error, {type(error).__name__}", str(error)))


def _step_back() -> None:
    """Let the page, and what draws it, have the processor first."""
    if not hasattr(os, "setpriority"):
        return
    threads = Path("/proc/self/task")  # on Linux every thread has an order of its own; new ones inherit it
    numbers = map(int, os.listdir(threads)) if threads.is_dir() else (0,)
    for number in numbers:
        with contextlib.suppress(OSError):  # one that has ended
            os.setpriority(os.PRIO_PROCESS, number, NICENESS)
