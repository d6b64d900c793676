"""Welding: files split at seams become one surface, and values and landmarks keep their numbering everywhere."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, grid

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.points import symmetry_on
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.values.part_numbering import FileRows
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, find_part, join_meshes, numbers_on_part
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.topology import used_vertices
from cagemap.mesh.weld import coincident_vertices, weld_mesh, weld_tolerance
from cagemap.studio.autosave import FileTracker
from cagemap.studio.finish import FinishOptions, finish_commands
from cagemap.studio.landmark_files import load_landmarks, save_landmarks
from cagemap.studio.models import open_model
from cagemap.studio.opening import default_files
from cagemap.studio.session import Session
from cagemap.tasks.requests.catalogue import all_options

from command_line import Run
from mesh_faults import moebius_strip
from plain_meshes import animal, soup, split_at_seams
from studio_boxes import opened_pair, until


def jittered(mesh: ControlMesh, share: float) -> ControlMesh:
    """Every vertex moved by less than a share of the bounding-box diagonal."""
    moves = np.random.default_rng(0).uniform(-1, 1, mesh.positions.shape)
    size = np.linalg.norm(np.ptp(mesh.positions, axis=0))
    return mesh.with_positions(mesh.positions + share * size / 4 * moves)


def test_a_mesh_split_at_seams_becomes_the_one_before() -> None:
    body = creature()
    corners = np.arange(len(body.face_indices))
    body = body.with_uvs(np.random.default_rng(1).uniform(size=(len(corners), 2)), corners)
    split = split_at_seams(body)
    assert len(check_mesh(split).component_sizes) > 1
    welded = weld_mesh(split)
    require_valid(welded.mesh)
    assert welded.mesh.n_vertices == body.n_vertices
    order = welded.mesh.positions[welded.mesh.face_indices]
    np.testing.assert_array_equal(order, body.positions[body.face_indices])
    np.testing.assert_array_equal(welded.mesh.uvs[welded.mesh.uv_indices], body.uvs)
    np.testing.assert_array_equal(welded.mesh.positions[welded.vertex_of], split.positions)
    assert "became 1 piece" in welded.notes[0]


def test_every_file_vertex_is_named_once() -> None:
    split = split_at_seams(creature())
    welded = weld_mesh(split)
    named = np.concatenate([welded.mesh.file_vertices, welded.mesh.file_copies[:, 1]])
    np.testing.assert_array_equal(np.sort(named), np.arange(split.n_vertices))
    np.testing.assert_array_equal(welded.vertex_of[welded.mesh.file_copies[:, 1]], welded.mesh.file_copies[:, 0])
    number = int(welded.mesh.file_vertices[-1])
    named = welded.mesh.file_vertex(welded.mesh.n_vertices - 1)
    assert number >= welded.mesh.n_vertices
    assert named == split.file_vertex(number) != split.file_vertex(number - 1)


def test_surfaces_that_only_touch_stay_apart() -> None:
    box = cube()
    beside = box.with_positions(box.positions + np.array([2.0, 0, 0]))
    both = join_meshes([box, beside])
    assert len(np.unique(both.positions, axis=0)) == 12
    assert weld_tolerance(both) is None
    welded = weld_mesh(both, 0.0)
    assert welded.mesh is both
    assert "no border vertices at the same place to weld" in welded.notes[0]


@pytest.mark.parametrize(("share", "expected"), [(0.0, 0.0), (5e-7, 1e-6), (5e-6, 1e-5), (1e-3, None)])
def test_the_tolerance_that_makes_one_surface_is_found(share: float, expected: float | None) -> None:
    split = jittered(split_at_seams(creature()), share)
    assert weld_tolerance(split) == expected
    if expected is not None:
        assert len(check_mesh(weld_mesh(split).mesh).component_sizes) == 1


def test_the_tolerance_is_relative_to_the_size_and_inclusive_of_chains() -> None:
    strip = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (0, 1, 0), (-1, 0, 0)], [(0, 1, 2), (3, 4, 5)]
    )
    for scale in (1e-30, 1.0, 1e30):
        moved = strip.with_positions(scale * (strip.positions + 1e-7 * (np.arange(6) > 2)[:, None]))
        assert weld_mesh(moved, 0.0).mesh.n_vertices == 6
        assert weld_mesh(moved, 1e-6).mesh.n_vertices == 4
    fan = np.array([[0, 0, 0], [0.8e-6, 0, 0], [1.6e-6, 0, 0], [1, 0, 0]])
    apart = ControlMesh.from_faces(np.repeat(fan, 3, axis=0) + np.tile(np.eye(3)[[2, 1, 0]] * [[0], [1], [1]], (4, 1)),
                                   np.arange(12).reshape(4, 3))  # fmt: skip
    assert len(np.unique(coincident_vertices(apart, 1e-6)[[0, 3, 6]])) == 1


def test_faces_that_collapse_go_and_creases_stay() -> None:
    thin = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1e-4, 0, 0), (0, 1e-4, 0)],
        [(0, 4, 5), (4, 1, 2, 3, 5)],
    ).with_creases([[1, 2], [0, 4]], [2.0, 1.0])
    welded = weld_mesh(thin, 1e-3)
    assert welded.mesh.face_indices.tolist() == [0, 1, 2, 3]
    assert any("1 faces collapsed" in note for note in welded.notes)
    np.testing.assert_array_equal(welded.mesh.crease_edges, [[1, 2]])
    require_valid(welded.mesh)
    ribbon = [(0.05 * (number // 2), 0.05 * (number % 2), 0) for number in range(60)]
    with pytest.raises(InvalidMeshError, match=r"got none\. Give a smaller"):
        weld_mesh(ControlMesh.from_faces(ribbon, np.arange(58)[:, None] + np.arange(3)), 0.1)


def test_a_crease_on_a_seam_is_one() -> None:
    strip = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (0, 1, 0), (-1, 0, 0)], [(0, 1, 2), (3, 4, 5)]
    ).with_creases([[0, 2], [4, 3]], [1.0, 3.0])
    strip = strip.with_corners([0, 3, 5], [1.0, 2.0, 4.0])
    mesh = weld_mesh(strip).mesh
    np.testing.assert_array_equal(mesh.crease_edges, [[0, 2]])
    np.testing.assert_array_equal(mesh.crease_sharpness, [3.0])
    np.testing.assert_array_equal(mesh.corner_vertices, [0, 3])
    np.testing.assert_array_equal(mesh.corner_sharpness, [2.0, 4.0])


def test_colours_of_welded_vertices_are_averaged_and_said() -> None:
    body = creature()
    split = split_at_seams(replace(body, vertex_colors=np.full((body.n_vertices, 3), 0.5)))
    assert len(weld_mesh(split).notes) == 1
    first = weld_mesh(split).mesh.file_copies[0]
    colors = np.array(split.vertex_colors)
    colors[first[1]] = 1.0
    welded = weld_mesh(replace(split, vertex_colors=colors))
    assert any("colours of 2 joined vertices differ" in note for note in welded.notes)
    np.testing.assert_allclose(welded.mesh.vertex_colors[first[0]], 0.75)


@pytest.mark.parametrize("tolerance", [-1.0, 0.5, np.nan, np.inf])
def test_other_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(ParameterError, match=r"from 0 to 0\.1"):
        weld_mesh(grid(), tolerance)


def _rows() -> tuple[FileRows, ControlMesh]:
    split = split_at_seams(creature())
    return FileRows(weld_mesh(split).mesh, split), split


def test_values_of_the_file_come_and_go_at_welded_vertices(caplog: pytest.LogCaptureFixture) -> None:
    rows, split = _rows()
    np.testing.assert_array_equal(rows.to_file(rows.to_part(split.positions)), split.positions)
    np.testing.assert_array_equal(rows.placed(rows.part.positions), split.positions)
    assert not caplog.text
    own, further = rows.copies[0]
    values = np.zeros(split.n_vertices)
    values[further] = 1.0
    sharing = 1 + np.sum(rows.copies[:, 0] == own)
    assert rows.to_part(values)[own] == 1.0 / sharing
    assert "values differ at 1 vertices that were welded: averaged" in caplog.text
    caplog.clear()
    numbers = np.arange(split.n_vertices)
    np.testing.assert_array_equal(rows.to_part(numbers), rows.vertices)
    assert "those of the first are taken" in caplog.text
    corners = split.positions[split.face_indices]
    np.testing.assert_array_equal(rows.to_file(rows.to_part(corners)), corners)


def test_corners_of_a_mended_mesh_are_those_of_its_vertices() -> None:
    body = replace(creature(), name="mixed")
    faces = [body.face(number)[::-1] if number % 5 == 0 else body.face(number) for number in range(body.n_faces)]
    faces[3:4] = [faces[3][:3], faces[3][[0, 2, 3]]]  # two triangles: all are split
    mixed = ControlMesh.from_faces(body.positions, faces)
    ready = plain_mesh(mixed).mesh
    assert ready.is_triangle_mesh
    taken = FileRows(ready, mixed).to_part(mixed.positions[mixed.face_indices])
    np.testing.assert_array_equal(taken, ready.positions[ready.face_indices])


def test_plain_meshes_give_values_to_the_vertices_that_were_joined() -> None:
    given = soup(animal(1))
    rows = FileRows(plain_mesh(given).mesh, given)
    np.testing.assert_array_equal(rows.to_file(rows.part.positions), given.positions)


def test_parts_of_a_welded_mesh_keep_the_copies() -> None:
    split = split_at_seams(creature())
    far = replace(split, positions=split.positions + np.array([9.0, 0, 0]))
    welded = weld_mesh(join_meshes([split, far])).mesh
    parts = [extract_faces(welded, find_part(welded, f"component:{number}").faces) for number in (1, 0)]
    joined = join_meshes(parts)
    whole = join_meshes([split, far])
    for mesh in (*parts, joined):
        rows = FileRows(mesh, whole)
        found = rows.to_file(mesh.positions, below=whole.positions)
        np.testing.assert_array_equal(found, whole.positions)
    assert len(joined.file_copies) == whole.n_vertices - welded.n_vertices


def test_every_copy_of_a_welded_vertex_has_its_number() -> None:
    mesh = split_at_seams(creature())
    welded = weld_mesh(mesh)
    assert welded.mesh.n_vertices < mesh.n_vertices
    np.testing.assert_array_equal(numbers_on_part(welded.mesh, mesh), welded.vertex_of)
    sheet = grid(8, 8)  # a vertex where two places of the sheet touch becomes two
    touching = replace(sheet, face_indices=np.where(sheet.face_indices == 10, 50, sheet.face_indices))
    plain = plain_mesh(touching)
    assert len(np.unique(plain.mesh.file_vertices)) < plain.mesh.n_vertices
    np.testing.assert_array_equal(numbers_on_part(plain.mesh, touching), plain.vertex_of)


def test_plain_pieces_set_aside_are_said_with_the_tolerance_that_joins_them() -> None:
    near = jittered(split_at_seams(animal(1)), 5e-7)
    (note,) = (note for note in plain_mesh(near).notes if "set aside" in note)
    assert "`weld_mesh(mesh, 1e-06)` joins" in note
    apart = jittered(split_at_seams(animal(1)), 1e-2)
    (note,) = (note for note in plain_mesh(apart).notes if "set aside" in note)
    assert "`find_part` selects another" in note


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("weld")
    body = creature()
    split = replace(split_at_seams(body), name="split.obj")
    write_mesh(place / "split.obj", split)
    write_mesh(place / "whole.obj", body)
    spread = np.linspace(0, body.n_vertices - 1, 9).astype(int)
    # The last of the file's vertices at each place: one that welding drops where there are several.
    distance = np.linalg.norm(split.positions[None] - body.positions[spread][:, None], axis=2)
    picked = split.n_vertices - 1 - distance[:, ::-1].argmin(axis=1)
    names = tuple(f"point {number}" for number in range(9))
    write_landmarks(place / "pairs.json", Landmarks(names, picked, spread, "split", "whole"))
    return place


def test_check_names_the_tolerance_and_takes_it(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    before = run("check split.obj")
    assert before.code == 1
    assert "--weld 0 leaves 1 piece" in before.out
    for word in ("0", "auto"):
        after = run.done("check split.obj --weld", word)
        assert f"vertices              {creature().n_vertices}" in after.out
        assert "became 1 piece" in after.out
    assert json.loads(run("check --json --weld auto split.obj").out)[0]["usable"]
    wrong = run("check split.obj --weld much")
    assert wrong.code in (1, 2)
    assert "expected auto or a distance" in wrong.out + wrong.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "usable", "said"),
    [
        (lambda: soup(animal(1)), True, "vertices joined with others at the same place"),
        (lambda: join_meshes([animal(1), cube()]), True, "1 other piece set aside ("),
        (lambda: replace(animal(1), face_indices=animal(1).face_indices[::-1]), True, "faces turned round"),
        (moebius_strip, False, "Moebius"),
    ],
    ids=["soup", "two pieces", "inside out", "one-sided"],
)
def test_check_takes_the_plain_meshes_that_match_takes(run, tmp_path, build, usable, said):
    write_mesh(tmp_path / "plain.obj", build())
    checked = run("check plain.obj --scheme none")
    assert checked.code == (0 if usable else 1)
    assert said in checked.out
    words = "--target plain.obj --source plain.obj --scheme none -k 10 -o R".split()
    assert (run("match", *words).code == 0) is usable


@pytest.mark.slow
def test_a_welded_match_carries_values_in_the_numbering_of_the_file(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = ["match", "-t", "split.obj", "-s", "whole.obj", "--landmarks", "pairs.json", "--level", 1, "-k", 30]
    run.refused(*words, "-o", "R", says="--weld 0")
    matched = run.done(*words, "--target-weld", "0", "-o", "R")
    assert "became 1 piece" in matched.err
    result = read_result(folder / "R")
    assert result.manifest["parameters"]["target_weld"] == "0"
    assert len(result.landmarks) == 9
    split, body = read_mesh("split.obj"), read_mesh("whole.obj")
    size = np.ptp(body.positions)
    np.save("places.npy", body.positions)
    assert run("transfer R --attribute places.npy -o carried.npy").code == 0
    assert np.abs(np.load("carried.npy") - split.positions).max() < 1e-4 * size
    wrapped = run.done("wrap R -o wrapped.obj")
    assert "stay where they are" not in wrapped.err
    found = read_mesh("wrapped.obj")
    np.testing.assert_array_equal(found.face_indices, split.face_indices)
    assert np.abs(found.positions - split.positions).max() < 0.02 * size
    assert run("report R -o r.html").code == 0


@pytest.mark.slow
def test_a_welded_source_gives_values_numbered_as_its_file(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = ["match", "-t", "whole.obj", "-s", "split.obj", "--landmarks", "pairs.json", "--exchange-landmarks"]
    assert run(*words, "--level", 1, "-k", 30, "--weld", "auto", "-o", "S").code == 0
    split, body = read_mesh("split.obj"), read_mesh("whole.obj")
    side = (split.positions[:, 0] - split.positions[:, 0].min()) / np.ptp(split.positions[:, 0])
    np.savez("skin.npz", hip=side, head=1 - side)
    assert run("transfer S --weights skin.npz -o skin_out.npz").code == 0
    expected = (body.positions[:, 0] - body.positions[:, 0].min()) / np.ptp(body.positions[:, 0])
    assert np.abs(np.load("skin_out.npz")["hip"] - expected).max() < 1e-4


@pytest.mark.slow
def test_a_symmetry_of_the_file_is_one_of_the_welded_mesh(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    split, body = read_mesh("split.obj"), read_mesh("whole.obj")
    places = np.linalg.norm(split.positions[:, None] - body.positions[None], axis=2).argmin(axis=1)
    images = np.roll(np.arange(body.n_vertices), 3)
    images[5] = -1
    first = [int(np.flatnonzero(places == number)[-1]) if number >= 0 else -1 for number in images]
    mesh = weld_mesh(split).mesh
    assert mesh.file_vertices is not None
    found = symmetry_on(np.array(first)[places], mesh)
    own = places[mesh.file_vertices]
    np.testing.assert_array_equal(np.where(found < 0, -1, own[found]), images[own])
    np.testing.assert_array_equal(symmetry_on(found, mesh), found)
    np.save("self.npy", np.arange(split.n_vertices))
    np.save("self_whole.npy", np.arange(body.n_vertices))
    words = ["match", "-t", "split.obj", "-s", "whole.obj", "--landmarks", "pairs.json", "--level", 1]
    asked = ["--method", "paper", "--set", "schedule=30,20", "--weld", "0"]
    asked += ["--set", "target.symmetry=self.npy", "--set", "source.symmetry=self_whole.npy"]
    run.done(*words, *asked, "-o", "Y")


def test_a_map_between_welded_meshes(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    body = read_mesh("whole.obj")
    mesh = weld_mesh(read_mesh("split.obj")).mesh
    images = np.linalg.norm(mesh.positions[:, None] - body.positions[None], axis=2).argmin(axis=1)
    np.save("images.npy", images)
    np.save("mask.npy", np.ones(read_mesh("split.obj").n_vertices))
    words = ["map", "images.npy", "-t", "split.obj", "-s", "whole.obj", "--level", 1, "--target-mask", "mask.npy"]
    assert "--weld 0" in run(*words, "-o", "M").err
    run.done(*words, "--weld", "auto", "-o", "M")
    np.save("places.npy", body.positions)
    assert run("transfer M --attribute places.npy -o by_map.npy").code == 0
    found, expected = np.load("by_map.npy"), read_mesh("split.obj").positions
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.ptp(expected))


def test_refine_and_functions_weld(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    split = run.done("refine split.obj --level 1 -o fine_split.obj")
    assert "--weld 0" in split.out
    assert run("refine split.obj --level 1 --weld auto -o fine.obj").code == 0
    assert run("refine whole.obj --level 1 -o fine_whole.obj").code == 0
    places = [np.sort(read_mesh(name).positions.round(9), axis=0) for name in ("fine.obj", "fine_whole.obj")]
    np.testing.assert_allclose(*places, atol=1e-9)
    words = ["functions", "split.obj", "-k", 5, "--level", 1, "-o", "f.npz"]
    assert run(*words).code == 2
    assert run(*words, "--weld", "0").code == 0
    assert len(np.load("f.npz")["eigenfunctions"]) == len(read_mesh("fine.obj").positions)


def test_a_welded_mesh_with_holes_is_refined(run: Run, tmp_path: Path) -> None:
    split = split_at_seams(creature())
    write_mesh(tmp_path / "holes.obj", replace(split, hole_faces=np.array([split.n_faces - 1])))
    assert run("refine holes.obj --level 1 --weld auto -o fine.obj").code == 0
    fine = read_mesh(tmp_path / "fine.obj")
    assert fine.n_faces == 4 * (split.n_faces - 1)
    assert used_vertices(fine).all()
    assert run("refine holes.obj --level 0 -o cage.obj").code == 0  # the cage as it is
    assert read_mesh(tmp_path / "cage.obj").hole_faces is not None


def test_the_studio_opens_the_welded_whole(folder: Path) -> None:
    model = open_model(folder / "split.obj", None, None, 300)
    split = read_mesh(folder / "split.obj")
    assert model.weld == "0"
    assert model.control.n_faces == split.n_faces
    assert model.part_choices.opened is None
    assert any("became 1 piece" in note for note in model.notes)
    assert model.look.other_parts is None
    own = model.shape.to_control_vertices(np.arange(split.n_vertices))
    np.testing.assert_array_equal(model.control.positions[own], split.positions)
    numbers = model.shape.to_file_vertices(np.arange(model.control.n_vertices))
    np.testing.assert_array_equal(split.positions[numbers], model.control.positions)
    assert open_model(folder / "whole.obj", None, None, 300).weld is None


@pytest.mark.slow
def test_the_finish_of_the_studio_welds_as_it_opened(folder: Path, boxes: Path, session: Session) -> None:
    for name in ("split.obj", "whole.obj"):
        shutil.copy(folder / name, boxes)
    session.open(default_files(boxes / "split.obj", boxes / "whole.obj", None))
    until(lambda: session.state.files is not None and session.state.files.welds == ("0", None), session)
    assert session.state.files is not None
    request = finish_commands(all_options(), session.state.files, FinishOptions(), use_landmarks=False)[0].request
    assert (request.target_weld, request.source_weld) == ("0", None)


@pytest.mark.slow
def test_studio_landmarks_on_a_welded_mesh_have_the_numbers_of_the_file(folder: Path, tmp_path: Path) -> None:
    opening, _, opened = opened_pair(folder / "split.obj", folder / "whole.obj")
    files = replace(default_files(opening.target, opening.source, None), landmarks=folder / "pairs.json")
    found, notes = load_landmarks(files.landmarks, None, opened.scene, files, FileTracker())
    assert len(found.items) == 9, notes
    for item in found.items:
        np.testing.assert_allclose(item.target.position, item.source.position, atol=1e-9)
    files = replace(files, landmarks=tmp_path / "saved.json")
    save_landmarks(files.landmarks, found, opened.scene, files, FileTracker())
    saved, _ = read_landmarks(files.landmarks, "split", "whole")
    split, body = read_mesh(folder / "split.obj"), read_mesh(folder / "whole.obj")
    np.testing.assert_array_equal(split.positions[saved.target], body.positions[saved.source])
