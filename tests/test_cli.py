"""The command line: words, exit codes and files; one message and no traceback when something is wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cagemap import __version__
from cagemap.cli import main
from cagemap.cli.progress import Stages
from cagemap.files.images import read_image, write_image
from cagemap.files.meshes import read_mesh, write_mesh
from cagemap.files.result import read_result, write_result
from cagemap.mesh import cube, icosahedron

from example_result import identity_result, textured_cube


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Run a command in an empty folder; an error is one message on standard error, and never a traceback."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*words: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["cagemap", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        code = ended.value.code if isinstance(ended.value.code, int) else int(bool(ended.value.code))
        assert "Traceback" not in captured.err
        return Outcome(code, captured.out, captured.err)

    return call


def test_version_and_help_name_every_command(run: Run) -> None:
    assert run("--version").out.strip() == f"cagemap {__version__}"
    shown = run("--help")
    assert shown.code == 0
    for command in ("demo", "check", "refine", "match", "transfer", "report"):
        assert command in shown.out
        assert run(command, "--help").code == 0


def test_help_is_instant() -> None:
    command = [
        sys.executable,
        "-c",
        "import sys; sys.argv = ['cagemap', '--help']; from cagemap.cli import main; main()",
    ]
    imported = subprocess.run(
        [*command[:1], "-X", "importtime", *command[1:]], capture_output=True, text=True, check=False
    )
    assert imported.returncode == 0
    for heavy in ("numpy", "scipy", "numba", "embreex", "OpenImageIO"):
        assert f" {heavy}\n" not in imported.stderr
    before = os.times()
    subprocess.run(command, capture_output=True, check=True)
    after = os.times()
    # Processor time, since other tests may run beside this one. Measured 0.25 s.
    assert after.children_user - before.children_user < 0.5


def test_check_reports_and_judges(run: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "good.obj", cube())
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 2 3\n")
    good = run("check", "good.obj")
    assert good.code == 0
    assert "problems              none" in good.out
    both = run("check", "good.obj", "bad.obj", "missing.obj")
    assert both.code == 1
    assert "duplicate faces" in both.out
    assert "missing.obj" in both.out


@pytest.mark.parametrize("extension", ["obj", "ply"])
def test_refine_writes_the_level_asked(run: Run, tmp_path: Path, extension: str) -> None:
    write_mesh(tmp_path / "ball.obj", icosahedron())
    outcome = run("refine", "ball.obj", "--level", 2, "-o", f"out.{extension}")
    assert outcome.code == 0
    assert "162" in outcome.out
    fine = read_mesh(tmp_path / f"out.{extension}")
    assert (fine.n_vertices, fine.n_faces) == (162, 320)


def test_refined_uvs_and_materials_come_along(run: Run, tmp_path: Path) -> None:
    control = textured_cube("box.obj")
    write_mesh(tmp_path / "box.obj", control)
    assert run("refine", "box.obj", "--level", 1, "-o", "fine.obj").code == 0
    fine = read_mesh(tmp_path / "fine.obj")
    assert fine.uvs is not None
    assert fine.uvs.min() >= control.uvs.min() - 1e-6  # type: ignore[union-attr]
    assert fine.face_materials is not None
    np.testing.assert_array_equal(fine.face_materials, np.repeat(control.face_materials, 4))
    assert run("refine", "box.obj", "--level", 0, "-o", "same.obj").code == 0
    assert read_mesh(tmp_path / "same.obj").n_faces == 6


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["refine", "none.obj", "--level", "1", "-o", "x.obj"], "none.obj"),
        (["refine", "box.obj", "--level", "20", "-o", "x.obj"], "Use --level 10 or less"),
        (["refine", "box.obj", "--level", "1", "-o", "x.stl"], r".obj or .ply"),
        (["refine", "box.obj", "--level", "1", "-o", "nowhere/x.obj"], "nowhere"),
        (["refine", "box.obj", "--level", "-1", "-o", "x.obj"], "--level"),
        (["match", "--target", "box.obj", "--source", "box.obj", "-o", "R"], "--landmarks"),
        (
            ["match", *"--target box.obj --source box.obj --landmarks l.json -o R --level 2 --vertices 5".split()],
            "got both",
        ),
        (
            ["match", *"--target box.obj --source box.obj --landmarks l.json -o R --schedule 10,x".split()],
            "100,50,50,50",
        ),
        (["match", *"--target box.obj --source box.obj --landmarks l.json -o R".split()], "l.json"),
        (["match", *"--target box.obj --source box.obj --landmarks l.json -o R --method magic".split()], "hfm"),
        (["transfer", "R", "--texture", "t.png", "-o", "o.png"], "cagemap match"),
        (["report", "R"], "cagemap match"),
        (["demo", "-o", "box.obj"], "box.obj"),
        (["dance"], "dance"),
    ],
    ids=lambda words: " ".join(words)[:50] if isinstance(words, list) else "",
)
def test_wrong_requests_are_refused_in_words(run: Run, tmp_path: Path, words: list[str], expected: str) -> None:
    write_mesh(tmp_path / "box.obj", cube())
    before = sorted(tmp_path.iterdir())
    outcome = run(*words)
    assert outcome.code == 2
    assert expected in outcome.err
    assert sorted(tmp_path.iterdir()) == before


def test_transfer_bakes_and_report_shows_it(run: Run, tmp_path: Path) -> None:
    write_result(tmp_path / "R", identity_result())
    texture = np.random.default_rng(29).integers(0, 255, (64, 96, 3), dtype=np.uint8)
    write_image(tmp_path / "t.png", texture)
    outcome = run("transfer", "R", "--texture", "t.png", "--size", 96, "-o", "baked.png")
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""  # no progress where there is no terminal
    assert read_image(tmp_path / "baked.png").pixels.shape == (96, 96, 3)
    assert [entry["kind"] for entry in read_result(tmp_path / "R").manifest["transfers"]] == ["texture"]


def test_progress_is_timed_and_silent_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with Stages() as stages:
        stages("one")
        stages("two")
        stages("one")
    assert list(stages.timings) == ["one", "two"]
    assert all(seconds >= 0 for seconds in stages.timings.values())
    assert capsys.readouterr() == ("", "")


def test_faults_of_ours_are_said_to_be(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(paths: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("cagemap.cli.mesh_commands.check_files", break_down)
    monkeypatch.delenv("CAGEMAP_DEBUG", raising=False)
    outcome = run("check", "x.obj")
    assert outcome.code == 70
    assert "fault of cagemap" in outcome.err
