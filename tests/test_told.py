"""Commands that somebody else runs: they say what they wrote, and end when whoever runs them does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.cli.entry import SIGNALLED, WRONG_INPUT
from cagemap.cli.told import _run
from cagemap.files.meshes import write_mesh
from cagemap.studio.wrote import command_line, ended, ended_line

TOLD = (sys.executable, "-m", "cagemap.cli.told")
STOPPED = SIGNALLED + signal.SIGTERM


def told(*commands: tuple[object, ...], call: tuple[str, ...] = TOLD) -> subprocess.Popen[str]:
    process = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdin is not None
    for words in commands:
        process.stdin.write(f"{command_line(['-v', *map(str, words)])}\n")
    process.stdin.flush()
    return process


def test_every_command_says_how_it_ended_and_what_it_wrote(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.obj", creature())
    fine = ("refine", tmp_path / "a.obj", "--level", 1, "-o", tmp_path / "fine.obj")
    finer = ("refine", tmp_path / "fine.obj", "--level", 1, "-o", tmp_path / "ä finer.obj")
    process = told(fine, ("refine", tmp_path / "none.obj", "-o", tmp_path / "b.obj"), finer)
    assert process.stdout is not None
    ends = []
    while len(ends) < 3:
        line = process.stdout.readline()
        ends += [end for end in [ended(line)] if end is not None]
    process.communicate()
    assert ends == [(0, (tmp_path / "fine.obj",)), (WRONG_INPUT, ()), (0, (tmp_path / "ä finer.obj",))]
    assert ended("cagemap: stage: refine") is None
    assert ended(f"said: {ended_line(0, [])}") is None


def test_the_line_at_its_end_is_one_of_its_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["cagemap"])
    monkeypatch.setattr("cagemap.cli.told.main", lambda: sys.stdout.write("50 %"))
    _run(["wait"])
    assert ended(capsys.readouterr().out.splitlines()[-1]) == (0, ())


def test_a_command_ends_with_whoever_runs_it_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    mesh = creature()
    write_mesh(tmp_path / "a.obj", mesh)
    write_mesh(tmp_path / "b.obj", mesh.with_positions(mesh.positions * np.array([1.0, 1.1, 1.3])))
    files = ("--target", tmp_path / "a.obj", "--source", tmp_path / "b.obj")
    after = ("refine", tmp_path / "a.obj", "--level", 1, "-o", tmp_path / "fine.obj")
    process = told(("match", *files, "--vertices", 30_000, "-o", tmp_path / "R"), after)
    assert process.stdout is not None
    assert process.stdin is not None
    next(line for line in process.stdout if "stage:" in line)
    process.stdin.close()
    assert "stopped" in process.stdout.read()
    assert process.wait() == STOPPED
    assert sorted(os.listdir(tmp_path)) == ["a.obj", "b.obj"]


def test_a_command_that_waits_for_its_threads_ends_too() -> None:
    waiting = (
        "import threading; from cagemap.cli import app, told; "
        "app.app = lambda: (print('waits', flush=True), threading.Event().wait()); told.run()"
    )
    process = told(("wait",), call=(sys.executable, "-c", waiting))
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline() == "waits\n"
    process.stdin.close()
    assert "stopped" in process.stdout.read()  # by itself, not by force once patience is over
    assert process.wait() == STOPPED
