"""FBX files: read in a process of their own, as what they hold in metres with Y up."""

from __future__ import annotations

import json
import logging
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.poses import parent_transforms, pose_at
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.errors import FormatError
from cagemap.files.fbx import read as fbx_read
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import image_bytes, read_accessor
from cagemap.files.gltf.material_images import material_images
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.rigs import read_shapes, read_skeleton
from cagemap.mesh import Plain
from cagemap.tasks.mesh_commands import run_check, run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest, RefineRequest

from fbx_scenes import SECOND, TO_FBX, Fbx, Node, add_curve, add_layer, fbx_arm, geometry, layer, properties
from gltf_scenes import arm

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")
PNG = b"\x89PNG" + bytes(60)


BOX = geometry(cube().positions, cube().face_indices.reshape(-1, 4))


def _file(folder: Path, made: Fbx, name: str = "arm.fbx") -> Path:
    path = folder / name
    path.write_bytes(made.bytes())
    return path


def _at_half_a_second(character: Character) -> np.ndarray:
    assert character.rig is not None
    return skinned_positions(character.parts[0], character.rig, pose_at(character.rig, character.animations[0], 0.5))


def test_a_made_file_holds_what_its_gltf_twin_holds(tmp_path: Path) -> None:
    character = read_character(_file(tmp_path, fbx_arm()))
    (strip,), twin = character.parts, character_of(arm()).parts[1]
    assert isinstance(strip.mesh.scheme, Plain)
    np.testing.assert_allclose(strip.mesh.positions, twin.mesh.positions, atol=1e-6)
    np.testing.assert_array_equal(strip.mesh.face_indices, [0, 2, 3, 1, 2, 4, 5, 3])
    np.testing.assert_array_equal(strip.mesh.face_sizes, [4, 4])
    np.testing.assert_allclose(
        strip.mesh.uvs[strip.mesh.uv_indices], strip.mesh.positions[strip.mesh.face_indices, :2] / 2, atol=1e-6
    )
    np.testing.assert_allclose(strip.weights.toarray(), twin.weights.toarray(), atol=1e-6)
    np.testing.assert_allclose(strip.shapes["raise"], twin.shapes["raise"], atol=1e-6)
    assert strip.mesh.material_names == ("skin",)
    np.testing.assert_allclose(strip.mesh.material_colors, [[0.5, 0.25, 1.0]], atol=1e-6)
    assert character.rig.names == ("upper", "lower")
    np.testing.assert_allclose(character.rig.heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)


def test_an_animation_moves_joints_and_shapes(tmp_path: Path) -> None:
    path = _file(tmp_path, fbx_arm())
    character = read_character(path)
    assert [one.name for one in character.animations] == ["bend"]
    np.testing.assert_allclose(_at_half_a_second(character)[4:], [[1, 1, 0], [0, 1, 0]], atol=1e-5)
    document = read_document(path)
    paths = [channel["target"]["path"] for channel in document.json["animations"][0]["channels"]]
    assert paths == ["rotation", "weights"]


def test_a_shape_moves_on_all_nodes_that_share_its_mesh(tmp_path: Path) -> None:
    made = fbx_arm()
    mesh = next(one.properties[0] for one in made.objects if one.properties[-1] == "Mesh" and one.name == "Geometry")
    made.connect(mesh, made.add("Model", "second", "Mesh"))
    document = read_document(_file(tmp_path, made))
    nodes = [node["name"] for node in document.json["nodes"]]
    targets = [channel["target"] for channel in document.json["animations"][0]["channels"]]
    moved = {nodes[target["node"]] for target in targets if target["path"] == "weights"}
    assert moved == {"strip", "second"}


def test_a_shape_that_an_animation_does_not_move_keeps_its_weight(tmp_path: Path) -> None:
    made = fbx_arm()
    blend = next(one.properties[0] for one in made.objects if one.properties[-1] == "BlendShape")
    percent = Node("DeformPercent", (25.0,)), Node("FullWeights", (np.array([100.0]),))
    channel = made.add("Deformer", "lower", "BlendShapeChannel", *percent, to=blend)
    offsets = Node("Indexes", (np.array([0], "<i4"),)), Node("Vertices", (np.array([0.0, 0.0, -1.0]),))
    made.add("Geometry", "lower", "Shape", *offsets, to=channel)
    document = read_document(_file(tmp_path, made))
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
    document = read_document(_file(tmp_path, made))
    (animation,) = document.json["animations"]
    starts = [document.json["accessors"][one["input"]]["min"] for one in animation["samplers"]]
    assert np.min(starts) == 0.0
    expected = _at_half_a_second(read_character(_file(tmp_path, fbx_arm(), "plain.fbx")))
    np.testing.assert_allclose(_at_half_a_second(character_of(document)), expected, atol=1e-5)
    assert "animation bend begins 1 s before 0 and is moved to begin at 0" in caplog.text


