"""glTF and VRM files as meshes, characters and values: seams, skins, shapes, animations, and what is refused."""

from __future__ import annotations

import base64
import json
import struct
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube
from scipy.spatial.transform import Rotation

from cagemap.character.poses import pose_at, world_transforms
from cagemap.character.values import skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of, humanoid_bones, read_character
from cagemap.files.gltf.document import glb_bytes, read_document, write_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.nodes import read_nodes, transform
from cagemap.files.gltf.read import read_gltf
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows
from cagemap.files.values.rigs import read_shapes, read_skeleton, write_shapes
from cagemap.mesh import Plain
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from gltf_scenes import Maker, arm, matrices, moved


def _written(tmp_path: Path, document: Document, name: str = "made.glb") -> Path:
    path = tmp_path / name
    path.write_bytes(glb_bytes(document))
    return path


def _changed(document: Document, **top: Any) -> Document:
    return replace(document, json=json.loads(json.dumps(document.json)) | top)


def _rest(rig: Any) -> np.ndarray:
    world = rig.local.copy()
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            world[joint] = rig.local[joint] @ world[parent]
    return world


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


def test_an_armature_is_part_of_the_transforms_of_its_joints() -> None:
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
    assert character.rig is not None
    track = next(one for one in character.animations[0].tracks if one.channel == "rotation")
    np.testing.assert_allclose(np.abs(track.values[0] @ quarter), 1.0)
    both = np.array([0.5, 0.5, 0.5, 0.5])  # about z, then about y
    np.testing.assert_allclose(np.abs(track.values[1] @ both), 1.0, atol=1e-6)


def test_a_mirrored_armature_mirrors_the_scales_of_its_root() -> None:
    document = arm(above={"scale": [-2, 2, 2]})
    document.json["animations"][0]["channels"] = [{"sampler": 1, "target": {"node": 1, "path": "scale"}}]
    character = character_of(document)
    assert character.rig is not None
    posed = pose_at(character.rig, character.animations[0], 0.5)  # scale 0, 0, 1 of the first joint
    np.testing.assert_allclose(posed[0, :3, :3], np.diag([0, 0, 1]) @ np.diag([-2, 2, 2]), atol=1e-6)


@pytest.mark.parametrize("scale", [(-1.0, 2.0, 3.0), (-1.0, -2.0, 3.0)])
def test_animations_of_joints_with_negative_scales(scale: tuple[float, ...]) -> None:
    """A rotation alone moves a joint, mirrored along one axis or turned along two; also when it is written again."""
    document = arm()
    document.json["nodes"][2]["scale"] = list(scale)
    times = document.json["animations"][0]["samplers"][0]["input"]
    for character in (character_of(document), character_of(character_glb(character_of(document), document))):
        assert character.rig is not None
        posed = pose_at(character.rig, character.animations[0], 0.5)
        turned = transform(np.array([1.0, 0, 0]), np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)]), np.array(scale))
        np.testing.assert_allclose(posed[1], turned @ moved(0, 0, 1), atol=1e-6)
    grown = json.loads(json.dumps(document.json["animations"]))
    grown[0]["samplers"][0] = {"input": times, "output": grown[0]["samplers"][1]["output"]}
    grown[0]["channels"] = [{"sampler": 0, "target": {"node": 2, "path": "scale"}}]
    character = character_of(_changed(document, animations=grown))
    assert character.rig is not None
    np.testing.assert_allclose(
        pose_at(character.rig, character.animations[0], 0.5)[1, :3, :3], np.diag([0, 0, 1]), atol=1e-6
    )


def test_an_animated_armature_is_a_joint() -> None:
    document = arm(above={"translation": [0, 0, 3]})
    document.json["animations"][0]["channels"][0]["target"]["node"] = 0
    rig = character_of(document).rig
    assert rig.names == ("armature", "upper", "lower")
    np.testing.assert_array_equal(rig.parents, [-1, 0, 1])


def test_skins_bound_in_other_poses_are_brought_together() -> None:
    document = arm()
    other = arm(bind=moved(0, 4, 0))
    size = len(document.buffers[0])
    count, views = len(document.json["accessors"]), len(document.json["bufferViews"])
    joined = json.loads(json.dumps(document.json))
    joined["bufferViews"] += [view | {"byteOffset": view["byteOffset"] + size} for view in other.json["bufferViews"]]
    joined["accessors"] += [entry | {"bufferView": entry["bufferView"] + views} for entry in other.json["accessors"]]
    second = json.loads(json.dumps(other.json["meshes"][0]))
    primitive = second["primitives"][0]
    primitive["attributes"] = {name: number + count for name, number in primitive["attributes"].items()}
    primitive["indices"] += count
    primitive["targets"] = [{"POSITION": primitive["targets"][0]["POSITION"] + count}]
    joined["meshes"].append(second)
    joined["nodes"].append({"name": "second", "mesh": 2, "skin": 1})
    joined["scenes"][0]["nodes"].append(5)
    joined["skins"].append(
        {"joints": [1, 2], "inverseBindMatrices": other.json["skins"][0]["inverseBindMatrices"] + count}
    )
    joined["buffers"] = [{"byteLength": size + len(other.buffers[0])}]
    character = character_of(replace(document, json=joined, buffers=(document.buffers[0] + other.buffers[0],)))
    _, strip, again = character.parts
    np.testing.assert_allclose(again.mesh.positions, strip.mesh.positions, atol=1e-6)
    assert len(character.rig.names) == 2  # type: ignore[union-attr]


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


