"""Skins, bind poses, armatures and animations of glTF files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagemap.character.poses import pose_at, world_transforms
from cagemap.character.values import skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.nodes import transform
from cagemap.files.gltf.read import gltf_skeleton
from cagemap.files.gltf.write import character_glb

from gltf_scenes import Maker, arm, changed, matrices, moved
from refusals import refuses


def _rest(rig: Any) -> np.ndarray:
    world = rig.local.copy()
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            world[joint] = rig.local[joint] @ world[parent]
    return world


@pytest.mark.parametrize("bind", [np.eye(4), moved(0, 0, 3), np.diag([2.0, 2.0, 2.0, 1.0])])
def test_a_skin_in_its_bind_pose(bind: np.ndarray) -> None:
    character = character_of(arm(bind=bind))
    ball, strip = character.parts
    rig = character.rig
    assert rig.names == ("upper", "lower")
    np.testing.assert_allclose(strip.mesh.positions.max(axis=0), [2, 1, 0], atol=1e-6)
    np.testing.assert_allclose(rig.heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(strip.weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(strip.weights.toarray()[2], [0.5, 0.5])
    np.testing.assert_allclose(skinned_positions(strip, rig, _rest(rig)), strip.mesh.positions, atol=1e-6)
    np.testing.assert_array_equal(ball.weights.toarray(), [[0, 1]] * 3)
    np.testing.assert_allclose(ball.mesh.positions[0], [1, 0, 5])


def test_shapes_turn_with_the_bind_pose() -> None:
    grown = character_of(arm(bind=np.diag([0.5, 0.5, 0.5, 1.0]))).parts[1]
    np.testing.assert_allclose(grown.shapes["raise"][4:], [[0, 0, 2]] * 2, atol=1e-6)


def test_an_armature_is_part_of_the_transforms_of_its_joints(tmp_path: Path) -> None:
    quarter = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    above = {"scale": [0.1, 0.1, 0.1], "rotation": quarter, "translation": [0, 0, 3]}
    plain, turned = character_of(arm()), character_of(arm(above=above))
    placed = np.eye(4)
    placed[:3, :3] = 0.1 * np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)])
    placed[3, 2] = 3.0
    np.testing.assert_allclose(turned.rig.heads, (plain.rig.bind @ placed)[:, 3, :3], atol=1e-6)
    for one, other in zip(turned.parts, plain.parts, strict=True):
        expected = np.column_stack([other.mesh.positions, np.ones(other.mesh.n_vertices)]) @ placed
        np.testing.assert_allclose(one.mesh.positions, expected[:, :3], atol=1e-6)
    write_document(tmp_path / "arm.glb", arm(above=above))
    axes = gltf_skeleton(tmp_path / "arm.glb").axes
    np.testing.assert_allclose(axes, [10 * placed[:3, :3]] * 2, atol=1e-6)
    root = next(track for track in turned.animations[0].tracks if track.channel == "translation")
    np.testing.assert_allclose(root.values, [[0, 0, 3], [0, -0.1, 3], [0, 0, 3]], atol=1e-6)
    bend = next(track for track in turned.animations[0].tracks if track.channel == "rotation")
    assert turned.rig.names[bend.joint] == "lower"
    np.testing.assert_allclose(bend.values[1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-6)
    assert len(turned.animations[0].tracks) == 2


def test_a_turned_armature_turns_the_rotations_of_its_root() -> None:
    quarter = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]
    document = arm(above={"rotation": quarter})
    document.json["animations"][0]["channels"][0]["target"]["node"] = 1
    character = character_of(document)
    track = next(one for one in character.animations[0].tracks if one.channel == "rotation")
    np.testing.assert_allclose(np.abs(track.values[0] @ quarter), 1.0)
    both = np.array([0.5, 0.5, 0.5, 0.5])  # about z, then about y
    np.testing.assert_allclose(np.abs(track.values[1] @ both), 1.0, atol=1e-6)


def test_a_mirrored_armature_mirrors_the_scales_of_its_root() -> None:
    document = arm(above={"scale": [-2, 2, 2]})
    document.json["animations"][0]["channels"] = [{"sampler": 1, "target": {"node": 1, "path": "scale"}}]
    character = character_of(document)
    posed = pose_at(character.rig, character.animations[0], 0.5)  # scale 0, 0, 1 of the first joint
    np.testing.assert_allclose(posed[0, :3, :3], np.diag([0, 0, 1]) @ np.diag([-2, 2, 2]), atol=1e-6)


@pytest.mark.parametrize("scale", [(-1.0, 2.0, 3.0), (-1.0, -2.0, 3.0)])
def test_animations_of_joints_with_negative_scales(scale: tuple[float, ...]) -> None:
    """A rotation alone moves a joint, mirrored along one axis or turned along two; also when it is written again."""
    document = arm()
    document.json["nodes"][2]["scale"] = list(scale)
    times = document.json["animations"][0]["samplers"][0]["input"]
    for character in (character_of(document), character_of(character_glb(character_of(document), document))):
        posed = pose_at(character.rig, character.animations[0], 0.5)
        turned = transform(np.array([1.0, 0, 0]), np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)]), np.array(scale))
        np.testing.assert_allclose(posed[1], turned @ moved(0, 0, 1), atol=1e-6)
    grown = json.loads(json.dumps(document.json["animations"]))
    grown[0]["samplers"][0] = {"input": times, "output": grown[0]["samplers"][1]["output"]}
    grown[0]["channels"] = [{"sampler": 0, "target": {"node": 2, "path": "scale"}}]
    character = character_of(changed(document, animations=grown))
    np.testing.assert_allclose(
        pose_at(character.rig, character.animations[0], 0.5)[1, :3, :3], np.diag([0, 0, 1]), atol=1e-6
    )


@pytest.mark.parametrize("node", ["ball", "socket"])
def test_a_mesh_below_a_joint_keeps_its_own_motion(node: str) -> None:
    """The mesh's node or one above it moves; also when the character is written again."""
    document = arm()
    nodes, (animation,) = document.json["nodes"], document.json["animations"]
    nodes[2]["children"] = [5]
    nodes.append({"name": "socket", "children": [3], "scale": [1, 2, 1]})
    animation["channels"].append({"sampler": 1, "target": {"node": 3 if node == "ball" else 5, "path": "translation"}})
    for character in (character_of(document), character_of(character_glb(character_of(document), document))):
        rig, ball = character.rig, character.parts[0]
        assert rig.names[-1] == node
        assert set(ball.weights.indices) == {len(rig.names) - 1}
        posed = skinned_positions(ball, rig, pose_at(rig, character.animations[0], 0.5))
        height = 2.0 if node == "ball" else 7.0  # 1 of the upper joint; at rest the ball is 5 above its parent
        np.testing.assert_allclose(posed[0], [1, 0, height], atol=1e-6)


