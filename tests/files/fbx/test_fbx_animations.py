"""Animations, poses and scales of FBX files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cagemap.character.poses import parent_transforms
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import read_accessor

from fbx_scenes import BOX, SECOND, Node, add_curve, fbx_arm, fbx_file, half_a_second_in, properties

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")


def test_an_animation_moves_joints_and_shapes(tmp_path: Path) -> None:
    path = fbx_file(tmp_path, fbx_arm())
    character = read_character(path)
    assert [one.name for one in character.animations] == ["bend"]
    np.testing.assert_allclose(half_a_second_in(character)[4:], [[1, 1, 0], [0, 1, 0]], atol=1e-5)
    document = read_document(path)
    paths = [channel["target"]["path"] for channel in document.json["animations"][0]["channels"]]
    assert paths == ["rotation", "weights"]


def test_a_shape_moves_on_all_nodes_that_share_its_mesh(tmp_path: Path) -> None:
    made = fbx_arm()
    mesh = made.named("Geometry", "Mesh").properties[0]
    made.connect(mesh, made.add("Model", "second", "Mesh"))
    document = read_document(fbx_file(tmp_path, made))
    nodes = [node["name"] for node in document.json["nodes"]]
    targets = [channel["target"] for channel in document.json["animations"][0]["channels"]]
    moved = {nodes[target["node"]] for target in targets if target["path"] == "weights"}
    assert moved == {"strip", "second"}


def test_a_shape_that_an_animation_does_not_move_keeps_its_weight(tmp_path: Path) -> None:
    made = fbx_arm()
    blend = made.named("Deformer", "BlendShape").properties[0]
    percent = Node("DeformPercent", (25.0,)), Node("FullWeights", (np.array([100.0]),))
    channel = made.add("Deformer", "lower", "BlendShapeChannel", *percent, to=blend)
    offsets = Node("Indexes", (np.array([0], "<i4"),)), Node("Vertices", (np.array([0.0, 0.0, -1.0]),))
    made.add("Geometry", "lower", "Shape", *offsets, to=channel)
    document = read_document(fbx_file(tmp_path, made))
    assert document.json["meshes"][0]["weights"] == [0.0, 0.25]
    animation = document.json["animations"][0]
    moved = next(one for one in animation["channels"] if one["target"]["path"] == "weights")
    output = animation["samplers"][moved["sampler"]]["output"]
    amounts = read_accessor(document, output, "weights", ("SCALAR",)).reshape(-1, 2)
    np.testing.assert_allclose(amounts, [[0.0, 0.25], [0.5, 0.25], [0.0, 0.25]], atol=1e-6)


def test_an_animation_that_begins_before_0_is_moved(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """In glTF no time is negative."""
    made = fbx_arm()
    keys = [one for curve in made.objects if curve.name == "AnimationCurve" for one in curve.inside]
    for times in (one for one in keys if one.name == "KeyTime"):
        times.properties = (times.properties[0] - SECOND,)
    document = read_document(fbx_file(tmp_path, made))
    (animation,) = document.json["animations"]
    starts = [document.json["accessors"][one["input"]]["min"] for one in animation["samplers"]]
    assert np.min(starts) == 0.0
    expected = half_a_second_in(read_character(fbx_file(tmp_path, fbx_arm(), "plain.fbx")))
    np.testing.assert_allclose(half_a_second_in(character_of(document)), expected, atol=1e-5)
    assert "animation bend begins 1 s before 0 and is moved to begin at 0" in caplog.text


def test_joints_posed_in_the_file_are_in_the_pose_of_the_bind(tmp_path: Path) -> None:
    plain, turned = (read_character(fbx_file(tmp_path, fbx_arm(posed=posed))) for posed in (False, True))
    for one in (plain, turned):
        np.testing.assert_allclose(one.rig.local, parent_transforms(one.rig.bind, one.rig.parents), atol=1e-6)
    np.testing.assert_allclose(half_a_second_in(turned), half_a_second_in(plain), atol=1e-6)
    made = fbx_arm(posed=True)
    made.connections = [one for one in made.connections if "Lcl Rotation" not in one.properties]
    still = half_a_second_in(read_character(fbx_file(tmp_path, made)))
    turn = np.radians(30.0)
    np.testing.assert_allclose(still[4], [1 + np.cos(turn), np.sin(turn), 0.0], atol=1e-5)


@pytest.mark.parametrize("moving", [False, True])
def test_uneven_scales_that_children_inherit_otherwise_than_in_gltf(moving, tmp_path, caplog):
    """InheritType 0: scales multiply along the axes of each joint. Names and the hierarchy stay."""
    made = fbx_arm()
    upper, lower = (one for one in made.objects if one.properties[2] == "LimbNode")
    upper.inside.append(properties(Lcl_Scaling=(1.0, 1.0, 2.0)))
    lower.inside[0].inside += properties(InheritType=0).inside
    box = made.add("Model", "box", "Mesh", properties(Lcl_Scaling=(1.0, 1.0, 3.0), InheritType=0))
    made.add("Geometry", "box", "Mesh", *BOX, to=box)
    if moving:
        add_curve(made, upper.properties[0], "Lcl Scaling", "d|Z", (2.0, 4.0, 2.0), others=1.0)
    character = read_character(fbx_file(tmp_path, made))
    said = "animation bend: 2 moving scales left out, which children inherit otherwise than in glTF"
    assert (said in caplog.text) == moving
    assert [part.name for part in character.parts] == ["strip", "box"]
    assert character.rig.names == ("upper", "lower")
    np.testing.assert_array_equal(character.rig.parents, [-1, 0])
    expected = [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
    np.testing.assert_allclose(half_a_second_in(character)[[0, 1, 4, 5]], expected, atol=1e-5)
