"""`cagemap face`: the face shapes that ARKit names, on any head."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.face_kit import FIRST_OF_SOCKETS, FORWARD, KEPT, LEAST, depths, eye_slits, face_arrays
from scipy import sparse

from cagemap import tasks
from cagemap.character.poses import pose_at
from cagemap.character.values import Animation, Character, Part, Rig, ShapeTrack, Track
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.files.face_kit import ABSENT, kit_vertices, read_face_kit
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character
from cagemap.files.usd.space import StageSpace, stage_units
from cagemap.files.usd.stages import open_stage
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, join_meshes, numbers_on_part
from cagemap.mesh.topology import face_components
from cagemap.subdivision import with_options
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.bodies import Bodies, body_shapes, largest_stretches, limit_stretch, match_bodies
from cagemap.tasks.face import (
    _amount,
    _cut,
    _head_vertices,
    _landmarks,
    _on_body,
    _other_parts,
    contact_sheet,
    face_shapes,
)
from cagemap.tasks.face_parts import Mouth, turn_lashes
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.face import FaceRequest

from example_rigs import body_moved
from plain_meshes import ball
from refusals import refuses


@pytest.fixture(autouse=True)
def coarse_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heads are matched at level 1 in place of 2: no test here asks how accurate the map of two heads is."""
    monkeypatch.setattr("cagemap.tasks.bodies.BODY_VERTICES", 10_000)