def test_joints_posed_in_the_file_are_in_the_pose_of_the_bind(tmp_path: Path) -> None:
    """Also the animation is what it is with an unposed file, where it moves the joint and where it does not."""
    plain, turned = (read_character(_file(tmp_path, fbx_arm(posed=posed))) for posed in (False, True))
    for one in (plain, turned):
        np.testing.assert_allclose(one.rig.local, parent_transforms(one.rig.bind, one.rig.parents), atol=1e-6)
    np.testing.assert_allclose(_at_half_a_second(turned), _at_half_a_second(plain), atol=1e-6)
    made = fbx_arm(posed=True)
    made.connections = [one for one in made.connections if "Lcl Rotation" not in one.properties]
    still = _at_half_a_second(read_character(_file(tmp_path, made)))
    turn = np.radians(30.0)
    np.testing.assert_allclose(still[4], [1 + np.cos(turn), np.sin(turn), 0.0], atol=1e-5)


def test_leaf_bones_that_move_nothing_are_no_joints_and_check_says_what_a_file_holds(tmp_path: Path) -> None:
    path = _file(tmp_path, fbx_arm(leaf=True))
    assert read_character(path).rig.names == ("upper", "lower")
    assert "lower_end" in [node["name"] for node in read_document(path).json["nodes"]]
    text, _ = run_check(CheckRequest((path,)), Stages())
    assert [said for said in ("2 joints", "1 (raise)", "1 (bend (2 s))") if said not in text] == []


@pytest.mark.parametrize("where", ["inside", "below"])
def test_a_texture_inside_the_file_or_beside_it(where: str, tmp_path: Path) -> None:
    made = fbx_arm(image=PNG if where == "inside" else b"")
    if where != "inside":
        material = next(one.properties[0] for one in made.objects if one.name == "Material")
        named = fbx_arm(image=PNG).objects
        texture = next(one for one in named if one.name == "Texture")
        made.add("Texture", "skin", "", *texture.inside, to=material, by="DiffuseColor")
        folder = tmp_path / "textures"
        folder.mkdir()
        (folder / "skin.png").write_bytes(PNG)
    document = read_document(_file(tmp_path, made))
    assert image_bytes(document, 0) == (PNG, ".png")
    assert document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}


@pytest.mark.parametrize(("angle", "across", "deep"), [(30.0, 4.0, 1), (0.0, 2.0, 0), (30.0, 2.0, 1), (0.0, 0.0, 1)])
def test_a_texture_that_is_moved_turned_and_scaled(
    angle: float, across: float, deep: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """In FBX the image is scaled, turned and moved over the coordinates: not always what glTF can say.

    The third scale has no effect; assimp writes 0.
    """
    made = fbx_arm(image=PNG)
    texture = next(one for one in made.objects if one.name == "Texture")
    moved = {"Translation": (0.25, 0.5, 0.0), "Rotation": (0.0, 0.0, angle), "Scaling": (across, 4.0, float(deep))}
    texture.inside.append(properties(**moved))
    (image,) = material_images(read_document(_file(tmp_path, made)), "skin")
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
    texture = next(one for one in made.objects if one.name == "Texture")
    texture.inside.append(properties(UVSet=named))
    if layered:
        number = texture.properties[0]
        of_material = next(one for one in made.connections if one.properties[1] == number and one.properties[0] == "OP")
        above = made.add("LayeredTexture", "layers", "", to=of_material.properties[2], by="DiffuseColor")
        of_material.properties = ("OO", number, above)
    path = _file(tmp_path, made)
    (image,) = material_images(read_document(path), "skin")
    assert image.uv_set == f"TEXCOORD_{coordinates}"
    assert (read_mesh(path).uv_sets[0].uvs == 0.25).all()


def test_further_layers_of_a_texture_are_said_to_be_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm(image=PNG)
    material, texture = (
        next(one.properties[0] for one in made.objects if one.name == name) for name in ("Material", "Texture")
    )
    above = made.add("LayeredTexture", "layers", "", to=material, by="DiffuseColor")
    made.connections = [one for one in made.connections if one.properties[1:3] != (texture, material)]
    made.connect(texture, above)
    named = [Node("FileName", ("dirt.png",)), Node("RelativeFilename", ("dirt.png",))]
    made.add(
        "Video",
        "dirt",
        "Clip",
        *named,
        Node("Content", (PNG + b"2",)),
        to=made.add("Texture", "dirt", "", *named, to=above),
    )
    assert len(material_images(read_document(_file(tmp_path, made)), "skin")) == 1
    assert "material skin: baseColorTexture: has 2 layers, the first is used" in caplog.text


def test_a_texture_that_is_clamped_stays_so(tmp_path: Path) -> None:
    made = fbx_arm(image=PNG)
    texture = next(one for one in made.objects if one.name == "Texture")
    texture.inside.append(properties(WrapModeU=1, WrapModeV=0))
    document = read_document(_file(tmp_path, made))
    (sampler,) = document.json["samplers"]
    assert document.json["textures"][0]["sampler"] == 0
    assert sampler == {"wrapS": 33071, "wrapT": 10497}


def test_a_texture_that_is_not_there_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "skin.png").write_bytes(PNG)  # outside the folder of the file
    made = fbx_arm(image=b"gone")
    made.objects = [one for one in made.objects if one.name != "Video"]
    document = read_document(_file(folder, made))
    assert "images" not in document.json
    assert "skin.png' is not found and left out" in caplog.text


