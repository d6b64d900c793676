"""Files of several parts in the studio: which one is open, its numbers, and what becomes of landmarks on the others."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, triangulated
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.files.usd.write import write_usd
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import CurvePair
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, join_meshes, list_parts, numbers_on_part
from cagemap.studio.autosave import FileTracker, autosave_path, read_autosave, read_autosave_parts, write_autosave
from cagemap.studio.compute import OpenModels, PairFiles, run_task
from cagemap.studio.downloads import textured_model
from cagemap.studio.file_parts import in_one_piece, select_part
from cagemap.studio.finish import FinishOptions, finish_commands
from cagemap.studio.landmark_files import (
    autosaved_landmarks,
    load_landmarks,
    save_landmarks,
    to_file_numbers,
    to_part_numbers,
)
from cagemap.studio.landmarks import Landmark, LandmarkList, add_place, keep_unused_landmarks
from cagemap.studio.models import open_model
from cagemap.studio.opening import command_line_files, default_files, result_folder, with_parts
from cagemap.studio.places import vertex_place
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.skins import source_skin
from cagemap.studio.state import Output, StudioState
from cagemap.studio.worker import Failure
from cagemap.subdivision import refine
from cagemap.tasks.requests.catalogue import all_options

from example_result import identity_result
from refusals import refuses
from studio_boxes import Idle, session_of, unwrapped_cube
from usd_scenes import stage_at


def named(mesh: ControlMesh, name: str) -> ControlMesh:
    return replace(mesh, face_objects=np.zeros(mesh.n_faces, dtype=np.int64), object_names=(name,))


def figure() -> ControlMesh:
    """An eye, a body and a hat, in this order, each an object."""
    eye, body, hat = cube(), creature(), cube()
    eye, hat = eye.with_positions(0.1 * eye.positions), hat.with_positions(hat.positions + np.array([0.0, 5.0, 0.0]))
    return join_meshes([named(eye, "eye"), named(body, "body"), named(hat, "hat")])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, figure())
    return tmp_path


@cache
def opened(part: str) -> Scene:
    """The figure beside itself, with this part of both open."""
    with TemporaryDirectory() as name:
        files = [Path(name) / file for file in ("a.obj", "b.obj")]
        for file in files:
            write_mesh(file, figure())
        opening = PairFiles(*files, None, 300, Path(name), parts=(part, part))
        _, answer = run_task(None, OpenModels(opening), lambda _: None)
    return answer.scene


def test_the_largest_part_is_open_and_the_others_are_offered(folder: Path) -> None:
    model = open_model(folder / "a.obj", None, None, 300)
    assert model.part_choices.opened == "object:body"
    assert model.part_choices.titles == ("object:body", "object:eye", "object:hat")
    assert len(model.part_choices.faces) == 3
    assert not model.part_choices.whole
    assert any("only object:body is matched" in note for note in model.notes)
    assert model.control.n_faces == creature().n_faces
    eye = open_model(folder / "a.obj", None, None, 300, "eye")
    assert (eye.part_choices.opened, eye.control.n_faces) == ("object:eye", 6)
    assert eye.notes == ()
    # Its numbers are those of the file.
    np.testing.assert_allclose(
        eye.shape.file_mesh.positions[eye.shape.to_file_vertices(np.arange(8))], 0.1 * cube().positions
    )
    assert eye.shape.to_control_vertices(np.array([7, 8])).tolist() == [7, -1]
    refuses(ParameterError, "named 'nose'", open_model, folder / "a.obj", None, None, 300, "nose")


def test_what_is_left_alone_is_drawn_apart(folder: Path) -> None:
    model = open_model(folder / "a.obj", None, None, 300)
    rest = model.look.other_parts
    # The hat lies five above, the eye inside.
    assert rest.positions[:, 1].max() > 5
    assert (model.level, len(rest.triangles)) == (1, 2 * 2 * 4 * 6)  # subdivided as often as the open part
    assert b'"other_parts"' in source_skin(model)
    write_mesh(folder / "one.obj", creature())
    alone = open_model(folder / "one.obj", None, None, 300)
    assert alone.look.other_parts is None
    assert (alone.part_choices.titles, alone.part_choices.opened) == ((), None)


def test_the_whole_is_offered_where_it_can_be_opened() -> None:
    body = creature()
    front = (body.positions[body.face_indices].reshape(-1, 4, 3).mean(1)[:, 2] > 0).astype(np.int64)
    groups = replace(body, face_groups=front, group_names=("back", "front"))
    offer = select_part(groups, None, plain=False).part_choices
    assert offer.whole
    assert {"group:back", "group:front"} & set(offer.titles)
    materials = replace(body, face_materials=front, material_names=("back", "front"), object_schemes=("catmull-clark",))
    offer = select_part(materials, None, plain=False).part_choices
    assert offer.titles
    assert offer.whole if offer.opened is None else offer.opened in offer.titles


@settings(max_examples=20)
@given(st.lists(st.integers(0, 3), min_size=18, max_size=18))
def test_a_part_is_in_one_piece_where_its_mesh_is(numbers: list[int]) -> None:
    mesh = join_meshes([cube(), cube(), cube()])
    mesh = replace(mesh, face_materials=np.array(numbers), material_names=("a", "b", "c", "d"))
    parts = [part for part in list_parts(mesh) if part.kind == "material"]
    one = [
        part for part in parts if len(list_parts(replace(extract_faces(mesh, part.faces), face_materials=None))) == 1
    ]
    assert [part.name for part in in_one_piece(mesh, parts)] == [part.name for part in one]
    for part in parts:
        taken = extract_faces(mesh, part.faces)
        number = numbers_on_part(taken, mesh)
        on = np.flatnonzero(number >= 0)
        np.testing.assert_array_equal(taken.positions[number[on]], mesh.positions[on])
        assert len(on) == taken.n_vertices


def list_of(scene: Scene, *vertices: int) -> LandmarkList:
    """Landmarks at control vertices of the open parts."""
    ends = ((vertex_place(scene.target, v), vertex_place(scene.source, v)) for v in vertices)
    return LandmarkList(
        tuple(Landmark(k, f"mark {v}", *end) for k, (v, end) in enumerate(zip(vertices, ends, strict=True), 1))
    )


def test_landmarks_of_one_part_leave_those_of_the_others_in_the_file(folder: Path) -> None:
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    eyes, body = opened("eye"), opened("body")
    tracker = FileTracker()
    save_landmarks(files.landmarks, list_of(eyes, 2, 5), eyes, files, tracker)
    found, notes = load_landmarks(files.landmarks, None, body, files, tracker)
    assert found.items == ()
    assert any("other parts" in note for note in notes)
    both = replace(list_of(body, 10, 20), unused_landmarks=found.unused_landmarks)
    save_landmarks(files.landmarks, both, body, files, tracker)
    written, _ = read_landmarks(files.landmarks, "a.obj", "b.obj")
    assert sorted(written.target.tolist()) == [2, 5, 18, 28]
    assert [item.name for item in load_landmarks(files.landmarks, None, eyes, files, tracker)[0].items] == [
        "mark 2",
        "mark 5",
    ]
    assert not list(folder.glob("*before-studio*"))


def test_no_name_is_given_that_a_landmark_elsewhere_has() -> None:
    scene = opened("eye")
    others = Landmarks(("landmark 1",), np.array([20]), np.array([20]), "a.obj", "b.obj")
    placed = add_place(LandmarkList(unused_landmarks=others), "target", vertex_place(scene.target, 0))
    assert placed.items[0].name == "landmark 1 (2)"


def test_what_was_not_saved_opens_its_part_and_waits_on_the_others(folder: Path) -> None:
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    kept = autosave_path(files.landmarks)
    eyes, body = opened("eye"), opened("body")
    half = list_of(eyes, 3)
    half = replace(half, items=(*half.items, Landmark(9, "half", vertex_place(eyes.target, 1))))
    write_autosave(kept, to_file_numbers(half, eyes), ("object:eye", "object:eye"))
    assert read_autosave_parts(kept) == ("object:eye", "object:eye")
    assert autosaved_landmarks(files, eyes, FileTracker())[0] == half
    elsewhere, notes = autosaved_landmarks(files, body, FileTracker())
    assert elsewhere.items == ()
    assert any("half" in note for note in notes)
    # Kept on with what is done on the body, and there when the eye is opened again.
    more = replace(list_of(body, 30), unused_landmarks=elsewhere.unused_landmarks)
    write_autosave(kept, to_file_numbers(more, body), ("object:body", "object:body"))
    again, _ = autosaved_landmarks(files, eyes, FileTracker())
    assert [(item.name, item.target.corners) for item in again.items] == [("mark 3", half.items[0].target.corners)]
    np.testing.assert_allclose(again.items[0].target.position, half.items[0].target.position, atol=1e-9)
    assert [item.name for item in autosaved_landmarks(files, body, FileTracker())[0].items] == ["mark 30"]
    kept.write_text("{")
    assert read_autosave_parts(kept) == (None, None)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(st.integers(0, 7 + creature().n_vertices + 8), unique=True, max_size=12), st.data())
def test_no_landmark_of_a_file_is_lost_by_opening_a_part(vertices: list[int], data: st.DataObject) -> None:
    whole = figure()
    vertices = [v for v in vertices if v < whole.n_vertices]
    scene, other = (opened(data.draw(st.sampled_from(["body", "eye", "hat"]))) for _ in range(2))
    points = CagePoints.of_vertices(np.array(vertices, dtype=np.int64))
    given = Landmarks.of_points(tuple(map(str, vertices)), points, points, "a.obj", "b.obj")
    kept = LandmarkList(unused_landmarks=given)
    for here in (scene, other, scene):
        found, _ = to_part_numbers(kept, here)
        kept = to_file_numbers(found, here)
        left = () if kept.unused_landmarks is None else kept.unused_landmarks.names
        assert sorted([item.name for item in found.items] + list(left)) == sorted(given.names)
    assert all(int(item.name) in item.target.corners for item in kept.items)


def test_the_finish_matches_the_open_parts_into_a_folder_of_their_own(folder: Path) -> None:
    files = command_line_files(folder / "a.obj", folder / "b.obj", None, None, None, parts=("eye", None))
    request = finish_commands(all_options(), files, FinishOptions(), use_landmarks=False)[0].request
    assert (request.target_part, request.source_part) == ("eye", None)
    results = {
        result_folder(files, parts).name for parts in ((None, None), ("object:eye", None), ("object:hat", "group:x/y"))
    }
    assert results == {"b__a_RESULT", "b__a_eye_RESULT", "b_group_x_y__a_hat_RESULT"}


def test_no_two_parts_share_a_file(folder: Path) -> None:
    files = default_files(folder / "a.obj", folder / "b.obj", folder / "skin.png")
    titles = (None, "object:eye", "object:/char/left/eye", "object:/char/right/eye", "material:eye", "object:::")
    titles += ("object:" + "long" * 20 + "_L", "object:" + "long" * 20 + "_R")
    pairs = [(target, source) for target in titles for source in titles]
    for name in ("", "hero"):
        asked = FinishOptions(
            name=name, wrap=True, map_form=".npy", option_values={("transfer", "material_colors"): True}
        )
        written = [
            command.output
            for pair in pairs
            for command in finish_commands(all_options(), with_parts(files, pair), asked, use_landmarks=False)
        ]
        assert len(set(written)) == len(written)
    # A RESULT that was named by a person keeps its name; the pair's own gets the parts' names.
    assert with_parts(files, ("eye", None)).result.name == "b__a_eye_RESULT"
    mine = replace(files, result=folder / "mine")
    assert with_parts(mine, ("eye", None)).result == mine.result


def idle_session(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session whose computations never give an answer."""
    monkeypatch.setattr("cagemap.studio.preview.Worker", Idle)
    return session_of(folder)