def test_the_kit_has_all_names_of_arkit_but_one() -> None:
    kit = read_face_kit()
    assert len(kit.shapes) == 51
    assert ABSENT not in kit.shapes
    assert {"jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "noseSneerRight", "browInnerUp"} <= set(kit.shapes)
    # Left is the face's own: at +X of a face that looks along +Z.
    for name, side in (("eyeBlinkLeft", 1.0), ("eyeBlinkRight", -1.0), ("mouthSmileLeft", 1.0)):
        weights = np.linalg.norm(kit.shapes[name], axis=1)
        assert side * (weights @ kit.mesh.positions[:, 0]) > 0.0
    assert KEPT.stat().st_size < 4e6


@pytest.mark.slow
def test_the_kits_file_is_made_of_the_data(shared_data: Path) -> None:
    with np.load(KEPT) as kept:
        made = face_arrays(shared_data / "characters" / "face")
        assert set(kept.files) == set(made)
        for name in ("positions", "quads", "names"):
            assert np.array_equal(kept[name], made[name]), name
        # Lips are moved apart in double precision: the last bit of a half, and which rows are just above LEAST, vary.
        for number, name in enumerate(made["names"]):
            found = [shifts_of(arrays, number) for arrays in (kept, made)]
            np.testing.assert_allclose(*found, atol=2 * LEAST, err_msg=name)


def shifts_of(arrays: Mapping[str, np.ndarray], number: int) -> np.ndarray:
    """(n, 3) shifts of one shape."""
    start, end = arrays["starts"][number : number + 2]
    shifts = np.zeros((len(arrays["positions"]), 3))
    shifts[arrays["rows"][start:end]] = arrays["shifts"][start:end]
    return shifts


def test_the_sheet_shows_the_face_wherever_it_looks() -> None:
    kit = read_face_kit(("jawOpen",))
    to_x = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    turned = replace(kit, mesh=kit.mesh.with_positions(kit.mesh.positions @ to_x), shapes={})
    sides = (kit, np.eye(3)), (turned, to_x)
    sheets = [contact_sheet(Character((part,)), [], part, turn) for part, turn in sides]
    assert np.mean(sheets[0] != sheets[0][0, 0]) > 0.2  # a face is there
    assert np.mean(sheets[0] != sheets[1]) < 0.01


@pytest.mark.slow
def test_lips_of_the_kit_do_not_go_through_each_other() -> None:
    kit = read_face_kit(("mouthShrugLower", "mouthPucker", "eyeBlinkLeft"))
    triangles = fan_triangles(kit.mesh.face_offsets, kit.mesh.face_indices)[0]
    found = depths(kit.mesh.positions, kit.shapes, triangles, FORWARD)
    assert max(found.values()) < 0.05, found


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_blinks_of_the_kit_close_the_eyes(side: str) -> None:
    kit = read_face_kit()
    triangles = fan_triangles(kit.mesh.face_offsets, kit.mesh.face_indices)[0]
    is_socket = np.arange(kit.mesh.n_vertices) >= FIRST_OF_SOCKETS
    height, gap = eye_slits(kit.mesh.positions, triangles, is_socket, kit.shapes[f"eyeBlink{side}"])
    assert gap < 0.02 * height


def test_only_names_of_the_kit_are_taken() -> None:
    assert list(read_face_kit(("jawOpen",)).shapes) == ["jawOpen"]
    refuses(ParameterError, r"tongueOut is not among", read_face_kit, ("tongueOut",))
    refuses(ParameterError, r"expected names among .* got jawopen", read_face_kit, ("jawopen",))
    refuses(InvalidLandmarksError, "got ear", kit_vertices, ("chin", "ear"))


@pytest.mark.slow
def test_on_the_kits_own_head_every_shape_comes_back() -> None:
    kit = read_face_kit(("jawOpen", "eyeBlinkLeft"))
    found = match_bodies(Part("head", kit.mesh), kit, Landmarks.none(), Stages())
    for name, offsets in body_shapes(found).items():
        assert np.abs(offsets - kit.shapes[name]).max() < 1e-3 * np.abs(kit.shapes[name]).max(), name


@pytest.mark.slow
def test_eyeballs_in_the_mesh_of_the_head_stay() -> None:
    """They neither follow the lids nor are flattened; a lash, which is no ball, follows; a tooth follows the jaw."""
    kit = read_face_kit(("eyeBlinkLeft", "jawOpen", "noseSneerLeft"))
    lid, lip = (np.argmax(np.linalg.norm(kit.shapes[name], axis=1)) for name in ("eyeBlinkLeft", "jawOpen"))
    eye, lash, tooth = ball(1), ball(1), ball(1)
    size = 0.05 * np.ptp(kit.mesh.positions, axis=0).max()
    eye = eye.with_positions(kit.mesh.positions[lid] - [0, 0, size] + size * eye.positions)
    lash = lash.with_positions(kit.mesh.positions[lid] + size * lash.positions * [1.0, 0.05, 0.05])
    tooth = tooth.with_positions(kit.mesh.positions[lip] - [0, 0, size] + 0.2 * size * tooth.positions)
    head = Part("head", replace(with_options(join_meshes([kit.mesh, tooth, eye, lash]), "none"), name="head"))
    found = match_bodies(head, kit, Landmarks.none(), Stages())
    given = found, Mouth.of(found), body_shapes(found)
    shapes = face_shapes(*given, list(kit.shapes))
    assert np.linalg.norm(shapes["jawOpen"][-3 * eye.n_vertices : -2 * eye.n_vertices], axis=1).min() > 0.0
    shift = shapes["eyeBlinkLeft"][-2 * eye.n_vertices :].reshape(2, -1, 3)
    assert not shift[0].any()
    assert np.linalg.norm(shift[1], axis=1).min() > 0.0
    alone = face_shapes(*given, ["noseSneerLeft"])["noseSneerLeft"]
    assert not alone[-2 * eye.n_vertices : -eye.n_vertices].any()


@pytest.mark.parametrize("in_mesh", [True, False])
def test_teeth_and_lashes_move_as_those_of_the_kit(shared_data: Path, in_mesh: bool) -> None:
    """Upper teeth stay, lower ones and lower gums follow the jaw rigidly, lashes the lids; in centimetres."""
    folder = shared_data / "characters" / "face"
    if not folder.is_dir():
        pytest.skip("characters are not among the shared data")
    kit, parts = read_face_kit(("eyeBlinkLeft", "jawOpen", "jawLeft")), read_mesh(folder / "ict_parts_neutral.obj")
    pieces = face_components(parts)
    meshes = [extract_faces(parts, np.flatnonzero(np.isin(pieces, range(*some)))) for some in ((0, 33), (43, 55))]
    mesh = join_meshes([kit.mesh, *meshes]) if in_mesh else kit.mesh
    head = Part("head", replace(with_options(mesh, "none"), name="head"))
    found = match_bodies(head, kit, Landmarks.none(), Stages())
    mouth = Mouth.of(found)
    on_head = face_shapes(found, mouth, body_shapes(found), list(kit.shapes))
    if in_mesh:
        cuts = np.cumsum([one.n_vertices for one in (kit.mesh, *meshes)])
        moved = [{name: offsets[start:end] for name, offsets in on_head.items()} for start, end in pairwise(cuts)]
    else:
        own = Part("denture", meshes[0]), Part("Eyelashes", meshes[1])
        made = dict(_other_parts(Character((head, *own)), head, found, mouth, on_head, dict.fromkeys(on_head, 1.0)))
        assert [list(one.shapes) for one in made.values()] == [["jawOpen", "jawLeft"], ["eyeBlinkLeft", "jawOpen"]]
        moved = [made[one].shapes for one in own]
    with np.load(folder / "ict_expressions.npz") as given:
        names = list(given["names"])
        true = {}
        for name in ("jawOpen", "jawLeft", "eyeBlink_L"):
            start, end = given["extra_offset"][names.index(name) :][:2]
            true[name] = np.zeros(parts.positions.shape)
            true[name][given["extra_row"][start:end].astype(int) - kit.mesh.n_vertices] = given["extra_delta"][
                start:end
            ]
    half = {name: _amount(0.5 * on_head[name], on_head[name]) for name in ("jawLeft", "jawOpen")}  # the head's own
    for name, offsets in mouth.shapes(meshes[0], half)[1].items():
        assert np.abs(offsets - 0.5 * moved[0][name]).max() < 0.1 * np.abs(moved[0][name]).max()
    rows = [one.file_numbers[0] for one in meshes]
    teeth = numbers_on_part(extract_faces(parts, np.flatnonzero((pieces > 0) & (pieces < 33))), meshes[0]) >= 0
    for name in ("jawOpen", "jawLeft"):
        error = np.linalg.norm(moved[0][name] - true[name][rows[0]], axis=1)
        assert error[teeth].max() < 0.05
        assert error[~teeth].mean() < 0.25  # gums and tongue, in one piece
    error = np.linalg.norm(moved[1]["eyeBlinkLeft"] - true["eyeBlink_L"][rows[1]], axis=1)
    assert error.mean() < 0.06
    assert error.max() < 0.35  # tips of lashes turn with the lids: by 0.9 without


@pytest.mark.parametrize(("sinking", "amount", "angle"), [(1.0, 1.0, 0.93), (1.0, 0.5, 0.465), (0.016, 1.0, 0.0)])
def test_what_sinks_much_less_than_the_lids_does_not_turn(sinking: float, amount: float, angle: float) -> None:
    """Such as a fringe; and a blink of half the size turns lashes by half."""
    bodies = SimpleNamespace(result=SimpleNamespace(point_map=body_moved(1.0, np.eye(3), np.zeros(3))))
    points, means = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), sparse.csr_array([[1.0, 0.0], [1.0, 0.0]])
    lids = {"eyeBlinkLeft": amount * np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 0.0]])}
    shapes = {"eyeBlinkLeft": np.tile([0.0, -amount * sinking, 0.0], (2, 1))}
    found = turn_lashes(bodies, points, means, shapes, lids, {"eyeBlinkLeft": amount})["eyeBlinkLeft"]
    turned = found - shapes["eyeBlinkLeft"] + points
    np.testing.assert_allclose(turned, [[0, 0, 0], [0, -np.sin(angle), np.cos(angle)]], atol=1e-9)


