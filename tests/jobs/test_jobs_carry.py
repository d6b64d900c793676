"""Landmarks of one model on all others: carried along maps, corrected by a person, used from then on."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.errors import FormatError, InvalidLandmarksError
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import read_manifest
from cagemap.jobs.carry import add_carry_tasks, carry_landmarks, carry_notes
from cagemap.jobs.detours import add_detours
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import Plan, plan_job
from cagemap.jobs.tree import spanning_tree
from cagemap.maps.pair import cage_points_of, locate
from cagemap.mesh.cage_points import NamedPoints
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.spectral.surface import prepare_surface
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.tasks.requests.catalogue import COMMANDS

from example_once import example_pair
from example_result import identity_result, textured_cube
from job_text import job_text
from plain_meshes import renumbered
from refusals import refuses

BOTH = {"source": ["a", "b"], "target": ["a", "b"]}
CARRY = '[carry]\nsource = "a"\nfolder = "marks"\n'
ASSETS = {"a": {"landmarks": "a.json"}, "b": {}, "c": {}}
JOB = job_text("vertices = 500", ASSETS, [BOTH, {"source": "b", "target": "c"}]) + CARRY


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in "abc":
        write_mesh(tmp_path / f"{name}.obj", creature())
    (tmp_path / "a.json").write_text(json.dumps({"points": [{"name": "nose", "vertex": 3}]}))
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path


def planned(folder: Path) -> Plan:
    job = read_job(folder / "job.toml", COMMANDS)
    return add_carry_tasks(plan_job(job, "1", spanning_tree), job, "1")


def test_every_other_model_gets_a_file_along_the_shortest_way(folder: Path) -> None:
    tasks = {task.request["asset"]: task for task in planned(folder).tasks if task.kind == "carry"}
    assert sorted(tasks) == ["b", "c"]
    night = folder / "night"
    # A map goes from target to source: a's landmarks go to b by the map of target a and source b.
    assert tasks["b"].request["steps"] == [[str(night / "b__a" / "RESULT"), True]]
    assert tasks["b"].request["back"] == str(night / "a__b" / "RESULT")
    assert tasks["c"].request["steps"] == [
        [str(night / "b__a" / "RESULT"), True],
        [str(night / "b__c" / "RESULT"), False],
    ]
    assert tasks["c"].outputs == ("../marks/c.json",)
    assert set(tasks["c"].needs) == {"match b -> a", "match b -> c"}


def test_a_way_round_is_taken_where_a_map_is_doubtful(folder: Path) -> None:
    plan = planned(folder)
    pairs = {("a", "b"): ("a", "c", "b")}
    matches = [replace(t, pair=("b", "c"), name="match b c") for t in plan.tasks if t.pair == ("b", "a")][:1]
    extra = [replace(t, pair=("c", "a"), name="match c a") for t in matches]
    around = add_detours(replace(plan, tasks=(*matches, *extra, *plan.tasks)), pairs, "1")
    before, after = ({t.request["asset"]: t for t in p.tasks if t.kind == "carry"} for p in (plan, around))
    assert after["b"].request["steps"][0][0].endswith("RESULT-composed")
    assert any(name.startswith("compose b -> a") for name in after["b"].needs)
    assert after["b"].key != before["b"].key


def test_a_file_that_somebody_edited_counts_as_landmarks_and_is_left_alone(folder: Path) -> None:
    names = {task.name: task for task in planned(folder).tasks}
    (folder / "marks").mkdir()
    carried = folder / "marks" / "b.json"
    none = np.full((1, 3), np.nan)
    write_points(carried, NamedPoints(("nose",), np.array([5]), none, "b.obj"), creature())
    assert {task.name: task.key for task in planned(folder).tasks} == {n: t.key for n, t in names.items()}
    carried.write_text(carried.read_text().replace("5}", "6}"))
    after = {task.name: task for task in planned(folder).tasks}
    assert "carry landmarks to b" not in after
    assert after["match a -> b"].request["target_points"] == str(carried)
    assert after["match b -> a"].request["source_points"] == str(carried)
    assert after["match a -> b"].key != names["match a -> b"].key
    assert after["match b -> c"].key == names["match b -> c"].key  # c has none


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('landmarks = "a.json"\n', "", r"carry\.source: 'a' has no landmarks"),
        (CARRY, CARRY.replace('"a"', '"x"'), "no asset is called 'x'"),
    ],
)
def test_mistakes_are_named(folder: Path, old: str, new: str, words: str) -> None:
    (folder / "job.toml").write_text(JOB.replace(old, new))
    refuses(FormatError, words, planned, folder)


def carry(folder: Path, given: dict[str, Any], forward: bool = True, back: str | None = None, **more: str) -> Any:
    """Carry landmarks along the map of ``folder / "RESULT"`` to ``folder / "carried.json"``."""
    (folder / "given.json").write_text(json.dumps(given))
    files = {"landmarks": str(folder / "given.json"), "output": str(folder / "carried.json")}
    return carry_landmarks({"steps": [[str(folder / "RESULT"), forward]], "back": back, **files, **more})


@pytest.mark.parametrize("forward", [True, False])
def test_points_and_curves_arrive_where_the_map_says(forward: bool, tmp_path: Path) -> None:
    """Target and source are the same cube, the target twice as large; every vertex maps to itself."""
    result = identity_result()
    write_result(tmp_path / "RESULT", result)
    start, end = (result.target, result.source) if forward else (result.source, result.target)
    ratio = end.control.positions[0, 0] / start.control.positions[0, 0]
    middle = start.control.positions[start.control.face_indices[:4]].mean(axis=0)
    entries = [{"name": "corner", "vertex": 5}, {"name": "middle", "position": middle.tolist()}]
    edge = start.control.face_indices[:3].tolist()
    figures = carry(tmp_path, {"points": entries, "curves": [{"name": "rim", "vertices": edge}]}, forward)
    assert (figures["points"], figures["curves"], figures["look_at"]) == (2, 1, [])
    found = read_points(tmp_path / "carried.json")
    assert found.names == ("corner", "middle")
    assert found.vertices.tolist() == [5, -1]
    np.testing.assert_allclose(found.positions[1], ratio * middle, atol=1e-3)
    np.testing.assert_allclose(found.curves[0].positions, end.control.positions[edge], atol=1e-3)
    assert "2 landmarks carried" in carry_notes([figures])[0]


@pytest.mark.parametrize("forward", [True, False])
def test_landmarks_of_parts_have_the_numbers_of_their_files(forward: bool, tmp_path: Path) -> None:
    """Each file has another piece before the cube; its vertices come first, and a landmark there is left out."""
    cubes = textured_cube("large.obj", 2.0), textured_cube("small.obj")
    piece = creature()
    wholes = [replace(join_meshes([piece, one]), name=one.name) for one in cubes]
    faces = np.arange(piece.n_faces, wholes[0].n_faces)
    parts = [extract_faces(whole, faces) for whole in wholes]
    write_result(tmp_path / "RESULT", identity_result(controls=(parts[0], parts[1])))
    start, end = wholes if forward else wholes[::-1]
    write_mesh(tmp_path / "start.obj", start)
    corner = piece.n_vertices + 5
    entries = [{"name": "elsewhere", "vertex": 2}, {"name": "corner", "vertex": corner}]
    rim = (piece.n_vertices + parts[0].face_indices[:3]).tolist()
    curves = [{"name": "other", "vertices": piece.face_indices[:2].tolist()}, {"name": "rim", "vertices": rim}]
    file = str(tmp_path / "start.obj")
    figures = carry(tmp_path, {"points": entries, "curves": curves}, forward, file=file)
    assert (figures["points"], figures["curves"]) == (1, 1)
    found = read_points(tmp_path / "carried.json")
    assert (found.names, found.vertices.tolist()) == (("corner",), [corner])
    np.testing.assert_allclose(found.curves[0].positions, end.positions[rim], atol=1e-3)
    with pytest.raises(InvalidLandmarksError, match=r"given\.json: expected landmarks on .*, found none there"):
        carry(tmp_path, {"points": entries[:1]}, forward, file=file)


def test_points_where_both_directions_disagree_are_to_be_looked_at(tmp_path: Path) -> None:
    result = identity_result()
    write_result(tmp_path / "RESULT", result)
    count = len(result.point_map.images)
    images = result.point_map.images.at(np.roll(np.arange(count), 40))
    write_result(tmp_path / "back", replace(result, point_map=replace(result.point_map, images=images)))
    given = {"points": [{"name": "corner", "vertex": 5}]}
    assert carry(tmp_path, given, back=str(tmp_path / "back"))["look_at"] == ["corner"]


def test_a_point_of_the_surface_has_a_point_of_the_cage_that_lies_there() -> None:
    """`cage_points_of` undoes `locate`, up to what creases of the cage leave without a counterpart."""
    surface = prepare_surface(creature(), 2)
    finest = surface.triangles(surface.finest_level)
    random = np.random.default_rng(8)
    chosen = random.integers(len(finest.triangles), size=200)
    weights = random.dirichlet(np.ones(3), size=200)
    points = SurfacePoints(finest, chosen, weights)
    missed = np.linalg.norm(
        locate(surface.finest_triangles, cage_points_of(surface, points)).positions - points.positions, axis=1
    )
    assert np.median(missed) < 1e-4
    assert np.quantile(missed, 0.95) < 2e-3
    corners = SurfacePoints.from_vertices(finest, np.arange(surface.control.n_vertices))
    assert cage_points_of(surface, corners).vertices.tolist() == list(range(surface.control.n_vertices))


@pytest.mark.slow
@pytest.mark.usefixtures("jobs_in_threads", "small_pages")
def test_a_job_carries_landmarks_and_takes_the_corrected_ones(tmp_path: Path) -> None:
    pair = example_pair(16)
    other, number = renumbered(pair.source, 2)
    write_mesh(tmp_path / "a.obj", pair.source)
    write_mesh(tmp_path / "b.obj", other)
    corrected = number[pair.landmarks.source]
    some = NamedPoints(pair.landmarks.names, pair.landmarks.source, np.full((len(pair.landmarks), 3), np.nan), "a.obj")
    write_points(tmp_path / "a.json", some, pair.source)
    assets = {name: ASSETS[name] for name in "ab"}
    (tmp_path / "job.toml").write_text(job_text("vertices = 1500", assets, [BOTH]) + CARRY)
    runner = CliRunner()
    first = runner.invoke(app, ["run", str(tmp_path / "job.toml"), "--workers", "2"])
    assert first.exit_code == 0, first.output
    assert f"{len(some.names)} landmarks carried" in first.output
    carried = read_points(tmp_path / "marks" / "b.json")
    assert carried.names == some.names
    places = np.where(carried.vertices[:, None] < 0, carried.positions, other.positions[carried.vertices])
    size = np.linalg.norm(np.ptp(other.positions, axis=0))
    assert np.linalg.norm(places - other.positions[corrected], axis=1).max() < 1e-3 * size
    entries = [{"name": n, "vertex": int(v)} for n, v in zip(some.names, corrected, strict=True)]
    (tmp_path / "marks" / "b.json").write_text(json.dumps({"points": entries}))
    again = runner.invoke(app, ["run", str(tmp_path / "job.toml"), "--workers", "2"])
    assert again.exit_code == 0, again.output
    manifest = read_manifest(tmp_path / "night" / "a__b" / "RESULT")
    assert manifest["inputs"]["target_points"]["file"] == "b.json"
    assert len(manifest["landmark_names"]) == len(some.names)
    assert json.loads((tmp_path / "marks" / "b.json").read_text()) == {"points": entries}
