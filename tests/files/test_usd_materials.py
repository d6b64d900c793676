"""Materials, images and UV sets of USD files, as meshes and as glTF documents."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import material_images, read_material_image
from cagemap.files.inner_texture import color_texture, material_document
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.transfer import unwrap

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Sdf, Usd, UsdGeom, UsdShade

from cagemap.files.images.image import write_image
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character, usd_document
from cagemap.files.usd.materials import STRENGTH
from cagemap.files.usd.read import read_usd, read_usd_meshes
from cagemap.files.usd.results import connect_texture, define_material, uv_reader
from cagemap.files.usd.shaders import _as_bytes
from cagemap.files.usd.write import write_usd
from cagemap.tasks.material_atlas import material_atlas

from usd_characters import painted
from usd_scenes import stage_at, usd_mesh


def test_materials_come_back(tmp_path: Path) -> None:
    """Factors, opacity, images with their UV set, transform and sampler; USD has no place for the normal's strength."""
    made, document = painted()
    document.json["materials"][0]["extensions"] = {STRENGTH: {"emissiveStrength": 4.0}}
    write_usd_character(tmp_path / "C.usda", made, read_scene(document))
    found = usd_document(tmp_path / "C.usda")
    assert material_names(found) == ("body", "hat", "eye")
    for name in ("body", "hat", "eye"):
        before, after = (of.entry("materials", material_names(of).index(name)) for of in (document, found))
        for key in ("alphaMode", "alphaCutoff", "doubleSided", "emissiveFactor"):
            default = [0.0] * 3 if key == "emissiveFactor" else None
            assert after.get(key, default) == pytest.approx(before.get(key, default)), (name, key)
        for key, factor in before["pbrMetallicRoughness"].items():
            if key.endswith("Factor") and (key != "baseColorFactor" or name != "eye"):
                assert after["pbrMetallicRoughness"][key] == pytest.approx(factor), (name, key)
    body = found.entry("materials", 0)
    assert body["occlusionTexture"]["strength"] == pytest.approx(0.25)
    assert body["extensions"][STRENGTH]["emissiveStrength"] == pytest.approx(4.0)
    assert STRENGTH in found.json["extensionsUsed"]
    images = [material_images(of, "body") for of in (document, found)]
    assert {one.slot for one in images[0]} == {one.slot for one in images[1]}
    uvs = np.random.default_rng(0).random((9, 2))
    for one in images[0]:
        back = next(other for other in images[1] if other.slot == one.slot)
        assert back.uv_set == one.uv_set
        np.testing.assert_allclose(back.on_image(uvs), one.on_image(uvs), atol=1e-6)
        pixels = [read_material_image(of, image).pixels for of, image in ((document, one), (found, back))]
        np.testing.assert_array_equal(*pixels)
    hats = [next(one for one in character_of(of).parts if one.name == "hat") for of in (document, found)]
    np.testing.assert_allclose(hats[1].normals, hats[0].normals, atol=1e-6)
    color = body["pbrMetallicRoughness"]["baseColorTexture"]
    sampler = found.entry("samplers", found.entry("textures", color["index"])["sampler"])
    assert sampler == {"wrapS": 33071, "wrapT": 33648}


def _with_image(path: Path, mesh: ControlMesh, name: str) -> None:
    """Write a USD file of a mesh whose material has a colour image in a UV set."""
    write_usd(path, mesh)
    write_image(path.with_name("t.png"), np.full((4, 4, 3), [255, 0, 0], dtype=np.uint8))
    with stage_at(path) as stage:
        material, surface = define_material(stage, "/Asset/red")
        reader = uv_reader(stage, material.GetPath().AppendChild("reader"), name)
        connect_texture(stage, surface, "diffuseColor", "./t.png", reader)
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Asset/mesh")).Bind(material)


def _with_sets(*names: str) -> ControlMesh:
    """A cube with UV sets of different size."""
    mesh = unwrap(cube())
    first, *others = (UvSet(name, mesh.uvs / (number + 1), mesh.uv_indices) for number, name in enumerate(names))
    return replace(mesh, uvs=first.uvs, uv_name=first.name, uv_sets=tuple(others))