def test_a_texture_that_cannot_be_read_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document = read_document(_file(tmp_path, fbx_arm(image=b"no image")))
    assert "images" not in document.json
    assert "skin.png' cannot be read as an image and is left out" in caplog.text


def test_a_skin_without_joints_is_passed_over(tmp_path: Path) -> None:
    made = fbx_arm()
    mesh = next(one.properties[0] for one in made.objects if one.name == "Geometry")
    made.connections.insert(0, Node("C", ("OO", made.add("Deformer", "", "Skin", to=None), mesh)))
    character = read_character(_file(tmp_path, made))
    assert character.rig is not None
    assert character.rig.names == ("upper", "lower")


def test_vertices_of_no_face_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm()
    vertices = next(one.inside[0] for one in made.objects if one.name == "Geometry")
    vertices.properties = (np.append(vertices.properties[0], [0.0, 0.0, 900.0]),)
    assert read_mesh(_file(tmp_path, made)).n_vertices == 6
    assert "strip: 1 vertex of no face left out; later vertices have other numbers than in the file" in caplog.text


def test_stated_axes_turn_positions_shapes_joints_and_animations_alike(tmp_path: Path) -> None:
    """The same numbers, stated to have Z up and Y up."""
    made = fbx_arm()
    standing = read_character(_file(tmp_path, made))
    made.settings = Fbx(UpAxis=1, FrontAxis=2, FrontAxisSign=1).settings
    lying = read_character(_file(tmp_path, made))
    assert standing.rig is not None
    assert lying.rig is not None
    for one, other in (
        (standing.parts[0].mesh.positions, lying.parts[0].mesh.positions),
        (standing.parts[0].shapes["raise"], lying.parts[0].shapes["raise"]),
        (standing.rig.heads, lying.rig.heads),
        (_at_half_a_second(standing), _at_half_a_second(lying)),
    ):
        np.testing.assert_allclose(other, one @ TO_FBX / 100.0, atol=1e-5)


