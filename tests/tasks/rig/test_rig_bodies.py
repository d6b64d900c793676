"""Bodies of `cagemap rig`: refused, paired, repaired, and what is said of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import grid
from scipy import sparse
from scipy.spatial.transform import Rotation

from cagemap import tasks
from cagemap.character.values import Character, Part, Rig
from cagemap.errors import ParameterError
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, read_whole, write_mesh
from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.quality import unshared_warnings
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import face_centres
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.subdivision import with_options
from cagemap.tasks.bodies import Bodies, match_bodies
from cagemap.tasks.carry_character import CarriedCharacter, carry_character
from cagemap.tasks.match_summary import body_warnings
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.rig import RigRequest
from cagemap.tasks.rig_character import _kinds, _landmarks, character_body, read_body
from cagemap.tasks.rig_checks import pose_warning, split_body_warning, up_warning

from command_line import Run
from example_character import ball, write_character
from example_rigs import body_moved, person
from plain_meshes import far_apart, marks_at, renumbered
from refusals import refuses
from rigged import part_named


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--passengers", "cape"], "expected names of parts of the character (eye, hat), got cape"),
        (["--body-part", "leg"], "expected a part named 'leg', there is none"),
        (
            ["--like", "B.obj"],
            "a character file ending in .glb, .gltf, .vrm, .fbx, .usd, .usda, .usdc or .usdz, got .obj",
        ),
        (["-o", "OUT.fbx"], "expected a name ending in .glb, .gltf, .vrm, .usd, .usda, .usdc or .usdz, got .fbx"),
        (["-o", "C.glb"], "C.glb"),
        (["--landmarks", "missing.json"], "missing.json"),
        (["--rigid", "hta"], "hta: expected one of the passengers, hat, eye, body pieces (rig: --rigid"),
        (["--size", "64", "--keep-textures"], "--size: expected without --keep-textures"),
    ],
)
def test_refusals_name_what_is_wrong(run: Run, files: Character, words, said, monkeypatch) -> None:
    monkeypatch.setattr("cagemap.tasks.carry_character.match_bodies", lambda *_: pytest.fail("matched"))
    before = Path("C.glb").read_bytes()
    run.refused(
        "rig B.glb", *(["--like", "C.glb"] if "--like" not in words else []), "-o", "OUT.glb", *words, says=said
    )
    assert not Path("OUT.glb").exists()
    assert Path("C.glb").read_bytes() == before


def test_a_passenger_is_rigid_or_cloth() -> None:
    request = RigRequest(Path("B.glb"), Path("C.glb"), Path("O.glb"), rigid="hat, eyes", cloth="shirt,hat")
    refuses(ParameterError, "--rigid and --cloth: expected each passenger in one of them, got hat", _kinds, request)
    assert _kinds(replace(request, cloth="shirt")) == {"hat": "rigid", "eyes": "rigid", "shirt": "cloth"}


def test_landmarks_between_vertices_and_curves_are_used(files: Character) -> None:
    meshes = read_mesh("B.glb"), read_whole(Path("C.glb"))
    corners = [mesh.face_indices[:3] for mesh in meshes]
    weights = [0.2, 0.5, 0.3]
    spots = [{"corners": corner.tolist(), "weights": weights} for corner in corners]
    chains = [corner[:2].tolist() for corner in corners]
    data = {
        "pairs": [{"name": "spot", "target": spots[0], "source": spots[1]}],
        "curves": [{"name": "rim", "target": chains[0], "source": chains[1]}],
    }
    Path("L.json").write_text(json.dumps(data))
    _, target = read_body(Path("B.glb"))
    _, source = read_body(Path("C.glb"))
    parts = character_body(target, None, Path("B.glb")), character_body(source, "body", Path("C.glb"))
    landmarks, _ = _landmarks(
        RigRequest(Path("B.glb"), Path("C.glb"), Path("O.glb"), Path("L.json")), parts, (target, source)
    )
    (rim,) = landmarks.curves
    assert (landmarks.names, rim.name) == (("spot",), "rim")
    sides = (landmarks.target_points, rim.target), (landmarks.source_points, rim.source)
    for (points, curve), part, mesh, corner in zip(sides, parts, meshes, corners, strict=True):
        places = mesh.positions[corner]
        np.testing.assert_allclose(points.of(part.mesh.positions)[0], np.array(weights) @ places, atol=1e-6)
        np.testing.assert_allclose(curve.points.of(part.mesh.positions), places[:2], atol=1e-6)


@pytest.mark.slow
def test_a_character_whose_body_has_no_weights_is_named(run: Run, files: Character) -> None:
    bare, *others = files.parts
    write_character(Path("C.glb"), replace(files, parts=(replace(bare, weights=None), *others)))
    outcome = run("rig", "B.glb", "--like", "C.glb", "-o", "OUT.glb")
    assert outcome.code == 0
    assert f"{bare.name} has no weights, so the body does not move with the skeleton" in outcome.err


def test_a_kind_of_a_part_that_the_body_has_itself_names_the_option_that_carries_it(body, monkeypatch):
    monkeypatch.setattr("cagemap.tasks.carry_character.match_bodies", lambda *_: pytest.fail("matched"))
    hat = Part("Hat", ball("Hat", np.zeros(3), 0.1))
    character = Character((Part("body", body), hat))
    with pytest.raises(ParameterError, match=r"^Hat: .* the body has its own .* passenger too \(rig: --passengers\)"):
        carry_character(character, character, kinds={"Hat": "rigid"})


def test_a_scan_as_ply_is_repaired(run: Run, files: Character, body: ControlMesh) -> None:
    """Of a cage file: holes that touch in a vertex, a loose piece, no UVs and no stated scheme."""
    around = np.flatnonzero((body.face_indices.reshape(-1, 3) == 100).any(axis=1))
    holes = extract_faces(body, np.setdiff1d(np.arange(body.n_faces), around[[0, len(around) // 2]]))
    button = ball("button", body.positions.min(axis=0), 0.1)
    scan = join_meshes([replace(one, uvs=None, uv_indices=None) for one in (holes, button)])
    faces = scan.face_indices.reshape(-1, 3)
    write_mesh("SCAN.ply", ControlMesh.from_faces(scan.positions, faces))
    outcome = run.done("rig SCAN.ply --like C.glb -o OUT.glb")
    assert "SCAN.ply: matched as a plain mesh, since it is no control mesh: " in outcome.err
    assert "SCAN.ply: for the match alone: 1 vertex split where parts only touch" in outcome.err
    assert part_named(read_character("OUT.glb"), "body").mesh.n_vertices == scan.n_vertices


def test_a_body_whose_largest_piece_is_a_fragment_is_refused() -> None:
    balls = [ball("piece", np.array([x, 0.0, 0.0]), size) for x, size in ((0.0, 0.15), (-0.9, 0.1), (0.9, 0.1))]
    mesh = join_meshes([replace(one, face_objects=None, object_names=()) for one in balls])
    body = Part("skin", with_options(replace(mesh, name="C.glb"), "none"))
    message = r"C\.glb: .* skin has 3 pieces, and the one that is matched spans only 2.% of it"
    refuses(ParameterError, message, match_bodies, body, body, Landmarks.none(), Stages())


def test_a_body_whose_legs_are_other_pieces_is_refused_before_the_match(body, monkeypatch) -> None:
    """As `quaternius_Female_Dress.fbx`, unless landmarks or equal faces pair the rest."""
    legs = ball("legs", body.positions[np.argmin(body.positions[:, 1])] - [0.0, 2.0, 0.0], 0.8)
    meshes = [replace(one, face_objects=None, object_names=()) for one in (body, legs)]
    mesh = with_options(join_meshes(meshes), "none")
    rig, is_leg = person(), np.arange(mesh.n_vertices) >= body.n_vertices
    joints = [rig.names.index("LeftLeg"), rig.names.index("LeftArm")]
    weights = np.zeros((mesh.n_vertices, len(rig.names)))
    weights[:, joints] = np.where(is_leg[:, None], [0.8, 0.2], [0.2, 0.8])
    monkeypatch.setattr("cagemap.tasks.bodies.match", lambda *given, progress: "matched")
    source = Part("Female", replace(mesh, name="C.fbx"), sparse.csr_array(weights))
    target, few = Part("body", renumbered(body, 0)[0]), marks_at(far_apart(body.positions, 5))
    message = r"C\.fbx: expected a body in one piece, but the left leg of Female is not on the piece that is matched\."
    refuses(ParameterError, message, match_bodies, target, source, Landmarks.none(), Stages(), rig)
    for given, of, marks in ((target, source, few), (source, source, Landmarks.none())):
        assert match_bodies(given, of, marks, Stages(), rig).result is not None
    small = mesh.positions.copy()  # an anklet
    small[is_leg] = small[is_leg].mean(axis=0) + 0.1 * (small[is_leg] - small[is_leg].mean(axis=0))
    sleeve = np.where(is_leg[:, None], weights[0], weights)
    for other in (
        replace(source, mesh=source.mesh.with_positions(small)),
        replace(source, weights=sparse.csr_array(sleeve)),
    ):
        assert match_bodies(target, other, Landmarks.none(), Stages(), rig).result == "matched"


def test_bodies_with_the_same_faces_are_paired_by_number_unless_landmarks_are_given(body, quick_fit) -> None:
    bent = body.positions + 0.3 * np.sin(body.positions[:, [1, 2, 0]])
    faces = body.face_indices.reshape(-1, 3).copy()
    a, b, c = faces[0]  # one quad is split along its other diagonal
    (other,) = (row for row in range(1, len(faces)) if {a, b} <= {*faces[row]})
    (d,) = {*faces[other]} - {a, b}
    faces[0], faces[other] = (a, d, c), (d, b, c)
    given = ControlMesh.from_faces(bent, faces)
    parts = Part("bent", replace(given, name="bent", scheme=body.scheme)), Part("body", body)
    bodies = match_bodies(*parts, Landmarks.none(), Stages())
    np.testing.assert_array_equal(bodies.result.point_map.images.positions, bodies.result.point_map.source.positions)
    pair = f"bent has the same faces as {body.name}"
    assert bodies.notes == (f"{pair}: their vertices are paired by number; with --landmarks they are matched",)
    refuses(ParameterError, "answer 1: expected 0", match_bodies, *parts, Landmarks.none(), Stages(), answer=1)
    matched = match_bodies(*parts, marks_at(far_apart(body.positions, 5)), Stages())
    assert matched.notes == ()
    assert np.abs(matched.result.point_map.images.positions - matched.result.point_map.source.positions).max() > 1e-6


def test_a_body_with_another_axis_up_is_named() -> None:
    x_turn, y_turn = (Rotation.from_rotvec(angle).as_matrix() for angle in ([np.pi / 2, 0, 0], [0, 2.0, 0]))
    for turn, words in ((np.eye(3), []), (y_turn, []), (x_turn, ["-Z here"]), (x_turn.T, ["Z here"])):
        found = up_warning(body_moved(2.0, turn, np.ones(3)), Path("B.obj"))
        assert [word in text for word, text in zip(words, found, strict=True)] == [True] * len(words)


@pytest.mark.parametrize("verdict", [SURE, "look at it"])
def test_a_doubtful_match_is_named_and_the_axis_only_of_a_sure_one(files, body, verdict, monkeypatch) -> None:
    def with_verdict(*given: Any, **options: Any) -> CarriedCharacter:
        found = carry_character(*given, **options)
        said = {"verdict": verdict, "message": verdict, "signs": {}}
        confidence = SimpleNamespace(verdict=verdict, summary=said.copy)
        return replace(found, result=replace(found.result, confidence=confidence))

    monkeypatch.setattr("cagemap.tasks.rig_character.carry_character", with_verdict)
    lying = body.with_positions(body.positions @ Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix())
    write_mesh("B.glb", lying, force=True)
    outcome = tasks.run(RigRequest(Path("B.glb"), Path("C.glb"), Path("OUT.glb")))
    said = [any(words in text for text in outcome.warnings) for words in ("may be wrong", "glTF has Y up")]
    assert said == [verdict != SURE, verdict == SURE]


def test_a_body_of_one_triangle_is_refused() -> None:
    """The mesh of `saturday06_skinned_morph_vrm0.vrm`."""
    body = Part("Cube", ControlMesh.from_faces(np.eye(3), np.array([[0, 1, 2]]), name="C.vrm"))
    message = r"C\.vrm: expected a body, but Cube has only 1 face\. .*--like-part"
    refuses(ParameterError, message, match_bodies, body, body, Landmarks.none(), Stages())


def test_a_body_in_several_joined_parts_is_named() -> None:
    whole = ball("ball", np.zeros(3), 1.0)
    upper = face_centres(whole)[:, 1] > 0.0
    halves = [
        Part(name, extract_faces(whole, np.flatnonzero(faces))) for name, faces in (("top", upper), ("legs", ~upper))
    ]
    shell = Part("coat", whole.with_positions(1.001 * whole.positions))
    legs = halves[1]
    (said,) = split_body_warning(Path("man.fbx"), Character((*halves, shell)), legs)
    assert "man.fbx: legs alone is matched as the body, but top continues it" in said
    assert split_body_warning(Path("man.fbx"), Character((legs, shell)), legs) == []


def test_landmarks_that_are_left_out_and_warnings_of_the_map_are_said(body, monkeypatch):
    pieces = body, ball("button", np.array([0.0, 0.0, 9.0]), 0.1)
    whole = join_meshes([replace(one, face_objects=None, object_names=()) for one in pieces])
    part = Part("body", replace(whole, name="body.obj", scheme=Plain()))
    check = {"suspects": [{"message": "nose: left out"}], "notes": []}
    manifest = {"landmark_check": check, "quality": {"warnings": ["5 % is folded"]}}
    result = SimpleNamespace(manifest=manifest)
    monkeypatch.setattr("cagemap.tasks.bodies.prepare_surfaces", lambda *given: (None, None))
    configs = []
    monkeypatch.setattr("cagemap.tasks.bodies.match", lambda *given, progress: configs.append(given[3]) or result)
    spots = np.array([3, whole.n_vertices - 1])
    bodies = match_bodies(part, part, Landmarks(("nose", "button"), spots, spots, "a", "b"), Stages(), answer=2)
    assert [config.answer for config in configs] == [2]
    lost = "1 of 2 landmarks lie on pieces that are set aside and are left out"
    assert bodies.notes == (lost,)
    assert body_warnings(bodies.result) == ["nose: left out", "5 % is folded"]
    confidence = {"verdict": "look at it", "message": "use `answer=1`", "signs": {"jumps": 0.08, "cost": 9.0}}
    quality = {"warnings": [], "flipped_area": 0.2}
    doubtful = SimpleNamespace(manifest={"confidence": confidence, "quality": quality})
    assert body_warnings(doubtful) == [
        "Do not use this map as it is: 20.00 % of the body is folded over.",
        "the map between the bodies may be wrong: it jumps between parts that only touch, at 8 % of the body. Look "
        "at the result, and give --landmarks where it is wrong",
    ]


def test_warnings_of_rig_and_face_name_the_two_models_and_no_masks() -> None:
    """Neither command has a source, a target or masks."""
    quality = {"warnings": unshared_warnings(0.7, 0.8), "flipped_area": 0.0}
    assert body_warnings(SimpleNamespace(manifest={"quality": quality}), ("head", "built-in face")) == [
        "30.0 % of the head has no counterpart on the built-in face: it receives what the nearest places that have one "
        "receive",
        "20.0 % of the built-in face has no counterpart on the head",
    ]


def test_vertices_that_the_repair_splits_have_the_values_of_their_place() -> None:
    """A sheet of which two corners are one vertex."""
    mesh = grid(4, 3)
    corners = np.where(mesh.face_indices == 0, mesh.n_vertices - 1, mesh.face_indices)
    part = Part("body", ControlMesh.from_faces(mesh.positions, corners.reshape(-1, 4)))
    ready = plain_mesh(part.mesh)
    assert ready.repairs.cut_vertices == 1
    rows = Bodies((part, part), (ready, ready), None).rows(0)
    np.testing.assert_array_equal(part.mesh.positions[rows], ready.mesh.positions)


def test_a_body_that_its_skeleton_poses_is_named(run: Run, files: Character, body: ControlMesh) -> None:
    places = np.tile(np.eye(4), (2, 1, 1))
    part = Part("skin", body, sparse.csr_array(np.tile([0.0, 1.0], (body.n_vertices, 1))))
    rig = Rig(("hips", "chest"), np.array([-1, 0]), places, places)
    assert pose_warning(Path("B.glb"), Character((part,), rig), part) == []
    local = places.copy()
    local[1, :3, :3] = Rotation.from_euler("x", 40.0, degrees=True).as_matrix()
    write_document("P.glb", character_glb(Character((part,), replace(rig, local=local))))
    assert "skin is taken in its bind pose" in run.done("rig P.glb --like C.glb -o OUT.glb").err
