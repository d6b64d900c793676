"""`cagemap run` on real files: the same maps as single commands, and nothing twice."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.cli.library import in_words
from cagemap.example import example_pair
from cagemap.files.images import write_image
from cagemap.files.landmarks import write_landmarks
from cagemap.files.meshes import write_mesh
from cagemap.files.result import read_result
from cagemap.library.page import PairRow

JOB = """output = "night"

[options]
vertices = 1500

[[assets]]
name = "pony"
file = "pony.obj"
files = { color = "pony.png" }

[[assets]]
name = "deer"
file = "deer.obj"

[[assets]]
name = "broken"
file = "broken.obj"
files = { color = "pony.png" }

[[pairs]]
source = "pony"
target = "deer"
landmarks = "landmarks.json"

[[pairs]]
source = "broken"
target = "deer"
landmarks = "landmarks.json"

[[outputs]]
command = "transfer"
texture = "{source.color}"
size = 64
output = "{target}.png"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pair = example_pair(64)
    write_mesh(tmp_path / "deer.obj", pair.target)
    write_mesh(tmp_path / "pony.obj", pair.source)
    write_image(tmp_path / "pony.png", pair.texture)
    write_landmarks(tmp_path / "landmarks.json", pair.landmarks)
    (tmp_path / "broken.obj").write_text("v 0 0 0\nf 1 2 3\n")
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path


def test_a_dry_run_says_what_would_be_done_and_does_nothing(folder: Path) -> None:
    before = sorted(folder.iterdir())
    said = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--dry-run"])
    assert said.exit_code == 0, said.output
    assert "2 pairs" in said.output
    assert "match pony -> deer" in said.output
    assert "core minutes" in said.output
    assert sorted(folder.iterdir()) == before


def test_a_dry_run_foresees_what_will_be_refused(folder: Path) -> None:
    def said(command: str) -> str:
        (folder / "job.toml").write_text(JOB.replace('texture = "{source.color}"\nsize = 64', command))
        run = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--dry-run"])
        assert run.exit_code == 0, run.output
        return run.output

    texture = 'texture = "{source.color}"'
    assert "refused" not in said(texture)
    assert "broken cannot be used: " in said(texture)
    pair = example_pair(64)
    write_mesh(folder / "deer.obj", replace(pair.target, uvs=None, uv_indices=None))
    assert "will be refused, for deer has no texture coordinates: add `unwrap = true`" in said(texture)
    assert "refused" not in said(texture + "\nunwrap = true")
    write_mesh(folder / "pony.obj", replace(pair.source, uvs=None, uv_indices=None))
    assert "will be refused, for pony has no texture coordinates, which texture lies over" in said(texture)
    assert "refused" not in said("material_colors = true\nunwrap = true")


def test_the_page_of_a_job_speaks_of_options() -> None:
    row = PairRow("a", "b", "failed", ("use the pairs reversed (`Landmarks.reversed()`)",), 0.0)
    assert in_words([row])[0].messages == ("use the pairs reversed (--exchange-landmarks)",)


@pytest.mark.slow
def test_a_job_gives_what_single_commands_give_and_names_what_failed(folder: Path) -> None:
    runner = CliRunner()
    job = ["run", str(folder / "job.toml"), "--workers", "2"]
    first = runner.invoke(app, job)
    assert first.exit_code == 1
    assert "broken" in first.output
    assert "match broken -> deer: skipped" in first.output
    night = folder / "night"
    assert (night / "pony__deer" / "deer.png").is_file()
    assert not (night / "broken__deer" / "RESULT").exists()
    assert "skipped" in (night / "index.html").read_text()

    single = ["match", "-t", str(folder / "deer.obj"), "-s", str(folder / "pony.obj"), "--vertices", "1500"]
    done = runner.invoke(app, [*single, "--landmarks", str(folder / "landmarks.json"), "-o", str(folder / "RESULT")])
    assert done.exit_code == 0, done.output
    one, many = read_result(folder / "RESULT"), read_result(night / "pony__deer" / "RESULT")
    np.testing.assert_allclose(many.image(), one.image(), atol=1e-12 * np.ptp(one.image()))

    written = {path: path.stat().st_mtime_ns for path in night.rglob("*") if ".lock" not in path.name}
    again = runner.invoke(app, job)
    assert again.exit_code == 1
    after = {path: path.stat().st_mtime_ns for path in night.rglob("*") if ".lock" not in path.name}
    assert {path for path in written if after.get(path) != written[path] and path.is_file()} == set()
    (folder / "broken.obj").write_bytes((folder / "pony.obj").read_bytes())
    mended = runner.invoke(app, job)
    assert mended.exit_code == 0, mended.output
    assert "failed" not in mended.output
    assert os.path.isfile(night / "broken__deer" / "deer.png")
