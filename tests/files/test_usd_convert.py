"""USD characters as glTF documents: what cagemap wrote, and files of other programs."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.poses import pose_at
from cagemap.character.values import skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.character import animation_names, character_of, read_shape_keys
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.material_images import material_images, read_material_image
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.write import character_glb
from cagemap.files.inner_texture import color_texture, material_document
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.transfer import unwrap

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel

from cagemap.files.images.image import write_image
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character, usd_document
from cagemap.files.usd.materials import STRENGTH
from cagemap.files.usd.read import place_in_world, read_usd_meshes
from cagemap.files.usd.results import connect_texture, define_material, uv_reader
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.write import write_usd
from cagemap.mesh.faces import reversed_corners
from cagemap.numerics.srgb import encode_srgb
from cagemap.tasks.material_atlas import material_atlas
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from refusals import refuses
from usd_characters import lively, painted, posed, with_shape_weights
from usd_scenes import skinned_points, stage_at, usd_mesh


@pytest.fixture
def painted_path(tmp_path: Path) -> Path:
    """C.usda: a character with a material that has every slot."""
    made, document = painted()
    write_usd_character(tmp_path / "C.usda", made, read_scene(document))
    return tmp_path / "C.usda"


def test_a_written_character_comes_back(tmp_path: Path) -> None:
    """Names, rest pose, weights, shapes, all animations and their weights of shapes."""
    made = lively()
    weights = np.array([[0.0, 0.0], [1.0, 0.25], [0.5, 1.0]])
    document = with_shape_weights(character_glb(made), "walk | fast", weights)
    write_usd_character(tmp_path / "C.usdz", made, read_scene(document))
    given = usd_document(tmp_path / "C.usdz")
    write_document(tmp_path / "C.glb", given)
    found = character_of(read_document(tmp_path / "C.glb"))
    assert found.rig.names == made.rig.names
    np.testing.assert_allclose(found.rig.heads, made.rig.heads, atol=1e-6)
    assert [part.name for part in found.parts] == [part.name for part in made.parts]
    for part, back in zip(made.parts, found.parts, strict=True):
        np.testing.assert_allclose(back.mesh.positions, part.mesh.positions, atol=1e-6)
        assert list(back.shapes) == list(part.shapes)
        for name, offsets in part.shapes.items():
            np.testing.assert_allclose(back.shapes[name], offsets, atol=1e-6)
        assert (back.weights is None) == (part.weights is None)
        if part.weights is not None:
            np.testing.assert_allclose(back.weights.toarray(), part.weights.toarray(), atol=1e-6)
    assert [one.name for one in found.animations] == [one.name for one in made.animations]
    for before, after in zip(made.animations, found.animations, strict=True):
        for seconds in (0.0, 0.25, 0.5, 1.37, 2.0):
            for part, back in zip(made.parts, found.parts, strict=True):
                expected = skinned_positions(part, made.rig, pose_at(made.rig, before, seconds))
                got = skinned_positions(back, found.rig, pose_at(found.rig, after, seconds))
                np.testing.assert_allclose(got, expected, atol=1e-4, err_msg=f"{before.name} {seconds}")
    keys = read_shape_keys(read_scene(given), 0)
    for place, shape in enumerate(("raise", "wide")):
        times, values, _ = keys["body", shape]
        np.testing.assert_allclose(times, [0, 1, 2], atol=1e-6)
        np.testing.assert_allclose(values[:, 0], weights[:, place], atol=1e-6)


def test_static_weights_of_a_clip_stay_in_it(tmp_path: Path) -> None:
    """Also of a clip without motion; only those of a file's one clip are at rest."""
    made = lively()
    walk, steps, _ = made.animations
    document = with_shape_weights(
        character_glb(replace(made, animations=(walk, steps))), walk.name, np.array([[1, 0.5]])
    )
    made = replace(made, animations=(replace(walk, tracks=()), steps))
    write_usd_character(tmp_path / "C.usda", made, read_scene(document))
    found = usd_document(tmp_path / "C.usda")
    keys = {name: read_shape_keys(read_scene(found), number) for number, name in enumerate(animation_names(found))}
    assert {name: values.item() for (_, name), (_, values, _) in keys[walk.name].items()} == {"raise": 1.0, "wide": 0.5}
    assert keys[steps.name] == read_shape_keys(read_scene(found), None) == {}


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


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_hard_edges_of_reversed_faces_stay(painted_path: Path, left_handed: bool, sign: float) -> None:
    """Faces are reversed if they are left-handed or mirrored, but not if they are both."""
    with stage_at(painted_path) as stage:
        prim = stage.GetPrimAtPath("/Asset/hat")
        UsdGeom.Mesh(prim).CreateOrientationAttr("leftHanded" if left_handed else "rightHanded")
        UsdSkel.BindingAPI(prim).CreateGeomBindTransformAttr().Set(Gf.Matrix4d().SetScale((sign, 1.0, 1.0)))
    found = next(part for part in document_and_character(painted_path)[1].parts if part.name == "hat")
    hat = painted()[0].parts[1]
    corners = np.arange(len(hat.normals))
    corners = corners if left_handed == (sign < 0) else reversed_corners(hat.mesh.face_offsets)
    np.testing.assert_array_equal(found.mesh.face_indices, hat.mesh.face_indices[corners])
    np.testing.assert_allclose(found.normals, hat.normals[corners] * [sign, 1, 1], atol=1e-6)


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("kind", ["constant", "uniform", "varying", "vertex", "faceVarying"])
def test_normals_of_every_interpolation_are_read(tmp_path: Path, kind: str, indexed: bool, left_handed: bool) -> None:
    """As an attribute, or as a primvar with indices and only a time sample; a corner is known by face and vertex."""
    mesh = cube()
    with stage_at(tmp_path / "cube.usda", ("Y", 1.0)) as stage:
        prim = usd_mesh(stage, "/cube", mesh)
        prim.CreateSubdivisionSchemeAttr("none")
        prim.CreateOrientationAttr("leftHanded" if left_handed else "rightHanded")
        rows = {
            "constant": np.zeros(len(mesh.face_indices), dtype=int),
            "uniform": mesh.corner_faces,
            "faceVarying": np.arange(len(mesh.face_indices)),
        }.get(kind, mesh.face_indices)
        values = np.random.default_rng(3).normal(size=(rows.max() + 1, 3))
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        if indexed:
            primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, kind)
            primvar.Set(values[::-1].tolist(), 1.0)
            primvar.SetIndices(list(range(len(values)))[::-1], 1.0)
        else:
            prim.CreateNormalsAttr(values.tolist())
            prim.SetNormalsInterpolation(kind)
    (part,) = document_and_character(tmp_path / "cube.usda")[1].parts
    order = [part.mesh.corner_faces * 8 + part.mesh.face_indices, mesh.corner_faces * 8 + mesh.face_indices]
    found, expected = (np.argsort(keys) for keys in order)
    np.testing.assert_allclose(part.normals[found], values[rows][expected], atol=1e-6)


