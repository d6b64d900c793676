"""The computing process as Blender sees it: requests in, replies out, through a thread."""

from __future__ import annotations

import importlib.util
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

Message = tuple[str, Any]
HERE = Path(__file__).parent


class RefusedError(Exception):
    """What cannot be done, and what to do about it, as a message to the user."""


def site_packages() -> str:
    """The folder that holds cagemap: where Blender unpacked the extension's wheels."""
    spec = importlib.util.find_spec("cagemap")
    if spec is None or spec.origin is None:
        raise RefusedError("The extension's packages are missing. Remove the extension and install its zip file again.")
    return str(Path(spec.origin).parents[1])


class Worker:
    """The computing process; a request starts it if it does not run."""

    def __init__(self) -> None:
        self.busy = False
        self.matched = ("", "")  # digests of what the process keeps a match of, see `work.pair_digest`
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: queue.Queue[Message | None] = queue.Queue()
        self._replies: queue.Queue[Message] = queue.Queue()

    @property
    def has_match(self) -> bool:
        """Whether the process has a match at all."""
        return bool(self.matched[0]) and self._process is not None and self._process.poll() is None

    def send(self, name: str, arguments: dict[str, Any]) -> None:
        """Begin a request, see `worker.Session`."""
        if self._process is None or self._process.poll() is not None:
            self._start()
        self.busy = True
        self._requests.put((name, arguments))

    def receive(self, timeout: float | None = None) -> Message | None:
        """The next reply: ("stage", text), ("done", values) or ("refused", sentence); None if there is none yet."""
        try:
            message = self._replies.get(timeout is not None, timeout)
        except queue.Empty:
            return None
        self.busy = message[0] == "stage"
        return message

    def stop(self) -> None:
        """End the process and what it computes."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._forget()

    def _forget(self) -> None:
        self._requests.put(None)
        self.matched, self.busy, self._process = ("", ""), False, None
        self._requests, self._replies = queue.Queue(), queue.Queue()

    def _start(self) -> None:
        self._forget()
        log = tempfile.NamedTemporaryFile("w", prefix="cagemap_", suffix=".log", delete=False)
        with log:
            self._process = subprocess.Popen(
                [sys.executable, "-I", str(HERE / "worker.py"), site_packages()],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # no console on Windows
            )
        queues = self._requests, self._replies
        threading.Thread(target=_serve, args=(self._process, Path(log.name), *queues), daemon=True).start()


def _serve(
    process: subprocess.Popen[bytes],
    log: Path,
    requests: queue.Queue[Message | None],
    replies: queue.Queue[Message],
) -> None:
    """Write requests and read their replies, until there are no more or the process ends."""
    assert process.stdin is not None
    assert process.stdout is not None
    with process, process.stdin, process.stdout:
        try:
            while (request := requests.get()) is not None:
                pickle.dump(request, process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
                process.stdin.flush()
                kind = "stage"
                while kind == "stage":
                    kind, value = pickle.load(process.stdout)
                    replies.put((kind, value))
        except (OSError, EOFError, pickle.UnpicklingError):
            code = process.wait()
            replies.put(
                ("refused", f"The computing process ended (code {code}); details: {log}. Press the button again.")
            )
            return
    log.unlink(missing_ok=True)