def test_a_shape_of_the_kit_that_moves_nothing_has_no_amount() -> None:
    with np.errstate(all="raise"):
        assert _amount(np.ones((4, 3)), np.zeros((4, 3))) == 0.0


@pytest.mark.slow
def test_a_head_keeps_what_it_has_and_gets_shapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    kit = read_face_kit(())
    own = {"jawOpen": np.tile([0.0, 1.0, 0.0], (kit.mesh.n_vertices, 1))}
    eyes, lash = Part("eyes", ball(2)), ball(1)
    head = Part("head", kit.mesh.with_positions(0.01 * kit.mesh.positions), None, own, shape_weights={"jawOpen": 0.5})
    talk = Animation("talk", (), (ShapeTrack("head", ("jawOpen",), 41.0 + np.arange(2.0), np.array([[0.0], [1.0]])),))
    lid = np.argmax(np.linalg.norm(read_face_kit(("eyeBlinkLeft",)).shapes["eyeBlinkLeft"], axis=1))
    lash = Part("lashes", lash.with_positions(head.mesh.positions[lid] + 1e-3 * lash.positions))
    document = character_glb(Character((head, eyes, lash), None, (talk,)))
    binds = {"morphTargetBinds": [{"node": 0, "index": 0, "weight": 1.0}]}
    document.json["extensions"] = {"VRMC_vrm": {"expressions": {"preset": {"aa": binds}}}}
    write_document(Path("H.glb"), document)
    request = FaceRequest(Path("H.glb"), Path("F.glb"), only="jawOpen,eyeBlinkLeft", sheet=Path("S.png"))
    done = tasks.run(request)
    assert any("jawOpen: H.glb has its own" in warning for warning in done.warnings)
    assert done.figures.pop("trusted_area") > 0.9
    assert done.figures == {"part": "head", "shapes": ["eyeBlinkLeft"]}
    before, after = (read_character(name).parts for name in ("H.glb", "F.glb"))
    assert [part.name for part in after] == ["head", "eyes", "lashes"]
    assert set(after[0].shapes) == {"jawOpen", "eyeBlinkLeft"}
    assert np.array_equal(after[0].mesh.positions, before[0].mesh.positions)
    assert np.allclose(after[0].shapes["jawOpen"], [0.0, 1.0, 0.0])
    assert not after[1].shapes
    assert set(after[2].shapes) == {"jawOpen", "eyeBlinkLeft"}
    np.testing.assert_allclose(after[2].shapes["jawOpen"], np.tile([0.0, 1.0, 0.0], (42, 1)), atol=1e-5)
    assert [part.shape_weights.get("jawOpen") for part in after] == [0.5, None, 0.5]
    (animation,) = read_character("F.glb").animations
    for track, part in zip(animation.shape_tracks, ("head", "lashes"), strict=True):
        assert track.part == part
        np.testing.assert_array_equal(track.times, [0.0, 1.0])
        np.testing.assert_array_equal(track.values[:, track.shapes.index("jawOpen")], [0.0, 1.0])
    expressions = read_document("F.glb").json["extensions"]["VRMC_vrm"]["expressions"]
    assert [bind["node"] for bind in expressions["preset"]["aa"]["morphTargetBinds"]] == [0, 2]
    largest = np.abs(read_face_kit(("eyeBlinkLeft",)).shapes["eyeBlinkLeft"]).max()
    assert np.abs(after[0].shapes["eyeBlinkLeft"]).max() == pytest.approx(0.01 * largest, rel=0.1)
    assert Path("S.png").stat().st_size > 0