@pytest.mark.parametrize("is_animated", [True, False])
def test_a_mesh_below_an_armature_that_is_a_joint_keeps_its_own_motion(is_animated: bool) -> None:
    """The armature is animated, or scaled unevenly."""
    document = arm(above=None if is_animated else {"scale": [1, 1, 2]})
    nodes, (animation,) = document.json["nodes"], document.json["animations"]
    nodes[0]["children"], nodes[2]["children"] = [1, 3], []
    moving = [3, 0] if is_animated else [3]
    animation["channels"] += [{"sampler": 1, "target": {"node": node, "path": "translation"}} for node in moving]
    for character in (character_of(document), character_of(character_glb(character_of(document), document))):
        rig, ball = character.rig, character.parts[0]
        assert {rig.names[joint] for joint in ball.weights.indices} == {"ball"}
        posed = skinned_positions(ball, rig, pose_at(rig, character.animations[0], 0.5))
        np.testing.assert_allclose(posed[0], [0, 0, 2], atol=1e-6)


def test_a_moved_mesh_of_no_size_at_rest_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    document = arm()
    document.json["nodes"][3]["scale"] = [0, 0, 0]
    document.json["animations"][0]["channels"].append({"sampler": 1, "target": {"node": 3, "path": "scale"}})
    assert character_of(document).rig.names == ("upper", "lower")
    assert "is scaled to nothing and left out" in caplog.text


