"""FBX files: read in a process of their own, as what they hold in metres with Y up."""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import image_bytes
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.rigs import read_shapes, read_skeleton
from cagemap.mesh import Plain
from cagemap.tasks.mesh_commands import run_check, run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest, RefineRequest

from fbx_scenes import BOX, PNG, TO_FBX, Fbx, Node, fbx_arm, fbx_file, half_a_second_in, properties
from gltf_scenes import arm

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")


def test_a_made_file_holds_what_its_gltf_twin_holds(tmp_path: Path) -> None:
    character = read_character(fbx_file(tmp_path, fbx_arm()))
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


def test_leaf_bones_that_move_nothing_are_no_joints_and_check_says_what_a_file_holds(tmp_path: Path) -> None:
    path = fbx_file(tmp_path, fbx_arm(leaf=True))
    assert read_character(path).rig.names == ("upper", "lower")
    assert "lower_end" in [node["name"] for node in read_document(path).json["nodes"]]
    text, _ = run_check(CheckRequest((path,)), Stages())
    assert [said for said in ("2 joints", "1 (raise)", "1 (bend (2 s))") if said not in text] == []


def test_a_skin_without_joints_is_passed_over(tmp_path: Path) -> None:
    made = fbx_arm()
    mesh = made.named("Geometry").properties[0]
    made.connections.insert(0, Node("C", ("OO", made.add("Deformer", "", "Skin", to=None), mesh)))
    character = read_character(fbx_file(tmp_path, made))
    assert character.rig.names == ("upper", "lower")


def test_vertices_of_no_face_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm()
    vertices = made.named("Geometry").inside[0]
    vertices.properties = (np.append(vertices.properties[0], [0.0, 0.0, 900.0]),)
    assert read_mesh(fbx_file(tmp_path, made)).n_vertices == 6
    assert "strip: 1 vertex of no face left out; later vertices have other numbers than in the file" in caplog.text


def test_stated_axes_turn_positions_shapes_joints_and_animations_alike(tmp_path: Path) -> None:
    """The same numbers, stated to have Z up and Y up."""
    made = fbx_arm()
    standing = read_character(fbx_file(tmp_path, made))
    made.settings = Fbx(UpAxis=1, FrontAxis=2, FrontAxisSign=1).settings
    lying = read_character(fbx_file(tmp_path, made))
    for one, other in (
        (standing.parts[0].mesh.positions, lying.parts[0].mesh.positions),
        (standing.parts[0].shapes["raise"], lying.parts[0].shapes["raise"]),
        (standing.rig.heads, lying.rig.heads),
        (half_a_second_in(standing), half_a_second_in(lying)),
    ):
        np.testing.assert_allclose(other, one @ TO_FBX / 100.0, atol=1e-5)