def test_the_whole_file_can_be_chosen_while_a_part_has_unsaved_landmarks(folder, monkeypatch):
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    session = idle_session(folder, monkeypatch)
    session.open(replace(files, parts=("object:eye", "object:eye")))
    session._scene = opened("eye")
    session._edit(lambda present: add_place(present, "target", vertex_place(session._scene.target, 0)))
    assert read_autosave_parts(autosave_path(files.landmarks)) == ("object:eye", "object:eye")
    session.choose_part("target", None)
    assert session._preview.pair_files.parts[0] is None
    session.open(files)  # not named, they are those of the autosave
    assert session._preview.pair_files.parts == ("object:eye", "object:eye")
    session.close()


def test_an_autosave_of_a_part_that_is_gone_keeps_nobody_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    write_autosave(autosave_path(files.landmarks), LandmarkList(), ("object:nose", None))
    session = idle_session(folder, monkeypatch)
    session.open(files)
    models = session._preview.pair_files
    assert models.parts == ("object:nose", None)
    session._receive(OpenModels(models), Failure("ParameterError", "no nose", ("no image",)))
    assert [message.text for message in session.state.messages[-2:]] == ["no image", "no nose"]
    assert session._preview.pair_files.parts == (None, None)
    again = session._preview.pair_files
    session._receive(OpenModels(again), Failure("ParameterError", "no file"))
    assert session._preview.pair_files is again
    session.close()


