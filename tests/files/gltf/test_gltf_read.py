"""glTF and VRM files as meshes, characters and values: seams, primitives, shapes, and what `check` says."""

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron

from cagemap.character.normals import move_vertices
from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of, humanoid_bones, read_character
from cagemap.files.gltf.document import glb_bytes, read_document, write_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.read import contents_of, read_gltf
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows
from cagemap.files.values.rigs import read_shapes, read_skeleton, write_shapes
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from gltf_scenes import Maker, arm, changed
from refusals import refuses


def _written(tmp_path: Path, document: Document, name: str = "made.glb") -> Path:
    path = tmp_path / name
    path.write_bytes(glb_bytes(document))
    return path


def test_what_was_split_at_seams_is_one_surface(tmp_path: Path) -> None:
    body = creature()
    corners = np.arange(len(body.face_indices))
    body = body.with_uvs(np.random.default_rng(1).uniform(size=(len(corners), 2)), corners)
    path = tmp_path / "body.glb"
    write_mesh(path, body)
    mesh = read_mesh(path)
    assert mesh.n_vertices == body.n_vertices
    assert isinstance(mesh.scheme, Plain)
    assert mesh.file_vertices is None
    np.testing.assert_allclose(mesh.positions.min(axis=0), body.positions.min(axis=0), atol=1e-6)
    assert len(mesh.uvs) == len(corners)


def test_seams_of_normals_are_no_seams_of_uvs(tmp_path: Path) -> None:
    make = Maker()
    box = cube()
    corners = box.face_indices
    indices = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].ravel()
    attributes = {
        "POSITION": make.add(box.positions[corners]),
        "TEXCOORD_0": make.add(box.positions[corners][:, :2]),
    }
    mesh = {"primitives": [{"attributes": attributes, "indices": make.add(indices, "<u2")}]}
    document = make.document(nodes=[{"mesh": 0}], meshes=[mesh])
    read = read_gltf(_written(tmp_path, document))
    assert read.n_vertices == 8
    assert len(read.uvs) == 8


def test_closed_lips_stay_apart() -> None:
    make = Maker()
    lips = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (1, 0, 0), (0, -1, 0)])
    opened = np.zeros((6, 3))
    mesh = {"attributes": {"POSITION": make.add(lips)}, "indices": make.add([0, 1, 2, 3, 5, 4], "<u2")}
    opened[:3, 1] = 0.5
    targets = [{"POSITION": make.add(opened)}]
    for shapes, expected in (({}, 4), ({"targets": targets}, 6)):
        document = make.document(nodes=[{"mesh": 0}], meshes=[{"primitives": [mesh | shapes]}])
        assert character_of(document).parts[0].mesh.n_vertices == expected


def test_copies_of_an_instanced_mesh_are_left_out_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    maker = Maker()
    attributes = {"POSITION": maker.add(np.eye(3))}
    places = maker.add(np.arange(6.0).reshape(2, 3))
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}
    document = maker.document(
        meshes=[{"primitives": [{"attributes": attributes}]}],
        nodes=[{"mesh": 0, "name": "leaf", "extensions": instances}],
        extensionsUsed=["EXT_mesh_gpu_instancing"],
    )
    assert len(character_of(document).parts) == 1
    assert "copies of leaf by EXT_mesh_gpu_instancing are left out" in caplog.text


