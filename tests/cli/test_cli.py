"""The command line: requests as commands, words, exit codes and files; one message and no traceback for errors."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
import typer
from examples.shapes import cube, icosahedron
from typer.main import get_command
from typer.testing import CliRunner

from cagemap import __version__
from cagemap.cli import main
from cagemap.cli.app import app
from cagemap.cli.console import set_verbosity
from cagemap.cli.progress import ConsoleStages
from cagemap.cli.request_command import command_of
from cagemap.files.images.image import read_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import join_meshes
from cagemap.tasks.requests.options import Argument, Option, PythonOnly
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.wrap import WrapConfig

from command_line import Run
from example_result import textured_cube
from locations import ROOT


def test_the_version_is_said(run: Run) -> None:
    assert run("--version").out.strip() == f"cagemap {__version__}"


def test_help_names_options_whole_in_a_narrow_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, _, listed = run("--help").out.partition("Commands:")
    assert listed.count("\n") >= len(get_command(app).commands)
    assert "..." not in listed, "a command's sentence is cut off"
    for name, command in get_command(app).commands.items():
        shown = run(name, "--help").out.replace(",", " ").split()
        for option in (word for one in command.params for word in (*one.opts, *one.secondary_opts)):
            assert option in shown or not option.startswith("-"), f"{name} {option}"


def test_quiet_and_verbose_are_taken_after_every_command(run: Run, tmp_path: Path) -> None:
    for name in get_command(app).commands:
        shown = run.done(name, "-q", "-v", "--help")
        assert {"--quiet", "--verbose"} <= set(shown.out.replace(",", " ").split())
    write_mesh(tmp_path / "mesh.obj", cube())
    for words in (("-q", "check", "mesh.obj"), ("check", "-q", "mesh.obj"), ("check", "mesh.obj", "--quiet")):
        assert run(*words).out == ""
    matched = ("match", "-t", "mesh.obj", "-s", "mesh.obj", "--level", "2", "-k", "5", "-o", "R")
    assert "stage:" in run(*matched, "-v").err
    assert "mesh.obj" in run("check mesh.obj").out  # what was asked of one command is not asked of the next


def test_only_commands_that_repair_offer_it(run: Run, tmp_path: Path) -> None:
    bad = cube()
    bad = replace(bad, face_indices=np.concatenate([bad.face_indices[:4][::-1], bad.face_indices[4:]]))
    write_mesh(tmp_path / "bad.obj", bad)
    np.save(tmp_path / "p2p.npy", np.arange(8))
    offer = "Or use --scheme none (of a source alone: --source-scheme none), which repairs"
    run.refused("match -t bad.obj -s bad.obj -o R", says=offer)
    others = "refine bad.obj --level 1 -o f.obj", "functions bad.obj -o f.npz", "map p2p.npy -t bad.obj -s bad.obj -o R"
    for words in others:
        assert offer not in run.refused(words, says="orientation").err


def test_check_offers_to_take_a_scan_with_floating_pieces_as_it_is(run: Run, tmp_path: Path) -> None:
    write_mesh(
        tmp_path / "scan.obj", join_meshes([icosahedron(), icosahedron().with_positions(icosahedron().positions + 9)])
    )
    offer = "--scheme none repairs the mesh and takes it without subdivision"
    assert f"note: {offer}" in run("check scan.obj").out
    assert offer not in run("check scan.obj --scheme none").out


def test_check_lists_pieces_and_not_uv_islands(run: Run, tmp_path: Path) -> None:
    two = join_meshes([icosahedron(), icosahedron().with_positions(icosahedron().positions + 9)])
    write_mesh(tmp_path / "two.obj", two)
    assert "component:1" in run("check two.obj --scheme none").out
    split = ControlMesh.from_faces(two.positions[two.face_indices], np.arange(120).reshape(40, 3))
    write_mesh(tmp_path / "split.obj", split)
    assert "component:" not in run("check split.obj --scheme none").out


def test_check_reports_and_judges(run: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "good.obj", cube())
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 2 3\n")
    good = run.done("check good.obj")
    assert "problems              none" in good.out
    both = run("check bad.obj good.obj")
    assert both.code == 1
    assert "duplicate faces" in both.out
    listed = run("check --json bad.obj good.obj missing.obj")
    assert listed.code == 1
    bad, fine, gone = json.loads(listed.out)
    assert (bad["usable"], fine["usable"], gone["usable"]) == (False, True, False)
    assert "duplicate faces" in [problem["kind"] for problem in bad["problems"]]
    assert fine["n_faces"] == 6
    assert "missing.obj" in gone["error"]
    assert (gone["code"], gone["place"]) == ("missing-file", "missing.obj")
    assert gone["error"].endswith(f". {gone['remedy']}")
    assert run("-q check good.obj").out == ""
    assert json.loads(run("-q check --json good.obj").out)[0]["usable"]
    assert "duplicate faces" in run("-q check bad.obj").out
    missing = run("check missing.obj good.obj")
    assert missing.code == 1
    assert "missing.obj" in missing.out


@pytest.mark.parametrize("extension", ["obj", "ply", "glb"])
def test_refine_writes_the_level_asked_and_replaces_its_own_file(run: Run, tmp_path: Path, extension: str) -> None:
    write_mesh(tmp_path / "ball.obj", icosahedron())
    for level, vertices, faces in ((1, 42, 80), (2, 162, 320)):
        outcome = run.done("refine ball.obj --level", level, "-o", f"out.{extension}")
        assert (str(vertices) in outcome.out, outcome.err) == (True, "")
        fine = read_mesh(tmp_path / f"out.{extension}")
        assert (fine.n_vertices, fine.n_faces) == (vertices, faces)


def test_pieces_are_refined_each_for_itself(run: Run, tmp_path: Path) -> None:
    ball = icosahedron()
    far = ball.with_positions(ball.positions + np.array([5.0, 0, 0]))
    write_mesh(tmp_path / "balls.obj", join_meshes([ball, far]))
    outcome = run.done("refine balls.obj --level 2 -o fine.obj")
    assert (read_mesh(tmp_path / "fine.obj").n_vertices, "--weld" in outcome.out) == (324, False)


def test_refined_uvs_and_materials_come_along(run: Run, tmp_path: Path) -> None:
    control = textured_cube("box.obj")
    write_mesh(tmp_path / "box.obj", control)
    assert run("refine box.obj --level 1 -o fine.obj").code == 0
    fine = read_mesh(tmp_path / "fine.obj")
    assert fine.uvs.min() >= control.uvs.min() - 1e-6  # type: ignore[union-attr]
    names = np.array(fine.material_names)[fine.face_materials]  # files number materials as they occur
    np.testing.assert_array_equal(names, np.repeat(np.array(control.material_names)[control.face_materials], 4))
    assert not (tmp_path / "fine.mtl").exists(), "the materials of box.mtl, with their images, are named"
    (tmp_path / "lod").mkdir()
    assert run("refine box.obj --level 1 -o lod/fine.obj").code == 0
    assert "\nmtllib ../box.mtl\n" in (tmp_path / "lod" / "fine.obj").read_text()
    assert run("refine box.obj --level 0 -o same.obj").code == 0
    assert read_mesh(tmp_path / "same.obj").n_faces == 6


SYMMETRIES = ("--set", "target.symmetry=pipe", "--set", "source.symmetry=pipe")


@pytest.mark.parametrize(
    "words",
    [
        ["check", "pipe.obj"],
        ["transfer", "R", "--texture", "pipe", "-o", "o.png"],
        ["transfer", "R", "--attribute", "pipe", "-o", "o.npz"],
        ["wrap", "R", "--normal-map", "n.png", "--detail", "pipe.obj", "-o", "o.obj"],
        ["run", "pipe"],
        ["map", "pipe.npy", "-t", "t.obj", "-s", "t.obj", "-o", "Q"],
        ["match", "-t", "t.obj", "-s", "t.obj", *SYMMETRIES, "-o", "Q"],
    ],
    ids=" ".join,
)
def test_pipes_are_no_files_and_do_not_hang(run: Run, result_folder: Path, words: list[str]) -> None:
    place = result_folder.parent
    write_mesh(place / "t.obj", cube())
    for name in ("pipe", "pipe.npy", "pipe.obj"):
        os.mkfifo(place / name)
    before = sorted(place.iterdir())
    refused = run(*words)
    assert refused.code in (1, 2)
    assert "a device or a pipe" in refused.out + refused.err
    assert sorted(place.iterdir()) == before


@pytest.mark.slow
def test_demo_runs_and_writes_what_the_readme_block_reads(run, tmp_path, monkeypatch, quick_fit):
    """The demo is small: `make demo` in .ci/run is the whole one."""
    monkeypatch.setattr("cagemap.tasks.demo.VERTICES", 1500)
    monkeypatch.setattr("cagemap.tasks.demo.TEXTURE_SIZE", 128)
    outcome = run.done("demo -o demo")
    assert str(Path("demo") / "report.html") in outcome.out
    for name in ("deer.obj", "pony.obj", "pony.png", "landmarks.json", "deer.png", "report.html", "RESULT/map.npz"):
        assert (tmp_path / "demo" / name).is_file()
    assert read_image(tmp_path / "demo" / "deer.png").pixels.shape == (128, 128, 3)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 12
    named = re.findall(r'"(\w+\.\w+)"', block)
    assert [name for name in named if not (tmp_path / "demo" / name).is_file()] == []
    assert set(named) == {"deer.obj", "pony.obj", "landmarks.json", "pony.png", "deer.png"}


def test_progress_is_timed_and_silent_without_a_terminal(capsys, monkeypatch):
    clock = iter(range(100))
    monkeypatch.setattr("cagemap.tasks.progress.time.perf_counter", lambda: float(next(clock)))
    with ConsoleStages() as stages:
        stages("one")
        stages("two")
        stages("one")
    assert stages.timings == {"one": 2.0, "two": 1.0}
    assert capsys.readouterr() == ("", "")


def test_a_long_command_without_a_terminal_says_its_stages(capsys, monkeypatch):
    monkeypatch.setattr("cagemap.cli.progress.SILENT_SECONDS", 0.05)
    seen = ""

    def until(text: str) -> None:
        nonlocal seen
        end = time.monotonic() + 10
        while text not in seen and time.monotonic() < end:
            time.sleep(0.01)
            seen += capsys.readouterr().err

    with ConsoleStages() as stages:
        stages("first")
        until("first")  # the one that runs is said, however long it is
        stages("second")
        stages("third")
    until("third")
    assert seen == "cagemap: stage: first\ncagemap: stage: second\ncagemap: stage: third\n"
    for quiet, said in ((True, ""), (False, "cagemap: stage: fourth\n")):  # -v says stages by itself, once
        set_verbosity(1, quiet)
        with ConsoleStages() as stages:
            stages("fourth")
            time.sleep(0.2)
        assert capsys.readouterr().err == said
    set_verbosity(0, quiet=False)


def test_control_characters_of_names_do_not_reach_the_terminal(run: Run, tmp_path: Path) -> None:
    names = ("red\x1b[2J", "blue\x07")
    parts = join_meshes([cube(), cube().with_positions(cube().positions + 3.0)])
    write_mesh(tmp_path / "cubes.obj", replace(parts, face_objects=np.repeat([0, 1], 6), object_names=names))
    said = run("check", "cubes.obj")
    assert "red\\x1b[2J" in said.out
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f]", said.out + said.err)


def test_faults_of_ours_are_said_to_be(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(paths: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("cagemap.tasks.mesh_commands.run_check", break_down)
    monkeypatch.delenv("CAGEMAP_DEBUG", raising=False)
    outcome = run("check x.obj")
    assert outcome.code == 70
    assert "fault of cagemap" in outcome.err


def test_threads_are_one_setting_for_the_process(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("CAGEMAP_THREADS", "OPENIMAGEIO_THREADS"):
        monkeypatch.setenv(variable, "7")
    mesh = tmp_path / "mesh.obj"
    write_mesh(mesh, icosahedron())
    assert run("--threads 2 check", mesh).code == 0
    assert os.environ["CAGEMAP_THREADS"] == os.environ["OPENIMAGEIO_THREADS"] == "2"
    assert run("--threads 0 check", mesh).code == 2


def test_without_its_server_the_studio_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(("cagemap.studio.page", "websockets"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "websockets", None)
    run.refused("studio --no-browser", says="which is not installed. Run pip install 'cagemap[studio]'.")


def test_a_fault_in_the_code_is_shown_whole_if_asked_for(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*given: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("cagemap.cli.entry._check_words", fault)
    assert run("check a.obj").code not in (0, 2)
    monkeypatch.setenv("CAGEMAP_DEBUG", "1")
    monkeypatch.setattr(sys, "argv", ["cagemap", "check", "a.obj"])
    with pytest.raises(ZeroDivisionError):
        main()


@dataclass(frozen=True)
class Asked:
    """A request with a field of every kind."""

    files: Annotated[tuple[Path, ...], Argument("Files.", metavar="[FILE]")]
    kinds: Annotated[tuple[str, ...], Option("Kinds.")] = ()
    sizes: Annotated[tuple[int, ...], Option("Sizes.", names=("--size",))] = (1, 2)
    amount: Annotated[float, Option("Amount.")] = 0.5
    space: Annotated[Literal["a", "b"] | None, Option("Space.")] = None
    inner: Annotated[str, PythonOnly("Of Python alone.")] = "not of the command line"


@dataclass(frozen=True)
class AskedInWords:
    """A request with a field that is typed in another form."""

    kinds: Annotated[tuple[str, ...], Option("Kinds.", typed=str | None)] = ()

    @classmethod
    def of_words(cls, kinds: str | None) -> AskedInWords:
        """The request from what is typed."""
        return cls(kinds=tuple(kinds.split(",")) if kinds else ())


def _asked(*words: str, kind: type = Asked) -> Any:
    got: list[Any] = []
    app = typer.Typer()

    app.command()(command_of(kind, got.append))
    done = CliRunner().invoke(app, words)
    assert (done.exit_code, done.output) == (0, ""), done.output
    return got[0]


def test_what_is_not_said_is_the_requests_own_default() -> None:
    assert _asked() == Asked(())


def test_words_become_the_fields_values() -> None:
    got = _asked("a", "b", "--kinds", "x", "--kinds", "y", "--size", "3", "--amount", "1", "--space", "b")
    assert got == Asked((Path("a"), Path("b")), ("x", "y"), (3,), 1.0, "b")
    assert type(got.space) is str


def test_a_field_may_be_said_in_words_of_its_own() -> None:
    assert _asked("--kinds", "x,y", kind=AskedInWords) == AskedInWords(("x", "y"))
    assert _asked(kind=AskedInWords) == AskedInWords()


def test_wrap_is_asked_for_what_the_library_does_by_itself() -> None:
    assert WrapRequest((), Path("out.obj")).fairness == WrapConfig.fairness  # written twice so that --help starts fast


def test_what_no_command_uses_is_loaded_when_it_is_asked_for_after_all() -> None:
    asked = """
import sys
from cagemap.cli.request_command import LAZY_MODULES, load_lazily
load_lazily(LAZY_MODULES)
import numpy, scipy.linalg
print(any(name.startswith(f"{late}.") for name in sys.modules for late in LAZY_MODULES))
numpy.testing.assert_equal(1, 1)
from numpy.f2py import crackfortran
print(crackfortran.__name__)
"""
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "numpy.f2py.crackfortran"]


def test_a_match_imports_no_baking() -> None:
    script = "import sys, cagemap.tasks.match\nprint([name for name in sys.modules if 'cagemap.transfer' in name])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
