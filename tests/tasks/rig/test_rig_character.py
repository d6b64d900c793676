"""`cagemap rig`: a body rigged, textured, dressed and animated like a character."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube
from scipy.spatial.transform import Rotation

from cagemap import tasks
from cagemap.character.poses import pose_at
from cagemap.character.values import Animation, Character, Part, ShapeTrack, Track, skinned_positions
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.usd.character import write_usd_character
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import face_areas
from cagemap.mesh.landmarks import Landmarks
from cagemap.subdivision import refine, with_options
from cagemap.tasks.bodies import body_shapes, match_bodies
from cagemap.tasks.carry_character import carry_character
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.rig import RigRequest
from cagemap.tasks.rig_character import read_body

from command_line import Run
from example_character import ball, write_character
from plain_meshes import renumbered
from rigged import image_error, part_named, rig_done, same_order
from usd_characters import shape_keys


def test_the_same_body_gets_back_what_the_character_has(files: Character) -> None:
    """Weights, shapes, joints, passengers, animation and texture, to single precision and a texel."""
    outcome = tasks.run(RigRequest(Path("B.glb"), Path("C.glb"), Path("OUT.glb")))
    figures, made = outcome.figures, read_character("OUT.glb")
    body = f"  body: {figures['vertices']} vertices, {len(figures['shapes'])} shape"
    assert body in outcome.summary
    assert figures.pop("trusted_area") > 0.99
    assert figures == {
        "vertices": part_named(made, "body").mesh.n_vertices,
        "joints": len(made.rig.names),
        "animations": ["nod"],
        "shapes": list(part_named(files, "body").shapes),
        "passengers": ["hat", "eye"],
    }
    assert {part.name for part in made.parts} == {"body", "hat", "eye"}
    assert made.rig.names == files.rig.names
    np.testing.assert_allclose(made.rig.bind, files.rig.bind, atol=1e-5)
    for given in files.parts:
        found = part_named(made, given.name)
        rows = same_order(found, given)
        np.testing.assert_allclose(found.weights[rows].toarray(), given.weights.toarray(), atol=1e-5)
        for name, offsets in given.shapes.items():
            np.testing.assert_allclose(found.shapes[name][rows], offsets, atol=1e-5)
    (nod,) = made.animations
    (before,) = files.animations
    np.testing.assert_allclose(pose_at(made.rig, nod, 0.7), pose_at(files.rig, before, 0.7), atol=1e-5)
    # At seams of islands of 64 texels a texel holds what is on both sides; colours of other places differ by 0.2.
    assert image_error() < 0.03


def test_a_body_moved_and_scaled_moves_like_the_character(run: Run, files: Character, body, quick_fit) -> None:
    """Every vertex of every part, posed: the character's, scaled by 2, turned and shifted; numbered otherwise."""
    turn = Rotation.from_rotvec([0.0, 0.4, 0.0]).as_matrix()
    moved, _ = renumbered(body.with_positions(2 * body.positions @ turn + [0.1, 0.2, 0.3]), 0)
    write_mesh("B.glb", moved, force=True)
    assert "paired by number" not in run.done("rig B.glb --like C.glb -o OUT.glb").err
    made = read_character("OUT.glb")
    poses = [pose_at(of.rig, of.animations[0], 1.0) for of in (files, made)]
    for given in files.parts:
        found = part_named(made, given.name)
        moved = replace(given, mesh=given.mesh.with_positions(2 * given.mesh.positions @ turn + [0.1, 0.2, 0.3]))
        rows = same_order(found, moved, 1e-2)
        expected = 2 * skinned_positions(given, files.rig, poses[0]) @ turn + [0.1, 0.2, 0.3]
        # The map is found, not given: a thousandth of the size.
        size = float(np.ptp(body.positions, axis=0).max())
        np.testing.assert_allclose(skinned_positions(found, made.rig, poses[1])[rows], expected, atol=2e-3 * size)