@pytest.mark.slow
def test_a_head_in_usd_keeps_what_it_has_and_gets_shapes(tmp_path, run, monkeypatch):
    """Units, axes, points, skeleton, own shapes and other meshes; as glTF it is in metres with Y up."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    monkeypatch.chdir(tmp_path)
    mesh = read_face_kit(()).mesh
    mesh = mesh.with_positions(0.01 * mesh.positions)
    own = {"jawOpen": np.tile([0.0, 0.01, 0.0], (mesh.n_vertices, 1))}
    places = np.tile(np.eye(4), (2, 1, 1))
    places[1, 3, 1] = 0.02
    rig = Rig(("spine", "skull"), np.array([-1, 0]), places, places)
    weights = sparse.csr_array(np.tile([0.0, 1.0], (mesh.n_vertices, 1)))
    nod = Track(0, "translation", np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]))
    made = Character((Part("head", mesh, weights, own), Part("eyes", ball(2))), rig, (Animation("nod", (nod,)),))
    write_usd_character("H.usda", made, read_scene(character_glb(made)), space=StageSpace("Z", 0.01))
    found_once: list[Bodies] = []

    def match_once(*asked: Any) -> Bodies:  # both commands ask for the same
        if not found_once:
            found_once.append(match_bodies(*asked))
        return found_once[0]

    monkeypatch.setattr("cagemap.tasks.face.match_bodies", match_once)
    Path("P.json").write_text(json.dumps({"points": [{"name": "chin", "vertex": int(kit_vertices(("chin",))[0])}]}))
    for name in ("F.usdc", "F.glb"):
        done = run.done("face H.usda --only jawOpen,eyeBlinkLeft --landmarks P.json -o", name)
        assert "jawOpen: H.usda has its own" in done.err
    stages = [open_stage(name) for name in ("H.usda", "F.usdc")]
    assert str(stage_units("F.usdc")) == str(stage_units("H.usda")) == "0.01 m a unit, Z up"
    points = [stage.GetAttributeAtPath("/Asset/head.points").Get() for stage in stages]
    np.testing.assert_array_equal(*points)
    for found in (document_and_character("F.usdc")[1], read_character("F.glb")):
        head, eyes = found.parts
        assert (head.name, eyes.name) == ("head", "eyes")
        assert set(head.shapes) == {"jawOpen", "eyeBlinkLeft"}
        assert not eyes.shapes
        np.testing.assert_allclose(found.rig.bind, rig.bind, atol=1e-6)
        np.testing.assert_allclose(head.mesh.positions, mesh.positions, atol=1e-6)
        np.testing.assert_allclose(head.shapes["jawOpen"], own["jawOpen"], atol=1e-6)
        np.testing.assert_allclose(pose_at(found.rig, found.animations[0], 1.0)[0, 3, :3], [0, 0, 0.5], atol=1e-6)
        largest = np.abs(read_face_kit(("eyeBlinkLeft",)).shapes["eyeBlinkLeft"]).max()
        assert np.abs(head.shapes["eyeBlinkLeft"]).max() == pytest.approx(0.01 * largest, rel=0.1)


def test_points_between_vertices_are_kept_and_curves_are_said_to_be_unused(tmp_path: Path) -> None:
    mesh = ball(2)
    write_mesh(tmp_path / "H.obj", mesh)
    middle = mesh.positions[mesh.face_indices[:3]].mean(axis=0)
    curve = {"name": "lips", "vertices": [0, 1, 2], "closed": False}
    points = [{"name": "chin", "position": middle.tolist()}, {"name": "nose_tip", "vertex": 5}]
    (tmp_path / "P.json").write_text(json.dumps({"points": points, "curves": [curve]}))
    head = Part("head", read_mesh(tmp_path / "H.obj"))
    request = FaceRequest(tmp_path / "H.obj", tmp_path / "F.glb", landmarks=tmp_path / "P.json")
    landmarks, (note,) = _landmarks(request, head, Character((head,)))
    np.testing.assert_allclose(landmarks.target_points.of(mesh.positions), [middle, mesh.positions[5]], atol=1e-9)
    np.testing.assert_array_equal(landmarks.source_points.vertices, kit_vertices(("chin", "nose_tip")))
    assert "curves are left out" in note
    assert "lips" in note


def test_shapes_do_not_tear_a_surface() -> None:
    """A vertex that moves alone is brought back to its neighbours; what stretches less stays."""
    mesh = ball(2)
    triangles, torn = mesh.face_indices.reshape(-1, 3), mesh.positions.copy()
    torn[5] += 5.0
    allowed = np.full(mesh.n_vertices, 5.0)
    found = limit_stretch(mesh, torn, allowed)
    edges = triangles[(triangles == 5).any(axis=1)]
    spans = [np.ptp((mesh.positions + offsets)[edges], axis=1).max() for offsets in (torn, found)]
    assert spans[1] < 0.4 * spans[0]
    np.testing.assert_array_equal(limit_stretch(mesh, mesh.positions, allowed), mesh.positions)
    np.testing.assert_array_equal(limit_stretch(mesh, torn, largest_stretches(mesh, torn)), torn)


def test_of_a_rigged_body_the_head_is_taken() -> None:
    mesh = ball(3)
    high = (mesh.positions[:, 1] > 0.3).astype(float)
    place = np.tile(np.eye(4), (4, 1, 1))
    rig = Rig(("hips", "spine", "neck", "head"), np.array([-1, 0, 1, 2]), place, place)
    weights = sparse.csr_array(np.column_stack([1 - high, 0 * high, 0 * high, high]))
    body = Part("body", mesh, weights)
    vertices = _head_vertices(body, rig)
    assert np.array_equal(vertices, np.flatnonzero(high))
    head = _cut(body, vertices)
    put = _on_body({"up": head.mesh.positions}, head, body)["up"]
    there = np.abs(put).max(axis=1) > 0
    assert np.array_equal(put[there], mesh.positions[there])
    assert there.sum() == head.mesh.n_vertices
    assert _head_vertices(body, None) is None
    assert _head_vertices(Part("head", mesh, sparse.csr_array(np.eye(4)[np.full(len(high), 3)])), rig) is None


def test_a_whole_body_without_a_skeleton_is_refused_before_the_match(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("cagemap.tasks.face.match_bodies", lambda *_: pytest.fail("the body was matched"))
    mesh = ball(3)
    write_mesh(tmp_path / "BODY.obj", mesh.with_positions(mesh.positions * [2.0, 3.5, 1.0]))
    with pytest.raises(ParameterError, match="'BODY' has the proportions of a whole body"):
        tasks.run(FaceRequest(tmp_path / "BODY.obj", tmp_path / "OUT.glb"))