def test_loaded_landmarks_leave_those_of_other_parts(folder: Path) -> None:
    scene = opened("body")
    away = Landmarks(("mark 10", "hat"), np.array([2, 5]), np.array([2, 5]), "a.obj", "b.obj")
    before = LandmarkList(unused_landmarks=away)
    loaded = keep_unused_landmarks(list_of(scene, 10), before)
    assert loaded.unused_landmarks.names == ("mark 10 (2)", "hat")
    np.testing.assert_array_equal(loaded.unused_landmarks.target, [2, 5])
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    save_landmarks(files.landmarks, loaded, scene, files, FileTracker())
    assert len(read_landmarks(files.landmarks, "a.obj", "b.obj")[0]) == 3
    # A file that has some there replaces them.
    said = replace(list_of(scene, 10), unused_landmarks=away.without([0]))
    assert keep_unused_landmarks(said, before).unused_landmarks.names == ("hat",)
    assert keep_unused_landmarks(list_of(scene, 10), LandmarkList()).unused_landmarks is None


def test_curves_alone_on_other_parts_are_kept_by_the_autosave(folder: Path) -> None:
    corners = creature().face_indices[:4] + 8
    away = replace(Landmarks.none(), curves=(CurvePair.of_vertices("rim", corners, corners, closed=True),))
    kept = autosave_path(folder / "a.json")
    write_autosave(kept, LandmarkList(unused_landmarks=away))
    n = figure().n_vertices
    assert read_autosave(kept, (n, n)).curves[0].name == "rim"