def test_sparse_strided_and_normalised_accessors() -> None:
    make = Maker()
    block = np.zeros(3, np.dtype([("place", "<i2", 3), ("pad", "V2"), ("uv", "u1", 2), ("pad2", "V2")]))
    block["place"] = [(-32768, 0, 32767)] * 3
    block["uv"] = [(0, 255)] * 3
    view = make.view(block.tobytes(), byteStride=12)
    stated = {"bufferView": view, "count": 3}
    make.accessors += [
        stated | {"componentType": 5122, "type": "VEC3", "normalized": True},
        stated | {"componentType": 5121, "type": "VEC2", "byteOffset": 8, "normalized": True},
    ]
    rows = make.view(np.array([0, 2], "<u2").tobytes())
    values = make.view(np.ones((2, 3), "<f4").tobytes())
    sparse = {"count": 2, "indices": {"bufferView": rows, "componentType": 5123}, "values": {"bufferView": values}}
    make.accessors.append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse})
    document = make.document()
    np.testing.assert_array_equal(read_accessor(document, 0, "t", ("VEC3",)), [(-1, 0, 1)] * 3)
    np.testing.assert_array_equal(read_accessor(document, 1, "t", ("VEC2",)), [(0, 1)] * 3)
    for count in (3, None):
        found = read_accessor(document, 2, "t", ("VEC3",), count)
        np.testing.assert_array_equal(found, [(1, 1, 1), (0, 0, 0), (1, 1, 1)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 4_000_000_000}, "ends before"),
        ({"byteOffset": 2**40}, "byteOffset"),
        ({"count": 0}, "whole number from 1"),
        ({"count": 1.5}, "whole number"),
        ({"componentType": 5124}, "componentType"),
        ({"type": "VEC7"}, "VEC3"),
        ({"bufferView": 99}, "bufferViews"),
        ({"bufferView": None, "count": 4_000_000_000}, "has no data"),
    ],
)
def test_accessors_that_lie_are_refused(changes: dict[str, Any], message: str) -> None:
    document = arm()
    number = document.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    document.json["accessors"][number] |= changes
    with pytest.raises(FormatError, match=message):
        character_of(document)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"asset": {"version": "1.0"}}, r"version 2\.0"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression.*gltf-transform"),
        ({"extensionsRequired": ["KHR_texture_basisu"]}, "KHR_texture_basisu.*PNG"),
        ({"extensionsRequired": ["ACME_other"]}, "ACME_other"),
        ({"buffers": [{"byteLength": 4, "uri": "../secret.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "%2e%2e/secret.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "https://example.org/a.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "/etc/passwd"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "absent.bin"}]}, r"made\.gltf names"),
        ({"buffers": [{"byteLength": 400, "uri": "data:;base64,AAAA"}]}, "cut short"),
        ({"buffers": [{"byteLength": 3, "uri": "data:;base64,A*AA"}]}, "data URI is damaged"),
        ({"buffers": [{"byteLength": 4}]}, "no data in the file"),
    ],
)
def test_documents_that_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "made.gltf"
    path.write_text(json.dumps(arm().json | changes))
    with pytest.raises(FormatError, match=message):
        read_document(path)


def test_a_gltf_with_its_files(tmp_path: Path) -> None:
    document = arm()
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "a.bin").write_bytes(document.buffers[0])
    for name, uri in (
        ("beside.gltf", "sub%20folder/a.bin"),
        ("inside.gltf", "data:application/octet-stream;base64," + base64.b64encode(document.buffers[0]).decode()),
    ):
        buffers = [{"byteLength": len(document.buffers[0]), "uri": uri}]
        (tmp_path / name).write_text(json.dumps(document.json | {"buffers": buffers}))
        assert len(read_character(tmp_path / name).parts) == 2


def test_glbs_that_are_cut_short(tmp_path: Path) -> None:
    content = glb_bytes(arm())
    path = tmp_path / "cut.glb"
    for length in (0, 3, 12, 19, 40, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(FormatError):
            read_document(path)
    path.write_bytes(struct.pack("<4sII", b"glTF", 1, len(content)) + content[12:])
    with pytest.raises(FormatError, match="version 2, got 1"):
        read_document(path)
    for chunk, message in ((b"\xff\0\0\0JSON", "ends after the file"), (b"\0\0\0\0BIN\0", "expected a JSON chunk")):
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 20) + chunk)
        with pytest.raises(FormatError, match=message):
            read_document(path)


