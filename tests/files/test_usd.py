"""USD in and out: topology, subdivision, primvars, skinning, layers over a target, and files that are damaged."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube, grid, icosahedron

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.mesh.topology import uv_islands
from cagemap.subdivision import finest_mesh, refine
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from usd_scenes import complaints, full_cube, stage_at, usd_mesh

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from cagemap.files.usd.read import place_in_world, read_usd, read_usd_meshes
from cagemap.files.usd.results import MATERIAL, connect_texture, define_material, uv_reader
from cagemap.files.usd.stages import damage_as_error, open_stage
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over

from refusals import refuses


def assert_same(one: ControlMesh, other: ControlMesh) -> None:
    for field in fields(ControlMesh):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if field.name in ("name", "uv_sets", "upright"):  # files have an up axis, meshes need not
            continue
        if isinstance(mine, np.ndarray):
            rounding = 1e-7 if field.name == "vertex_colors" else 0.0  # stored as linear single precision
            np.testing.assert_allclose(theirs, mine, rtol=0.0, atol=rounding, err_msg=field.name)
        else:
            assert mine == theirs, field.name
    for mine, theirs in zip(one.uv_sets, other.uv_sets, strict=True):
        assert mine.name == theirs.name
        np.testing.assert_array_equal(mine.uvs[mine.uv_indices], theirs.uvs[theirs.uv_indices])


def uv_primvar(mesh: Any, name: str, interpolation: str) -> Any:
    return UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, Sdf.ValueTypeNames.TexCoord2fArray, interpolation)


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_what_is_written_is_read_again(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cube{suffix}"
    write_mesh(path, full_cube())
    assert_same(full_cube(), read_mesh(path))
    assert complaints(path) == []


@pytest.mark.parametrize("scheme", [Loop("edge_only", "boundaries"), Bilinear("none", "none")], ids=str)
def test_schemes_are_kept(scheme: Loop | Bilinear, tmp_path: Path) -> None:
    path = tmp_path / "mesh.usda"
    write_usd(path, replace(icosahedron(), scheme=scheme))
    assert read_usd(path).scheme == scheme
    refined = finest_mesh(refine(read_usd(path), 1))
    write_usd(tmp_path / "refined.usda", refined)
    stage = Usd.Stage.Open(str(tmp_path / "refined.usda"))
    assert UsdGeom.Mesh(stage.GetPrimAtPath("/Asset/mesh")).GetSubdivisionSchemeAttr().Get() == "none"


def test_defaults_are_those_of_usd(tmp_path: Path) -> None:
    with stage_at(tmp_path / "bare.usda") as stage:
        usd_mesh(stage, "/m", grid(2, 2))
    assert read_usd(tmp_path / "bare.usda").scheme == CatmullClark("edge_and_corner", "corners_plus1")


def test_uvs_of_every_interpolation(tmp_path: Path) -> None:
    control = grid(2, 1)
    with stage_at(tmp_path / "uvs.usda") as stage:
        api = UsdGeom.PrimvarsAPI(usd_mesh(stage, "/m", control))
        counts = {"constant": 1, "uniform": 2, "varying": 6, "vertex": 6, "faceVarying": 8}
        for name, count in counts.items():
            values = np.arange(2 * count, dtype=np.float32).reshape(count, 2)
            api.CreatePrimvar(name, Sdf.ValueTypeNames.TexCoord2fArray, name).Set(Vt.Vec2fArray.FromNumpy(values))
    mesh = read_usd(tmp_path / "uvs.usda")
    owners = {"constant": np.zeros(8, int), "uniform": mesh.corner_faces, "faceVarying": np.arange(8)}
    for name in counts:
        chosen = mesh.with_uv_set(name)
        owner = owners.get(name, mesh.face_indices)
        np.testing.assert_array_equal(chosen.uvs[chosen.uv_indices][:, 0], 2 * owner)


def test_texture_coordinates_without_indices_are_one_island_where_they_agree(tmp_path: Path) -> None:
    control = grid(4, 3)
    uvs = control.positions[:, :2][control.face_indices].astype(np.float32)
    right = np.repeat(np.arange(control.n_faces) >= 6, 4)  # columns 2 and 3
    uvs[right] += [np.float32(2.0), np.float32(0.0)]  # a seam down the middle
    with stage_at(tmp_path / "blender.usda") as stage:
        api = UsdGeom.PrimvarsAPI(usd_mesh(stage, "/m", control))
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        api.CreatePrimvar("st", kind, "faceVarying").Set(Vt.Vec2fArray.FromNumpy(uvs))
    mesh = read_usd(tmp_path / "blender.usda")
    islands = uv_islands(mesh)
    assert islands.max() + 1 == 2
    assert len(mesh.uvs) == 2 * 3 * 4
    np.testing.assert_array_equal(mesh.uvs[mesh.uv_indices], uvs)


def test_creases_along_chains_and_a_left_handed_mesh(tmp_path: Path) -> None:
    with stage_at(tmp_path / "chain.usda") as stage:
        mesh = usd_mesh(stage, "/m", cube())
        mesh.CreateOrientationAttr("leftHanded")
        ring = cube().face(0).tolist()
        mesh.CreateCreaseIndicesAttr([*ring, ring[0], ring[2], int(cube().face(5)[0])])
        mesh.CreateCreaseLengthsAttr([5, 2])
        mesh.CreateCreaseSharpnessesAttr([2.5, 1.0])
    read = read_usd(tmp_path / "chain.usda")
    np.testing.assert_array_equal(read.crease_sharpness, [2.5] * 4 + [1.0])
    np.testing.assert_array_equal(read.crease_edges[:4, 0], ring)
    assert {tuple(np.roll(f, -np.argmin(f))) for f in (read.face(i) for i in range(6))} == {
        tuple(np.roll(f[::-1], -np.argmin(f[::-1]))) for f in (cube().face(i) for i in range(6))
    }


def _character(path: Path) -> None:
    """Two meshes under transforms, one skinned and with a blend shape, in centimetres and Z-up."""
    with stage_at(path, (UsdGeom.Tokens.z, 0.01)) as stage:
        root = UsdSkel.Root.Define(stage, "/hero")
        stage.SetDefaultPrim(root.GetPrim())
        body = usd_mesh(stage, "/hero/body", cube())
        eye = usd_mesh(stage, "/hero/eye", grid(2, 2))
        UsdGeom.XformCommonAPI(eye).SetTranslate(Gf.Vec3d(0, 5, 0))
        binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
        binding.CreateJointIndicesPrimvar(False, 2).Set([0, 2] * 8)
        binding.CreateJointWeightsPrimvar(False, 2).Set([0.25, 0.75] * 8)
        shape = UsdSkel.BlendShape.Define(stage, "/hero/body/smile")
        shape.CreateOffsetsAttr([Gf.Vec3f(1, 0, 0)])
        shape.CreatePointIndicesAttr([5])
        binding.CreateBlendShapesAttr(["smile"])
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
        api = UsdGeom.PrimvarsAPI(body)
        api.CreatePrimvar("fur", Sdf.ValueTypeNames.FloatArray, "vertex").Set(list(map(float, range(8))))


def test_a_character_with_parts_weights_and_blend_shapes(tmp_path: Path) -> None:
    path = tmp_path / "hero.usda"
    _character(path)
    body, eye = read_usd_meshes(path)
    assert (body.path, eye.path) == ("/hero/body", "/hero/eye")
    np.testing.assert_allclose(place_in_world(eye).control.positions, eye.control.positions + np.array([0, 5, 0]))
    np.testing.assert_array_equal(body.attributes["skel:jointWeights"], [[0.25, 0, 0.75]] * 8)
    np.testing.assert_array_equal(body.attributes["blendShape:smile"][5], [1, 0, 0])
    np.testing.assert_array_equal(body.attributes["fur"], np.arange(8))
    joined = read_usd(path)
    assert joined.object_names == ("/hero/body", "/hero/eye")
    assert (joined.n_vertices, joined.n_faces) == (17, 10)


def test_names_without_an_identifier_of_their_own_stay_apart(tmp_path: Path) -> None:
    mesh = replace(full_cube(), material_names=("皮肤", "头发"), material_colors=np.array([[0.5, 0, 0], [0, 0, 0.5]]))
    moves = np.eye(3)[np.arange(8) % 3]
    attributes = {"blendShape:笑": moves, "blendShape:怒": 2 * moves, "高": np.arange(8.0), "低": -np.arange(8.0)}
    write_usd(tmp_path / "cube.usda", mesh, UsdResults(attributes=attributes))
    (read,) = read_usd_meshes(tmp_path / "cube.usda")
    colors = read.control.material_colors[read.control.face_materials]  # type: ignore[index]
    np.testing.assert_array_equal(colors, mesh.material_colors[mesh.face_materials])  # type: ignore[index]
    np.testing.assert_array_equal(read.attributes["blendShape:笑"], moves)
    np.testing.assert_array_equal(read.attributes["blendShape:怒"], 2 * moves)
    others = [read.attributes[name] for name in read.attributes if name.startswith("_")]
    np.testing.assert_array_equal(others, [np.arange(8.0), -np.arange(8.0)])


def test_textures_show_on_all_faces(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"")
    mesh, results = full_cube(), UsdResults(textures={"albedo": "./a.png"})
    write_usd(tmp_path / "own.usda", mesh, results)
    write_usd(tmp_path / "target.usda", mesh)
    write_usd_over(tmp_path / "over.usda", tmp_path / "target.usda", ["/Asset/mesh"], mesh, results)
    for name in ("own.usda", "over.usda"):
        stage = Usd.Stage.Open(str(tmp_path / name))
        subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(stage.GetPrimAtPath("/Asset/mesh")))
        bound = [UsdShade.MaterialBindingAPI(one.GetPrim()).ComputeBoundMaterial()[0].GetPath() for one in subsets]
        assert [str(path) for path in bound] == [f"/Asset/{MATERIAL}"] * 2
        assert complaints(tmp_path / name) == []


def test_uv_sets_of_any_name_are_written(tmp_path: Path) -> None:
    """Names as of 3ds Max, and those that USD gives to normals and colours."""
    corners = np.arange(24)
    (tmp_path / "a.png").write_bytes(b"")
    for names in (("UV Channel 1", "UV Channel 2"), ("normals", "Körper"), ("displayColor", "1"), ("", "st")):
        uvs = np.random.default_rng(0).random((2, 24, 2)).astype(np.float32)
        mesh = replace(full_cube(), uvs=uvs[0], uv_indices=corners, uv_name=names[0])
        mesh = replace(mesh, uv_sets=(UvSet(names[1], uvs[1], corners),))
        results = UsdResults(textures={"albedo": "./a.png"})
        write_usd(tmp_path / "cube.usda", mesh, results)
        assert complaints(tmp_path / "cube.usda") == []
        stage = open_stage(tmp_path / "cube.usda")
        reader = next(p for p in stage.Traverse() if p.GetName().startswith("uv_"))
        used = UsdShade.Shader(reader).GetInput("varname").Get()
        found = {one.name: one.uvs[one.uv_indices] for one in read_usd(tmp_path / "cube.usda").all_uv_sets}
        np.testing.assert_allclose(found.pop(used), uvs[0])
        np.testing.assert_allclose(*found.values(), uvs[1])


@pytest.mark.parametrize("kind", ["TexCoord2fArray", "Float2Array"])
@pytest.mark.parametrize(("on_faces", "purpose"), [(False, ""), (True, ""), (False, "preview"), (True, "full")])
def test_the_first_uv_set_is_that_of_the_material_s_colour(kind, on_faces, purpose, tmp_path):
    """`lightmap` comes before `map1` by name; pairs of floats without a role count where the material reads them."""
    corners = np.random.default_rng(0).random((2, 24, 2)).astype(np.float32)
    with stage_at(tmp_path / "cube.usda") as stage:
        mesh = usd_mesh(stage, "/cube", cube())
        for name, uvs in zip(("lightmap", "map1"), corners, strict=True):
            primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, getattr(Sdf.ValueTypeNames, kind), "faceVarying")
            primvar.Set(Vt.Vec2fArray.FromNumpy(uvs))
        material, surface = define_material(stage, "/skin")
        connect_texture(stage, surface, "diffuseColor", "./skin.png", uv_reader(stage, "/skin/uvs", "map1"))
        bound = mesh.GetPrim()
        if on_faces:
            bound = UsdGeom.Subset.CreateGeomSubset(mesh, "half", "face", [0, 1, 2], "materialBind").GetPrim()
        UsdShade.MaterialBindingAPI.Apply(bound).Bind(material, materialPurpose=purpose)
    found = read_usd(tmp_path / "cube.usda")
    assert found.uv_name == "map1"
    np.testing.assert_allclose(found.uvs[found.uv_indices], corners[1])
    further = [one.name for one in found.uv_sets]
    assert further == (["lightmap"] if kind == "TexCoord2fArray" else [])


def test_texture_coordinates_of_three_components_are_named_once_and_kept_as_values(tmp_path, caplog):
    with stage_at(tmp_path / "cube.usda") as stage:
        uvw = UsdGeom.PrimvarsAPI(usd_mesh(stage, "/cube", cube())).CreatePrimvar(
            "uvw", Sdf.ValueTypeNames.TexCoord3fArray, "vertex"
        )
        uvw.Set([(0.0, 0.0, 0.0)] * 8)
    (found,) = read_usd_meshes(tmp_path / "cube.usda")
    assert found.control.uvs is None
    assert found.attributes["uvw"].shape == (8, 3)  # values like any others
    assert caplog.text.count("cube.usda: /cube: texture coordinates uvw have three components") == 1


def test_a_blend_shape_does_not_take_the_place_of_a_subset(tmp_path: Path) -> None:
    mesh, moves = full_cube(), np.eye(3)[np.arange(8) % 3]
    write_usd(tmp_path / "cube.usda", mesh, UsdResults(attributes={"blendShape:skin": moves}))
    (read,) = read_usd_meshes(tmp_path / "cube.usda")
    assert read.control.material_names == mesh.material_names
    np.testing.assert_array_equal(read.attributes["blendShape:skin"], moves)


def test_references_and_variants_are_resolved(tmp_path: Path) -> None:
    _character(tmp_path / "hero.usda")
    with stage_at(tmp_path / "shot.usda") as stage:
        prim = stage.DefinePrim("/shot/hero")
        prim.GetReferences().AddReference("./hero.usda")
        variants = prim.GetVariantSets().AddVariantSet("look")
        for name in ("with", "without"):
            variants.AddVariant(name)
            variants.SetVariantSelection(name)
            with variants.GetVariantEditContext():
                stage.OverridePrim("/shot/hero/eye").SetActive(name == "with")
    (body,) = read_usd_meshes(tmp_path / "shot.usda")
    assert body.path == "/shot/hero/body"


def test_results_are_a_layer_over_the_target(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    (tmp_path / "out").mkdir()
    target = tmp_path / "assets" / "hero.usda"
    _character(target)
    before = target.read_bytes()
    body = read_usd_meshes(target)[0].control
    rng = np.random.default_rng(3)
    weights = rng.random((8, 5))
    results = UsdResults(
        textures={
            "albedo": "./skin.<UDIM>.png",
            "roughness": "./rough.png",
            "normal": "./normal.png",
            "gloss": "x.png",
        },
        attributes={
            "skel:jointWeights": weights / weights.sum(axis=1, keepdims=True),
            "blendShape:frown": np.eye(8, 3),
            "fur length": rng.random(8),
            "region": np.arange(6),
            "displayColor": rng.random((8, 3)),
        },
        points=body.positions * 2,
        uvs=("st", rng.random((24, 2)), np.arange(24)),
    )
    for name in ("skin.1001.png", "rough.png", "normal.png"):
        (tmp_path / "out" / name).write_bytes(b"")
    layer = tmp_path / "out" / "hero_textured.usda"
    write_usd_over(layer, target, ["/hero/body"], body, results)
    assert target.read_bytes() == before
    assert complaints(layer) == []
    stage = Usd.Stage.Open(str(layer))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    assert stage.GetDefaultPrim().GetPath() == "/hero"
    again = read_usd_meshes(layer)[0]
    np.testing.assert_allclose(again.control.positions, body.positions * 2)
    np.testing.assert_allclose(
        again.attributes["skel:jointWeights"], results.attributes["skel:jointWeights"], atol=1e-6
    )
    np.testing.assert_allclose(again.attributes["blendShape:frown"], np.eye(8, 3))
    np.testing.assert_array_equal(again.attributes["region"], np.arange(6))
    np.testing.assert_allclose(again.control.uvs, results.uvs[1], atol=1e-6)
    material = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/hero/body")).ComputeBoundMaterial()[0]
    files = [
        prim.GetAttribute("inputs:file").Get().path
        for prim in Usd.PrimRange(material.GetPrim())
        if prim.GetAttribute("inputs:file")
    ]
    assert sorted(files) == ["./normal.png", "./rough.png", "./skin.<UDIM>.png"]


def test_what_a_file_refers_to_and_is_not_there_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for number, arc in enumerate(("payload", "references")):
        file = tmp_path / f"{arc}.usda"
        file.write_text(f'#usda 1.0\ndef "a" (\nprepend {arc} = @./gone (2).usda@\n)\n{{\n}}\n')
        refuses(FormatError, "at least one mesh prim, got none", read_usd, file)
        assert re.search(r"Could not open asset .*gone \(2\)\.usda@", caplog.messages[-1])
        assert str(file) in caplog.messages[-1]
        assert len(caplog.messages) == number + 1
    chosen = tmp_path / "variants.usda"
    sets = 'variantSet "shape" = {\n"one" {\n}\n}\n'
    chosen.write_text(f'#usda 1.0\ndef "a" (\nprepend variantSets = "shape"\n)\n{{\n{sets}}}\n')
    refuses(FormatError, r"Choose one of the variants of /a \(shape\)", read_usd, chosen)


@pytest.mark.parametrize("scale", ["0, 1, 1", "nan, 1, 1"])
def test_a_transform_that_flattens_is_refused(tmp_path: Path, scale: str) -> None:
    file = tmp_path / "flat.usda"
    write_usd(file, full_cube())
    with stage_at(file) as stage:
        prim = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
        UsdGeom.Xformable(prim).AddScaleOp().Set(tuple(map(float, scale.split(", "))))
    refuses(FormatError, r"flat\.usda: .*expected a transform that can be undone", read_usd, file)


def test_a_flattened_mesh_beside_others_is_left_out_aloud(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Animators hide what is not on stage by a scale of 0: the others are read as without it."""
    file = tmp_path / "scene.usda"
    write_usd(file, full_cube())
    whole = read_usd(file)
    with stage_at(file) as stage:
        usd_mesh(stage, "/World/hidden", cube()).AddScaleOp().Set((0.0, 0.0, 0.0))
    read = read_usd(file)
    np.testing.assert_array_equal(read.positions, whole.positions)
    np.testing.assert_array_equal(read.face_indices, whole.face_indices)
    assert re.search(r"scene\.usda: left out .*: /World/hidden$", caplog.messages[-1])