@pytest.mark.parametrize(
    ("names", "image", "in_use", "fits"),
    [
        (("st", "st1"), "st", "st", True),
        (("st", "st1"), "st", "st1", False),
        (("st", "st1"), "st1", "st1", True),
        (("st", "st1"), "st1", "st", False),
        (("TEXCOORD_1", "TEXCOORD_0"), "TEXCOORD_1", "TEXCOORD_1", True),
        (("TEXCOORD_1", "TEXCOORD_0"), "TEXCOORD_1", "TEXCOORD_0", False),
        (("TEXCOORD_1",), "TEXCOORD_1", "TEXCOORD_1", True),
    ],
)
def test_an_image_belongs_to_the_uv_set_that_its_shader_names(names, image, in_use, fits, tmp_path):
    path = tmp_path / "box.usda"
    _with_image(path, _with_sets(*names), image)
    control = read_mesh(path).with_uv_set(in_use)
    assert (color_texture(material_document(path, control), control) is not None) == fits


@pytest.mark.parametrize("image", ["TEXCOORD_0", "TEXCOORD_1"])
def test_an_image_keeps_its_uv_set_in_gltf(image: str, tmp_path: Path) -> None:
    """UV sets with names of glTF are written in their order, that of the image is read first."""
    mesh = _with_sets("TEXCOORD_1", "TEXCOORD_0")
    _with_image(tmp_path / "box.usda", mesh, image)
    document = usd_document(tmp_path / "box.usda")
    (found,) = material_images(document, "red")
    (part,) = character_of(document).parts
    uvs = part.mesh.with_uv_set(found.uv_set).uvs
    np.testing.assert_allclose(uvs.max(axis=0), mesh.with_uv_set(image).uvs.max(axis=0), atol=1e-6)


def test_a_material_of_meshes_whose_uv_sets_differ_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_usd(tmp_path / "other.usda", _with_sets("st1"))
    other = Sdf.Layer.FindOrOpen(str(tmp_path / "other.usda"))
    _with_image(tmp_path / "box.usda", _with_sets("st", "st1"), "st1")
    with stage_at(tmp_path / "box.usda") as stage:
        Sdf.CopySpec(other, "/Asset/mesh", stage.GetRootLayer(), "/Asset/other")
        material = UsdShade.Material(stage.GetPrimAtPath("/Asset/red"))
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Asset/other")).Bind(material)
    (found,) = material_images(usd_document(tmp_path / "box.usda"), "red")
    assert found.uv_set == "TEXCOORD_1"
    assert caplog.text.count("red: some of its meshes lack its UV set st1, or have it at another number") == 1


def test_shaders_of_one_image_that_repeat_it_differently_are_not_one_texture(painted_path, caplog):
    """glTF has one texture for roughness and metalness."""
    with stage_at(painted_path) as stage:
        roughness = UsdShade.Shader(stage.GetPrimAtPath("/Asset/materials/body/roughness_texture"))
        roughness.GetInput("wrapS").Set("clamp")
    found = usd_document(painted_path)
    base = found.entry("materials", 0)["pbrMetallicRoughness"]
    assert "metallicRoughnessTexture" not in base
    assert (base["metallicFactor"], base["roughnessFactor"]) == (0.0, 0.5)  # not those of the images
    assert "the image of its metallic/roughness is left out" in caplog.text