@pytest.mark.parametrize(("text", "message"), [("[]", "with an asset, got other JSON"), ('{"a": NaN}', "number NaN")])
def test_other_json_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "other.gltf").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_document(tmp_path / "other.gltf")


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([{"children": [1]}, {"children": [0], "mesh": 0}], "own ancestors"),
        ([{"children": [2]}, {"children": [2]}, {"mesh": 0}], "two parents"),
        ([{"mesh": 0, "scale": [1, 1]}], "3 finite numbers"),
        ([{"mesh": 0, "matrix": [1e200] * 16}], "16 finite numbers"),
        ([{"mesh": 0, "rotation": [10**400, 0, 0, 1]}], "4 finite numbers"),
    ],
)
def test_nodes_that_are_refused(nodes: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_nodes(_changed(arm(), nodes=nodes, scenes=[{"nodes": [0]}]))


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
        assert humanoid_bones(_changed(arm(), extensions=extensions)) == {"leftUpperArm": "upper"}
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
        assert [len(character.rig.names)] * len(stated["skins"]) == stated["skins"] if character.rig else True
        assert {len(p.shapes) for p in character.parts if p.shapes} == set(stated["morph_targets"].values())
        assert len(character.animations) == stated["animations"]
    bones = humanoid_bones(read_document(place / "mh_male_young.vrm"))
    assert len(bones) == 53
    assert bones["head"] == "head"


@pytest.mark.slow
def test_draco(shared_data: Path) -> None:
    pytest.importorskip("DracoPy")
    place = shared_data / "characters"
    packed = read_character(place / "foreign" / "mh_male_young_draco.glb")
    plain = read_character(place / "rigs" / "character_A.glb")
    for one, other in zip(packed.parts, plain.parts, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.mesh.positions.max(axis=0), other.mesh.positions.max(axis=0), atol=1e-4)
        assert list(one.shapes) == list(other.shapes)
    assert "KHR_draco" not in json.dumps(read_document(place / "foreign" / "mh_male_young_draco.glb").json)


def test_draco_without_its_library(monkeypatch: pytest.MonkeyPatch, shared_data: Path) -> None:
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(FormatError, match=r"cagemap\[draco\].*gltf-transform"):
        read_document(shared_data / "characters" / "foreign" / "mh_male_young_draco.glb")


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
    with pytest.raises(FormatError, match="'raise'"):
        read_shapes([file], part)


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
        with pytest.raises(FormatError, match=r"bare\.glb.*skin"):
            read(path)


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


@pytest.mark.parametrize("output", ["shapes", "cube.npz"])
def test_written_shapes_come_back_without_the_cage_at_rest(tmp_path: Path, output: str) -> None:
    cage = replace(cube(), name="cube.obj")
    shapes = {"smile": np.ones((8, 3)), "none": np.zeros((8, 3))}
    write_shapes(tmp_path / output, shapes, cage, [])
    found = read_shapes([tmp_path if output.endswith(".npz") else tmp_path / output], cage)
    assert sorted(found) == ["none", "smile"]
    np.testing.assert_allclose(found["smile"], 1.0)


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
    """Read, and written and read again."""
    document, points, weights, binds = _two_skins()
    character = character_of(document)
    pose = np.array([moved(0, 0, 0), moved(1, 0, 0)])
    pose[:, :3, :3] = Rotation.from_rotvec([(0.3, 0.2, 0.1), (0.1, 0.9, -1.1)]).as_matrix()
    joints = world_transforms(pose, np.array([-1, 0]))
    for found in (character, character_of(character_glb(character, document))):
        rig = found.rig
        assert rig is not None
        local = rig.local.copy()
        for joint, of_joint in zip(("a", "b"), pose, strict=True):
            local[rig.names.index(joint)] = of_joint
        placed = world_transforms(local, rig.parents)
        for number, part in enumerate(found.parts):
            blended = np.einsum("vj,jab->vab", weights, np.linalg.inv(binds[number]) @ joints)
            meant = np.einsum("va,vab->vb", np.column_stack([points[number], np.ones(6)]), blended)[:, :3]
            got = skinned_positions(part, rig, placed)
            np.testing.assert_allclose(got[np.lexsort(got.T.round(3))], meant[np.lexsort(meant.T.round(3))], atol=1e-5)


def test_sparse_positions_need_no_buffer_view(tmp_path: Path) -> None:
    """Rows that are not listed are 0; a count beyond the document's bytes is refused."""
    make = Maker()
    indices, values = make.view(np.array([1, 2], "u1").tobytes()), make.view(np.eye(3, dtype="f4")[:2].tobytes())
    sparse = {"count": 2, "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}}
    entry = {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}
    top = {
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    write_document(tmp_path / "sparse.glb", make.document(accessors=[entry], **top))
    np.testing.assert_array_equal(read_mesh(tmp_path / "sparse.glb").positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    write_document(tmp_path / "huge.glb", make.document(accessors=[entry | {"count": 3_000_000_000}], **top))
    with pytest.raises(FormatError, match="has no data"):
        read_mesh(tmp_path / "huge.glb")


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