@pytest.mark.parametrize("skinned", [True, False])
def test_a_prop_with_a_motion_of_its_own_moves_at_the_place_and_size_of_the_body(
    run: Run, files: Character, body: ControlMesh, skinned: bool
) -> None:
    """A moon beside no joint, which turns and orbits: on a body that is scaled by 2, turned and shifted.

    A character without skin has no joint but the moon's; a turntable above everything stays a node.
    """
    place, turn = body.positions.max(axis=0), Rotation.from_rotvec([0.0, 0.4, 0.0]).as_matrix()
    moon, count = ball("moon", np.array([0.02, 0.0, 0.0]), 0.1), ball("moon", place, 0.1).n_vertices
    if not skinned:
        files = Character((replace(files.parts[0], weights=None),))
    document = character_glb(replace(files, parts=(files.parts[0], Part("moon", moon))))
    if not skinned:
        document.json["animations"] = [{"name": "nod", "samplers": [], "channels": []}]
        document.json["nodes"].append({"name": "turntable", "children": document.json["scenes"][0]["nodes"]})
        document.json["scenes"][0]["nodes"] = [len(document.json["nodes"]) - 1]
    binary = Binary(document)
    (node,) = (number for number, one in enumerate(document.json["nodes"]) if one["name"] == "moon")
    document.json["nodes"][node]["translation"] = place.tolist()
    times = binary.accessor(np.array([0.0, 1.0], "<f4"), min=[0.0], max=[1.0])
    (animation,) = document.json["animations"]
    if not skinned:
        still = binary.accessor(np.zeros((2, 3), "<f4"))
        animation["samplers"].append({"input": times, "output": still})
        table = len(document.json["nodes"]) - 1
        animation["channels"].append({"sampler": 0, "target": {"node": table, "path": "translation"}})
    quarter = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]
    for path, keys in (("translation", [place, place * [-1, 1, 1]]), ("rotation", [[0, 0, 0, 1], quarter])):
        animation["samplers"].append({"input": times, "output": binary.accessor(np.array(keys, "<f4"))})
        sampler = len(animation["samplers"]) - 1
        animation["channels"].append({"sampler": sampler, "target": {"node": node, "path": path}})
    write_document("C.glb", binary.document(document.json), force=True)
    moved = animation["channels"]
    animation["channels"] = moved[:1]  # the turntable's
    assert skinned or character_of(binary.document(document.json), props=True).rig is None
    animation["channels"] = moved
    write_mesh("B.glb", body.with_positions(2 * body.positions @ turn + [0.1, 0.2, 0.3]), force=True)
    made = rig_done(run)
    assert made.rig.names == (*(files.rig.names if skinned else ["turntable"]), "moon")
    posed = skinned_positions(part_named(made, "moon"), made.rig, pose_at(made.rig, made.animations[0], 1.0))
    rotation = Rotation.from_quat(quarter).as_matrix().T
    expected = 2 * (moon.positions @ rotation + place * [-1, 1, 1]) @ turn + [0.1, 0.2, 0.3]
    size = float(np.ptp(body.positions, axis=0).max())
    assert posed.shape == (count, 3)
    np.testing.assert_allclose(np.sort(posed, axis=0), np.sort(expected, axis=0), atol=5e-3 * size)


def test_animated_shapes_need_no_skeleton(run: Run, files: Character) -> None:
    write_character(Path("C.glb"), Character(tuple(replace(part, weights=None) for part in files.parts)))
    document = read_document("C.glb")
    (node,) = (number for number, one in enumerate(document.json["nodes"]) if one["name"] == "body")
    binary = Binary(document)
    times = binary.accessor(np.array([0.0, 1.0], "<f4"), min=[0.0], max=[1.0])
    sampler = {"input": times, "output": binary.accessor(np.array([0.25, 0.75], "<f4"))}
    channel = {"sampler": 0, "target": {"node": node, "path": "weights"}}
    animation = {"name": "talk", "samplers": [sampler], "channels": [channel]}
    write_document("C.glb", binary.document(document.json | {"animations": [animation]}), force=True)
    assert "\n  1 animation\n" in run.done("rig B.glb --like C.glb -o OUT.glb").out
    ((times_found, values, _),) = shape_keys(read_document("OUT.glb"), 0).values()
    np.testing.assert_allclose(times_found, [0.0, 1.0])
    np.testing.assert_allclose(values.ravel(), [0.25, 0.75])


