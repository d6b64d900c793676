"""Whole characters in USD, read back with USD's own skinning."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import icosahedron

from cagemap.character.poses import interpolate_keys, pose_at, world_transforms
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import material_images, with_copied_materials
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import read_image, write_image

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Usd, UsdGeom, UsdShade, UsdSkel

from cagemap.files.usd import character as usd_character
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import usd_document
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.write import UsdResults, write_usd_over
from cagemap.numerics.arrays import decode_srgb
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from refusals import refuses
from usd_characters import lively, painted, posed, shape_keys, with_shape_track
from usd_scenes import complaints, stage_at


def _written(path: Path, made: Character, document: Document | None = None, **options: Any) -> list[str]:
    document = character_glb(made) if document is None else document
    return write_usd_character(path, made, read_scene(document), **options)


def _as_gltf_says(made: Character, document: Document, number: int, seconds: float) -> dict[str, np.ndarray]:
    """Skinned and shaped points of all parts, by linear blend skinning as glTF defines it."""
    keys = shape_keys(document, number)
    transforms = pose_at(made.rig, made.animations[number], seconds)
    found = {}
    for part in made.parts:
        shaped = part.mesh.positions.copy()
        for shape, offsets in part.shapes.items():
            if (part.name, shape) in keys:
                weight = interpolate_keys(*keys[part.name, shape], np.array([seconds]), quaternions=False)[0, 0]
                shaped += weight * offsets
        found[part.name] = skinned_positions(replace(part, mesh=part.mesh.with_positions(shaped)), made.rig, transforms)
    return found


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd", "usdz"])
def test_usd_skins_and_shapes_as_gltf_does(tmp_path: Path, suffix: str) -> None:
    """At keys and between them, to 1e-5 of the size; of a spline between frames to 1e-4."""
    made = lively()
    weights = np.array([[0.0, 0.0], [1.0, 0.25], [0.5, 1.0]])
    made = with_shape_track(made, "walk | fast", weights)
    document = character_glb(made)
    path = tmp_path / f"OUT.{suffix}"
    notes = _written(path, made, document)
    assert notes == ["USD plays one animation, walk | fast; bind steps, spline in /Asset/animations to play them"]
    assert complaints(path) == []
    for number, animation in enumerate(made.animations):
        for seconds in (0.0, 0.25, 0.5, 1.0, 1.37, 2.0):
            expected = _as_gltf_says(made, document, number, seconds)
            found = posed(path, animation.name, seconds)
            assert found.keys() == expected.keys()
            for name, points in expected.items():
                between = 1e-4 if animation.name == "spline" and seconds == 1.37 else 1e-5
                np.testing.assert_allclose(found[name], points, atol=between, err_msg=f"{animation.name} {seconds}")


def test_at_bind_every_mesh_has_its_own_points(tmp_path: Path) -> None:
    """Transforms of the joints in the bind pose leave the points where they are; rest and names are kept."""
    made = lively()
    _written(tmp_path / "OUT.usdc", made)
    stage = Usd.Stage.Open(str(tmp_path / "OUT.usdc"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton"))
    assert list(skeleton.GetJointNamesAttr().Get()) == list(made.rig.names)
    joints = list(skeleton.GetJointsAttr().Get())
    assert joints[1].startswith(f"{joints[0]}/")
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
    binds = skeleton.GetBindTransformsAttr().Get()
    np.testing.assert_allclose(np.linalg.norm(np.array(binds)[:, :3, :3], axis=2), 1.0, atol=1e-12)
    inverse = [bind.GetInverse() * bind for bind in binds]
    for part in made.parts:
        prim = stage.GetPrimAtPath(f"/Asset/{part.name}")
        points = UsdGeom.Mesh(prim).GetPointsAttr().Get()
        np.testing.assert_array_equal(np.array(points), part.mesh.positions.astype(np.float32))
        lengths = np.linalg.norm(np.array(UsdGeom.Mesh(prim).GetNormalsAttr().Get()), axis=1)
        np.testing.assert_allclose(lengths, np.ones(part.mesh.n_vertices), atol=1e-6)
        query = cache.GetSkinningQuery(prim)
        assert query.HasJointInfluences() == (part.weights is not None)
        if part.weights is not None:
            assert query.ComputeSkinnedPoints(inverse, points, Usd.TimeCode.Default())
            np.testing.assert_allclose(np.array(points), part.mesh.positions, atol=1e-6)
    rests = cache.GetSkelQuery(skeleton).ComputeJointSkelTransforms(Usd.TimeCode.EarliestTime(), True)
    heads = world_transforms(made.rig.local, made.rig.parents)[:, 3, :3]
    np.testing.assert_allclose(np.array(rests)[:, 3, :3], heads, atol=1e-6)


def test_materials_keep_factors_images_and_transforms(tmp_path: Path) -> None:
    made, document = painted()
    path = tmp_path / "OUT.usda"
    notes = _written(path, made, document)
    assert notes == [
        "USD has no place for KHR_materials_unlit, VRMC_springBone (spring bones), extras: left out; a .glb keeps them",
        "body: its normal map has strength 0.5, in USD always 1",
        "vertex colours are written as displayColor, which the materials do not use",
    ]
    assert complaints(path) == []
    stage = Usd.Stage.Open(str(path))

    def surface(name: str) -> Any:
        return UsdShade.Material(stage.GetPrimAtPath(f"/Asset/materials/{name}")).ComputeSurfaceSource()[0]

    def texture(name: str) -> dict[str, Any]:
        source = surface("body").GetInput(name).GetConnectedSource()
        shader = UsdShade.Shader(source[0].GetPrim())
        values = {one.GetBaseName(): one.Get() for one in shader.GetInputs() if one.GetBaseName() != "st"}
        return values | {"output": source[1], "st": shader.GetInput("st").GetConnectedSource()[0].GetPrim()}

    color = texture("diffuseColor")
    assert (color["output"], color["sourceColorSpace"], color["wrapS"], color["wrapT"]) == (
        *("rgb", "sRGB", "clamp", "mirror"),
    )
    np.testing.assert_allclose(color["scale"], [0.5, 0.6, 0.7, 1.0], atol=1e-6)
    assert texture("opacity")["output"] == "a"
    np.testing.assert_allclose(texture("opacity")["scale"], 0.8, atol=1e-6)
    assert surface("body").GetInput("opacityThreshold").Get() == pytest.approx(0.3)
    assert (texture("metallic")["output"], texture("roughness")["output"]) == ("b", "g")
    np.testing.assert_allclose(texture("roughness")["scale"], 0.4, atol=1e-6)
    np.testing.assert_allclose(texture("normal")["scale"], [2, 2, 2, 1])
    np.testing.assert_allclose(texture("normal")["bias"], [-1, -1, -1, 0])
    assert texture("normal")["sourceColorSpace"] == "raw"
    np.testing.assert_allclose(texture("occlusion")["bias"], 0.75)
    np.testing.assert_allclose(texture("emissiveColor")["scale"], [1.0, 0.5, 0.25, 1.0])
    np.testing.assert_allclose(surface("hat").GetInput("diffuseColor").Get(), [0.1, 0.2, 0.3], atol=1e-6)
    assert surface("hat").GetInput("opacity").Get() == pytest.approx(0.4)
    # The image at a point of the mesh is the same as in glTF.
    inputs = {one.GetBaseName(): one.Get() for one in UsdShade.Shader(color["st"]).GetInputs()}
    angle = np.radians(inputs["rotation"])
    matrix = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    (image, *_) = material_images(document, "body")
    uvs = np.random.default_rng(0).random((20, 2))
    np.testing.assert_allclose(uvs * inputs["scale"] @ matrix + inputs["translation"], image.on_image(uvs), atol=1e-6)
    reader = UsdShade.Shader(UsdShade.Shader(color["st"]).GetInput("in").GetConnectedSource()[0].GetPrim())
    assert reader.GetInput("varname").Get() == "st1"
    body, hat, eye = (UsdGeom.Mesh(stage.GetPrimAtPath(f"/Asset/{name}")) for name in ("body", "hat", "eye"))
    assert (body.GetDoubleSidedAttr().Get(), hat.GetDoubleSidedAttr().Get()) == (True, False)
    for name, uv_set in zip(("st", "st1"), made.parts[0].mesh.all_uv_sets, strict=True):
        flat = UsdGeom.PrimvarsAPI(body.GetPrim()).GetPrimvar(name).ComputeFlattened()
        np.testing.assert_allclose(np.array(flat), uv_set.uvs[uv_set.uv_indices], atol=1e-6)
    assert (body.GetNormalsInterpolation(), hat.GetNormalsInterpolation()) == ("vertex", "faceVarying")
    np.testing.assert_allclose(np.array(hat.GetNormalsAttr().Get()), made.parts[1].normals)
    linear = decode_srgb(made.parts[2].mesh.vertex_colors)
    np.testing.assert_allclose(np.array(eye.GetDisplayColorAttr().Get()), linear, atol=1e-6)


def test_images_are_those_of_the_document(tmp_path: Path) -> None:
    """Beside a layer, or in a package; a JPEG stays one, with cagemap's mark."""
    made, document = painted()
    write_image(tmp_path / "noise.jpg", np.random.default_rng(0).integers(0, 255, (8, 8, 3), np.uint8))
    binary, top = Binary(document), json.loads(json.dumps(document.json))
    picture = (tmp_path / "noise.jpg").read_bytes()
    top["images"][0] = {"bufferView": binary.view(picture), "mimeType": "image/jpeg"}
    document = binary.document(top)
    _written(tmp_path / "OUT.usdc", made, document)
    names = [f"OUT_body_{slot}" for slot in ("baseColor.jpg", "metallicRoughness.png", "normal.png", "emissive.png")]
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"OUT.usdc", "noise.jpg", *names}  # the occlusion has the image of the metallic part
    np.testing.assert_array_equal(read_image(tmp_path / names[0]).pixels, read_image(tmp_path / "noise.jpg").pixels)
    data, _ = image_bytes(document, 1)
    (tmp_path / "given.png").write_bytes(data)
    normal = read_image(tmp_path / "OUT_body_normal.png").pixels
    np.testing.assert_array_equal(normal, read_image(tmp_path / "given.png").pixels)
    _written(tmp_path / "P.usdz", made, document)
    with zipfile.ZipFile(tmp_path / "P.usdz") as package:
        assert package.namelist()[0] == "P.usdc"
        assert {*package.namelist()[1:]} == {name.replace("OUT", "P") for name in names}
        assert package.testzip() is None
    assert complaints(tmp_path / "P.usdz") == []
    _written(tmp_path / "P.usdz", made, document)  # its own package is replaced
    content = bytearray((tmp_path / "P.usdz").read_bytes())
    content[-300] ^= 1
    (tmp_path / "P.usdz").write_bytes(content)
    refuses(FormatError, "changed since", _written, tmp_path / "P.usdz", made, document)
    _written(tmp_path / "P.usdz", made, document, force=True)