@pytest.mark.parametrize("normals", [[(0, 0, 1)] * 5, [(np.nan, 0, 1)] * 8])
def test_normals_that_do_not_fit_are_left_out_aloud(tmp_path, caplog, normals):
    with stage_at(tmp_path / "cube.usda") as stage:
        prim = usd_mesh(stage, "/cube", cube())
        prim.CreateSubdivisionSchemeAttr("none")
        prim.CreateNormalsAttr(normals)
    (part,) = document_and_character(tmp_path / "cube.usda")[1].parts
    assert part.normals is None
    assert "cube.usda: /cube: its normals are left out" in caplog.text


def test_units_axes_and_transforms_become_metres_with_y_up(tmp_path: Path) -> None:
    """Posed points are those that USD computes in the world, in metres with Y up."""
    made = lively()
    path = tmp_path / "C.usda"
    write_usd_character(path, made, read_scene(character_glb(made)))
    with stage_at(path, ("Z", 0.01)) as stage:
        turn = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), 30.0)) * Gf.Matrix4d().SetTranslate(
            (3.0, 4.0, 5.0)
        )
        UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddTransformOp().Set(turn)
        UsdGeom.Xformable(stage.GetPrimAtPath("/Asset/hat")).AddTransformOp().Set(Gf.Matrix4d().SetTranslate((9, 9, 9)))
        bound = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/hat")).GetGeomBindTransformAttr()
        bound.Set(Gf.Matrix4d().SetTranslate((0.0, 0.25, 0.0)))
    found = character_of(usd_document(path))
    expected = posed(path, "walk | fast", 0.5)
    # Skinned points are in the space of the skeleton, others in that of their prim: here /Asset's for both.
    for part in found.parts:
        points = skinned_positions(part, found.rig, pose_at(found.rig, found.animations[0], 0.5))
        world = np.column_stack([expected[part.name], np.ones(len(points))]) @ np.array(turn)
        np.testing.assert_allclose(points, 0.01 * world[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6, err_msg=part.name)
    alone = document_and_character(path)[1].parts
    np.testing.assert_allclose(alone[0].mesh.positions, found.parts[0].mesh.positions, atol=1e-6)


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


def test_an_uneven_scale_of_a_skeleton_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Joints of glTF have no shear, which rotated joints below it have."""
    made = lively()
    write_usd_character(tmp_path / "C.usda", made, read_scene(character_glb(made)))
    stage = Usd.Stage.Open(str(tmp_path / "C.usda"))
    scale = UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddScaleOp()
    for size, said in (((-2.0, 2.0, 2.0), 0), ((1.0, 2.0, 1.0), 1)):
        scale.Set(size)
        stage.Save()
        document_and_character(tmp_path / "C.usda")[1]
        assert caplog.text.count("/Asset/skeleton: its transform scales unevenly") == said


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


def test_several_skeletons_are_refused(painted_path: Path) -> None:
    with stage_at(painted_path) as stage:
        other = UsdSkel.Skeleton.Define(stage, "/Asset/other")
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/hat")).GetSkeletonRel().SetTargets([other.GetPath()])
    refuses(FormatError, "expected one skeleton, got /Asset/skeleton, /Asset/other", usd_document, painted_path)


@pytest.mark.parametrize("rate", [0.0, -24.0, np.inf])
def test_an_animation_without_a_rate_is_refused(painted_path: Path, rate: float) -> None:
    stage = Usd.Stage.Open(str(painted_path))
    stage.GetRootLayer().timeCodesPerSecond = rate
    stage.GetRootLayer().Save()
    refuses(FormatError, f"expected timeCodesPerSecond above 0, got {rate:g}", usd_document, painted_path)


def test_a_pose_needs_no_rate(painted_path: Path) -> None:
    stage = Usd.Stage.Open(str(painted_path))
    stage.RemovePrim("/Asset/animations")
    pose = UsdSkel.Animation.Define(stage, "/Asset/pose")
    pose.CreateJointsAttr(UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton")).GetJointsAttr().Get()[:1])
    pose.CreateTranslationsAttr([(1.0, 2.0, 3.0)])
    stage.GetRootLayer().timeCodesPerSecond = 0.0
    stage.GetRootLayer().Save()
    (track,) = document_and_character(painted_path)[1].animations[0].tracks
    np.testing.assert_array_equal(track.times, [0.0])


def test_bindings_above_a_mesh_and_with_indices_skin_as_in_usd(tmp_path: Path) -> None:
    """Joints, weights and bind transform of the prim above; joints by index; samples before the stage's first time."""
    path = tmp_path / "C.usda"
    with stage_at(path, ("Y", 1.0)) as stage:
        UsdSkel.Root.Define(stage, "/R")
        joints = UsdSkel.Skeleton.Define(stage, "/R/skeleton")
        places = [Gf.Matrix4d().SetTranslate((0, height, 0)) for height in (0, 1, 2)]
        joints.CreateJointsAttr(["A", "A/B", "A/B/C"])
        joints.CreateBindTransformsAttr(places)
        joints.CreateRestTransformsAttr([places[0], places[1], places[1]])
        animation = UsdSkel.Animation.Define(stage, "/R/animation")
        animation.CreateJointsAttr(["A/B"])
        animation.CreateScalesAttr([Gf.Vec3h(1, 1, 1)])
        animation.CreateTranslationsAttr().Set([(0, 1, 0)], -12.0)
        animation.CreateTranslationsAttr().Set([(2, 1, 0)], 12.0)
        animation.CreateRotationsAttr().Set([Gf.Quatf(1.0)], -12.0)
        animation.CreateRotationsAttr().Set([Gf.Quatf(0.5, 0.5, 0.5, 0.5)], 12.0)
        UsdSkel.BindingAPI.Apply(joints.GetPrim()).CreateAnimationSourceRel().SetTargets(["/R/animation"])
        group = UsdSkel.BindingAPI.Apply(UsdGeom.Xform.Define(stage, "/R/group").GetPrim())
        group.CreateSkeletonRel().SetTargets([joints.GetPath()])
        group.CreateJointsAttr(["A/B/C", "A"])
        group.CreateJointIndicesPrimvar(True, 2).Set([0, 1])
        group.CreateJointWeightsPrimvar(True, 2).Set([0.75, 0.25])
        group.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate((0.0, 0.5, 0.0)))
        usd_mesh(stage, "/R/group/below", cube())
        own = UsdSkel.BindingAPI.Apply(usd_mesh(stage, "/R/group/own", cube()).GetPrim())
        indices = own.CreateJointIndicesPrimvar(False, 1)
        indices.Set([1, 0])
        indices.SetIndices([0, 1] * 4)
        own.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 8)
    found = document_and_character(path)[1]
    assert min(track.times[0] for track in found.animations[0].tracks) == 0.0
    for part in found.parts:
        prim = stage.GetPrimAtPath(f"/R/group/{part.name}")
        for frame in (-12.0, 0.0, 12.0):
            posed_at = pose_at(found.rig, found.animations[0], (frame + 12.0) / 24.0)
            got = skinned_positions(part, found.rig, posed_at)
            np.testing.assert_allclose(got, skinned_points(prim, frame), atol=1e-6)
    skeleton = read_usd_skeleton(path, place_in_world(read_usd_meshes(path)[0]).control)
    np.testing.assert_allclose(skeleton.heads[:, 1], [-0.5, 0.5, 1.5])