def test_a_result_opens_the_parts_that_it_is_of(folder: Path) -> None:
    result = folder / "RESULT"
    inputs = stated_inputs({"target": folder / "a.obj", "source": folder / "b.obj"}, result)
    for word, opens in (("object:eye", "object:eye"), ("each", None)):
        parameters = {"target_part": word, "source_part": None}
        write_result(result, replace(identity_result(1), provenance={"inputs": inputs, "parameters": parameters}))
        files = command_line_files(None, None, None, None, result)
        assert files.parts == (opens, None)


def dense(count: int) -> ControlMesh:
    mesh = triangulated(creature())
    while mesh.n_faces < count:
        fine = refine(mesh, 1).finest
        mesh = ControlMesh.from_faces(fine.positions, fine.faces.tolist())
    return mesh


def test_a_scan_is_offered_to_be_taken_as_it_is_and_is_where_it_is_no_cage(tmp_path, monkeypatch):
    monkeypatch.setattr("cagemap.studio.models.MIN_SCAN_FACES", 1000)
    mesh = dense(1000)
    write_mesh(tmp_path / "scan.obj", mesh)
    offered = open_model(tmp_path / "scan.obj", None, None, 300)
    assert (offered.dense, offered.scheme) == (True, None)
    stated = open_model(tmp_path / "scan.obj", "none", None, 300)
    assert (stated.dense, stated.scheme, len(stated.shape.positions)) == (False, "none", mesh.n_vertices)
    # A third face at an edge: no cage.
    faces = np.concatenate([mesh.face_indices.reshape(-1, 3), [[*mesh.face_indices[:2], mesh.n_vertices - 1]]])
    write_mesh(tmp_path / "torn.obj", ControlMesh.from_faces(mesh.positions, faces.tolist()))
    torn = open_model(tmp_path / "torn.obj", None, None, 300)
    assert (torn.dense, torn.scheme) == (False, "none")
    assert "is no valid cage" in torn.notes[0]
    # A small mesh of triangles too: models of games have such faults. What is wrong with it is said.
    small = icosahedron()
    write_mesh(tmp_path / "small.obj", small)
    assert not open_model(tmp_path / "small.obj", None, None, 300).dense
    faces = np.concatenate([small.face_indices.reshape(-1, 3), [[*small.face_indices[:2], 9]]])
    write_mesh(tmp_path / "small.obj", ControlMesh.from_faces(small.positions, faces.tolist()))
    repaired = open_model(tmp_path / "small.obj", None, None, 300)
    assert (repaired.dense, repaired.scheme) == (False, "none")
    assert "is no valid cage, so it is not subdivided" in repaired.notes[0]
    assert "non-manifold edges" in repaired.notes[0]
    assert "Or use" not in repaired.notes[0]
    # Welded at seams as well.
    positions = small.positions[faces.ravel()]
    split = ControlMesh.from_faces(positions, np.arange(len(positions)).reshape(-1, 3).tolist())
    write_mesh(tmp_path / "split.obj", split)
    welded = open_model(tmp_path / "split.obj", None, None, 300)
    assert welded.scheme == "none"
    assert welded.control.n_vertices < len(positions)
    with pytest.raises(InvalidMeshError):  # as asked: a cage
        open_model(tmp_path / "small.obj", "loop", None, 300)


