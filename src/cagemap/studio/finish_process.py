"""The process of a finish; ends with the studio and removes unfinished files."""

from __future__ import annotations

import _thread
import gc
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

from cagemap.errors import explain_error, use_option_names
from cagemap.files.atomic import files_written
from cagemap.numerics.process import set_up_process
from cagemap.studio.finish import Command
from cagemap.studio.worker import END_TIMEOUT, RESULT, STAGE
from cagemap.tasks import runner_of
from cagemap.tasks.progress import Stages, logged_warnings


@dataclass(frozen=True)
class RequestResult:
    """Result of a request."""

    warnings: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()  # written files, also those of a failed request
    failure: str = ""  # error message; '' if it succeeded


def serve(connection: Connection) -> None:
    """Run commands until the pipe closes or sends None, which interrupts the running one."""
    set_up_process()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(connection, commands), daemon=True).start()
    try:
        while True:
            stages = Stages(lambda stage: connection.send((STAGE, stage)))
            connection.send((RESULT, run_command(commands.get(), stages)))
            gc.collect()  # the next one needs the memory
    except (KeyboardInterrupt, BrokenPipeError):
        return


def run_command(command: Command, stages: Stages) -> RequestResult:
    """Run a command; return also its warnings and error."""
    failure = ""
    with logged_warnings() as texts, files_written() as files:
        try:
            # `runner_of` imports the task's libraries: inside this block, so that Cancel can interrupt the import.
            run: Callable[..., tuple[str, Any]] = runner_of(command.request)
            computed = {} if command.computed is None else {"computed": command.computed}
            _, warnings = run(command.request, stages, **computed)
            texts += warnings
        except Exception as error:
            failure = explain_error(error)
    distinct = tuple(dict.fromkeys(map(use_option_names, texts)))  # some files are read several times
    return RequestResult(distinct, tuple(file.resolve() for file in files), failure)


def _listen(connection: Connection, commands: queue.SimpleQueue[Command]) -> None:
    """Receive commands; at the end interrupt the running one, and end the process after `END_TIMEOUT`."""
    try:
        while (command := connection.recv()) is not None:
            commands.put(command)
    except (EOFError, OSError):  # the studio's process has ended
        pass
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)  # unlike an interrupt, this also ends waiting for threads
    else:
        _thread.interrupt_main(signal.SIGTERM)
    time.sleep(END_TIMEOUT)
    os._exit(1)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the main thread once; further signals must not interrupt the removal of files."""
    for ignored in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ignored, signal.SIG_IGN)
    raise KeyboardInterrupt