@pytest.mark.slow
def test_what_the_body_has_of_its_own_stays_and_follows(run: Run, files: Character, body: ControlMesh) -> None:
    top = body.positions[np.argmax(body.positions[:, 1])]
    own, hat = ball("my_eye", top - [0, 0.3, 0], 0.1), ball("hat", top, 0.1)
    parts = Part("skin", body), Part("my_eye", own), Part("hat", hat)
    write_document("B.glb", character_glb(Character(parts[:2])), force=True)
    outcome = run.done("rig B.glb --like C.glb -o OUT.glb --force")
    assert "eye: the body has its own and keeps them" in outcome.err
    made = read_character("OUT.glb")
    assert {part.name for part in made.parts} == {"body", "hat", "my_eye"}
    kept = part_named(made, "my_eye")
    np.testing.assert_allclose(np.sort(kept.mesh.positions, axis=0), np.sort(own.positions, axis=0), atol=1e-5)
    np.testing.assert_allclose(kept.weights.sum(axis=1), 1.0, atol=1e-6)
    write_document("B.glb", character_glb(Character((parts[0], parts[2]))), force=True)
    assert {part.name for part in rig_done(run, "--passengers", "hat", "--force").parts} == {"body", "hat", "hat (own)"}


def test_an_own_part_may_have_the_name_of_a_joint(run: Run, files: Character, body: ControlMesh) -> None:
    own = Part("skin", body), Part("chest", ball("chest", body.positions.mean(axis=0), 0.1))
    write_document("B.glb", character_glb(Character(own)), force=True)
    made = rig_done(run)
    assert {part.name for part in made.parts} == {"body", "hat", "eye", "chest (own)"}
    assert made.rig.names == files.rig.names


@pytest.mark.slow
def test_a_character_without_passengers_gives_its_body(run: Run, files: Character) -> None:
    assert {part.name for part in rig_done(run, "--passengers", "none").parts} == {"body"}


@pytest.mark.slow
def test_the_report_shows_what_the_body_wears_and_how_it_moves(run: Run, files: Character) -> None:
    outcome = run("rig", *"B.glb --like C.glb -o OUT.glb --passengers hat --report R.html".split())
    assert outcome.out.endswith("Open R.html in a browser.\n")
    page = Path("R.html").read_text()
    assert "B.glb" in page
    for shown in ("Passengers", "Poses", "Skinning weights", "Blend shapes", "nod, 0.5 s"):
        assert shown in page
    assert run("rig B.glb --like C.glb -o NEW.glb --report R.txt").code == 2
    assert not Path("NEW.glb").exists()
    Path("NEW.glb").write_bytes(b"mine")
    run.refused("rig B.glb --like C.glb -o NEW.glb", says="NEW.glb: exists, and was not written")
    assert Path("NEW.glb").read_bytes() == b"mine"


@pytest.mark.slow
def test_gltf_and_vrm_have_the_same_character(run: Run, files: Character) -> None:
    """A `.vrm` without VRM data is said; with the character's it is not."""
    made = rig_done(run)
    said = "OUT.vrm has no VRM data, since C.glb has none"
    for name in ("OUT.gltf", "OUT.vrm"):
        outcome = run.done("rig B.glb --like C.glb -o", name)
        assert (said in outcome.err) == (name == "OUT.vrm")
        found = read_character(name)
        assert [part.name for part in found.parts] == [part.name for part in made.parts]
    document = read_document("C.glb")
    top = document.json | {"extensions": {"VRM": {"specVersion": "0.0"}}, "extensionsUsed": ["VRM"]}
    write_document("C.glb", replace(document, json=top), force=True)
    assert said not in run.done("rig B.glb --like C.glb -o OUT.vrm --force").err


