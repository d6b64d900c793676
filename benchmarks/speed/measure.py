"""Wall time, processor time and peak memory, of a block or of a whole child process."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
LIBRARIES = ("numpy", "scipy", "numba", "rslab", "OpenImageIO", "threadpoolctl")

Figures = dict[str, Any]


@contextmanager
def timed(figures: Figures, name: str) -> Iterator[None]:
    """Store wall and processor seconds of a block as ``figures[name]``."""
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    figures[name] = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def run(command: list[str], environment: dict[str, str] | None = None, limit: float | None = None) -> Figures:
    """Run a command to its end; wall and processor seconds (user + system) and peak memory in bytes.

    Raises
    ------
    RuntimeError
        If it fails; the message ends with what it wrote.
    """
    with tempfile.TemporaryFile() as output:
        start = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, cwd=REPOSITORY, env={**os.environ, **(environment or {})}
        )
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if limit is not None and time.perf_counter() - start > limit:
                process.kill()
                os.wait4(process.pid, 0)
                raise RuntimeError(f"{' '.join(command[:4])} ... did not end within {limit:.0f} s")
            time.sleep(0.005)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        text = output.read().decode(errors="replace")
    if process.returncode:
        raise RuntimeError(f"{' '.join(command[:4])} ... failed with exit code {process.returncode}:\n{text[-3000:]}")
    unit = 1 if sys.platform == "darwin" else 1024
    return {"wall": wall, "cpu": usage.ru_utime + usage.ru_stime, "peak": usage.ru_maxrss * unit, "output": text}


def run_task(name: str, arguments: Figures, **options: Any) -> Figures:
    """Run a function of `benchmarks.speed.tasks` in a process of its own; what it returns, with ``process`` figures."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, "-m", "benchmarks.speed.tasks", name, json.dumps(arguments), str(answer)]
        process = run(command, **options)
        process.pop("output")
        return json.loads(answer.read_text()) | {"process": process}


def cagemap(*arguments: object, **options: Any) -> Figures:
    """Run the command ``cagemap`` of this interpreter."""
    return run([sys.executable, "-c", "from cagemap.cli import main; main()", *map(str, arguments)], **options)


def machine() -> Figures:
    """What the figures were measured on."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    return {
        "date": time.strftime("%Y-%m-%d"),
        "commit": commit.stdout.strip() or "unknown",
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: _version(name) for name in LIBRARIES},
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "absent"