def test_strips_and_fans() -> None:
    make = Maker()
    square = make.add([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    ring = make.add([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    for mode, points in ((5, square), (6, ring)):
        mesh = {"attributes": {"POSITION": points}, "mode": mode}
        document = make.document(nodes=[{"mesh": 0}], meshes=[{"primitives": [mesh]}])
        read = character_of(document).parts[0].mesh
        a, b, c = (read.positions[read.face_indices[k::3]] for k in range(3))
        np.testing.assert_allclose(np.cross(b - a, c - a), [[0, 0, 1]] * 2)


def test_humanoid_bones_of_both_vrms() -> None:
    older = {"VRM": {"humanoid": {"humanBones": [{"bone": "leftUpperArm", "node": 1}]}}}
    newer = {"VRMC_vrm": {"humanoid": {"humanBones": {"leftUpperArm": {"node": 1}}}}}
    for extensions in (older, newer):
        assert humanoid_bones(changed(arm(), extensions=extensions)) == {"leftUpperArm": "upper"}
    assert humanoid_bones(arm()) == {}


@pytest.mark.slow
def test_files_as_they_come(shared_data: Path) -> None:
    """Counts of `inside.json`: welded vertices, joints, morphs; hair touches itself at one vertex and keeps both."""
    place = shared_data / "characters" / "foreign"
    inside = json.loads((place / "inside.json").read_text())
    for name in ("Fox.glb", "MorphStressTest.gltf", "mh_male_young.vrm", "saturday06_skinned_morph_vrm0.vrm"):
        character = read_character(place / name)
        stated = inside[name]
        welded: dict[str, int] = {}
        for part in stated["parts"]:
            welded[part["mesh"]] = welded.get(part["mesh"], 0) + part["welded"]
        assert [part.mesh.n_vertices for part in character.parts] == list(welded.values())
        assert bool(character.rig) == bool(stated["skins"])
        assert all(len(character.rig.names) == joints for joints in stated["skins"])
        assert {len(p.shapes) for p in character.parts if p.shapes} == set(stated["morph_targets"].values())
        assert len(character.animations) == stated["animations"]
    bones = humanoid_bones(read_document(place / "mh_male_young.vrm"))
    assert len(bones) == 53
    assert bones["head"] == "head"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "arm.glb"
    write_document(path, arm())
    return path


def test_weights_and_shapes_of_the_whole_and_of_a_part(file: Path) -> None:
    whole = read_gltf(file)
    table = read_attributes(file, whole)[JOINT_WEIGHTS]
    assert table.shape == (9, 2)
    np.testing.assert_allclose(table.sum(axis=1), 1.0)
    part = extract_faces(whole, find_part(whole, "strip").faces)
    rows = FileRows(part, whole)
    np.testing.assert_allclose(read_attributes(file, part, rows)[JOINT_WEIGHTS], table[3:])
    shapes = read_shapes([file], part, rows)
    assert list(shapes) == ["raise"]
    np.testing.assert_allclose(shapes["raise"].max(axis=0), [0, 0, 1])
    assert read_shapes([file], whole)["raise"].shape == (9, 3)
    refuses(FormatError, "'raise'", read_shapes, [file], part)


def test_joints(file: Path) -> None:
    skeleton = read_skeleton(file)
    assert skeleton.names == ("upper", "lower")
    assert skeleton.parents == ("", "upper")
    np.testing.assert_allclose(skeleton.heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(skeleton.tails, [[1, 0, 0], [1.5, 0, 0]], atol=1e-6)


def test_a_file_without_a_skin_is_refused(tmp_path: Path) -> None:
    make = Maker()
    mesh = {"primitives": [{"attributes": {"POSITION": make.add([(0, 0, 0), (1, 0, 0), (0, 1, 0)])}}]}
    path = tmp_path / "bare.glb"
    write_document(path, make.document(nodes=[{"mesh": 0}], meshes=[mesh]))
    for read in (read_skeleton, read_attributes):
        refuses(FormatError, r"bare\.glb.*skin", read, path)


def test_check_says_what_a_file_holds(file: Path, tmp_path: Path) -> None:
    text, _ = run_check(CheckRequest((file,)), Stages())
    for line in (
        "arm.glb: strip\n",
        "  vertices              6\n",
        "body        strip: is matched",
        "passengers  1 (ball): ride on the body",
        "skeleton    2 joints, at most 2 a vertex: is carried, with its weights",
        "shapes      1 (raise): are carried",
        "animations  1 (bend (2 s)): are retargeted",
    ):
        assert line in text
    for word in ("component:", "--weld", "set aside"):
        assert word not in text
    (held,) = json.loads(run_check(CheckRequest((file,), True), Stages())[0])
    assert held["contents"]["joints"] == 2
    write_mesh(tmp_path / "plain.obj", read_gltf(file))
    assert "holds" not in run_check(CheckRequest((tmp_path / "plain.obj",)), Stages())[0]


def test_check_says_that_the_body_has_no_weights(tmp_path: Path) -> None:
    document = arm()
    clothes = document.json["nodes"][4]
    nodes = [*document.json["nodes"][:4], clothes | {"name": "shirt"}, {"name": "bare", "mesh": 2}]
    meshes = json.loads(json.dumps(document.json["meshes"]))
    bare = {name: meshes[0]["primitives"][0]["attributes"][name] for name in ("POSITION", "TEXCOORD_0")}
    meshes.append({"primitives": [{"attributes": bare, "indices": meshes[0]["primitives"][0]["indices"]}]})
    scenes = [{"nodes": [0, 4, 5]}]
    path = _written(tmp_path, changed(document, nodes=nodes, meshes=meshes, scenes=scenes))
    text, _ = run_check(CheckRequest((path,)), Stages())
    assert "body        bare: is matched" in text
    assert (
        "2 joints, at most 2 a vertex: is carried, but bare has no weights, so the body does not move with it" in text
    )


@pytest.mark.parametrize("output", ["shapes", "cube.npz"])
def test_written_shapes_come_back_without_the_cage_at_rest(tmp_path: Path, output: str) -> None:
    cage = replace(cube(), name="cube.obj")
    shapes = {"smile": np.ones((8, 3)), "none": np.zeros((8, 3))}
    write_shapes(tmp_path / output, shapes, cage, [])
    found = read_shapes([tmp_path if output.endswith(".npz") else tmp_path / output], cage)
    assert sorted(found) == ["none", "smile"]
    np.testing.assert_allclose(found["smile"], 1.0)


def test_check_reports_a_mesh_whose_image_is_missing(tmp_path: Path) -> None:
    material = {"name": "skin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    lost = {"materials": [material], "textures": [{"source": 0}], "images": [{"uri": "lost.png"}]}
    document = arm()
    buffer = "data:application/octet-stream;base64," + base64.b64encode(document.buffers[0]).decode()
    top = document.json | lost | {"buffers": [{"byteLength": len(document.buffers[0]), "uri": buffer}]}
    (tmp_path / "made.gltf").write_text(json.dumps(top))
    text, _ = run_check(CheckRequest((tmp_path / "made.gltf",)), Stages())
    assert "skin baseColor (cannot be read: lost.png)" in text
    assert "faces" in text


@pytest.mark.parametrize(("name", "said"), [("made.glb", True), ("made.fbx", False), ("made.usda", False)])
def test_vertices_that_only_gltf_splits_are_said(name: str, said: bool) -> None:
    """FBX and USD files have own indices of normals and UVs: their vertices are those that programs show."""
    made = Maker()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    attributes = {"POSITION": made.add(corners), "NORMAL": made.add([(0, 0, 1)] * 3 + [(0, 1, 0)] * 3)}
    meshes = [{"primitives": [{"attributes": attributes}]}]
    scene = read_scene(made.document(Path(name), nodes=[{"mesh": 0}], meshes=meshes))
    text = str(contents_of(scene))
    assert ("4, made of 6 in the file: copies along seams are welded, so that later" in text) == said
    assert ("made of" in text) == said


def _faces(mesh: ControlMesh) -> list[tuple[int, ...]]:
    return [tuple(mesh.face(number).tolist()) for number in range(mesh.n_faces)]


def test_polygons_come_back_as_polygons(tmp_path: Path) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
    faces = [(0, 1, 2, 3), (0, 3, 4), (0, 4, 5, 6), (0, 6, 7, 8, 9, 10), (0, 10, 11), (0, 11, 12, 1)]
    disk = ControlMesh.from_faces(np.vstack([np.zeros(3), rim]), faces)
    disk = replace(disk, face_materials=np.array([0, 1, 0, 0, 1, 0]), material_names=("a", "b"))
    write_mesh(tmp_path / "disk.glb", disk)
    read = read_mesh(tmp_path / "disk.glb")
    # The primitives of the materials follow each other.
    assert _faces(read) == [_faces(disk)[number] for number in (0, 2, 3, 5, 1, 4)]
    np.testing.assert_allclose(read.positions, disk.positions, atol=1e-6)
    assert read_document(tmp_path / "disk.glb").json["extensionsUsed"] == ["FB_ngon_encoding"]
    rng = np.random.default_rng(3)
    for number in range(20):  # begun anywhere, in any order
        turned = [tuple(np.roll(face, rng.integers(len(face)))) for face in faces]
        other = ControlMesh.from_faces(disk.positions, [turned[k] for k in rng.permutation(6)])
        write_mesh(tmp_path / f"{number}.glb", other)
        assert _faces(read_mesh(tmp_path / f"{number}.glb")) == _faces(other)


@pytest.mark.parametrize("stated", [3, [[0]], [[0, 1], [2]], [[9, 1]], [[0, 4]], [[-1, 0]], [[0.5, 1]], "a", [{}]])
def test_corners_of_polygons_that_are_none_are_refused(stated: Any, tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.glb", cube())
    document = read_document(tmp_path / "box.glb")
    document.json["meshes"][0]["primitives"][0]["extras"] = {"cagemap_fan_starts": stated}
    refuses(FormatError, "expected faces and their corners", character_of, document)


def test_triangles_need_no_extension(tmp_path: Path) -> None:
    write_mesh(tmp_path / "ball.glb", icosahedron())
    assert "extensionsUsed" not in read_document(tmp_path / "ball.glb").json


def _painted(**targets: Any) -> Document:
    """Two triangles of a square, split along their common edge: red and half transparent blue."""
    maker = Maker()
    places = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    normals = np.tile([0.0, 0.0, 1.0], (6, 1))
    attributes = {
        "POSITION": maker.add(places),
        "NORMAL": maker.add(normals),
        "COLOR_0": maker.add(np.repeat([[255, 0, 0, 255], [0, 0, 255, 51]], 3, axis=0), "u1", normalized=True),
    }
    primitive: dict[str, Any] = {"attributes": attributes}
    if targets:
        primitive["targets"] = [{name: maker.add(offsets) for name, offsets in targets.items()}]
    node = {"name": "square", "mesh": 0, "scale": [2.0, 2.0, -2.0]}
    return maker.document(meshes=[{"primitives": [primitive]}], nodes=[node], scenes=[{"nodes": [0]}], scene=0)


def _corner_colors(document: Document) -> dict[tuple[float, ...], list[float]]:
    """Linear colour with opacity of every corner, by the corner's place and the centre of its triangle."""
    (primitive,) = document.json["meshes"][0]["primitives"]
    places, colors = (
        read_accessor(document, primitive["attributes"][name], name, ("VEC3", "VEC4"))
        for name in ("POSITION", "COLOR_0")
    )
    corners = np.arange(len(places))
    if "indices" in primitive:
        corners = read_accessor(document, primitive["indices"], "indices", ("SCALAR",))
    centres = places[corners].reshape(-1, 3, 3).mean(axis=1).round(3)
    return {
        (*places[corner], *centre): colors[corner].round(6).tolist()
        for corner, centre in zip(corners, np.repeat(centres, 3, axis=0), strict=True)
    }


def test_colours_of_corners_and_opacity_come_back() -> None:
    """Colours that differ at a weld are not averaged; `read_mesh` has one for each vertex."""
    document = _painted()
    character = character_of(document)
    assert character.parts[0].mesh.n_vertices == 4
    given, found = (_corner_colors(one) for one in (document, character_glb(character, document)))
    assert given == found
    assert len({tuple(color) for color in found.values()}) == 2


def test_tangents_of_blend_shapes_are_said_to_be_left_out(caplog: pytest.LogCaptureFixture) -> None:
    character_of(_painted(POSITION=np.ones((6, 3)), TANGENT=np.ones((6, 3))))
    assert caplog.messages == ["made.glb: tangents of blend shapes are left out; programs compute them"]


def test_a_mesh_that_no_node_uses_may_be_damaged() -> None:
    document = _painted()
    document.json["meshes"].append({"primitives": 7})
    assert len(character_of(document).parts) == 1


def test_normals_of_blend_shapes_come_back_and_turn_with_moved_faces() -> None:
    raised = np.zeros((6, 3))
    raised[:, 2] = [0.0, 0.5, 0.5, 0.0, 0.5, 0.0]  # x + 2 z = 0: the plane tilts about y
    stated = np.tile([-0.3, 0.1, -0.2], (6, 1))
    document = _painted(POSITION=raised, NORMAL=stated)
    character = character_of(document)
    again = character_glb(character, document)
    target = again.json["meshes"][0]["primitives"][0]["targets"][0]
    offsets = read_accessor(again, target["NORMAL"], "NORMAL", ("VEC3",))
    np.testing.assert_allclose(offsets, np.tile(stated[0], (len(offsets), 1)), atol=1e-6)
    (part,) = character.parts
    moved = move_vertices(part, part.mesh.positions * [2.0, 1.0, 1.0])
    (offsets,) = moved.shape_normals.values()
    (shape,) = moved.shapes.values()
    slope = moved.normals + offsets
    edges = (moved.mesh.positions + shape)[moved.mesh.face_indices[[0, 1, 2]]]
    np.testing.assert_allclose(slope[0] @ (edges[1:] - edges[0]).T, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("where", ["primitive", "accessors"])
def test_names_of_blend_shapes_are_also_those_of_the_primitive_or_of_the_accessors(where: str) -> None:
    """Early VRM files name them in the extras of primitives; written again, they are those of the mesh."""
    document = _painted(POSITION=np.ones((6, 3)))
    (primitive,) = document.json["meshes"][0]["primitives"]
    if where == "primitive":
        primitive["extras"] = {"targetNames": ["joy"]}
    else:
        document.json["accessors"][primitive["targets"][0]["POSITION"]]["name"] = "joy"
    character = character_of(document)
    assert list(character.parts[0].shapes) == ["joy"]
    assert character_glb(character, document).json["meshes"][0]["extras"] == {"targetNames": ["joy"]}


def test_equal_names_of_accessors_name_no_blend_shapes() -> None:
    document = _painted(POSITION=np.ones((6, 3)))
    (primitive,) = document.json["meshes"][0]["primitives"]
    primitive["targets"] *= 2
    document.json["accessors"][primitive["targets"][0]["POSITION"]]["name"] = "offsets"
    assert list(character_of(document).parts[0].shapes) == ["shape 0", "shape 1"]
