"""Writing glTF: what is not understood stays, and characters go into documents."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.values import Character, Interpolation, Part, ShapeTrack
from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.ownership import is_own
from cagemap.mesh.parts import extract_faces
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest

from gltf_scenes import arm, changed
from refusals import refuses
from usd_characters import lively, shape_keys, with_shape_track

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


@pytest.mark.parametrize(("document", "images"), [(arm(), ""), (_textured(), ", images of materials")])
def test_a_rig_that_cannot_go_along_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, document: Document, images: str
) -> None:
    write_document(tmp_path / "arm.glb", document)
    write_mesh(tmp_path / "box.glb", cube(), like=tmp_path / "arm.glb")
    held = f"skinning weights, blend shapes, skeleton, animations{images}"
    assert f"its {held} are left out" in caplog.text
    request = RefineRequest(mesh=tmp_path / "arm.glb", output=tmp_path / "arm.obj", level=0)
    assert run_refine(request, Stages())[1] == [f"arm.obj: left out of arm.glb: {held}"]
    kept = RefineRequest(mesh=tmp_path / "arm.glb", output=tmp_path / "kept.glb", level=0)
    assert run_refine(kept, Stages())[1] == []
    assert "skins" not in read_document(tmp_path / "box.glb").json
    caplog.clear()
    write_mesh(tmp_path / "same.glb", read_mesh(tmp_path / "arm.glb"), like=tmp_path / "arm.glb")
    assert caplog.text == ""


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
    document.json["animations"][0]["channels"].pop()  # of the strip, which has no skin then
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
        refuses(FormatError, words, character_glb, character_of(document), document, {("sleeve", slot): data})


def test_documents_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    document = arm()
    refuses(FormatError, r"a name ending in \.glb, \.gltf or \.vrm", write_document, tmp_path / "a.obj", document)
    document.json["asset"]["generator"] = float("nan")
    refuses(FormatError, "not finite", write_document, tmp_path / "a.glb", document)
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


@pytest.mark.parametrize("interpolation", ["LINEAR", "CUBICSPLINE"])
@pytest.mark.parametrize("of_node", [False, True])
def test_weights_of_shapes_follow_their_names(interpolation: str, of_node: bool) -> None:
    made = lively()
    rows = 3 if interpolation == "LINEAR" else 9
    made = with_shape_track(made, "walk | fast", np.arange(2.0 * rows).reshape(rows, 2))
    document = character_glb(made)
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
    made = character_of(given)
    body = made.parts[0]
    shapes = {"new": body.shapes["wide"], **dict(reversed(body.shapes.items()))}
    changed = replace(made, parts=(replace(body, shapes=shapes), *made.parts[1:]))
    for animation in (0, None):
        expected, found = (shape_keys(one, animation) for one in (given, character_glb(changed, given)))
        assert expected
        assert set(found) - set(expected) <= {("body", "new")}
        for name, keys_of in expected.items():
            for one, other in zip(keys_of, found[name], strict=True):
                np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("interpolation", ["LINEAR", "CUBICSPLINE"])
def test_shapes_without_a_track_keep_their_weight_at_rest(interpolation: Interpolation) -> None:
    made, keys = lively(), np.array([[0.0], [1.0]])
    splines = interpolation == "CUBICSPLINE"
    values = np.stack([keys, keys, keys], axis=1) if splines else keys
    body = replace(made.parts[0], shape_weights={"raise": 0.5, "wide": 0.25})
    track = ShapeTrack("body", ("wide",), np.arange(2.0), values, interpolation)
    walk = replace(made.animations[0], shape_tracks=(track,))
    made = replace(made, parts=(body, *made.parts[1:]), animations=(walk,))
    found = shape_keys(character_glb(made), 0)
    np.testing.assert_array_equal(found["body", "wide"][1], values)
    np.testing.assert_array_equal(found["body", "raise"][1][0].ravel(), [0.0, 0.5, 0.0] if splines else [0.5])


def test_lost_keys_of_weights_are_named(caplog: pytest.LogCaptureFixture) -> None:
    """Several at one time, and weights for another number of shapes than the part has."""
    document = character_glb(with_shape_track(lively(), "walk | fast", np.arange(8.0).reshape(4, 2)))
    top, keys = json.loads(json.dumps(document.json)), Binary(document)
    entry = next(one for one in top["animations"] if one["name"] == "walk | fast")
    sampler = entry["samplers"][entry["channels"][-1]["sampler"]]
    sampler["input"] = keys.accessor(np.array([0, 1, 1, 2], dtype="<f4"), bounds=True)
    (track,) = character_of(keys.document(top)).animations[0].shape_tracks
    np.testing.assert_array_equal(track.times, [0.0, 1.0, 2.0])
    assert caplog.messages == ["new.glb: animations 0 has several keys at the same time, the last one is used"]
    caplog.clear()
    sampler["input"] = keys.accessor(np.arange(4, dtype="<f4"), bounds=True)
    sampler["output"] = keys.accessor(np.arange(4, dtype="<f4"))
    assert character_of(keys.document(top)).animations[0].shape_tracks == ()
    assert caplog.messages == ["new.glb: animations 0: weights of body are left out: expected 8 values, got 4"]


def test_variants_of_materials_stay_and_lost_values_of_primitives_are_named(caplog: pytest.LogCaptureFixture) -> None:
    document = _textured()
    strip = document.json["meshes"][0]["primitives"][0]
    strip["attributes"] |= {"COLOR_1": 0, "_HEAT": 0}
    variants = {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}}
    strip["extensions"] = variants | {"ACME_hair": {}}
    again = character_glb(character_of(document), document)
    (primitive,) = again.json["meshes"][0]["primitives"]
    assert primitive["extensions"] == variants
    assert "extensions" not in again.json["meshes"][1]["primitives"][0]
    assert caplog.messages == ["made.glb: strip: ACME_hair, COLOR_1, _HEAT are left out, which cagemap does not read"]


def _expressive(version: str) -> Document:
    """`arm` with an expression that raises the strip, and one of a second node, with first-person flags."""
    document = arm()
    nodes, meshes = document.json["nodes"], document.json["meshes"]
    nodes.append({"name": "lash", "mesh": 2})
    document.json["scenes"][0]["nodes"].append(5)
    meshes.append(json.loads(json.dumps(meshes[0])))
    for name in ("JOINTS_0", "WEIGHTS_0"):
        meshes[2]["primitives"][0]["attributes"].pop(name)
    if version == "VRM":
        groups = [{"name": "aa", "binds": [{"mesh": 0, "index": 0, "weight": 100}, {"mesh": 2, "index": 0}]}]
        groups.append({"name": "lashes", "binds": [{"mesh": 2, "index": 0, "weight": 100}]})
        flags = [{"mesh": number, "firstPersonFlag": "Auto"} for number in range(3)]
        vrm = {"blendShapeMaster": {"blendShapeGroups": groups}}
    else:
        binds = [{"node": 4, "index": 0, "weight": 1.0}, {"node": 5, "index": 0, "weight": 1.0}]
        custom = {"lashes": {"morphTargetBinds": binds[1:]}, "color": {"materialColorBinds": []}, "odd": 7}
        vrm = {"expressions": {"preset": {"aa": {"morphTargetBinds": binds}}, "custom": custom}}
        flags = [{"node": node, "type": "auto"} for node in (3, 4, 5)]
    vrm["firstPerson"] = {"meshAnnotations": flags}
    return changed(document, extensions={version: vrm}, extensionsUsed=[version])


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm"])
def test_expressions_refer_to_the_shapes_that_are_written(version: str, caplog: pytest.LogCaptureFixture) -> None:
    """Another order of shapes changes numbers; a mesh, or a shape, that is not written is referred to no more."""
    document = _expressive(version)
    ball, strip, lash = character_of(document).parts
    own = np.ones_like(strip.shapes["raise"])
    longer = replace(strip, shapes={"own": own} | strip.shapes)
    key, numbers = ("mesh", [1, 0, 2]) if version == "VRM" else ("node", [3, 4, 5])

    def written(*parts: Part) -> tuple[list[Any], list[Any], list[Any]]:
        vrm = character_glb(replace(character_of(document), parts=parts), document).json["extensions"][version]
        if version == "VRM":
            binds = [group["binds"] for group in vrm["blendShapeMaster"]["blendShapeGroups"]]
        else:
            kinds = vrm["expressions"]
            assert kinds["custom"]["color"] == {"materialColorBinds": []}
            assert kinds["custom"]["lashes"].get("morphTargetBinds") != []
            binds = [kinds["preset"]["aa"]["morphTargetBinds"], kinds["custom"]["lashes"].get("morphTargetBinds", [])]
        flags = sorted(flag[key] for flag in vrm["firstPerson"]["meshAnnotations"])
        return *([(bind[key], bind["index"]) for bind in of_one] for of_one in binds), flags

    first, second = numbers[1:]
    assert written(ball, longer, lash) == ([(first, 1), (second, 0)], [(second, 0)], sorted(numbers))
    assert caplog.text == ""
    assert written(ball, longer) == ([(first, 1)], [], sorted(numbers[:2]))
    assert "expressions that move no shape any more, since" in caplog.text
    assert "not carried: lashes" in caplog.text
    assert written(strip, replace(lash, shapes={})) == ([(first, 0)], [], sorted(numbers[1:]))


def _binds(document: Document, version: str) -> list[dict[str, Any]]:
    """Binds of the first expression."""
    vrm = document.json["extensions"][version]
    if version == "VRM":
        return vrm["blendShapeMaster"]["blendShapeGroups"][0]["binds"]
    return vrm["expressions"]["preset"]["aa"]["morphTargetBinds"]


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm"])
def test_expressions_that_are_not_as_vrm_says_stay_while_the_shapes_do(version: str) -> None:
    """A whole number with a decimal point counts; a number without a shape is removed with other shapes."""
    document = _expressive(version)
    binds = _binds(document, version)
    binds[:] = [{**binds[0], "index": index} for index in (0.0, 1, -1, None, [0])]
    ball, strip, lash = character_of(document).parts

    def indices(one: Part) -> list[Any]:
        again = character_glb(replace(character_of(document), parts=(ball, one, lash)), document)
        return [bind["index"] for bind in _binds(again, version)]

    assert indices(strip) == [0.0, 1, -1, None, [0]]
    assert indices(replace(strip, shapes={"own": strip.shapes["raise"]} | strip.shapes)) == [1]


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm"])
def test_pieces_of_a_part_have_its_expressions_and_flags(version: str) -> None:
    document = _expressive(version)
    made = character_of(document)
    (strip,) = (part for part in made.parts if part.name == "strip")
    pieces = replace(strip, name="strip pieces")
    again = character_glb(replace(made, parts=(*made.parts, pieces)), document, pieces_of={pieces.name: "strip"})
    key, given, number = ("mesh", 0, 3) if version == "VRM" else ("node", 4, 6)
    found = [bind for bind in _binds(again, version) if bind[key] in (given, number)]
    assert found == [_binds(document, version)[0] | {key: one} for one in (given, number)]
    assert number in [flag[key] for flag in _flags(again, version)]


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm"])
def test_a_part_whose_given_node_has_no_shapes_keeps_its_mesh_and_flag(version: str) -> None:
    """It gets the expressions of the part that gave it shapes; that part's mesh stays as it is."""
    document = _expressive(version)
    key, numbers = ("mesh", (1, 0)) if version == "VRM" else ("node", (3, 4))
    meshes = document.json["meshes"]
    for mesh, name in ((0, "Strip"), (1, "Ball")):
        meshes[mesh] |= {"name": name, "extras": {"by": name}}
    meshes[0]["extras"]["targetNames"] = ["raise"]
    (flag,) = (one for one in _flags(document, version) if one[key] == numbers[1])
    flag["firstPersonFlag" if version == "VRM" else "type"] = "thirdPersonOnly"
    flags = json.loads(json.dumps(_flags(document, version)))
    ball, strip, lash = character_of(document).parts
    own = replace(ball, shapes={"raise": np.ones((ball.mesh.n_vertices, 3))})
    made = replace(character_of(document), parts=(own, strip, lash))
    again = character_glb(made, document, pieces_of={own.name: "strip"})
    assert [mesh["name"] for mesh in again.json["meshes"][:2]] == ["Strip", "Ball"]
    assert [mesh["extras"]["by"] for mesh in again.json["meshes"][:2]] == ["Strip", "Ball"]
    assert len(again.json["meshes"]) == 3
    assert {one["name"]: one["mesh"] for one in again.json["nodes"] if "mesh" in one}[own.name] == 1
    assert [bind for bind in _binds(again, version) if bind[key] in numbers] == [
        _binds(document, version)[0] | {key: number} for number in reversed(numbers)
    ]
    assert _flags(again, version) == flags


def _flags(document: Document, version: str) -> list[dict[str, Any]]:
    return document.json["extensions"][version]["firstPerson"]["meshAnnotations"]


def test_shapes_that_the_first_primitive_lacks_are_referred_to() -> None:
    """Its weights are read, too."""
    document = _expressive("VRMC_vrm")
    mesh = document.json["meshes"][0]
    without = {name: value for name, value in mesh["primitives"][0].items() if name != "targets"}
    mesh["primitives"] = [without, mesh["primitives"][0]]
    mesh["weights"] = [0.5]
    again = character_glb(character_of(document), document)
    assert _binds(again, "VRMC_vrm") == _binds(document, "VRMC_vrm")
    assert list(shape_keys(again, None)) == [("strip", "raise")]


def test_names_of_expressions_that_no_text_can_hold_are_named(caplog: pytest.LogCaptureFixture) -> None:
    document = _expressive("VRM")
    document.json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"][1]["name"] = "lash\ud800"
    character_glb(replace(character_of(document), parts=character_of(document).parts[:2]), document)
    assert "lash?" in caplog.text
