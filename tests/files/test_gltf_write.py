"""Writing glTF: what is not understood stays, characters go into documents, and others read what is written."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.character.normals import move_vertices
from cagemap.character.values import Character
from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.character import character_of, read_character, read_shape_keys
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.entries import Document, image_bytes, read_accessor
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.ownership import is_own
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import extract_faces
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest

from gltf_scenes import Maker, arm
from usd_characters import lively, with_shape_weights

READ = ("Fox.glb", "MorphStressTest.gltf", "saturday06_skinned_morph_vrm0.vrm", "mh_male_young_draco.glb")
PNG = b"\x89PNG" + bytes(20)


def _textured() -> Document:
    """An arm whose two meshes share one image, with an extension that nobody knows."""
    document = arm()
    json_ = document.json | {
        "extensionsUsed": ["ACME_springs"],
        "extensions": {"ACME_springs": {"joint": 2}},
        "materials": [
            {"name": name, "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 0}}}
            for name in ("sleeve", "ball")
        ],
        "samplers": [{"magFilter": 9728}],
        "textures": [{"source": 0, "sampler": 0}],
        "images": [{"bufferView": len(document.json["bufferViews"]), "mimeType": "image/png", "name": "skin"}],
    }
    view = {"buffer": 0, "byteOffset": len(document.buffers[0]), "byteLength": len(PNG)}
    json_["bufferViews"] = [*document.json["bufferViews"], view]
    json_["buffers"] = [{"byteLength": len(document.buffers[0]) + len(PNG)}]
    for number, mesh in enumerate(json_["meshes"]):
        mesh["primitives"][0]["material"] = number
    return replace(document, json=json_, buffers=(document.buffers[0] + PNG,))


def _same(one: Character, other: Character, tolerance: float = 1e-6) -> None:
    for part, again in zip(one.parts, other.parts, strict=True):
        assert part.name == again.name
        assert part.mesh.n_faces == again.mesh.n_faces
        assert part.mesh.material_names == again.mesh.material_names
        corners = part.mesh.positions[part.mesh.face_indices], again.mesh.positions[again.mesh.face_indices]
        np.testing.assert_allclose(*corners, atol=tolerance)
        assert list(part.shapes) == list(again.shapes)
        for name in part.shapes:
            offsets = part.shapes[name][part.mesh.face_indices], again.shapes[name][again.mesh.face_indices]
            np.testing.assert_allclose(*offsets, atol=tolerance)
        if part.weights is not None and again.weights is not None:
            rows = part.weights[part.mesh.face_indices] - again.weights[again.mesh.face_indices]
            assert np.abs(rows).max() < 1e-6
    assert (one.rig is None) == (other.rig is None)
    if one.rig is not None and other.rig is not None:
        assert one.rig.names == other.rig.names
        np.testing.assert_allclose(one.rig.local, other.rig.local, atol=tolerance)
        np.testing.assert_allclose(one.rig.bind, other.rig.bind, atol=tolerance)
        for animation, again_moving in zip(one.animations, other.animations, strict=True):
            for track, also in zip(animation.tracks, again_moving.tracks, strict=True):
                assert (track.joint, track.channel) == (also.joint, also.channel)
                np.testing.assert_allclose(track.values, also.values, atol=tolerance)


def _faces(mesh: ControlMesh) -> list[tuple[int, ...]]:
    return [tuple(mesh.face(number).tolist()) for number in range(mesh.n_faces)]


def test_polygons_come_back_as_polygons(tmp_path: Path) -> None:
    """Also faces round one vertex that all begin with it, which together look like one fan; of two materials."""
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
    with pytest.raises(FormatError, match="expected faces and their corners"):
        character_of(document)


def test_a_rig_that_cannot_go_along_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_document(tmp_path / "arm.glb", arm())
    write_mesh(tmp_path / "box.glb", cube(), like=tmp_path / "arm.glb")
    assert "its skeleton, shapes, animations are left out" in caplog.text
    assert "skins" not in read_document(tmp_path / "box.glb").json
    caplog.clear()
    write_mesh(tmp_path / "same.glb", read_mesh(tmp_path / "arm.glb"), like=tmp_path / "arm.glb")
    assert caplog.text == ""


def test_triangles_need_no_extension(tmp_path: Path) -> None:
    write_mesh(tmp_path / "ball.glb", icosahedron())
    assert "extensionsUsed" not in read_document(tmp_path / "ball.glb").json


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".vrm"])
def test_a_document_comes_back_as_it_was(suffix: str, tmp_path: Path) -> None:
    document = _textured()
    document.json["nodes"][2]["extras"] = {"note": ["kept", 1.5]}
    path = tmp_path / f"copy{suffix}"
    write_document(path, document)
    assert is_own(path)
    again = read_document(path)
    for name in set(document.json) - {"asset", "bufferViews", "buffers"}:
        assert again.json[name] == document.json[name]
    _same(character_of(document), character_of(again))
    assert image_bytes(again, 0) == (PNG, ".png")


def test_images_beside_a_gltf_are_packed(tmp_path: Path) -> None:
    document = _textured()
    (tmp_path / "skin.png").write_bytes(PNG)
    json_ = document.json | {"images": [{"uri": "skin.png", "name": "skin"}]}
    path = tmp_path / "out.glb"
    write_document(path, replace(document, json=json_, file=tmp_path / "in.gltf"))
    assert image_bytes(read_document(path), 0)[0] == PNG


@pytest.mark.parametrize("above", [None, {"scale": [0.1, 0.1, 0.1], "rotation": [0.5, 0.5, 0.5, 0.5]}])
def test_a_character_in_its_document_and_alone(above: dict[str, Any] | None, tmp_path: Path) -> None:
    document = arm(above=above)
    character = character_of(document)
    for name, made in (("in.glb", character_glb(character, document)), ("alone.glb", character_glb(character))):
        write_document(tmp_path / name, made)
        again = read_character(tmp_path / name)
        _same(character, again)


def test_what_is_no_joint_stays_in_the_document() -> None:
    document = _textured()
    made = character_glb(character_of(document), document)
    assert made.json["extensions"] == document.json["extensions"]
    assert [node["name"] for node in made.json["nodes"]] == ["armature", "upper", "lower", "ball", "strip"]
    assert made.json["nodes"][4]["translation"] == [7, 7, 7]
    paths = [(c["target"]["node"], c["target"]["path"]) for c in made.json["animations"][0]["channels"]]
    assert sorted(paths) == [(1, "translation"), (2, "rotation"), (4, "translation")]


@pytest.mark.parametrize("rigged", [True, False])
def test_nodes_outside_the_scene_keep_their_skin(rigged: bool, tmp_path: Path) -> None:
    given = arm()
    hidden = {"name": "hidden", "mesh": 0, "skin": 1}
    skins = [*given.json["skins"], {"joints": [2, 1]}]
    document = replace(given, json=given.json | {"nodes": [*given.json["nodes"], hidden], "skins": skins})
    character = character_of(document)
    if not rigged:
        parts = tuple(replace(part, weights=None) for part in character.parts)
        character = replace(character, parts=parts, rig=None, animations=())
    write_document(tmp_path / "out.glb", character_glb(character, document))
    made = read_document(tmp_path / "out.glb").json
    assert made["skins"][made["nodes"][5]["skin"]] == skins[1]
    if rigged:
        _same(character, read_character(tmp_path / "out.glb"))


def test_joints_move_and_join() -> None:
    document = arm()
    character = character_of(document)
    rig = character.rig
    lifted, tip = rig.local.copy(), np.eye(4)
    lifted[1, 3, 1] = 0.25
    tip[3, 0] = 1.0
    bind = np.stack([rig.bind[0], lifted[1] @ rig.bind[0], tip @ lifted[1] @ rig.bind[0]])
    grown = replace(
        rig,
        names=(*rig.names, "tip"),
        parents=np.array([-1, 0, 1]),
        local=np.concatenate([lifted, tip[None]]),
        bind=bind,
    )
    parts = tuple(replace(part, weights=None) for part in character.parts)
    again = character_of(character_glb(replace(character, rig=grown, parts=parts), document))
    assert again.rig.names == ("upper", "lower", "tip")
    np.testing.assert_allclose(again.rig.bind, bind, atol=1e-6)
    np.testing.assert_allclose(again.rig.local, grown.local, atol=1e-6)


def test_a_new_image_for_one_of_two_materials_that_share_one() -> None:
    document = _textured()
    other = b"\xff\xd8\xff" + bytes(9)
    made = character_glb(character_of(document), document, {("sleeve", "baseColorTexture"): other})
    slots = [material["pbrMetallicRoughness"]["baseColorTexture"] for material in made.json["materials"]]
    images = [image_bytes(made, made.json["textures"][slot["index"]]["source"]) for slot in slots]
    assert images == [(other, ".jpg"), (PNG, ".png")]
    assert slots[0]["texCoord"] == 0
    assert made.json["textures"][slots[0]["index"]]["sampler"] == 0
    with pytest.raises(FormatError, match="sleeve, ball"):
        character_glb(character_of(document), document, {("hat", "baseColorTexture"): other})
    for slot, data, words in (("baseColorTexture", b"text", "PNG or JPEG"), ("shine", other, "a texture slot of glTF")):
        with pytest.raises(FormatError, match=words):
            character_glb(character_of(document), document, {("sleeve", slot): data})


def test_documents_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    document = arm()
    with pytest.raises(FormatError, match=r"a name ending in \.glb, \.gltf, \.vrm"):
        write_document(tmp_path / "a.obj", document)
    document.json["asset"]["generator"] = float("nan")
    with pytest.raises(FormatError, match="not finite"):
        write_document(tmp_path / "a.glb", document)
    assert list(tmp_path.iterdir()) == []


def test_a_new_image_of_one_material_replaces_the_old_one() -> None:
    document = _textured()
    document.json["materials"].pop()
    del document.json["meshes"][1]["primitives"][0]["material"]
    del document.json["extensionsUsed"]
    other = b"\xff\xd8\xff" + bytes(9)
    made = character_glb(character_of(document), document, {("sleeve", "baseColorTexture"): other})
    assert len(made.json["images"]) == len(made.json["textures"]) == 1
    assert image_bytes(made, 0) == (other, ".jpg")
    assert PNG not in made.buffers[0]
    added = character_glb(character_of(document), document, {("sleeve", "normalTexture"): other})
    assert len(added.json["images"]) == 2


def test_more_than_four_influences_and_256_joints(tmp_path: Path) -> None:
    character = character_of(arm())
    rig, strip = character.rig, character.parts[1]
    assert rig is not None
    count = 300
    many = replace(
        rig,
        names=tuple(f"j{number}" for number in range(count)),
        parents=np.arange(-1, count - 1),
        local=np.tile(np.eye(4), (count, 1, 1)),
        bind=np.tile(np.eye(4), (count, 1, 1)),
    )
    from scipy import sparse

    table = np.zeros((strip.mesh.n_vertices, count))
    table[:, 290:296] = [0.3, 0.1, 0.2, 0.15, 0.05, 0.2]
    part = replace(strip, weights=sparse.csr_array(table))
    write_document(tmp_path / "many.glb", character_glb(Character((part,), many)))
    again = read_character(tmp_path / "many.glb").parts[0].weights
    np.testing.assert_allclose(again.toarray(), table, atol=1e-7)


def test_a_mesh_with_other_faces_is_written_alone(tmp_path: Path) -> None:
    write_document(tmp_path / "arm.glb", arm())
    mesh = read_mesh(tmp_path / "arm.glb")
    moved = mesh.with_positions(mesh.positions + np.array([0, 0, 1]))
    write_mesh(tmp_path / "moved.glb", moved, like=tmp_path / "arm.glb")
    again = read_character(tmp_path / "moved.glb")
    assert again.rig is not None
    np.testing.assert_allclose(again.parts[1].mesh.positions[:, 2], 1.0)
    half = extract_faces(mesh, np.array([1, 2]))
    write_mesh(tmp_path / "half.glb", half, like=tmp_path / "arm.glb")
    assert read_character(tmp_path / "half.glb").rig is None


def _inside(path: Path) -> dict[str, Any]:
    """What an independent reader finds."""
    pygltflib = pytest.importorskip("pygltflib")
    binary = path.read_bytes()[:4] == b"glTF"
    gltf = pygltflib.GLTF2().load_binary(str(path)) if binary else pygltflib.GLTF2().load_json(str(path))
    ends = []
    for animation in gltf.animations:
        inputs = [gltf.accessors[sampler.input] for sampler in animation.samplers]
        ends.append(round(max(entry.max[0] for entry in inputs), 5))
    places = [[gltf.accessors[primitive.attributes.POSITION] for primitive in mesh.primitives] for mesh in gltf.meshes]
    targets = [len(mesh.primitives[0].targets or []) for mesh in gltf.meshes]
    names = [(mesh.extras or {}).get("targetNames") for mesh in gltf.meshes]
    return {
        "nodes": [node.name for node in gltf.nodes],
        "low": [np.min([entry.min for entry in mesh], axis=0) for mesh in places],
        "high": [np.max([entry.max for entry in mesh], axis=0) for mesh in places],
        "morphs": (targets, names),
        "skins": [[gltf.nodes[joint].name for joint in skin.joints] for skin in gltf.skins],
        "animations": [animation.name for animation in gltf.animations],
        "ends": ends,
        "materials": [material.name for material in gltf.materials],
        "images": len(gltf.images),
        "extensions": sorted(gltf.extensions or {}),
    }


def _box(found: dict[str, Any]) -> tuple[list[Any], list[Any]]:
    return found.pop("low"), found.pop("high")


@pytest.mark.slow
@pytest.mark.parametrize("name", READ)
def test_round_trips_by_an_independent_reader(name: str, tmp_path: Path, shared_data: Path) -> None:
    """`refine --level 0` and a plain copy: bounding boxes, skins, morphs, lengths of animations."""
    given = shared_data / "characters" / "foreign" / name
    if "draco" in name:
        pytest.importorskip("DracoPy")
    before = _inside(given)
    low, high = _box(before)
    run_refine(RefineRequest(given, 0, tmp_path / "refined.glb"), Stages())
    write_document(tmp_path / "copied.glb", read_document(given))
    for path in (tmp_path / "refined.glb", tmp_path / "copied.glb"):
        after = _inside(path)
        size = np.max(np.ptp([low, high], axis=0))
        # Draco rounds, and the file states the bounds before.
        np.testing.assert_allclose(_box(after), (low, high), atol=(1e-4 if "draco" in name else 1e-6) * size)
        assert after == before


VALIDATE = """
const fs = require('fs'), validator = require(process.argv[1]);
(async () => {
  for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {maxIssues: 0});
    const errors = report.issues.messages.filter(one => one.severity === 0);
    console.log(JSON.stringify({file, errors: errors.slice(0, 5), count: report.issues.numErrors}));
  }
})();
"""


def _validator() -> str:
    """Folder of the Khronos validator; the test skips where it is not installed."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed, which runs the Khronos validator")
    found = subprocess.run(
        ["node", "-p", "require.resolve('gltf-validator')"], capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("the npm package gltf-validator is not installed (npm install gltf-validator; NODE_PATH)")
    return found.stdout.strip()


@pytest.mark.slow
@pytest.mark.usefixtures("fbx_server")
def test_the_khronos_validator_finds_no_errors(tmp_path: Path, shared_data: Path) -> None:
    validator = _validator()
    pytest.importorskip("DracoPy")
    pytest.importorskip("ufbx")
    place = shared_data / "characters"
    files = [*(place / "foreign" / name for name in (*READ, "mh_male_young.vrm")), place / "rigs" / "character_A.glb"]
    files += [place / "rigs" / "target_B_body.glb", *sorted((place / "foreign").glob("*.fbx"))]
    written = []
    for file in files:
        document = read_document(file)
        made = {"copied": document}
        if "draco" not in file.name:  # decoded, it is character_A
            character = character_of(document)
            made |= {"built": character_glb(character, document), "alone": character_glb(character)}
            written.append(tmp_path / f"{file.stem}_mesh.glb")
            write_mesh(written[-1], read_mesh(file))
        for kind, one in made.items():
            written.append(tmp_path / f"{file.stem}_{kind}.glb")
            write_document(written[-1], one)
    write_document(tmp_path / "made.glb", character_glb(character_of(arm()), arm()))
    reports = subprocess.run(
        ["node", "-e", VALIDATE, validator, *map(str, written), str(tmp_path / "made.glb")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert len(reports.splitlines()) == len(written) + 1
    assert [line for line in reports.splitlines() if json.loads(line)["count"]] == []


@pytest.mark.parametrize("interpolation", ["LINEAR", "CUBICSPLINE"])
@pytest.mark.parametrize("of_node", [False, True])
def test_weights_of_shapes_follow_their_names(interpolation: str, of_node: bool) -> None:
    """As where `face` adds shapes to a head that has animated ones, or another order is written."""
    made = lively()
    rows = 3 if interpolation == "LINEAR" else 9
    document = with_shape_weights(character_glb(made), "walk | fast", np.arange(2.0 * rows).reshape(rows, 2))
    top = json.loads(json.dumps(document.json))
    entry = next(one for one in top["animations"] if one["name"] == "walk | fast")
    sampler = entry["samplers"][-1]
    sampler["interpolation"] = interpolation
    keys = Binary(document)
    sampler["input"] = keys.accessor(np.arange(3, dtype="<f4"), min=[0.0], max=[2.0])
    node = entry["channels"][-1]["target"]["node"]
    top["meshes"][top["nodes"][node]["mesh"]]["weights"] = [0.25, 0.5]
    if of_node:
        top["nodes"][node]["weights"] = [0.75, 0.0]
    given = keys.document(top)
    body = made.parts[0]
    shapes = {"new": body.shapes["wide"], **dict(reversed(body.shapes.items()))}
    changed = replace(made, parts=(replace(body, shapes=shapes), *made.parts[1:]))
    before, after = (read_scene(one) for one in (given, character_glb(changed, given)))
    for animation in (0, None):
        expected, found = (read_shape_keys(scene, animation) for scene in (before, after))
        assert expected
        assert set(found) - set(expected) <= {("body", "new")}
        for name, keys_of in expected.items():
            for one, other in zip(keys_of, found[name], strict=True):
                np.testing.assert_array_equal(one, other)


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
    """As stated where the mesh is unchanged, else as the shape turns the faces."""
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
    assert moved.normals is not None
    (shape,) = moved.shapes.values()
    slope = moved.normals + offsets
    edges = (moved.mesh.positions + shape)[moved.mesh.face_indices[[0, 1, 2]]]
    np.testing.assert_allclose(slope[0] @ (edges[1:] - edges[0]).T, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 1.0, atol=1e-6)