def test_units(tmp_path: Path) -> None:
    """Inches, moved by 50 of them along Z, which is up."""
    made = Fbx(UnitScaleFactor=2.54)
    model = made.add("Model", "box", "Mesh", properties(Lcl_Translation=(0.0, 0.0, 50.0)))
    made.add("Geometry", "box", "Mesh", *BOX, to=model)
    expected = 0.0254 * (cube().positions[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [0.0, 50.0, 0.0])
    np.testing.assert_allclose(read_mesh(_file(tmp_path, made)).positions, expected, atol=1e-6)


def _instances(folder: Path, translation: str) -> tuple[Part, Part]:
    """Two nodes with one mesh, 9 apart by a property of the nodes, as they are read."""
    made = Fbx(UpAxis=1, FrontAxis=2, FrontAxisSign=1, UnitScaleFactor=100.0)
    models = [
        made.add("Model", name, "Mesh", properties(**{translation: (x, 0.0, 0.0)}))
        for name, x in (("a", 0.0), ("b", 9.0))
    ]
    made.connect(made.add("Geometry", "box", "Mesh", *BOX, to=models[0]), models[1])
    one, other = read_character(_file(folder, made)).parts
    assert (one.name, other.name) == ("a", "b")
    return one, other


def test_an_instance_has_its_own_place_and_with_y_up_nothing_turns(tmp_path: Path) -> None:
    one, other = _instances(tmp_path, "Lcl_Translation")
    np.testing.assert_allclose(one.mesh.positions, cube().positions, atol=1e-6)
    np.testing.assert_array_equal(one.mesh.face_indices, cube().face_indices)
    np.testing.assert_allclose(other.mesh.positions, cube().positions + np.array([9.0, 0.0, 0.0]), atol=1e-5)


@pytest.mark.parametrize("across", [1.0, -1.0])
def test_a_geometric_transform_moves_positions_and_shapes_and_turns_mirrored_faces(
    across: float, tmp_path: Path
) -> None:
    """It moves the mesh of a node, but not the node's children; 3ds Max writes it."""
    made = fbx_arm()
    model = next(one for one in made.objects if one.name == "Model")
    model.inside.append(
        properties(
            GeometricScaling=(across, 2.0, 3.0),
            GeometricRotation=(0.0, 0.0, 90.0),
            GeometricTranslation=(50.0, 0.0, 0.0),
        )
    )
    plain = read_character(_file(tmp_path, fbx_arm(), "plain.fbx")).parts[0]
    part = read_character(_file(tmp_path, made)).parts[0]
    linear = TO_FBX @ np.diag([across, 2.0, 3.0]) @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] @ np.linalg.inv(TO_FBX)
    np.testing.assert_allclose(part.mesh.positions, plain.mesh.positions @ linear + [0.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(part.shapes["raise"], plain.shapes["raise"] @ linear, atol=1e-6)
    corners = part.mesh.positions[part.mesh.face(0)]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert normal @ (np.array([0.0, 0.0, 1.0]) @ linear) > 0.0


def test_instances_with_other_geometric_transforms_keep_their_names(tmp_path: Path) -> None:
    one, other = _instances(tmp_path, "GeometricTranslation")
    np.testing.assert_allclose(other.mesh.positions - one.mesh.positions, np.tile([9.0, 0.0, 0.0], (8, 1)), atol=1e-5)


@pytest.mark.parametrize("moving", [False, True])
def test_uneven_scales_that_children_inherit_otherwise_than_in_gltf(
    moving: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """InheritType 0: scales multiply along the axes of each joint. Names and the hierarchy stay."""
    made = fbx_arm()
    upper, lower = (one for one in made.objects if one.properties[2] == "LimbNode")
    upper.inside.append(properties(Lcl_Scaling=(1.0, 1.0, 2.0)))
    lower.inside[0].inside += properties(InheritType=0).inside
    box = made.add("Model", "box", "Mesh", properties(Lcl_Scaling=(1.0, 1.0, 3.0), InheritType=0))
    made.add("Geometry", "box", "Mesh", *BOX, to=box)
    if moving:
        add_curve(made, upper.properties[0], "Lcl Scaling", "d|Z", (2.0, 4.0, 2.0), others=1.0)
    character = read_character(_file(tmp_path, made))
    said = "animation bend: 2 moving scales left out, which children inherit otherwise than in glTF"
    assert (said in caplog.text) == moving
    assert [part.name for part in character.parts] == ["strip", "box"]
    assert character.rig is not None
    assert character.rig.names == ("upper", "lower")
    np.testing.assert_array_equal(character.rig.parents, [-1, 0])
    expected = [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
    np.testing.assert_allclose(_at_half_a_second(character)[[0, 1, 4, 5]], expected, atol=1e-5)


def test_weights_shapes_and_joints_as_values(tmp_path: Path) -> None:
    """For `transfer --weights`, `--blend-shapes` and `--joints`."""
    path = _file(tmp_path, fbx_arm())
    mesh = read_mesh(path)
    assert read_attributes(path, mesh)[JOINT_WEIGHTS].shape == (6, 2)
    assert list(read_shapes([path], mesh)) == ["raise"]
    np.testing.assert_allclose(read_skeleton(path).heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)


def test_what_is_left_out_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm()
    made.add("NodeAttribute", "lamp", "Light", to=made.add("Model", "lamp", "Light"))
    hidden = made.add("Model", "widget", "Mesh", properties(Visibility=0.0))
    made.add("Geometry", "widget", "Mesh", *BOX, to=hidden)
    with caplog.at_level(logging.WARNING):
        character = read_character(_file(tmp_path, made))
    assert [part.name for part in character.parts] == ["strip"]
    assert any(message.endswith("left out: 1 light") for message in caplog.messages)
    assert "widget is hidden and left out" in caplog.text


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
def test_opacity_is_kept(
    skin: dict[str, Any], alpha: float, said: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        document = read_document(_file(tmp_path, fbx_arm(**skin)))
    (material,) = document.json["materials"]
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.5, 0.25, 1.0, alpha])
    assert material.get("alphaMode") == ("BLEND" if alpha < 1.0 else None)
    assert ("taken as opaque" in caplog.text) == said


def test_a_character_becomes_a_glb_with_all_of_it(tmp_path: Path) -> None:
    path = _file(tmp_path, fbx_arm(image=PNG))
    run_refine(RefineRequest(path, 0, tmp_path / "arm.glb"), Stages())
    before, after = read_character(path), read_character(tmp_path / "arm.glb")
    one, again = before.parts[0], after.parts[0]
    np.testing.assert_array_equal(again.mesh.face_sizes, one.mesh.face_sizes)
    np.testing.assert_array_equal(again.mesh.face_indices, one.mesh.face_indices)
    np.testing.assert_allclose(again.mesh.positions, one.mesh.positions, atol=1e-6)
    assert list(again.shapes) == ["raise"]
    np.testing.assert_allclose(_at_half_a_second(after), _at_half_a_second(before), atol=1e-5)
    assert image_bytes(read_document(tmp_path / "arm.glb"), 0)[0] == PNG


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty file"),
        (b"no FBX at all" * 9, "cannot be read as FBX"),
        (fbx_arm().bytes()[:900], "cannot be read as FBX"),
        (Fbx().bytes(), "expected triangles"),
    ],
)
def test_what_is_no_fbx_is_refused_by_name(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.fbx"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=rf"broken\.fbx.*{message}"):
        read_mesh(path)


def test_weights_of_vertices_that_are_not_there_are_refused_by_name(tmp_path: Path) -> None:
    made = fbx_arm()
    cluster = next(one for one in made.objects if one.properties[2] == "Cluster")
    next(one for one in cluster.inside if one.name == "Indexes").properties[0][0] = 29445
    with pytest.raises(FormatError, match="strip: a skin or shape of 6 vertices lists 29445"):
        read_mesh(_file(tmp_path, made))


@pytest.mark.parametrize(
    ("kind", "entry", "said"),
    [
        ("Mesh", "Vertices", "mesh strip: positions"),
        ("Mesh", "UV", "mesh strip: UVs map"),
        ("Mesh", "Colors", "mesh strip: colors"),
        ("Shape", "Vertices", "mesh strip: shape raise"),
        ("Cluster", "Weights", "mesh strip: skinning weights"),
        ("Cluster", "Transform", "mesh strip: bind pose of the skin"),
        ("AnimationCurve", "KeyValueFloat", "animation bend: keys"),
        ("LimbNode", "Lcl_Translation", "node lower: transform"),
        ("Material", "EmissiveColor", "material skin"),
    ],
)
def test_numbers_that_are_not_finite_are_refused_by_name(kind: str, entry: str, said: str, tmp_path: Path) -> None:
    made = fbx_arm()
    add_layer(made, layer("Color", "", "ByPolygonVertex", Colors=np.ones(32)))
    changed = next(one for one in reversed(made.objects) if kind in (one.name, one.properties[2]))
    if kind in ("LimbNode", "Material"):
        changed.inside[0].inside += properties(**{entry: (np.nan, 0.0, 0.0)}).inside
    else:
        inside = [inner for one in changed.inside for inner in (one, *one.inside)]
        next(one for one in inside if one.name == entry).properties[0][0] = np.nan
    with pytest.raises(FormatError, match=rf"arm\.fbx: .*\({said} .* not finite\)"):
        read_mesh(_file(tmp_path, made))


def test_normals_that_are_not_finite_are_computed_from_the_faces(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Some exporters write such normals where a face has no area."""
    made = fbx_arm()
    normals = np.tile(np.array([0.6, 0.0, 0.8]) @ TO_FBX / 100.0, (8, 1))
    normals[7] = np.nan
    add_layer(made, layer("Normal", "", "ByPolygonVertex", Normals=normals.ravel()))
    (part,) = read_character(_file(tmp_path, made)).parts
    assert part.normals is not None
    np.testing.assert_allclose(part.normals, [[0.6, 0.0, 0.8]] * 7 + [[0.0, 0.0, 1.0]], atol=1e-6)
    assert "strip: 1 normals are not finite and are computed from the faces" in caplog.text


@pytest.mark.parametrize("child", ["import os; os.abort()", "raise RuntimeError"])
def test_a_crash_of_the_library_is_an_error_message(
    child: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fbx_read, "_CHILD", child)
    with pytest.raises(FormatError, match=r"arm\.fbx: the FBX library stopped.*Export it again"):
        read_mesh(_file(tmp_path, fbx_arm()))


def test_a_file_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fbx_read, "_CHILD", "import time; time.sleep(60)")
    monkeypatch.setattr(fbx_read, "_SECONDS", 0.5)
    with pytest.raises(FormatError, match="given up"):
        read_mesh(_file(tmp_path, fbx_arm()))


def test_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fbx_read.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FormatError, match=r"needs the package ufbx. Install cagemap\[fbx\], or export"):
        read_mesh(_file(tmp_path, fbx_arm()))


@pytest.mark.slow
def test_a_new_process_answers_as_the_server_and_runs_no_modules_of_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A folder of downloads may hold anything."""
    monkeypatch.setattr(fbx_read, "subprocess", subprocess)
    (tmp_path / "ufbx.py").write_text("raise SystemExit(9)")
    monkeypatch.chdir(tmp_path)
    made = fbx_arm()
    made.add("NodeAttribute", "lamp", "Light", to=made.add("Model", "lamp", "Light"))
    assert read_mesh(_file(tmp_path, made)).n_faces == 2
    assert "left out: 1 light" in caplog.text
    (tmp_path / "arm.fbx").write_bytes(made.bytes()[:900])
    with pytest.raises(FormatError, match="cannot be read as FBX"):
        read_mesh(tmp_path / "arm.fbx")


FOREIGN = ("quaternius_Pug.fbx", "quaternius_Female_Dress.fbx", "mh_male_young_blender.fbx")


@pytest.mark.slow
@pytest.mark.parametrize("name", FOREIGN)
def test_files_as_they_come(name: str, shared_data: Path) -> None:
    """Counts of `inside.json`; bones that end others move nothing and are no joints."""
    place = shared_data / "characters" / "foreign"
    stated: dict[str, Any] = json.loads((place / "inside.json").read_text())[name]
    character = read_character(place / name)
    parts = {part.name: part for part in character.parts}
    assert len(parts) == stated["meshes"]
    assert len(character.animations) == stated["actions"]
    influences = max(int(np.diff(part.weights.indptr).max()) for part in parts.values() if part.weights is not None)
    assert influences == stated["max_influences"]
    if "faces" in stated:
        (part,) = parts.values()
        assert part.mesh.n_vertices == stated["vertices"]
        sizes, counts = np.unique(part.mesh.face_sizes, return_counts=True)
        assert dict(zip(map(str, sizes), counts.tolist(), strict=True)) == stated["faces"]
        assert len(part.mesh.material_names) == stated["materials"]
    else:
        assert {name: part.mesh.n_vertices for name, part in parts.items()} == stated["welded"]
        assert {name: len(part.shapes) for name, part in parts.items()} == stated["shapes"]


@pytest.mark.slow
def test_the_same_character_as_glb_and_as_fbx(shared_data: Path) -> None:
    place = shared_data / "characters"
    fbx = read_character(place / "foreign" / "mh_male_young_blender.fbx")
    glb = read_character(place / "rigs" / "character_A.glb")
    joints = [glb.rig.names.index(name) for name in fbx.rig.names]
    np.testing.assert_allclose(fbx.rig.heads, glb.rig.heads[joints], atol=2e-6)
    for part in fbx.parts:
        twin = next(one for one in glb.parts if one.name == part.name)
        np.testing.assert_allclose(part.mesh.positions, twin.mesh.positions, atol=2e-6)
        assert np.abs(part.weights - twin.weights[:, joints]).max() < 1e-6
        for name, offsets in part.shapes.items():
            np.testing.assert_allclose(offsets, twin.shapes[name], atol=2e-6)
