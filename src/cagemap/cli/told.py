"""Commands for a program that runs them: each says at its end which files it wrote, and all end when the program does.

``python -m cagemap.cli.told`` is the command line in one process, so that libraries are loaded once: every line on
standard input is a command, and the last line that it says is its end (`cagemap.studio.wrote`). When standard input
closes, the command that runs is stopped as by Ctrl-C.
"""

from __future__ import annotations

import _thread
import gc
import os
import queue
import signal
import sys
import threading
import time

from cagemap.cli.entry import SIGNALLED, main
from cagemap.files.atomic import files_written
from cagemap.studio.wrote import ended_line, words_of

# Seconds after which a command that is asked to stop is ended whatever it does.
PATIENCE = 20.0


def run() -> None:
    """Run the commands of standard input, one after the other, until it closes or one of them is stopped."""
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    threading.Thread(target=_follow_input, args=(lines,), daemon=True).start()
    code = 0
    while code < SIGNALLED and (line := lines.get()) is not None:
        code = _run(words_of(line))
        gc.collect()  # the next one needs the memory
    raise SystemExit(code)


def _run(words: list[str]) -> int:
    """Run one command; its exit code."""
    sys.argv[1:] = words
    code: object = 0
    with files_written() as files:
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    number = code if isinstance(code, int) else int(code is not None)
    sys.stdout.write(f"\n{ended_line(number, files)}\n")  # a line of its own, whatever a library wrote before it
    sys.stdout.flush()
    return number


def _follow_input(lines: queue.SimpleQueue[str | None]) -> None:
    read = b""
    while more := os.read(0, 65536):  # no buffer, whose lock would be held while the interpreter ends
        *whole, read = (read + more).split(b"\n")
        for line in whole:
            lines.put(line.decode())
    lines.put(None)
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)  # unlike an interrupt, also ends waiting for other threads
    else:
        _thread.interrupt_main(signal.SIGTERM)
    time.sleep(PATIENCE)
    os._exit(SIGNALLED + signal.SIGTERM)


if __name__ == "__main__":
    run()