def test_files_of_others_stay(tmp_path: Path) -> None:
    """An image of that name stays, even with force; a layer is refused."""
    made, document = painted()
    (tmp_path / "OUT_body_normal.png").write_bytes(b"mine")
    _written(tmp_path / "OUT.usda", made, document, force=True)
    _written(tmp_path / "OUT.usda", made, document)
    assert (tmp_path / "OUT_body_normal.png").read_bytes() == b"mine"
    assert "OUT_body_normal1.png" in (tmp_path / "OUT.usda").read_text()
    assert not (tmp_path / "OUT_body_normal2.png").exists()
    (tmp_path / "NEW.usda").write_text("mine")
    refuses(FormatError, "not written by cagemap", _written, tmp_path / "NEW.usda", made, document)
    assert (tmp_path / "NEW.usda").read_text() == "mine"
    assert not list(tmp_path.glob("NEW_*"))


def test_an_incomplete_file_is_not_moved_into_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, document = painted()

    def shortened(layer: Any, file: Path, temporary: Path) -> None:
        layer.GetAttributeAtPath("/Asset/body.points").default = []
        layer.Export(str(temporary))

    monkeypatch.setattr(usd_character, "export_layer", shortened)
    for name in ("OUT.usdc", "OUT.usdz"):
        refuses(FormatError, "could not be written whole", _written, tmp_path / name, made, document)
        assert not (tmp_path / name).exists()


