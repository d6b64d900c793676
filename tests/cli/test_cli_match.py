"""`cagemap match` on files: inputs, defaults, what it writes and what it says."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import use_option_names
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import file_hash
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.mesh.landmarks import NamedPoints
from cagemap.pipeline import MAP_BASIS, MatchConfig, prepare_surface, prepare_surfaces
from cagemap.tasks.match import MatchRequest, match_config, read_inputs
from cagemap.tasks.method import basis_config

from command_line import MATCH, Run

COARSE = ["--level", 1, "-k", 20, "--set", "method.search_vertices=300"]


@pytest.mark.slow
def test_a_match_without_landmarks_says_how_sure_it_is(run: Run, tmp_path: Path, quick_fit: None) -> None:
    """Two boxes, of which every half turn is an answer."""
    for name, depth in (("deer.obj", 1.4), ("pony.obj", 1.9)):
        write_mesh(tmp_path / name, cube().with_positions(cube().positions * [1.0, 1.2, depth]))
    outcome = run.done("match", *MATCH[:4], "--vertices", 300, "-k", 20, "-o", "R")
    assert "no landmarks" in outcome.out
    result = read_result(tmp_path / "R")
    said = result.manifest["confidence"]
    assert said["verdict"] in ("sure", "look at it", "two answers")
    told = use_option_names(said["message"])
    assert told in (outcome.out if said["verdict"] == "sure" else outcome.err)
    assert len(result.runner_up_images) == len(said["readings"]) - 1 > 0
    assert run("report R").code == 0


@pytest.mark.slow
def test_landmarks_come_from_one_file_for_each_mesh(run: Run, pair_files: Path, one_start: None) -> None:
    landmarks = read_landmarks(pair_files / "landmarks.json", "deer.obj", "pony.obj")[0]
    for side, vertices in (("deer", landmarks.target), ("pony", landmarks.source)):
        mesh = read_mesh(pair_files / f"{side}.obj")
        names = (*landmarks.names, f"only {side}")
        points = NamedPoints(names, np.append(vertices, 0), np.full((len(names), 3), np.nan))
        write_points(pair_files / f"{side}.pp", points, mesh)
    files = ["--target-points", "deer.pp", "--source-points", "pony.pp"]
    outcome = run.done("match", *MATCH[:4], *files, *COARSE, "-o", "R")
    assert "only deer" in outcome.err
    found = read_result(pair_files / "R")
    assert found.landmarks.names == landmarks.names
    np.testing.assert_array_equal(found.landmarks.target, landmarks.target)
    for words in ((*MATCH, *files), (*MATCH[:4], *files[:2])):
        run.refused("match", *words, "-o", "S", says="expected both, and no --landmarks beside them")


def test_match_from_files_to_a_result(run: Run, pair_files: Path, one_start: None) -> None:
    outcome = run.done("match", *MATCH, *COARSE, "-o", "R")
    assert "deer.obj" in outcome.out
    result = read_result(pair_files / "R")
    assert (result.target.finest_level, result.functional_map.shape) == (1, (20, 20))
    assert (result.barycentric >= -1e-12).all()
    np.testing.assert_allclose(result.barycentric.sum(1), 1.0, atol=1e-12)
    manifest = result.manifest
    assert manifest["parameters"]["target_k"] == manifest["parameters"]["source_k"] == 20
    assert manifest["inputs"]["target"]["sha256"] == file_hash(pair_files / "deer.obj")
    assert manifest["timings"]["first alignment"] > 0
    assert manifest["peak_memory_bytes"] > 2**20
    assert manifest["notes"] == []


@pytest.mark.slow
def test_a_wrong_landmark_is_left_out_with_a_warning_unless_trusted(run, pair_files, built_in_pair, quick_fit):
    pair = built_in_pair
    names = pair.landmarks.names
    source = pair.landmarks.source.copy()
    wrong = names.index("hoof_hind_L")
    away = np.linalg.norm(pair.source.positions - pair.source.positions[source[wrong]], axis=1)
    away[source] = 0.0
    source[wrong] = np.argmax(away)
    write_landmarks(pair_files / "landmarks.json", replace(pair.landmarks, source=source))
    outcome = run.done("match", *MATCH, *COARSE, "-o", "R")
    said = " ".join(outcome.err.split())
    assert "landmark 'hoof_hind_L' looks wrong and was left out" in said
    assert "--trust-landmarks" in said
    met = re.search(r"(\d+) landmarks missed by 0.00 % .*; 1 left out, which the map misses by (\d+) %", outcome.out)
    assert int(met[1]) == len(names) - 1
    assert int(met[2]) > 5  # across the body
    result = read_result(pair_files / "R")
    assert [suspect["name"] for suspect in result.manifest["landmark_check"]["suspects"]] == ["hoof_hind_L"]
    assert result.landmark_errors[wrong] > 0.3
    assert np.delete(result.landmark_errors, wrong).max() < 1e-9
    outcome = run("match", *MATCH, *COARSE, "-o", "R", "--trust-landmarks")
    assert "looks wrong" not in outcome.err
    assert read_result(pair_files / "R").landmark_errors.max() < 1e-9


def test_exchanged_meshes_are_refused_and_other_names_noted(run: Run, pair_files: Path) -> None:
    run.refused(
        "match --target pony.obj --source deer.obj", *MATCH[4:], "--level", 1, "-o", "R", says="other way round"
    )
    assert not (pair_files / "R").exists()
    (pair_files / "deer.obj").rename(pair_files / "stag.obj")
    request = MatchRequest(*(pair_files / name for name in ("stag.obj", "pony.obj", "R", "landmarks.json")))
    (note,) = read_inputs(request).notes
    assert "stag.obj" in note


def test_command_line_and_library_have_the_same_defaults() -> None:
    asked = MatchRequest(*[Path("x")] * 4)
    assert basis_config(asked) == MAP_BASIS
    assert match_config(asked) == MatchConfig()
    for prepare in (prepare_surface, prepare_surfaces, load_or_prepare):
        assert inspect.signature(prepare).parameters["config"].default == MAP_BASIS


def test_options_reach_the_library() -> None:
    paths = [Path("x")] * 4
    asked = MatchRequest(*paths, k=77, accuracy=1e-7, symmetry=False)
    assert basis_config(asked) == replace(MAP_BASIS, count=77, accuracy=1e-7)
    assert not match_config(asked).use_symmetry
    assert match_config(asked).check_landmarks
    assert not match_config(MatchRequest(*paths, trust_landmarks=True)).check_landmarks
    assert basis_config(MatchRequest(*paths, schedule="100,50,50")).schedule == (100, 50, 50)


def test_a_broken_mesh_is_refused_before_any_work(run: Run, pair_files: Path) -> None:
    lines = (pair_files / "deer.obj").read_text().splitlines()
    faces = [number for number, line in enumerate(lines) if line.startswith("f ")]
    lines[faces[3]] = "f " + " ".join(reversed(lines[faces[3]].split()[1:]))
    (pair_files / "deer.obj").write_text("\n".join(lines) + "\n")
    refused = run.refused("match", *MATCH, "--level", 1, "-o", "R", says="inconsistent orientation")
    assert "3" in refused.err