def test_a_download_has_the_image_in_the_uv_set_of_the_open_part(tmp_path: Path) -> None:
    """Another mesh of the file comes first, with a set of another name."""
    sdf = pytest.importorskip("pxr.Sdf", reason="usd-core is not installed")
    with stage_at(tmp_path / "a.usda", ("Y", 1.0)) as stage:
        for number, name in enumerate(("st", "map1")):
            box = unwrapped_cube()
            write_usd(tmp_path / f"{name}.usda", replace(box, positions=box.positions + 9.0 * number, uv_name=name))
            layer = sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usda"))
            sdf.CopySpec(layer, "/Asset/mesh", stage.GetRootLayer(), f"/{name}_mesh")
    opening = PairFiles(tmp_path / "a.usda", tmp_path / "a.usda", None, 300, tmp_path, parts=("map1_mesh",) * 2)
    _, answer = run_task(None, OpenModels(opening), lambda _: None)
    write_image(tmp_path / "t.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    files = default_files(tmp_path / "a.usda", tmp_path / "a.usda", None)
    state = StudioState(files=files, outputs=(Output(tmp_path / "t.png", "texture"),))
    (tmp_path / "out.glb").write_bytes(textured_model(state, answer.scene))
    found = read_mesh(tmp_path / "out.glb")
    is_open = found.positions[found.face_indices][:, 0] > 5.0
    assert is_open.sum() == 24
    assert np.ptp(found.uvs[found.uv_indices[is_open]]) > 0.9


def test_only_the_open_part_has_the_baked_image_in_a_download(folder: Path) -> None:
    import pygltflib

    write_image(folder / "t.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    write_mesh(folder / "a.obj", figure().with_uvs(np.zeros((1, 2)), np.zeros(len(figure().face_indices), dtype=int)))
    files = default_files(folder / "a.obj", folder / "b.obj", None)
    state = StudioState(files=files, outputs=(Output(folder / "t.png", "texture"),))
    document = pygltflib.GLTF2.load_from_bytes(textured_model(state, opened("eye")))
    textured = [material.pbrMetallicRoughness.baseColorTexture is not None for material in document.materials]
    assert sorted(textured) == [False, True]
    corners = [0, 0]
    for primitive in (primitive for mesh in document.meshes for primitive in mesh.primitives):
        corners[textured[primitive.material]] += document.accessors[primitive.indices].count
    assert corners == [(figure().n_faces - 6) * 6, 36]