def test_shapes_without_a_rig_and_weights_at_rest(tmp_path: Path) -> None:
    """A skeleton of one joint holds the weights that the file states."""
    made = replace(lively(), rig=None, animations=())
    made = replace(made, parts=tuple(replace(part, weights=None) for part in made.parts))
    body = replace(made.parts[0], shape_weights={"raise": 0.5})
    path = tmp_path / "OUT.usda"
    _written(path, replace(made, parts=(body, *made.parts[1:])))
    assert complaints(path) == []
    shaped = body.mesh.positions + 0.5 * body.shapes["raise"]
    np.testing.assert_allclose(posed(path, "rest", 0.0)["body"], shaped, atol=1e-5)
    again = usd_document(path)
    assert "animations" not in again.json
    assert shape_keys(again, None).keys() == {("body", "raise")}


def test_parts_that_follow_the_weights_of_others_are_named(tmp_path: Path) -> None:
    """A lash at rest has the shape of a half closed lid."""
    made = lively()
    body = made.parts[0]
    lash, raised = replace(body, name="lash"), replace(body, name="lid", shape_weights={"raise": 0.5})
    made = replace(made, parts=(raised, lash), animations=())
    said = "rest: other parts decide the weights of raise of lash, since USD has one weight for shapes of one name"
    assert _written(tmp_path / "OUT.usda", made) == [said]
    made = replace(made, parts=(raised, replace(raised, name="lash")))
    assert _written(tmp_path / "SAME.usda", made) == []