def test_missing_layers_and_damaged_images_are_named_once(painted_path, tmp_path, caplog):
    painted_path.write_text(painted_path.read_text().replace("(\n", "(\n    subLayers = [@./gone.usda@]\n", 1))
    (tmp_path / "C_body_emissive.png").unlink()
    with caplog.at_level(logging.WARNING):
        found = usd_document(painted_path)
    assert caplog.text.count("Could not load sublayer") == 1
    said = "C.usda: body: the image of its emissiveColor (./C_body_emissive.png) is not found or cannot be read"
    assert caplog.text.count(said) == 1
    assert "emissiveTexture" not in {one.slot for one in material_images(found, "body")}
    assert found.entry("materials", 0)["emissiveFactor"] == [0.0, 0.0, 0.0]
    made, document = painted()
    write_usd_character(tmp_path / "P.usdz", made, read_scene(document))
    content = (tmp_path / "P.usdz").read_bytes()
    image = content.index(b"\x89PNG")
    (tmp_path / "P.usdz").write_bytes(content[: image + 60] + b"damage" + content[image + 66 :])
    with caplog.at_level(logging.WARNING):
        usd_document(tmp_path / "P.usdz")
    assert "P.usdz: body: the image of its " in caplog.text


@pytest.mark.parametrize(
    ("shader", "setting", "value"),
    [
        ("normal", "scale", (2, -2, 2, 1)),
        ("normal", "sourceColorSpace", "sRGB"),
        ("diffuseColor", "sourceColorSpace", "raw"),
        ("emissiveColor", "bias", (0.5, 0.5, 0.5, 0)),
        ("occlusion", "bias", (0, 0, 0, 0)),
    ],
)
def test_images_that_gltf_reads_otherwise_are_named(painted_path, caplog, shader, setting, value):
    usd_document(painted_path)
    assert not caplog.records
    with stage_at(painted_path) as stage:
        texture = UsdShade.Shader(stage.GetPrimAtPath(f"/Asset/materials/body/{shader}_texture"))
        texture.CreateInput(setting, getattr(Sdf.ValueTypeNames, "Token" if isinstance(value, str) else "Float4")).Set(
            value
        )
    usd_document(painted_path)
    (said,) = (one.getMessage() for one in caplog.records)
    assert f"body: the image of its {shader} is taken as it is" in said


@pytest.mark.parametrize("with_image", [False, True])
def test_display_colors_beside_an_image_are_named(tmp_path, caplog, with_image):
    with stage_at(tmp_path / "cube.usda", ("Y", 1.0)) as stage:
        prim = usd_mesh(stage, "/cube", cube())
        prim.CreateDisplayColorPrimvar("vertex").Set([(0.5, 0.2, 0.1)] * 8)
        material, surface = define_material(stage, "/skin")
        if with_image:
            connect_texture(stage, surface, "diffuseColor", "./skin.png", uv_reader(stage, "/skin/uvs", "st"))
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)
    (part,) = document_and_character(tmp_path / "cube.usda")[1].parts
    assert part.mesh.vertex_colors is not None
    assert ("glTF multiplies both" in caplog.text) == with_image


@pytest.mark.parametrize(
    ("kind", "image", "said"),
    [
        ("ND_standard_surface_surfaceshader", "./skin.png", "skin: has no UsdPreviewSurface"),
        ("UsdPreviewSurface", "./skin.<UDIM>.png", "(./skin.<UDIM>.png) is a set of tiles"),
    ],
)
def test_materials_that_gltf_cannot_show_are_named(tmp_path, caplog, kind, image, said):
    with stage_at(tmp_path / "cube.usda", ("Y", 1.0)) as stage:
        prim, (material, surface) = usd_mesh(stage, "/cube", cube()), define_material(stage, "/skin")
        connect_texture(stage, surface, "diffuseColor", image, uv_reader(stage, "/skin/uvs", "st"))
        surface.CreateIdAttr(kind)
        if kind != "UsdPreviewSurface":  # of another renderer
            material.GetPrim().RemoveProperty("outputs:surface")
            material.CreateSurfaceOutput("mtlx").ConnectToSource(surface.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)
    usd_document(tmp_path / "cube.usda")
    assert [said in record.getMessage() for record in caplog.records] == [True]