def test_a_steep_shape_of_the_same_body_stays_as_it_is(body: ControlMesh) -> None:
    steep = np.zeros((body.n_vertices, 3))
    steep[40] = 3.0
    bodies = match_bodies(Part("a", body), Part("b", body, shapes={"steep": steep}), Landmarks.none(), Stages())
    np.testing.assert_allclose(body_shapes(bodies)["steep"], steep, atol=1e-9)


def test_spring_bones_have_the_size_of_the_body(run: Run, files: Character, body: ControlMesh) -> None:
    """Radii and offsets of VRM 1 and 0 on a body of twice the size; numbers of nodes and UV offsets stay."""
    document = read_document("C.glb")
    sphere, joint = {"offset": [0, 0.5, 0], "radius": 1}, {"node": 1, "hitRadius": 0.25, "stiffness": 1.0}
    uv, eyes = {"material": 0, "offset": [0.5, 0.5]}, {"offsetFromHeadBone": [0.0, 0.5, 0.0]}
    document.json["extensions"] = {
        "VRMC_springBone": {"colliders": [{"node": 1, "shape": {"sphere": sphere}}], "springs": [{"joints": [joint]}]},
        "VRMC_vrm": {"lookAt": eyes, "expressions": {"custom": {"blush": {"textureTransformBinds": [uv]}}}},
        "VRM": {"secondaryAnimation": {"colliderGroups": [{"node": 1, "colliders": [{"offset": {"x": 0.5}}]}]}},
    }
    write_document("C.glb", document, force=True)
    write_mesh("B.glb", body.with_positions(2 * body.positions), force=True)
    rig_done(run)
    made = read_document("OUT.glb").json["extensions"]
    (collider,), (spring,) = made["VRMC_springBone"]["colliders"], made["VRMC_springBone"]["springs"]
    assert collider["shape"]["sphere"]["offset"] == pytest.approx([0, 1, 0], rel=1e-3)
    assert collider["shape"]["sphere"]["radius"] == pytest.approx(2, rel=1e-3)
    assert collider["node"] == spring["joints"][0]["node"] == spring["joints"][0]["stiffness"] == 1
    assert spring["joints"][0]["hitRadius"] == pytest.approx(0.5, rel=1e-3)
    assert made["VRMC_vrm"]["lookAt"]["offsetFromHeadBone"] == pytest.approx([0, 1, 0], rel=1e-3)
    assert made["VRMC_vrm"]["expressions"]["custom"]["blush"]["textureTransformBinds"] == [uv]
    (group,) = made["VRM"]["secondaryAnimation"]["colliderGroups"]
    assert group["colliders"][0]["offset"]["x"] == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("suffix", [".glb", ".usda"])
def test_animations_that_start_late_start_at_0_in_gltf_and_stay_in_usd(run: Run, files: Character, suffix) -> None:
    """At frame 1001, with a shape and a pose of one key; another one starts at 0."""
    if suffix == ".usda":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    (nod,), late = files.animations, 1001 / 24
    weights = ShapeTrack("body", ("raise",), late + np.arange(2.0), np.array([[0.0], [1.0]]))
    still = Track(0, "rotation", np.zeros(1), nod.tracks[0].values[1:])
    wave = Animation("wave", (replace(nod.tracks[0], times=late + np.arange(2.0)), still), (weights,))
    document = character_glb(replace(files, animations=(wave, nod)))
    write_document("C.glb", document, force=True)
    made = character_of(document)
    if suffix == ".usda":
        write_usd_character("C.usda", made, read_scene(document))
    outcome = run.done(f"rig B.glb --like C{suffix} --keep-textures -o OUT.glb")
    assert "animations moved to start at 0 in OUT.glb, as programs expect: wave (from 41.7 s)" in outcome.err
    found = read_character("OUT.glb")
    assert [animation.name for animation in found.animations] == ["wave", "nod"]
    for animation, given, shift in zip(found.animations, made.animations, (late, 0.0), strict=True):
        for time in (0.0, 0.7, 1.0):
            poses = pose_at(found.rig, animation, time), pose_at(made.rig, given, time + shift)
            np.testing.assert_allclose(*poses, atol=1e-4)
    (track,) = found.animations[0].shape_tracks
    np.testing.assert_allclose(track.times, [0.0, 1.0], atol=1e-5)
    if suffix == ".usda":
        assert "moved to start" not in run.done("rig B.glb --like C.usda --keep-textures -o OUT.usda").err
        (kept,) = (one for one in read_body(Path("OUT.usda"))[1].animations if one.name == "wave")
        np.testing.assert_allclose(kept.shape_tracks[0].times, late + np.arange(2.0), atol=1e-4)