def test_a_character_of_another_program(shared_data: Path) -> None:
    """RiggedFigure: rotated by its prims, quaternions in key frames; posed points as USD computes them."""
    path = shared_data / "characters" / "foreign" / "RiggedFigure.usdz"
    found = document_and_character(path)[1]
    assert len(found.rig.names) == 19
    (animation,) = found.animations
    stage = Usd.Stage.Open(str(path))
    prim = next(one for one in stage.Traverse() if one.IsA(UsdGeom.Mesh))
    skeleton = UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
    to_world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(skeleton.GetPrim()))
    for frame in (0.0, 12.0, 30.0):
        points = skinned_points(prim, frame)
        expected = np.column_stack([points, np.ones(len(points))]) @ to_world
        seconds = frame / stage.GetTimeCodesPerSecond()
        got = skinned_positions(found.parts[0], found.rig, pose_at(found.rig, animation, seconds))
        np.testing.assert_allclose(got, expected[:, :3], atol=1e-5)


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("kind", ["uniform", "vertex", "faceVarying"])
def test_display_colors_and_opacity_of_every_interpolation_are_read(tmp_path, kind, left_handed):
    mesh = cube()
    rows = {"uniform": mesh.corner_faces, "vertex": mesh.face_indices}.get(kind, np.arange(len(mesh.face_indices)))
    values = np.random.default_rng(3).uniform(size=(rows.max() + 1, 4)).astype(np.float32)
    with stage_at(tmp_path / "cube.usda", ("Y", 1.0)) as stage:
        prim = usd_mesh(stage, "/cube", mesh)
        prim.CreateOrientationAttr("leftHanded" if left_handed else "rightHanded")
        prim.CreateDisplayColorPrimvar(kind).Set(values[::-1, :3].tolist())
        prim.GetDisplayColorPrimvar().SetIndices(list(range(len(values)))[::-1])
        prim.CreateDisplayOpacityPrimvar(kind).Set(values[:, 3].tolist())
    (part,) = document_and_character(tmp_path / "cube.usda")[1].parts
    order = [part.mesh.corner_faces * 8 + part.mesh.face_indices, mesh.corner_faces * 8 + mesh.face_indices]
    found, expected = (np.argsort(keys) for keys in order)
    np.testing.assert_allclose(part.colors[found], values[rows][expected], atol=1e-6)
    encoded = encode_srgb(values[rows, :3])
    means = [encoded[mesh.face_indices == vertex].mean(axis=0) for vertex in range(8)]
    np.testing.assert_allclose(part.mesh.vertex_colors, means, atol=1e-6)
    write_document(tmp_path / "cube.glb", usd_document(tmp_path / "cube.usda"))
    (again,) = character_of(read_document(tmp_path / "cube.glb")).parts
    keys = again.mesh.positions[again.mesh.face_indices] @ [1, 10, 100]
    assert set(zip(keys.tolist(), map(tuple, again.colors.tolist()), strict=True)) == set(
        zip(
            (part.mesh.positions[part.mesh.face_indices] @ [1, 10, 100]).tolist(),
            map(tuple, part.colors.tolist()),
            strict=True,
        )
    )