def test_an_animated_armature_is_a_joint() -> None:
    document = arm(above={"translation": [0, 0, 3]})
    document.json["animations"][0]["channels"][0]["target"]["node"] = 0
    rig = character_of(document).rig
    assert rig.names == ("armature", "upper", "lower")
    np.testing.assert_array_equal(rig.parents, [-1, 0, 1])


def _two_skins() -> tuple[Document, np.ndarray, np.ndarray, np.ndarray]:
    """Two strips on the same joints, the second bound with its second joint bent; their points, weights and binds."""
    make, bent = Maker(), moved(1, 0, 0)
    bent[:3, :3] = Rotation.from_rotvec([0, 0, -0.8]).as_matrix()
    binds = np.array([[moved(0, 0, 0), moved(1, 0, 0)], [moved(0, 0, 0), bent]])
    points = np.array([[(x, y, z) for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0)] for z in (0.0, 3.0)])
    weights = np.repeat([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]], 2, axis=0)
    common = {
        "JOINTS_0": make.add(np.tile([0, 1, 0, 0], (6, 1)), "u1"),
        "WEIGHTS_0": make.add(np.pad(weights, ((0, 0), (0, 2)))),
    }
    indices = make.add([0, 2, 1, 1, 2, 3, 2, 4, 3, 3, 4, 5], "<u2")
    meshes = [
        {"primitives": [{"attributes": {"POSITION": make.add(of_mesh)} | common, "indices": indices}]}
        for of_mesh in points
    ]
    skins = [{"joints": [0, 1], "inverseBindMatrices": make.add(matrices(np.linalg.inv(of_skin)))} for of_skin in binds]
    nodes = [{"name": "a", "children": [1]}, {"name": "b", "translation": [1, 0, 0]}]
    nodes += [{"name": f"strip {number}", "mesh": number, "skin": number} for number in (0, 1)]
    document = make.document(scene=0, scenes=[{"nodes": [0, 2, 3]}], nodes=nodes, meshes=meshes, skins=skins)
    return document, points, weights, binds


def test_joints_that_two_skins_bind_in_other_poses_move_both_as_the_file_says() -> None:
    document, points, weights, binds = _two_skins()
    character = character_of(document)
    pose = np.array([moved(0, 0, 0), moved(1, 0, 0)])
    pose[:, :3, :3] = Rotation.from_rotvec([(0.3, 0.2, 0.1), (0.1, 0.9, -1.1)]).as_matrix()
    joints = world_transforms(pose, np.array([-1, 0]))
    for found in (character, character_of(character_glb(character, document))):
        rig = found.rig
        local = rig.local.copy()
        for joint, of_joint in zip(("a", "b"), pose, strict=True):
            local[rig.names.index(joint)] = of_joint
        placed = world_transforms(local, rig.parents)
        for number, part in enumerate(found.parts):
            blended = np.einsum("vj,jab->vab", weights, np.linalg.inv(binds[number]) @ joints)
            meant = np.einsum("va,vab->vb", np.column_stack([points[number], np.ones(6)]), blended)[:, :3]
            got = skinned_positions(part, rig, placed)
            np.testing.assert_allclose(got[np.lexsort(got.T.round(3))], meant[np.lexsort(meant.T.round(3))], atol=1e-5)


def test_of_keys_at_the_same_time_the_last_one_counts(caplog: pytest.LogCaptureFixture) -> None:
    document = arm()
    times = document.json["animations"][0]["samplers"][0]["input"]
    at = document.json["bufferViews"][document.json["accessors"][times]["bufferView"]]["byteOffset"]

    def with_times(*stated: float) -> Document:
        (data,) = document.buffers
        return replace(document, buffers=(data[:at] + np.array(stated, "<f4").tobytes() + data[at + 12 :],))

    (before,), (after,) = (character_of(one).animations for one in (document, with_times(0.0, 2.0, 2.0)))
    for one, other in zip(before.tracks, after.tracks, strict=True):
        np.testing.assert_array_equal(other.times, [0.0, 2.0])
        np.testing.assert_array_equal(other.values, one.values[[0, 2]])
    assert caplog.messages == ["made.glb: animations 0 has several keys at the same time, the last one is used"]
    refuses(FormatError, "rotation of lower: expected rising times", character_of, with_times(0.0, 2.0, 1.0))