def test_a_layer_over_a_character_plays_as_it_does(tmp_path: Path) -> None:
    made = lively()
    _written(tmp_path / "a.usda", made)
    with stage_at(tmp_path / "a.usda") as given:
        given.SetTimeCodesPerSecond(30.0)
        given.SetStartTimeCode(3.0)
    body = read_usd_meshes(tmp_path / "a.usda")[0]
    values = UsdResults(attributes={"height": np.arange(float(body.control.n_vertices))})
    write_usd_over(tmp_path / "over.usda", tmp_path / "a.usda", [body.path], body.control, values)
    over = Usd.Stage.Open(str(tmp_path / "over.usda"))
    for name in ("GetStartTimeCode", "GetEndTimeCode", "GetTimeCodesPerSecond", "GetFramesPerSecond"):
        assert getattr(over, name)() == getattr(given, name)(), name
    path = "/Asset/animations/steps.rotations"
    assert over.GetAttributeAtPath(path).GetTimeSamples() == given.GetAttributeAtPath(path).GetTimeSamples()


def test_a_character_in_an_instance_is_read_whole(tmp_path: Path) -> None:
    made, document = painted()
    _written(tmp_path / "a.usda", made, document)
    with stage_at(tmp_path / "shot.usda", ("Y", 1.0)) as stage:
        prim = stage.DefinePrim("/hero")
        prim.GetReferences().AddReference("./a.usda")
        prim.SetInstanceable(True)
    alone, instance = (usd_document(tmp_path / name) for name in ("a.usda", "shot.usda"))
    for name in ("body", "hat", "eye"):
        entries = [of.entry("materials", material_names(of).index(name)) for of in (alone, instance)]
        assert entries[0] == entries[1]
    assert [one["name"] for one in instance.json["animations"]] == ["nod"]


def test_check_says_what_a_character_in_usd_holds(tmp_path: Path) -> None:
    _written(tmp_path / "a.usdz", lively())
    text, _ = run_check(CheckRequest((tmp_path / "a.usdz",)), Stages())
    for line in (
        "a.usdz: body\n",
        "body        body: is matched",
        "skeleton    2 joints, 1 of them named as humanoid bones",
        "are retargeted",
    ):
        assert line in text
    for word in ("component:", "set aside", "copies along seams"):
        assert word not in text


def test_check_reads_a_character_in_usd_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _written(tmp_path / "a.usda", lively())
    with stage_at(tmp_path / "a.usda") as stage:
        shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Asset/body/raise"))
        shape.CreateInbetween("half").SetWeight(0.5)
    run_check(CheckRequest((tmp_path / "a.usda",)), Stages())
    assert [one.getMessage().partition(": ")[2] for one in caplog.records] == [
        "/Asset/body: blend shape raise: its in-betweens are left out"
    ]


def test_colours_and_opacity_of_corners_are_written(tmp_path: Path) -> None:
    mesh = replace(icosahedron(), name="ball", vertex_colors=np.full((12, 3), 0.5))
    colors = np.random.default_rng(3).uniform(size=(len(mesh.face_indices), 4))
    _written(tmp_path / "OUT.usda", Character((Part("ball", mesh, colors=colors),)))
    stage = Usd.Stage.Open(str(tmp_path / "OUT.usda"))
    prim = UsdGeom.Mesh(stage.GetPrimAtPath("/Asset/ball"))
    for primvar, meant in (
        (prim.GetDisplayColorPrimvar(), colors[:, :3]),
        (prim.GetDisplayOpacityPrimvar(), colors[:, 3]),
    ):
        assert primvar.GetInterpolation() == "faceVarying"
        np.testing.assert_allclose(np.array(primvar.Get()), meant, atol=1e-6)


def test_materials_without_their_images_are_neither_metallic_nor_glow(tmp_path: Path) -> None:
    """Of images in a format that is not read, the factors are left out too; in USD, and in copies of materials."""
    made, document = painted()
    textures = document.json["textures"]
    textures.append({"extensions": {"KHR_texture_basisu": {"source": 0}}})
    skin = document.json["materials"][0]
    for table, slot in ((skin, "emissiveTexture"), (skin["pbrMetallicRoughness"], "metallicRoughnessTexture")):
        table[slot] = {"index": len(textures) - 1}
    _written(tmp_path / "OUT.usda", made, document)
    stage = Usd.Stage.Open(str(tmp_path / "OUT.usda"))
    surface = UsdShade.Material(stage.GetPrimAtPath("/Asset/materials/body")).ComputeSurfaceSource()[0]
    assert not any(surface.GetInput(name) for name in ("metallic", "roughness", "emissiveColor"))
    copied = with_copied_materials(document, [("body", "copy")], [("copy", "baseColorTexture")]).json["materials"][-1]
    assert copied["emissiveFactor"] == [0.0, 0.0, 0.0]
    assert copied["pbrMetallicRoughness"]["metallicFactor"] == 0.0
    assert copied["pbrMetallicRoughness"]["baseColorFactor"] == [0.5, 0.6, 0.7, 0.8]