def test_damaged_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"damaged \(no number: 'x'\)"), damage_as_error("bad.usda"):
        raise ValueError("no number: 'x'")
    refuses(FormatError, "no such file", read_usd, tmp_path / "none.usda")
    bad = tmp_path / "bad.usda"
    for text in ("", "#usda 1.0\n(", "\0\1\2", "PXR-USDC" + "x" * 50):
        bad.write_text(text)
        refuses(FormatError, r"bad\.usda", read_usd, bad)
    with stage_at(tmp_path / "empty.usda") as stage:
        UsdGeom.Mesh.Define(stage, "/m")
    refuses(FormatError, "1 without points", read_usd, tmp_path / "empty.usda")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mesh: mesh.GetFaceVertexCountsAttr().Set([4, 4]), "sum to the"),
        (lambda mesh: mesh.GetFaceVertexIndicesAttr().Set([99] * 24), "from 0 to 7"),
        (lambda mesh: mesh.GetFaceVertexIndicesAttr().Set([-1] * 24), "from 0 to 7"),
        (lambda mesh: mesh.CreateCreaseIndicesAttr([0, 1]), "creases"),
        (lambda mesh: mesh.CreateCornerIndicesAttr([0, 1]), "one sharpness a corner"),
        (lambda mesh: mesh.CreateSubdivisionSchemeAttr("doo-sabin"), "subdivisionScheme"),
        (lambda mesh: uv_primvar(mesh, "st", "faceVarying").Set([Gf.Vec2f(0, 0)]), "primvar st"),
        (lambda mesh: uv_primvar(mesh, "st", "constant").Set([Gf.Vec2f(float("nan"), 0)]), "not numbers"),
        (
            lambda mesh: [(st := uv_primvar(mesh, "st", "faceVarying")).Set([Gf.Vec2f(0, 0)]), st.SetIndices([1] * 24)],
            "got indices from 1 to 1 into 1 values",
        ),
    ],
)
def test_meshes_that_do_not_fit_together_are_refused(change: object, message: str, tmp_path: Path) -> None:
    with stage_at(tmp_path / "mesh.usda") as stage:
        change(usd_mesh(stage, "/m", cube()))
    refuses(FormatError, message, read_usd, tmp_path / "mesh.usda")


