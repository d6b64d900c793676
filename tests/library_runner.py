"""Runners that Dask's workers import: quick stand-ins for the commands."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_path
from cagemap.library import Task


def write_name(task: Task) -> dict[str, Any]:
    """Write the task's name to its outputs, and count that it ran; do what the request says goes wrong."""
    with Path(task.request["log"]).open("a") as log:
        log.write(task.name + "\n")
    trouble = task.request.get("trouble")
    if trouble == "bad mesh":
        raise FormatError(f"{task.name}: expected a mesh, got none. Mend it.")
    if trouble == "bug":
        raise KeyError("surprise")
    if trouble == "full disk":
        raise OSError(28, "No space left on device", "somewhere")
    if trouble == "die once":
        mark = Path(task.request["log"] + ".died")
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if trouble == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(float(task.request.get("sleep", 0)))
    for output in task.request.get("files", task.outputs):
        with atomic_path(Path(task.request["root"]) / output, force=True) as temporary:
            temporary.write_text(task.name)
    return {"said": task.name}