@pytest.mark.parametrize("only", [("roughness",), ("metallic", "roughness")])
def test_grey_images_of_roughness_and_metalness_become_one(painted_path: Path, only: tuple[str, ...]) -> None:
    """Of any sizes; an input without an image keeps its value."""
    sizes = {"metallic": (2, 2, 1), "roughness": (4, 4, 3)}
    pixels = {name: np.arange(np.prod(size), dtype=np.uint8).reshape(size) for name, size in sizes.items()}
    with stage_at(painted_path) as stage:
        for name in only:
            texture = UsdShade.Shader(stage.GetPrimAtPath(f"/Asset/materials/body/{name}_texture"))
            write_image(painted_path.with_name(f"{name}.png"), pixels[name])
            texture.GetInput("file").Set(f"./{name}.png")
            surface = UsdShade.Shader(stage.GetPrimAtPath("/Asset/materials/body/surface"))
            surface.GetInput(name).ConnectToSource(texture.CreateOutput("r", Sdf.ValueTypeNames.Float))
        if "metallic" not in only:
            surface.GetInput("metallic").ClearSources()
            surface.GetInput("metallic").Set(0.75)
    found = usd_document(painted_path)
    base = found.entry("materials", 0)["pbrMetallicRoughness"]
    assert base["roughnessFactor"] == pytest.approx(0.4)
    assert base["metallicFactor"] == pytest.approx(0.3 if "metallic" in only else 0.75)
    (image,) = material_images(found, "body", "metallicRoughnessTexture")
    packed = read_material_image(found, image).pixels
    np.testing.assert_array_equal(packed[:, :, 1], pixels["roughness"][:, :, 0])
    metallic = pixels["metallic"][:, :, 0].repeat(2, axis=0).repeat(2, axis=1) if "metallic" in only else 255
    np.testing.assert_array_equal(packed[:, :, 2], np.broadcast_to(metallic, (4, 4)))
    used = {entry["source"] for entry in found.json["textures"]}
    assert used == set(range(len(found.json["images"])))  # without those that were packed


@pytest.mark.parametrize("stated", ["", "uv"])
def test_an_image_without_a_uv_set_of_the_mesh_belongs_to_the_first(stated, tmp_path, caplog):
    _with_image(tmp_path / "box.usda", _with_sets("st", "UVMap2"), stated)
    control = read_mesh(tmp_path / "box.usda")
    document = material_document(tmp_path / "box.usda", control)
    assert color_texture(document, control) is not None
    assert color_texture(document, control.with_uv_set("UVMap2")) is None
    assert ("red: no mesh has its UV set uv" in caplog.text) == bool(stated)
    assert "a material of its own" not in caplog.text


def test_images_of_other_uv_sets_than_that_in_use_are_not_joined(tmp_path: Path) -> None:
    """Each is in the first UV set of its mesh in glTF."""
    path = tmp_path / "pair.usda"
    _with_image(path, _with_sets("UVMap"), "UVMap")
    _with_image(tmp_path / "other.usda", _with_sets("st", "UVMap"), "st")
    other = Sdf.Layer.FindOrOpen(str(tmp_path / "other.usda"))
    write_image(tmp_path / "green.png", np.full((4, 4, 3), [0, 255, 0], dtype=np.uint8))
    with stage_at(path) as stage:
        for given, name in (("mesh", "second"), ("red", "green")):
            Sdf.CopySpec(other, f"/Asset/{given}", stage.GetRootLayer(), f"/Asset/{name}")
        material = UsdShade.Material(stage.GetPrimAtPath("/Asset/green"))
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Asset/second")).Bind(material)
        textures = [UsdShade.Shader(one) for one in stage.Traverse() if str(one.GetPath()).startswith("/Asset/green/")]
        for one in textures:
            if one.GetInput("file"):
                one.GetInput("file").Set("./green.png")
    whole = read_mesh(path)
    document = material_document(path, whole)
    assert material_atlas(document, whole.with_uv_set("UVMap")) is None
    assert material_atlas(replace(document, uv_names={}), whole.with_uv_set("UVMap")) is not None


