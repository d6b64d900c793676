"""The command line: words, exit codes and files; one message and no traceback when something is wrong."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import cagemap
from cagemap import BasisConfig, __version__
from cagemap.cli import main
from cagemap.cli.app import match as match_command
from cagemap.cli.bases import basis_config
from cagemap.cli.match import MatchRequest, match_config, read_inputs
from cagemap.cli.progress import Stages
from cagemap.example import ExamplePair, example_pair
from cagemap.files.images import read_image, write_image
from cagemap.files.landmarks import read_landmarks, write_landmarks
from cagemap.files.meshes import read_mesh, write_mesh
from cagemap.files.point_forms import write_points
from cagemap.files.result import file_hash, read_result, write_result
from cagemap.files.surface_store import prepared
from cagemap.mesh import cube, icosahedron
from cagemap.mesh.landmarks import NamedPoints
from cagemap.pipeline import MAP_BASIS, MatchConfig, prepare_surface, prepare_surfaces

from example_result import identity_result, textured_cube


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]
MATCH = ["--target", "deer.obj", "--source", "pony.obj", "--landmarks", "landmarks.json"]


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


def test_help_loads_nothing_heavy() -> None:
    # How long it takes is measured by benchmarks.speed ("start").
    shown = "import sys; sys.argv = ['cagemap', '--help']; from cagemap.cli import main; main()"
    command = [sys.executable, "-X", "importtime", "-c", shown]
    imported = subprocess.run(command, capture_output=True, text=True, check=False)
    assert imported.returncode == 0
    assert " cagemap.cli" in imported.stderr
    for heavy in ("numpy", "scipy", "numba", "embreex", "OpenImageIO"):
        assert f" {heavy}\n" not in imported.stderr


def test_check_reports_and_judges(run: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "good.obj", cube())
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 2 3\n")
    good = run("check", "good.obj")
    assert good.code == 0
    assert "problems              none" in good.out
    both = run("check", "bad.obj", "good.obj")
    assert both.code == 1
    assert "duplicate faces" in both.out
    listed = run("check", "--json", "bad.obj", "good.obj", "missing.obj")
    assert listed.code == 1
    bad, fine, gone = json.loads(listed.out)
    assert (bad["usable"], fine["usable"], gone["usable"]) == (False, True, False)
    assert "duplicate faces" in [problem["kind"] for problem in bad["problems"]]
    assert fine["n_faces"] == 6
    assert "missing.obj" in gone["error"]
    assert run("-q", "check", "good.obj").out == ""
    assert "duplicate faces" in run("-q", "check", "bad.obj").out
    missing = run("check", "missing.obj", "good.obj")
    assert missing.code == 1
    assert "missing.obj" in missing.out


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
    names = np.array(fine.material_names)[fine.face_materials]  # files number materials as they occur
    np.testing.assert_array_equal(names, np.repeat(np.array(control.material_names)[control.face_materials], 4))
    assert run("refine", "box.obj", "--level", 0, "-o", "same.obj").code == 0
    assert read_mesh(tmp_path / "same.obj").n_faces == 6


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["refine", "none.obj", "--level", "1", "-o", "x.obj"], "none.obj"),
        (["refine", "box.obj", "--level", "20", "-o", "x.obj"], "Use --level 10 or less"),
        (["refine", "box.obj", "--level", "1000", "-o", "x.obj"], "Use --level 10 or less"),
        (["refine", "box.obj", "--level", "1", "-o", "x.stl"], r"ending in .obj, .ply"),
        (["refine", "box.obj", "--level", "1", "-o", "nowhere/x.obj"], "nowhere"),
        (["refine", "box.obj", "--level", "-1", "-o", "x.obj"], "--level"),
        (["match", "--target", "box.obj", "-o", "R"], "--source"),
        (["match", *"--target box.obj --source box.obj --method hfm -o R".split()], "at least 3 pairs"),
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
        (["transfer", "box.obj", "--texture", "t.png", "-o", "o.png"], "found a file"),
        (["report", "R"], "cagemap match"),
        (["report", "R", "-o", "r.pdf"], "ending in .html, got '.pdf'"),
        (["match", "--target", ".", "--source", "box.obj", "-o", "R"], "got a folder"),
        (["wrap", "box.obj", "box.obj", "-o", "new.obj"], "meshes are given by --target and --source"),
        (["run", "."], "got a folder"),
        (["demo", "-o", "box.obj"], "box.obj"),
        (["demo", "-o", ""], "-o: expected a value, got an empty one"),
        (["match", *"--target box.obj --source box.obj --force --output=".split()], "--output: expected a value"),
        (["demo", "-o", "-"], "nothing is written to standard output"),
        (["demo", "--output=-"], "--output: expected a name, got '-'"),
        (["run", "box.obj/inside.toml"], "there is no such file"),
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


def test_a_refined_mesh_is_exported_as_gltf(run: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.obj", textured_cube("box.obj"))
    assert run("refine", "box.obj", "--level", 1, "-o", "fine.glb").err == ""
    assert run("refine", "box.obj", "--level", 2, "-o", "fine.glb").code == 0, "our own file is replaced"


@pytest.fixture
def result_folder(tmp_path: Path) -> Path:
    """A cube twice as large as its source, and an image over its layout."""
    write_result(tmp_path / "R", identity_result())
    gradient = np.linspace(40, 215, 64 * 96 * 3).reshape(3, 64, 96).astype(np.uint8)
    write_image(tmp_path / "t.png", np.moveaxis(gradient, 0, 2))
    return tmp_path / "R"


def test_transfer_bakes_and_report_shows_it(run: Run, result_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = result_folder.parent
    outcome = run("transfer", "R", "--texture", "t.png", "--size", 96, "-o", "baked.png")
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""  # no progress where there is no terminal
    baked = read_image(place / "baked.png").pixels
    assert baked.shape == (96, 96, 3)
    shown = {}
    monkeypatch.setattr("cagemap.cli.report.write_report", lambda *args, **kwargs: shown.update(kwargs))
    assert run("report", "R", "-o", "r.html").code == 0
    np.testing.assert_array_equal(shown["texture"], read_image(place / "t.png").pixels)
    np.testing.assert_array_equal(shown["baked"], baked)
    (place / "baked.png").unlink()
    assert run("report", "R", "-o", "r.html").code == 0
    assert shown["texture"] is not None
    assert shown["baked"] is None
    (place / "t.png").unlink()
    assert run("report", "R", "-o", "r.html").code == 0
    assert shown["texture"] is None


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--texture", "none.png", "-o", "o.png"], "none.png: expected an image, there is no such file"),
        (["--texture", "t.png", "-o", "o.exr"], "choose 16 or 32 bits"),
        (["--texture", "t.png", "-o", "o.png", "--bits", "12"], "8, 16 or 32"),
        (["--texture", "t.png", "-o", "."], "got no suffix"),
        (["--texture", "t.png", "-o", "o"], "got no suffix"),
    ],
)
def test_images_that_cannot_be_are_refused_in_words(
    run: Run, result_folder: Path, words: list[str], expected: str
) -> None:
    outcome = run("transfer", result_folder.name, *words)
    assert outcome.code == 2
    assert expected in outcome.err


def test_report_is_written(run: Run, result_folder: Path, small_pages: None) -> None:
    outcome = run("report", "R", "-o", "r.html")
    assert outcome.code == 0, outcome.err
    assert "r.html" in outcome.out
    assert (result_folder.parent / "r.html").read_text(encoding="utf-8").endswith("</html>\n")


def test_bits_choose_the_number_type(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    assert run("transfer", "R", "--texture", "t.png", "--size", 32, "--bits", 16, "-o", "deep.png").code == 0
    assert read_image(place / "deep.png").pixels.dtype == np.uint16
    refused = run("transfer", "R", "--texture", "t.png", "--bits", 32, "-o", "deep.png")
    assert refused.code == 2
    assert "bits" in refused.err


def test_displacement_grows_with_the_model(run: Run, result_folder: Path) -> None:
    heights = np.full((32, 48, 1), 0.25, np.float32)
    write_image(result_folder.parent / "h.exr", heights)
    outcome = run("transfer", "R", "--displacement", "h.exr", "--size", 32, "-o", "d.exr")
    assert outcome.code == 0, outcome.err
    # The target is twice as large. 1e-3: the image holds float32, areas are summed in another order.
    np.testing.assert_allclose(read_image(result_folder.parent / "d.exr").pixels, 0.5, rtol=1e-3)
    whole = run("transfer", "R", "--displacement", "t.png", "--size", 32, "-o", "d.png")
    assert whole.code == 2  # in colour
    assert "grey" in whole.err


def test_material_colours_are_baked(run: Run, result_folder: Path) -> None:
    outcome = run("transfer", "R", "--material-colors", "--size", 60, "-o", "m.png")
    assert outcome.code == 0, outcome.err
    pixels = read_image(result_folder.parent / "m.png").pixels
    red, green, _ = pixels[45, 10].astype(int)  # face 0: the lower left cell of the layout
    assert red > green + 50
    assert np.ptp(pixels[45, 30].astype(int)) <= 1  # face 1: unknown, grey


def test_attributes_arrive_at_the_same_kind_of_place(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    result = read_result(result_folder)
    rng = np.random.default_rng(31)
    values = {
        "weight": rng.random((8, 2)),
        "label": rng.integers(0, 4, 8),
        "group": rng.integers(0, 4, 6),
        "corner": rng.random((24, 3)),
        "dense": rng.random(len(result.source.vertices)),
    }
    np.savez(place / "in.npz", **values)
    outcome = run("transfer", "R", "--attribute", "in.npz", "-o", "out.npz")
    assert outcome.code == 0, outcome.err
    with np.load(place / "out.npz") as carried:
        np.testing.assert_allclose(carried["dense"], values["dense"], atol=1e-12)
        # The map is the identity, so each comes back as it was: no smoothing, labels as labels.
        for name in ("group", "label"):
            np.testing.assert_array_equal(carried[name], values[name])
            assert carried[name].dtype == values[name].dtype
        for name in ("weight", "corner"):
            np.testing.assert_allclose(carried[name], values[name], atol=1e-12)
    np.save(place / "seven.npy", np.arange(7))
    refused = run("transfer", "R", "--attribute", "seven.npy", "-o", "out.npz")
    assert refused.code == 2
    assert "7 rows" in refused.err


def test_a_target_without_uvs_needs_unwrap(run: Run, result_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place, result = result_folder.parent, read_result(result_folder)
    bare = result.target.with_control(result.target.control.with_uvs(None, None))
    write_result(result_folder, replace(result, target=bare))
    refused = run("transfer", "R", "--texture", "t.png", "--size", 32, "-o", "b.png")
    assert refused.code == 2
    assert "--unwrap" in refused.err
    outcome = run("transfer", "R", "--texture", "t.png", "--size", 32, "--unwrap", "-o", "b.png")
    assert outcome.code == 0, outcome.err
    laid_out = read_mesh(place / "b_unwrapped.obj")
    assert laid_out.uvs is not None
    shown: dict[str, object] = {}
    monkeypatch.setattr(
        "cagemap.cli.report.write_report", lambda path, result, **kwargs: shown.update(kwargs, r=result)
    )
    assert run("report", "R").code == 0
    assert shown["baked"] is not None
    assert shown["r"].target.control.uvs is not None  # type: ignore[attr-defined]


def test_a_normal_map_is_not_taken_for_colours_without_a_word(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    slopes = np.random.default_rng(5).normal(0.0, 0.3, (32, 48, 2))
    normals = np.concatenate([slopes, np.ones((32, 48, 1))], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    write_image(place / "n.png", np.round(255 * (normals + 1) / 2).astype(np.uint8))
    refused = run("transfer", "R", "--texture", "n.png", "--size", 16, "-o", "o.png")
    assert refused.code == 2
    assert "looks like a normal map" in refused.err
    sky = np.round(255 * np.random.default_rng(6).random((32, 48, 1)) * [0.5, 0.7, 1.0]).astype(np.uint8)
    for name, pixels in (("t.png", None), ("sky.png", sky), ("grey.png", sky[:, :, :1])):
        if pixels is not None:
            write_image(place / name, pixels)
        assert run("transfer", "R", "--texture", name, "--size", 16, "-o", "o.png").err == "", name
    assert run("transfer", "R", "--normal-map", "n.png", "--size", 16, "-o", "o.png").err == ""
    assert "is it a normal map" in run("transfer", "R", "--normal-map", "sky.png", "--size", 16, "-o", "o.png").err


@pytest.mark.parametrize("option", ["--scale", "--midlevel"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_heights_have_finite_scales(run: Run, result_folder: Path, option: str, value: str) -> None:
    write_image(result_folder.parent / "h.exr", np.zeros((4, 4, 1), np.float32))
    refused = run("transfer", "R", "--displacement", "h.exr", option, value, "-o", "d.exr")
    assert refused.code == 2
    assert f"{option}: expected a finite number" in refused.err


@pytest.mark.parametrize(
    "words",
    [
        ["check", "pipe.obj"],
        ["transfer", "R", "--texture", "pipe", "-o", "o.png"],
        ["transfer", "R", "--attribute", "pipe", "-o", "o.npz"],
        ["wrap", "R", "--normal-map", "n.png", "--detail", "pipe.obj", "-o", "o.obj"],
        ["run", "pipe"],
        ["map", "pipe.npy", "-t", "t.obj", "-s", "t.obj", "-o", "Q"],
        ["match", "-t", "t.obj", "-s", "t.obj", "--target-symmetry", "pipe", "--source-symmetry", "pipe", "-o", "Q"],
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


def test_suggested_landmarks_go_to_a_landmark_file(run: Run, result_folder: Path) -> None:
    refused = run("suggest", "R", "-o", "t.png")
    assert refused.code == 2
    assert "ending in .json" in refused.err
    assert read_image(result_folder.parent / "t.png").pixels.shape == (64, 96, 3)


def test_one_thing_at_a_time(run: Run, result_folder: Path) -> None:
    for words in ([], ["--texture", "t.png", "--material-colors"]):
        refused = run("transfer", "R", *words, "-o", "o.png")
        assert refused.code == 2
        assert "expected one of" in refused.err


def test_islands_outside_the_square_are_warned_of(run: Run, result_folder: Path) -> None:
    result = read_result(result_folder)
    moved = result.target.control.with_uvs(result.target.control.uvs - [0.4, 0.0], result.target.control.uv_indices)
    write_result(result_folder, replace(result, target=result.target.with_control(moved)))
    outcome = run("transfer", "R", "--texture", "t.png", "--size", 32, "-o", "b.png")
    assert outcome.code == 0
    assert "outside the unit square" in outcome.err


def test_a_source_without_layout_is_named_before_anything_is_written(run: Run, result_folder: Path) -> None:
    result = read_result(result_folder)
    bare = result.source.with_control(result.source.control.with_uvs(None, None))
    write_result(result_folder, replace(result, source=bare))
    refused = run("transfer", "R", "--texture", "t.png", "--unwrap", "-o", "b.png")
    assert refused.code == 2
    assert f"{bare.control.name}: expected texture coordinates of the source" in refused.err
    assert not list(result_folder.parent.glob("b*"))


def test_layouts_that_lie_over_themselves_are_warned_of(run: Run, result_folder: Path) -> None:
    """Half of the faces in the place of the other half: mirrored halves, or materials with an image each."""

    def doubled(surface: cagemap.Surface) -> cagemap.Surface:
        control = surface.control
        corners = control.uv_indices.reshape(-1, 4).copy()
        half = len(corners) // 2
        corners[half : 2 * half] = corners[:half]
        faces = np.arange(control.n_faces) >= half
        materials = {"face_materials": faces.astype(np.int64), "material_names": ("skin", "eyes")}
        return surface.with_control(replace(control.with_uvs(control.uvs, corners.ravel()), **materials))

    plain = run("transfer", "R", "--texture", "t.png", "--size", 32, "-o", "plain.png")
    assert plain.code == 0
    assert "over" not in plain.err
    result = read_result(result_folder)
    write_result(result_folder, replace(result, target=doubled(result.target), source=doubled(result.source)))
    outcome = run("transfer", "R", "--texture", "t.png", "--size", 32, "-o", "b.png")
    assert outcome.code == 0
    assert "50 % of the target's layout lies over other parts" in outcome.err
    assert "materials of the source lie over each other in its layout (skin, eyes)" in outcome.err
    colours = run("transfer", "R", "--material-colors", "--size", 32, "-o", "c.png")
    assert "materials of the source" not in colours.err


@pytest.fixture(scope="module")
def pair() -> ExamplePair:
    return example_pair(64)


@pytest.fixture
def pair_files(pair: ExamplePair, tmp_path: Path) -> Path:
    """The built-in pair as files."""
    write_mesh(tmp_path / "deer.obj", pair.target)
    write_mesh(tmp_path / "pony.obj", pair.source)
    write_landmarks(tmp_path / "landmarks.json", pair.landmarks)
    write_image(tmp_path / "pony.png", pair.texture)
    return tmp_path


@pytest.mark.slow
def test_a_match_without_landmarks_says_how_sure_it_is(run: Run, pair_files: Path, small_pages: None) -> None:
    outcome = run("match", *MATCH[:4], "--level", 1, "-k", 20, "-o", "R")
    assert outcome.code == 0, outcome.err
    assert "no landmarks" in outcome.out
    result = read_result(pair_files / "R")
    said = result.manifest["confidence"]
    assert said["verdict"] in ("sure", "look at it", "two answers")
    told = said["message"]
    assert told in (outcome.out if said["verdict"] == "sure" else outcome.err)
    assert len(result.runner_up_images) == len(said["readings"]) - 1
    assert run("report", "R").code == 0


def test_landmarks_come_from_one_file_for_each_mesh(run: Run, pair_files: Path) -> None:
    landmarks = read_landmarks(pair_files / "landmarks.json", "deer.obj", "pony.obj")[0]
    for side, vertices in (("deer", landmarks.target), ("pony", landmarks.source)):
        mesh = read_mesh(pair_files / f"{side}.obj")
        names = (*landmarks.names, f"only {side}")
        points = NamedPoints(names, np.append(vertices, 0), np.full((len(names), 3), np.nan))
        write_points(pair_files / f"{side}.pp", points, mesh)
    files = ["--target-points", "deer.pp", "--source-points", "pony.pp"]
    outcome = run("match", *MATCH[:4], *files, "--level", 1, "-k", 20, "-o", "R")
    assert outcome.code == 0, outcome.err
    assert "only deer" in outcome.err
    found = read_result(pair_files / "R")
    assert found.landmark_names == landmarks.names
    np.testing.assert_array_equal(found.landmarks.target, landmarks.target)
    assert run("match", *MATCH, *files, "-o", "S").code == 2
    assert run("match", *MATCH[:4], *files[:2], "-o", "S").code == 2


def test_match_from_files_to_a_result(run: Run, pair_files: Path) -> None:
    outcome = run("match", *MATCH, "--level", 1, "-k", 20, "-o", "R")
    assert outcome.code == 0, outcome.err
    assert "deer.obj" in outcome.out
    result = read_result(pair_files / "R")
    assert (result.target.finest, result.functional_map.shape) == (1, (20, 20))
    assert (result.barycentric >= -1e-12).all()
    np.testing.assert_allclose(result.barycentric.sum(1), 1.0, atol=1e-12)
    manifest = result.manifest
    assert manifest["parameters"]["target_k"] == manifest["parameters"]["source_k"] == 20
    assert manifest["inputs"]["target"]["sha256"] == file_hash(pair_files / "deer.obj")
    assert manifest["timings"]["functional map"] > 0
    assert manifest["peak_memory_bytes"] > 2**20
    assert manifest["notes"] == []


@pytest.mark.slow
def test_a_wrong_landmark_is_left_out_with_a_warning_unless_trusted(
    run: Run, pair_files: Path, pair: ExamplePair
) -> None:
    names = pair.landmarks.names
    source = pair.landmarks.source.copy()
    wrong = names.index("hoof_hind_L")
    away = np.linalg.norm(pair.source.positions - pair.source.positions[source[wrong]], axis=1)
    away[source] = 0.0
    source[wrong] = np.argmax(away)
    write_landmarks(pair_files / "landmarks.json", replace(pair.landmarks, source=source))
    outcome = run("match", *MATCH, "--level", 1, "-k", 20, "-o", "R")
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.err.split())
    assert "landmark 'hoof_hind_L' looks wrong and was left out" in said
    assert "--trust-landmarks" in said
    met = re.search(r"(\d+) landmarks missed by 0.00 % .*; 1 left out, which the map misses by (\d+) %", outcome.out)
    assert met is not None, outcome.out
    assert int(met[1]) == len(names) - 1
    assert int(met[2]) > 5  # across the body
    result = read_result(pair_files / "R")
    assert [suspect["name"] for suspect in result.manifest["landmark_check"]["suspects"]] == ["hoof_hind_L"]
    assert result.landmark_errors[wrong] > 0.3
    assert np.delete(result.landmark_errors, wrong).max() < 1e-9
    outcome = run("match", *MATCH, "--level", 1, "-k", 20, "-o", "R", "--trust-landmarks")
    assert "looks wrong" not in outcome.err
    assert read_result(pair_files / "R").landmark_errors.max() < 1e-9


def test_exchanged_meshes_are_refused_and_other_names_noted(run: Run, pair_files: Path) -> None:
    refused = run("match", "--target", "pony.obj", "--source", "deer.obj", *MATCH[4:], "--level", 1, "-o", "R")
    assert refused.code == 2
    assert "other way round" in refused.err
    assert not (pair_files / "R").exists()
    (pair_files / "deer.obj").rename(pair_files / "stag.obj")
    request = MatchRequest(*(pair_files / name for name in ("stag.obj", "pony.obj", "landmarks.json", "R")))
    (note,) = read_inputs(request).notes
    assert "stag.obj" in note


def test_command_line_and_library_have_the_same_defaults() -> None:
    shown = inspect.signature(match_command).parameters
    asked = MatchRequest(*[Path("x")] * 4)
    assert (shown["k"].default, shown["tolerance"].default) == (asked.k, asked.tolerance)
    assert basis_config(asked) == MAP_BASIS
    assert match_config(asked) == MatchConfig()
    for prepare in (prepare_surface, prepare_surfaces, prepared):
        assert inspect.signature(prepare).parameters["config"].default == MAP_BASIS


def test_options_reach_the_library() -> None:
    paths = [Path("x")] * 4
    asked = MatchRequest(*paths, k=77, tolerance=0.02, symmetry=False)
    assert basis_config(asked) == BasisConfig(count=77, tolerance=0.02, schedule=None)
    assert not match_config(asked).use_symmetry
    assert match_config(asked).check_landmarks
    assert not match_config(MatchRequest(*paths, trust_landmarks=True)).check_landmarks
    assert basis_config(MatchRequest(*paths, schedule="100,50,50")).schedule == (100, 50, 50)


@pytest.mark.slow
def test_demo_runs_and_the_readme_block_does(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = run("demo", "-o", "demo")
    assert outcome.code == 0, outcome.err
    assert str(Path("demo") / "report.html") in outcome.out
    for name in ("deer.obj", "pony.obj", "pony.png", "landmarks.json", "deer.png", "report.html", "RESULT/map.npz"):
        assert (tmp_path / "demo" / name).is_file()
    readme = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 12
    (tmp_path / "demo" / "deer.png").unlink()
    monkeypatch.chdir(tmp_path / "demo")
    exec(compile(block, "README.md", "exec"), {})  # the block as a reader runs it
    assert "flipped_area" in capsys.readouterr().out
    assert read_image("deer.png").pixels.shape == (1024, 1024, 3)
    assert read_result("RESULT").target.finest == 3


def test_a_broken_mesh_is_refused_before_any_work(run: Run, pair_files: Path) -> None:
    lines = (pair_files / "deer.obj").read_text().splitlines()
    faces = [number for number, line in enumerate(lines) if line.startswith("f ")]
    lines[faces[3]] = "f " + " ".join(reversed(lines[faces[3]].split()[1:]))
    (pair_files / "deer.obj").write_text("\n".join(lines) + "\n")
    refused = run("match", *MATCH, "--level", 1, "-o", "R")
    assert refused.code == 2
    assert "inconsistent orientation" in refused.err
    assert "3" in refused.err


def test_progress_is_timed_and_silent_without_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(100))
    monkeypatch.setattr("cagemap.cli.progress.time.perf_counter", lambda: float(next(clock)))
    with Stages() as stages:
        stages("one")
        stages("two")
        stages("one")
    assert stages.timings == {"one": 2.0, "two": 1.0}
    assert capsys.readouterr() == ("", "")


def test_faults_of_ours_are_said_to_be(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(paths: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("cagemap.cli.mesh_commands.check_files", break_down)
    monkeypatch.delenv("CAGEMAP_DEBUG", raising=False)
    outcome = run("check", "x.obj")
    assert outcome.code == 70
    assert "fault of cagemap" in outcome.err


def test_threads_are_one_setting_for_the_process(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("CAGEMAP_THREADS", "OPENIMAGEIO_THREADS"):
        monkeypatch.setenv(variable, "7")
    mesh = tmp_path / "mesh.obj"
    write_mesh(mesh, icosahedron())
    assert run("--threads", "2", "check", mesh).code == 0
    assert os.environ["CAGEMAP_THREADS"] == os.environ["OPENIMAGEIO_THREADS"] == "2"
    assert run("--threads", "0", "check", mesh).code == 2
