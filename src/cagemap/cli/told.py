"""A command for a program that runs it: ends when that program does, and says which files it wrote.

``python -m cagemap.cli.told COMMAND ...`` is the command line, with standard input held open by whoever runs it: when
it closes, the command is stopped as by Ctrl-C. The last line on standard output lists the files.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time

from cagemap.cli.entry import SIGNALLED, main
from cagemap.files.atomic import files_written
from cagemap.studio.wrote import wrote_line

# Seconds after which a command that is asked to stop is ended whatever it does.
PATIENCE = 20.0


def run() -> None:
    """Run the command line."""
    threading.Thread(target=_follow_input, daemon=True).start()
    with files_written() as files:
        try:
            main()
        except SystemExit as ended:
            if ended.code:
                raise
    sys.stdout.write(f"{wrote_line(files)}\n")
    sys.stdout.flush()


def _follow_input() -> None:
    while os.read(0, 1024):  # no buffer, whose lock would be held while the interpreter ends
        pass
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)  # unlike an interrupt, also ends waiting for other threads
    else:
        _thread.interrupt_main(signal.SIGTERM)
    time.sleep(PATIENCE)
    os._exit(SIGNALLED + signal.SIGTERM)


if __name__ == "__main__":
    run()