def test_normals_of_blend_shapes_are_read(tmp_path: Path) -> None:
    mesh = cube()
    offsets, turned = np.random.default_rng(4).normal(size=(2, 3, 3))
    normals = mesh.positions / np.linalg.norm(mesh.positions, axis=1, keepdims=True)
    with stage_at(tmp_path / "cube.usda", ("Y", 1.0)) as stage:
        prim = usd_mesh(stage, "/cube", mesh)
        prim.AddScaleOp().Set((1.0, 2.0, 1.0))
        prim.CreateSubdivisionSchemeAttr("none")
        prim.CreateNormalsAttr(normals.tolist())
        shape = UsdSkel.BlendShape.Define(stage, "/cube/smile")
        shape.CreatePointIndicesAttr([5, 0, 2])
        shape.CreateOffsetsAttr(offsets.tolist())
        shape.CreateNormalOffsetsAttr(turned.tolist())
        binding = UsdSkel.BindingAPI.Apply(prim.GetPrim())
        binding.CreateBlendShapesAttr(["smile"])
        binding.CreateBlendShapeTargetsRel().SetTargets(["/cube/smile"])
    (part,) = document_and_character(tmp_path / "cube.usda")[1].parts
    expected = np.zeros((8, 3))
    expected[[5, 0, 2]] = turned
    scaled = normals * [1.0, 0.5, 1.0]
    expected = expected * [1.0, 0.5, 1.0] / np.linalg.norm(scaled, axis=1, keepdims=True)
    np.testing.assert_allclose(part.shape_normals["smile"], expected[part.mesh.face_indices], atol=1e-6)


def test_faces_of_two_corners_are_refused_by_name(tmp_path: Path) -> None:
    with stage_at(tmp_path / "cube.usda") as stage:
        prim = usd_mesh(stage, "/cube", cube())
        prim.GetFaceVertexCountsAttr().Set([*cube().face_sizes.tolist(), 2])
        prim.GetFaceVertexIndicesAttr().Set([*cube().face_indices.tolist(), 0, 1])
    with pytest.raises(
        FormatError, match=r"cube\.usda: /cube: expected faces of at least three corners, got 1 .* 6\. D"
    ):
        usd_document(tmp_path / "cube.usda")
    assert "degenerate faces" in run_check(CheckRequest((tmp_path / "cube.usda",)), Stages())[0]


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