@pytest.mark.parametrize("factor", [0.01, 1.0, 2.0, 100.0])
def test_a_body_of_another_unit_is_named_and_moves_as_far_as_it_is_large(files, body, factor: float) -> None:
    """Joints, hat and the motion of the root in the size of the body."""
    places = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    walk = Animation("walk", (Track(0, "translation", np.arange(2.0), files.rig.local[0, 3, :3] + places),))
    write_character(Path("C.glb"), replace(files, animations=(walk,)))
    write_mesh("B.glb", body.with_positions(factor * body.positions), force=True)
    said = tasks.run(RigRequest(Path("B.glb"), Path("C.glb"), Path("OUT.glb"))).warnings
    assert any(f"B.glb is {factor:g} times as large as C.glb" in text for text in said) == (factor not in (1.0, 2.0))
    made, time = read_character("OUT.glb"), 1.0
    pose = pose_at(made.rig, made.animations[0], time)
    for given in files.parts:
        found = part_named(made, given.name)
        scaled = replace(given, mesh=given.mesh.with_positions(factor * given.mesh.positions))
        moved = skinned_positions(found, made.rig, pose)[same_order(found, scaled, 1e-4 * factor)]
        np.testing.assert_allclose(moved / factor, given.mesh.positions + places[1], atol=1e-4)


def test_clothes_are_outside_the_flat_faces_of_a_cage() -> None:
    """An OBJ body is matched subdivided and written as it is: its faces came through the clothes."""
    cage = refine(cube(), 3)
    faces = cage.finest.faces
    skin, shirt = (
        with_options(ControlMesh.from_faces(size * cage.finest.positions, faces), "none") for size in (1.0, 1.02)
    )
    source = Character((Part("body", skin), Part("shirt", shirt)))
    made = carry_character(Character((Part("body", cage.control),)), source).character
    cloth, half = part_named(made, "shirt").mesh.positions, np.abs(cage.control.positions).max()
    assert np.abs(cloth).max(axis=1).min() > half


@pytest.mark.slow
@pytest.mark.parametrize("body_file", ["target_B_body.glb", "target_B_soma18056.glb"])
def test_a_real_character_on_another_body(run, shared_data, tmp_path, monkeypatch, body_file):
    """Joints within 1.5 % of sqrt(area) of the truth in the mean; eleven parts, five shapes, the animation."""
    monkeypatch.chdir(tmp_path)
    rigs = shared_data / "characters" / "rigs"
    run.done("rig", rigs / body_file, "--like", rigs / "character_A.glb", "-o", "OUT.glb", "--size", 256)
    made, truth = read_character("OUT.glb"), read_character(rigs / "truth" / "character_B.glb")
    assert made.rig.names == truth.rig.names
    assert {part.name for part in made.parts} == {part.name for part in truth.parts}
    body, true = part_named(made, "body"), part_named(truth, "body")
    assert len(body.shapes) == 5
    assert len(made.animations) == 1
    size = float(np.sqrt(face_areas(true.mesh).sum()))
    assert np.linalg.norm(made.rig.heads - truth.rig.heads, axis=1).mean() < 0.015 * size
    if body_file == "target_B_body.glb":  # the faces of the character's body
        np.testing.assert_allclose(body.weights.toarray(), true.weights.toarray(), rtol=0, atol=1e-5)
        # 0.76 if a shape of the lids is fitted to displacements as loosely as one of the whole body.
        errors = [np.linalg.norm(body.shapes[name] - true.shapes[name]) for name in true.shapes]
        assert np.mean(errors / np.array([np.linalg.norm(of) for of in true.shapes.values()])) < 0.35