def test_units(tmp_path: Path) -> None:
    """Inches, moved by 50 of them along Z, which is up."""
    made = Fbx(UnitScaleFactor=2.54)
    model = made.add("Model", "box", "Mesh", properties(Lcl_Translation=(0.0, 0.0, 50.0)))
    made.add("Geometry", "box", "Mesh", *BOX, to=model)
    expected = 0.0254 * (cube().positions[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [0.0, 50.0, 0.0])
    np.testing.assert_allclose(read_mesh(fbx_file(tmp_path, made)).positions, expected, atol=1e-6)


@pytest.mark.parametrize("translation", ["Lcl_Translation", "GeometricTranslation"])
def test_an_instance_has_its_own_place_and_with_y_up_nothing_turns(translation: str, tmp_path: Path) -> None:
    """Two nodes with one mesh, 9 apart by a property of the nodes."""
    made = Fbx(UpAxis=1, FrontAxis=2, FrontAxisSign=1, UnitScaleFactor=100.0)
    models = [
        made.add("Model", name, "Mesh", properties(**{translation: (x, 0.0, 0.0)}))
        for name, x in (("a", 0.0), ("b", 9.0))
    ]
    made.connect(made.add("Geometry", "box", "Mesh", *BOX, to=models[0]), models[1])
    one, other = read_character(fbx_file(tmp_path, made)).parts
    assert (one.name, other.name) == ("a", "b")
    np.testing.assert_allclose(one.mesh.positions, cube().positions, atol=1e-6)
    np.testing.assert_array_equal(one.mesh.face_indices, cube().face_indices)
    np.testing.assert_allclose(other.mesh.positions, cube().positions + np.array([9.0, 0.0, 0.0]), atol=1e-5)


@pytest.mark.parametrize("across", [1.0, -1.0])
def test_a_geometric_transform_moves_positions_and_shapes_and_turns_mirrored_faces(across, tmp_path):
    """It moves the mesh of a node, but not the node's children; 3ds Max writes it."""
    made = fbx_arm()
    model = made.named("Model")
    model.inside.append(
        properties(
            GeometricScaling=(across, 2.0, 3.0),
            GeometricRotation=(0.0, 0.0, 90.0),
            GeometricTranslation=(50.0, 0.0, 0.0),
        )
    )
    plain = read_character(fbx_file(tmp_path, fbx_arm(), "plain.fbx")).parts[0]
    part = read_character(fbx_file(tmp_path, made)).parts[0]
    linear = TO_FBX @ np.diag([across, 2.0, 3.0]) @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] @ np.linalg.inv(TO_FBX)
    np.testing.assert_allclose(part.mesh.positions, plain.mesh.positions @ linear + [0.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(part.shapes["raise"], plain.shapes["raise"] @ linear, atol=1e-6)
    corners = part.mesh.positions[part.mesh.face(0)]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert normal @ (np.array([0.0, 0.0, 1.0]) @ linear) > 0.0


def test_weights_shapes_and_joints_as_values(tmp_path: Path) -> None:
    path = fbx_file(tmp_path, fbx_arm())
    mesh = read_mesh(path)
    assert read_attributes(path, mesh)[JOINT_WEIGHTS].shape == (6, 2)
    assert list(read_shapes([path], mesh)) == ["raise"]
    np.testing.assert_allclose(read_skeleton(path).heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)


def test_what_a_mesh_of_it_lacks_is_said(tmp_path: Path) -> None:
    path = fbx_file(tmp_path, fbx_arm())
    warnings = run_refine(RefineRequest(mesh=path, output=tmp_path / "arm.obj", level=0), Stages())[1]
    held = "skinning weights, blend shapes, skeleton, animations"
    assert warnings == [f"arm.obj: left out of {path.name}: {held}"]


def test_what_is_left_out_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm()
    made.add("NodeAttribute", "lamp", "Light", to=made.add("Model", "lamp", "Light"))
    hidden = made.add("Model", "widget", "Mesh", properties(Visibility=0.0))
    made.add("Geometry", "widget", "Mesh", *BOX, to=hidden)
    with caplog.at_level(logging.WARNING):
        character = read_character(fbx_file(tmp_path, made))
    assert [part.name for part in character.parts] == ["strip"]
    assert any(message.endswith("left out: 1 light") for message in caplog.messages)
    assert "widget is hidden and left out" in caplog.text


def test_a_character_becomes_a_glb_with_all_of_it(tmp_path: Path) -> None:
    path = fbx_file(tmp_path, fbx_arm(image=PNG))
    run_refine(RefineRequest(path, 0, tmp_path / "arm.glb"), Stages())
    before, after = read_character(path), read_character(tmp_path / "arm.glb")
    one, again = before.parts[0], after.parts[0]
    np.testing.assert_array_equal(again.mesh.face_sizes, one.mesh.face_sizes)
    np.testing.assert_array_equal(again.mesh.face_indices, one.mesh.face_indices)
    np.testing.assert_allclose(again.mesh.positions, one.mesh.positions, atol=1e-6)
    assert list(again.shapes) == ["raise"]
    np.testing.assert_allclose(half_a_second_in(after), half_a_second_in(before), atol=1e-5)
    assert image_bytes(read_document(tmp_path / "arm.glb"), 0)[0] == PNG


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


@pytest.mark.parametrize("inherits", [True, False])
def test_meshes_below_a_hidden_group_are_hidden_if_they_inherit_it(tmp_path: Path, inherits: bool) -> None:
    made = fbx_arm()
    group = made.add("Model", "helpers", "Null", properties(Visibility=0.0))
    stated = () if inherits else (properties(Visibility_Inheritance=0),)
    box = made.add("Model", "box", "Mesh", *stated, to=made.add("Model", "inner", "Null", to=group))
    made.add("Geometry", "box", "Mesh", *BOX, to=box)
    parts = read_character(fbx_file(tmp_path, made)).parts
    assert [part.name for part in parts] == (["strip"] if inherits else ["strip", "box"])


def test_joints_without_weights_whose_bind_matrix_has_no_inverse_are_left_out(tmp_path, caplog):
    """Their matrix places nothing; the file was refused."""
    made = fbx_arm()
    skin = made.named("Deformer", "Skin").properties[0]
    flat = Node("Transform", (np.diag([1.0, 1.0, 0.0, 1.0]).ravel(),))
    cluster = made.add("Deformer", "", "Cluster", flat, Node("TransformLink", (np.eye(4).ravel(),)), to=skin)
    made.connect(made.add("Model", "dead", "LimbNode"), cluster)
    character = read_character(fbx_file(tmp_path, made))
    assert character.rig.names == ("upper", "lower")
    assert character.parts[0].weights.shape == (6, 2)
    assert "strip: 1 joint without weights left out of its skin; their bind matrices have no inverse" in caplog.text