def _with_a_second_mesh(folder: Path, first: tuple[str, ...], second: tuple[str, ...], image: str) -> Path:
    """Two meshes of one material, whose images are in a UV set."""
    path = folder / "pair.usda"
    write_usd(folder / "other.usda", _with_sets(*second))
    other = Sdf.Layer.FindOrOpen(str(folder / "other.usda"))
    _with_image(path, _with_sets(*first), image)
    with stage_at(path) as stage:
        Sdf.CopySpec(other, "/Asset/mesh", stage.GetRootLayer(), "/Asset/other")
        material = UsdShade.Material(stage.GetPrimAtPath("/Asset/red"))
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Asset/other")).Bind(material)
        surface = UsdShade.Shader(next(p for p in stage.Traverse() if str(p.GetName()).startswith("surface")))
        reader = UsdShade.Shader(stage.GetPrimAtPath("/Asset/red/reader"))
        connect_texture(stage, surface, "emissiveColor", "./t.png", reader)
    return path


def test_an_image_belongs_to_the_named_uv_set_of_each_mesh(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Its number may differ, and the first mesh of the material may lack the set."""
    path = _with_a_second_mesh(tmp_path, ("UVMap",), ("st", "UVMap"), "st")
    whole = read_mesh(path)
    part = extract_faces(whole, find_part(whole, "other").faces)
    document = material_document(path, part)
    assert color_texture(document, part.with_uv_set("st")) is not None
    assert color_texture(document, part.with_uv_set("UVMap")) is None
    assert caplog.text.count("red: some of its meshes lack its UV set st") == 1


def _paint(shape: Any, path: str, color: tuple[int, int, int]) -> None:
    """Bind a new material of a colour to a mesh or subset."""
    material, surface = define_material(shape.GetPrim().GetStage(), path)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(color)
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material)


def test_materials_of_one_name_in_two_scopes_stay_apart(tmp_path: Path) -> None:
    with stage_at(tmp_path / "looks.usda") as stage:
        mesh = usd_mesh(stage, "/m", cube())
        for scope, faces, color in (("a", [0, 1, 2], (1, 0, 0)), ("b", [3, 4, 5], (0, 0, 1))):
            subset = UsdGeom.Subset.CreateUniqueGeomSubset(mesh, f"of_{scope}", "face", faces, "materialBind")
            _paint(subset, f"/{scope}/metal", color)
    read = read_usd(tmp_path / "looks.usda")
    assert read.material_names == ("metal", "/b/metal")
    colors = read.material_colors[read.face_materials]  # type: ignore[index]
    np.testing.assert_array_equal(colors, [[1, 0, 0]] * 3 + [[0, 0, 1]] * 3)


def test_materials_of_one_name_on_two_meshes_stay_apart(tmp_path: Path) -> None:
    """Each mesh has its own scope, as of assets put together; copies of an instance have one material."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "looks.usda"))
    for number, color in enumerate([(1, 0, 0), (0, 0, 1)]):
        _paint(usd_mesh(stage, f"/asset{number}/mesh", cube()), f"/asset{number}/looks/metal", color)
    stage.Save()
    read = read_usd(tmp_path / "looks.usda")
    assert read.material_names == ("metal", "/asset1/looks/metal")
    document = usd_document(tmp_path / "looks.usda")
    factors = [one["pbrMetallicRoughness"]["baseColorFactor"] for one in document.json["materials"]]
    for colors in (read.material_colors, factors):
        np.testing.assert_array_equal(np.array(colors)[:, :3], [[1, 0, 0], [0, 0, 1]])
    for name in ("one", "two"):
        prim = stage.OverridePrim(f"/{name}")
        prim.SetTypeName("Xform")
        prim.GetReferences().AddInternalReference("/asset1")
        prim.SetInstanceable(True)
    stage.RemovePrim("/asset0")
    stage.Save()
    assert read_usd(tmp_path / "looks.usda").material_names == ("metal", "/one/looks/metal")


def _bound(stage: Any, to: Any, material: str, **options: Any) -> None:
    api = UsdShade.MaterialBindingAPI.Apply(to.GetPrim())
    api.Bind(UsdShade.Material.Define(stage, f"/looks/{material}"), **options)


def test_materials_are_those_that_usd_resolves(tmp_path: Path) -> None:
    with stage_at(tmp_path / "looks.usda") as stage:
        strong = UsdShade.Tokens.strongerThanDescendants
        _bound(stage, UsdGeom.Xform.Define(stage, "/over"), "above", bindingStrength=strong)
        meshes = {path: usd_mesh(stage, path, cube()) for path in ("/over/m", "/full", "/preview", "/list/m")}
        subsets = {
            path: UsdGeom.Subset.CreateGeomSubset(meshes[path], "part", "face", [0, 1], "materialBind")
            for path in ("/over/m", "/preview", "/list/m")
        }
        _bound(stage, subsets["/over/m"], "below")
        _bound(stage, meshes["/full"], "final", materialPurpose="full")
        _bound(stage, meshes["/preview"], "all")
        _bound(stage, subsets["/preview"], "shown", materialPurpose="preview")
        group = UsdGeom.Xform.Define(stage, "/list").GetPrim()
        collection = Usd.CollectionAPI.Apply(group, "chosen")
        collection.IncludePath("/list/m/part")
        listed = UsdShade.Material.Define(stage, "/looks/listed")
        UsdShade.MaterialBindingAPI.Apply(group).Bind(collection, listed, "chosen")
    found = {mesh.path: mesh.control for mesh in read_usd_meshes(tmp_path / "looks.usda")}
    names = {path: [one.material_names[number] for number in one.face_materials] for path, one in found.items()}
    assert names == {
        "/over/m": ["above"] * 6,
        "/full": ["final"] * 6,
        "/preview": ["shown"] * 2 + ["all"] * 4,
        "/list/m": ["listed"] * 2 + [""] * 4,
    }


def test_a_binding_without_its_schema_is_read_without_a_word_of_usd(tmp_path, capfd):
    with stage_at(tmp_path / "cube.usda") as stage:
        prim = usd_mesh(stage, "/cube", cube()).GetPrim()
        UsdShade.Material.Define(stage, "/red")
        prim.CreateRelationship("material:binding").SetTargets(["/red"])
    assert read_usd(tmp_path / "cube.usda").material_names == ("red",)
    assert capfd.readouterr().err == ""


def test_a_face_in_several_groups_is_written_into_each_and_names_are_kept_as_display_names(tmp_path: Path) -> None:
    """One and two of `g one two` would lose the face; `Skin.001` is no name of a prim."""
    mesh = replace(
        cube(),
        face_groups=np.array([0, 3, 3, 3, 1, 2]),
        group_names=("one", "two", "one two", ""),
        face_materials=np.array([0, 0, 0, 1, 1, 1]),
        material_names=("Skin.001", "eye"),
    )
    write_usd(tmp_path / "box.usda", mesh)
    stage = Usd.Stage.Open(str(tmp_path / "box.usda"))
    subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(stage.GetPrimAtPath("/Asset/mesh")))
    found = {one.GetPrim().GetDisplayName(): list(one.GetIndicesAttr().Get()) for one in subsets}
    assert found == {"one": [0, 5], "two": [4, 5], "Skin.001": [0, 1, 2], "eye": [3, 4, 5]}
    assert stage.GetPrimAtPath("/Asset/materials/Skin_001").GetDisplayName() == "Skin.001"
    read = read_usd(tmp_path / "box.usda")
    assert read.group_names == ("one", "two", "", "one two")
    assert read.material_names == material_names(usd_document(tmp_path / "box.usda")) == ("Skin.001", "eye")


def test_pixels_as_bytes_are_rounded_and_limited() -> None:
    given = (
        np.array([0, 128, 129, 65535], np.uint16),
        np.array([-1.0, 0.0, 0.498, 0.5, 2.0]),
        np.array([0, 1, 255], np.uint8),
    )
    for pixels, expected in zip(given, ([0, 0, 1, 255], [0, 0, 127, 128, 255], [0, 1, 255]), strict=True):
        np.testing.assert_array_equal(_as_bytes(pixels), expected)
