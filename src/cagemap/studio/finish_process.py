"""The process that does the requests of a finish: it ends with the studio, and leaves nothing half written."""

from __future__ import annotations

import _thread
import gc
import logging
import os
import queue
import signal
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

from cagemap.errors import explain_error, use_option_names
from cagemap.files.atomic import files_written
from cagemap.numerics.process import set_up_process
from cagemap.studio.worker import PATIENCE, Done, Stage
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import Request


@dataclass(frozen=True)
class Made:
    """What a request made.

    Attributes
    ----------
    summary : str
    warnings : tuple of str
    files : tuple of Path
        All that it wrote, also before it failed.
    failure : str
        Why it failed; '' if it did not.
    """

    summary: str = ""
    warnings: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    failure: str = ""


class _Warnings(logging.Handler):
    """Collects what tasks log as warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


class _SentStages(Stages):
    """Stages that are told over a pipe."""

    def __init__(self, connection: Connection) -> None:
        super().__init__()
        self._connection = connection

    def __call__(self, stage: str) -> None:
        """End the running stage, begin the next."""
        super().__call__(stage)
        self._connection.send(Stage(stage))


def serve(connection: Connection) -> None:
    """Do requests, one after the other, until the pipe closes or says stop: then the running one ends as by Ctrl-C."""
    set_up_process()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(connection, requests), daemon=True).start()
    try:
        while True:
            connection.send(Done(perform(requests.get(), _SentStages(connection))))
            gc.collect()  # the next one needs the memory
    except (KeyboardInterrupt, BrokenPipeError):
        return


def perform(request: Request, stages: Stages) -> Made:
    """Do a request; an error is part of what it made."""
    summary, failure, logged = "", "", _Warnings()
    log = logging.getLogger("cagemap")
    log.addHandler(logged)
    try:
        with files_written() as files:
            try:
                from cagemap.tasks.requests.catalogue import (
                    run_request,  # so that a stop is heard while libraries are loaded
                )

                summary, warnings = run_request(request, stages)
                logged.texts += warnings
            except Exception as error:
                failure = explain_error(error)
    finally:
        log.removeHandler(logged)
    said = tuple(dict.fromkeys(map(use_option_names, logged.texts)))  # some files are read several times
    return Made(summary, said, tuple(file.resolve() for file in files), failure)


def _listen(connection: Connection, requests: queue.SimpleQueue[Request]) -> None:
    """Take requests; where there are no more, stop the one that runs, by force if it does not end by itself."""
    try:
        while (request := connection.recv()) is not None:
            requests.put(request)
    except (EOFError, OSError):  # whoever runs this process has gone
        pass
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)  # unlike an interrupt, also ends waiting for other threads
    else:
        _thread.interrupt_main(signal.SIGTERM)
    time.sleep(PATIENCE)
    os._exit(1)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the main thread, once: what it then removes must not be interrupted."""
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, signal.SIG_IGN)
    raise KeyboardInterrupt
