"""Commands that somebody else runs: they say what they wrote, and end when whoever runs them does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from cagemap.cli.entry import SIGNALLED
from cagemap.files.meshes import write_mesh
from cagemap.mesh.shapes import creature
from cagemap.studio.wrote import files_wrote, wrote_line

CALL = [sys.executable, "-m", "cagemap.cli.told", "-v"]


def told(*words: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*CALL, *map(str, words)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def test_a_command_says_what_it_wrote(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.obj", creature())
    process = told("refine", tmp_path / "a.obj", "--level", 1, "-o", tmp_path / "fine.obj")
    assert process.stdout is not None
    lines = process.stdout.read().splitlines()
    assert process.wait() == 0
    assert files_wrote(lines[-1]) == (tmp_path / "fine.obj",)
    assert files_wrote(lines[0]) is None
    assert files_wrote(wrote_line([tmp_path / "ä b.png"])) == (tmp_path / "ä b.png",)


def test_a_command_ends_with_whoever_runs_it_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    mesh = creature()
    write_mesh(tmp_path / "a.obj", mesh)
    write_mesh(tmp_path / "b.obj", mesh.with_positions(mesh.positions * np.array([1.0, 1.1, 1.3])))
    files = ("--target", tmp_path / "a.obj", "--source", tmp_path / "b.obj")
    process = told("match", *files, "--vertices", 30_000, "-o", tmp_path / "R")
    assert process.stdout is not None
    assert process.stdin is not None
    next(line for line in process.stdout if "stage:" in line)
    process.stdin.close()
    assert "stopped" in process.stdout.read()
    assert process.wait() == SIGNALLED + signal.SIGTERM
    assert sorted(os.listdir(tmp_path)) == ["a.obj", "b.obj"]


def test_a_command_that_waits_for_its_threads_ends_too() -> None:
    waiting = (
        "import threading; from cagemap.cli import app, entry, told; "
        "entry.app = lambda: (print('waits', flush=True), threading.Event().wait()); told.run()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", waiting],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline() == "waits\n"
    process.stdin.close()
    assert "stopped" in process.stdout.read()  # by itself, not by force once patience is over
    assert process.wait() == SIGNALLED + signal.SIGTERM
