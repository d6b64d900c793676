"""Materials, textures, animations, poses and scales of FBX files."""

import logging
from pathlib import Path

import numpy as np
import pytest

from cagemap.character.poses import parent_transforms
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import image_bytes, read_accessor
from cagemap.files.gltf.textures import material_images
from cagemap.files.meshes.formats import read_mesh

from fbx_scenes import (
    BOX,
    PNG,
    SECOND,
    Node,
    add_curve,
    add_layer,
    fbx_arm,
    fbx_file,
    half_a_second_in,
    layer,
    properties,
)

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")


@pytest.mark.parametrize("where", ["inside", "below"])
def test_a_texture_inside_the_file_or_beside_it(where: str, tmp_path: Path) -> None:
    made = fbx_arm(image=PNG if where == "inside" else b"")
    if where != "inside":
        material = made.named("Material").properties[0]
        texture = fbx_arm(image=PNG).named("Texture")
        made.add("Texture", "skin", "", *texture.inside, to=material, by="DiffuseColor")
        folder = tmp_path / "textures"
        folder.mkdir()
        (folder / "skin.png").write_bytes(PNG)
    document = read_document(fbx_file(tmp_path, made))
    assert image_bytes(document, 0) == (PNG, ".png")
    assert document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}


@pytest.mark.parametrize(("angle", "across", "deep"), [(30.0, 4.0, 1), (0.0, 2.0, 0), (30.0, 2.0, 1), (0.0, 0.0, 1)])
def test_a_texture_that_is_moved_turned_and_scaled(angle, across, deep, tmp_path, caplog):
    """FBX scales, turns and moves the image: not always what glTF can say; the third scale, 0 by assimp, is ignored."""
    made = fbx_arm(image=PNG)
    texture = made.named("Texture")
    moved = {"Translation": (0.25, 0.5, 0.0), "Rotation": (0.0, 0.0, angle), "Scaling": (across, 4.0, float(deep))}
    texture.inside.append(properties(**moved))
    (image,) = material_images(read_document(fbx_file(tmp_path, made)), "skin")
    on_image = np.random.default_rng(2).uniform(size=(5, 2))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    uvs = on_image * [across, 4.0] @ np.array([[c, s], [-s, c]]) + [0.25, 0.5]
    if (angle and across != 4.0) or not across:
        assert "is turned and stretched" in caplog.text
        on_image = uvs
    np.testing.assert_allclose(image.on_image(uvs), on_image, atol=1e-6)


@pytest.mark.parametrize("layered", [False, True])
@pytest.mark.parametrize(("named", "coordinates"), [("second", 1), ("map", 0), ("unknown", 0)])
def test_a_texture_of_another_uv_set(named: str, coordinates: int, layered: bool, tmp_path: Path) -> None:
    made = fbx_arm(image=PNG)
    add_layer(made, layer("UV", "second", "ByPolygonVertex", UV=np.full(2, 0.25), UVIndex=np.zeros(8, "<i4")))
    texture = made.named("Texture")
    texture.inside.append(properties(UVSet=named))
    if layered:
        number = texture.properties[0]
        of_material = next(one for one in made.connections if one.properties[1] == number and one.properties[0] == "OP")
        above = made.add("LayeredTexture", "layers", "", to=of_material.properties[2], by="DiffuseColor")
        of_material.properties = ("OO", number, above)
    path = fbx_file(tmp_path, made)
    (image,) = material_images(read_document(path), "skin")
    assert image.uv_set == f"TEXCOORD_{coordinates}"
    assert (read_mesh(path).uv_sets[0].uvs == 0.25).all()


def test_further_layers_of_a_texture_are_said_to_be_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm(image=PNG)
    material, texture = (made.named(kind).properties[0] for kind in ("Material", "Texture"))
    above = made.add("LayeredTexture", "layers", "", to=material, by="DiffuseColor")
    made.connections = [one for one in made.connections if one.properties[1:3] != (texture, material)]
    made.connect(texture, above)
    named = [Node("FileName", ("dirt.png",)), Node("RelativeFilename", ("dirt.png",))]
    dirt = made.add("Texture", "dirt", "", *named, to=above)
    made.add("Video", "dirt", "Clip", *named, Node("Content", (PNG + b"2",)), to=dirt)
    assert len(material_images(read_document(fbx_file(tmp_path, made)), "skin")) == 1
    assert "material skin: baseColorTexture: has 2 layers, the first is used" in caplog.text


def test_a_texture_that_is_clamped_stays_so(tmp_path: Path) -> None:
    made = fbx_arm(image=PNG)
    texture = made.named("Texture")
    texture.inside.append(properties(WrapModeU=1, WrapModeV=0))
    document = read_document(fbx_file(tmp_path, made))
    (sampler,) = document.json["samplers"]
    assert document.json["textures"][0]["sampler"] == 0
    assert sampler == {"wrapS": 33071, "wrapT": 10497}


def test_a_texture_that_is_not_there_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "skin.png").write_bytes(PNG)  # outside the folder of the file
    made = fbx_arm(image=b"gone")
    made.objects = [one for one in made.objects if one.name != "Video"]
    document = read_document(fbx_file(folder, made))
    assert "images" not in document.json
    assert r"'..\skin.png' is not found and left out" in caplog.text


def test_a_texture_that_cannot_be_read_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document = read_document(fbx_file(tmp_path, fbx_arm(image=b"no image")))
    assert "images" not in document.json
    assert "skin.png' cannot be read as an image and is left out" in caplog.text


@pytest.mark.parametrize(
    ("skin", "alpha", "said"),
    [
        ({}, 1.0, False),
        ({"Opacity": 0.25}, 0.25, False),
        ({"TransparencyFactor": 0.75, "TransparentColor": (1.0, 1.0, 1.0)}, 0.25, False),
        ({"TransparencyFactor": 1.0, "TransparentColor": (0.0, 0.0, 0.0)}, 1.0, False),
        ({"TransparencyFactor": 1.0, "TransparentColor": (1.0, 1.0, 1.0)}, 1.0, True),
    ],
)
def test_opacity_is_kept(skin, alpha, said, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        document = read_document(fbx_file(tmp_path, fbx_arm(**skin)))
    (material,) = document.json["materials"]
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.5, 0.25, 1.0, alpha])
    assert material.get("alphaMode") == ("BLEND" if alpha < 1.0 else None)
    assert ("taken as opaque" in caplog.text) == said


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