def test_an_export_as_gltf_is_in_metres_with_y_up(tmp_path: Path) -> None:
    write_usd(tmp_path / "cube.usda", full_cube())
    with stage_at(tmp_path / "cube.usda", ("Z", 0.01)):
        pass
    write_mesh(tmp_path / "cube.glb", read_mesh(tmp_path / "cube.usda"), like=tmp_path / "cube.usda")
    data = (tmp_path / "cube.glb").read_bytes()
    (node,) = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])["nodes"]
    matrix = np.array(node["matrix"]).reshape(4, 4).T  # by columns, for points as columns
    np.testing.assert_allclose(matrix @ [100, 200, 300, 1], [1, 3, -2, 1], atol=1e-12)


def test_meshes_of_different_schemes_are_read_for_their_parts(tmp_path: Path) -> None:
    path = tmp_path / "mixed.usda"
    write_usd(path, replace(cube(), scheme=CatmullClark("edge_only")))
    with stage_at(path) as stage:
        usd_mesh(stage, "/Asset/eye", icosahedron()).CreateSubdivisionSchemeAttr("loop")
    refuses(FormatError, "`find_part` NAME", read_usd, path)
    mixed = read_usd(path, mixed=True)
    part = extract_faces(mixed, find_part(mixed, "eye").faces)
    assert isinstance(part.scheme, Loop)
    assert extract_faces(mixed, find_part(mixed, "mesh").faces).scheme == CatmullClark("edge_only")
    text, sound = run_check(CheckRequest((path,)), Stages())
    assert not sound
    assert "object:/Asset/eye" in text, text


def test_in_betweens_are_left_out_aloud_and_shapes_without_a_target_refused(tmp_path, caplog):
    path = tmp_path / "cube.usda"
    write_usd(path, full_cube(), UsdResults(attributes={"blendShape:smile": np.eye(3)[np.arange(8) % 3]}))
    stage = Usd.Stage.Open(str(path))
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Asset/mesh/smile"))
    shape.CreateInbetween("half").SetWeight(0.5)
    stage.Save()
    read_usd_meshes(path)
    assert "blend shape smile: its in-betweens are left out" in caplog.text
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh")).GetBlendShapesAttr().Set(["smile", "frown"])
    stage.Save()
    refuses(FormatError, "2 names and 1 targets", read_usd_meshes, path)
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh")).GetBlendShapesAttr().Set(["smile"])
    shape.GetOffsetsAttr().Set([(np.nan, 0.0, 0.0)] * 8)
    stage.Save()
    refuses(FormatError, "expected one finite offset a point", read_usd_meshes, path)
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh")).GetBlendShapeTargetsRel().SetTargets(["/Asset/mesh"])
    stage.Save()
    refuses(FormatError, "blend shape smile: /Asset/mesh is no blend shape", read_usd_meshes, path)
