"""USD files that hold more than the matched part, other units or a moved prim: layers fit what they lie over."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, poles, torus

from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.result.folder import write_result
from cagemap.files.values.attributes import read_attributes
from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.mesh.parts import extract_faces, find_part, join_meshes
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.tasks.match import MatchRequest, read_inputs, run_match
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import run_wrap

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from cagemap.files.meshes.arrays import control_from_arrays, control_to_arrays
from cagemap.files.npz import Archive
from cagemap.files.usd.read import read_usd, read_usd_meshes
from cagemap.files.usd.results import define_material
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over

from example_result import identity_result
from plain_meshes import marks_at
from usd_scenes import complaints, full_cube, stage_at, usd_mesh

BODY_START = poles(6).n_vertices  # vertices of the eye come first
PLACE = np.array([[0, 2.0, 0, 0], [-2.0, 0, 0, 0], [0, 0, 2.0, 0], [5, 6, 7, 1]])


def _stage(path: Path, mesh: ControlMesh) -> None:
    """A mesh in a turned and enlarged prim, Z up, in centimetres."""
    write_usd(path, mesh)
    with stage_at(path, ("Z", 0.01)) as stage:
        UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddTransformOp().Set(Gf.Matrix4d(*PLACE.ravel().tolist()))


def _scene() -> ControlMesh:
    ball = poles(6)
    eye = ball.with_positions(ball.positions + np.array([9.0, 0, 0]))
    both = replace(join_meshes([eye, creature()]), name="hero.usda", scheme=CatmullClark(), uv_name="st")
    flat = both.positions[:, :2]
    return both.with_uvs((flat - flat.min(axis=0)) / np.ptp(flat, axis=0), both.face_indices)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("usd parts")
    scene, hero = _scene(), place / "hero.usda"
    _stage(hero, scene)
    picked = BODY_START + np.linspace(0, creature().n_vertices - 1, 9).astype(int)
    write_landmarks(place / "landmarks.json", marks_at(picked, "hero", "hero"))
    request = MatchRequest(hero, hero, place / "R", place / "landmarks.json", level=1, k=30, part="component:1")
    run_match(request, Stages())
    return place


@pytest.mark.slow
def test_layers_about_a_part_of_a_prim_fit_the_prim(folder: Path) -> None:
    scene = _scene()
    side = np.linspace(0.1, 0.9, scene.n_vertices)
    np.savez(folder / "side.npz", side=side)
    np.savez(folder / "skin.npz", hip=side, head=1 - side)
    smile = np.zeros((scene.n_vertices, 3))
    smile[BODY_START + 4] = (0, 0.1, 0)
    np.savez(folder / "smile.npz", smile=smile)
    result = folder / "R"
    for name, options in (
        ("side", {"attribute": folder / "side.npz"}),
        ("weights", {"weights": folder / "skin.npz"}),
        ("shapes", {"blend_shapes": (folder / "smile.npz",)}),
    ):
        layer = folder / f"{name}.usda"
        run_transfer(TransferRequest(result, folder / f"{name}_out.npz", usd=layer, **options), Stages())
        assert complaints(layer) == [], name
    read = {name: read_usd_meshes(folder / f"{name}.usda")[0] for name in ("side", "weights", "shapes")}
    np.testing.assert_allclose(read["side"].attributes["side"][BODY_START:], side[BODY_START:], atol=1e-5)
    assert not read["side"].attributes["side"][:BODY_START].any()
    weights = read["weights"].attributes["skel:jointWeights"]
    np.testing.assert_allclose(weights[BODY_START:, 0], side[BODY_START:], atol=1e-5)
    np.testing.assert_allclose(read["shapes"].attributes["blendShape:smile"], smile, atol=1e-5)
    run_wrap(WrapRequest((result,), folder / "wrapped.usda"), Stages())
    assert complaints(folder / "wrapped.usda") == []
    wrapped = read_usd(folder / "wrapped.usda")
    np.testing.assert_allclose(wrapped.positions[:BODY_START], scene.positions[:BODY_START], atol=1e-6)
    assert np.abs(wrapped.positions - scene.positions).max() < 0.05 * np.ptp(scene.positions)


@pytest.mark.slow
def test_a_new_layout_of_a_part_fits_the_prim(folder: Path) -> None:
    write_image(folder / "grey.png", np.full((32, 32, 3), 99, dtype=np.uint8))
    images = {"texture": folder / "grey.png", "output": folder / "colors.png"}
    run_transfer(TransferRequest(folder / "R", **images, unwrap=True, usd=folder / "look.usda"), Stages())
    assert complaints(folder / "look.usda") == []
    (mesh,) = read_usd_meshes(folder / "look.usda")
    layout = mesh.control.with_uv_set("cagemap_st")
    outside = layout.face_indices < BODY_START
    assert np.ptp(layout.uvs[layout.uv_indices[~outside]], axis=0).min() > 0.5
    assert not np.ptp(layout.uvs[layout.uv_indices[outside]], axis=0).any()


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_refined_files_keep_units_axis_and_place(suffix: str, tmp_path: Path) -> None:
    _stage(tmp_path / "box.usda", replace(cube(), scheme=CatmullClark()))
    run_refine(RefineRequest(tmp_path / "box.usda", 1, tmp_path / f"fine{suffix}"), Stages())
    stage = Usd.Stage.Open(str(tmp_path / f"fine{suffix}"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    (fine,), (coarse,) = (read_usd_meshes(path) for path in (tmp_path / f"fine{suffix}", tmp_path / "box.usda"))
    np.testing.assert_allclose(fine.to_world, coarse.to_world, atol=1e-12)
    assert fine.control.n_vertices == 26
    assert complaints(tmp_path / f"fine{suffix}") == []


def _volume(mesh: ControlMesh) -> float:
    surface = TriangleSurface.from_faces(mesh.positions, mesh.face_indices.reshape(-1, 4))
    a, b, c = (surface.positions[surface.triangles[:, k]] for k in range(3))
    return float(np.einsum("td,td->", a, np.cross(b, c)))


def test_what_only_moves_is_read_at_its_first_time(tmp_path: Path) -> None:
    with stage_at(tmp_path / "moving.usda") as stage:
        shift = UsdGeom.Xform.Define(stage, "/A").AddTranslateOp()
        mesh = usd_mesh(stage, "/A/m", cube())
        for time in (3, 9):
            shift.Set((5.0 * time, 0, 0), time)
        for attribute in (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()):
            value = attribute.Get()
            attribute.Clear()
            attribute.Set(value, 3)
        mesh.GetPointsAttr().Set((4 * cube().positions).tolist(), 9)
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
        primvar.Set(cube().positions[:, :2].tolist(), 3)
    (read,) = read_usd_meshes(tmp_path / "moving.usda")
    np.testing.assert_array_equal(read.control.positions, cube().positions)
    np.testing.assert_array_equal(read.to_world[3, :3], [15, 0, 0])
    assert read.control.uvs is not None


def test_mirrored_and_left_handed_prims_face_outwards_and_layers_fit_them(tmp_path: Path) -> None:
    with stage_at(tmp_path / "mirrored.usda", ("Y", 1)) as stage:
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
        other = cube().face_indices.reshape(-1, 4)[:, ::-1].ravel()
        reversed_cube = replace(cube(), face_indices=other)
        for name, scale, left in (("a", 1, False), ("b", -1, False), ("c", 1, True), ("d", -1, True)):
            parent = UsdGeom.Xform.Define(stage, f"/Root/{name}")
            parent.AddTranslateOp().Set((9.0 * ord(name), 0, 0))
            parent.AddScaleOp().Set((scale, 1, 1))
            made = usd_mesh(stage, f"/Root/{name}/m", reversed_cube if left else cube())
            if left:
                made.CreateOrientationAttr("leftHanded")
    whole, meshes = read_usd(tmp_path / "mirrored.usda"), read_usd_meshes(tmp_path / "mirrored.usda")
    for mesh in meshes:
        part = extract_faces(whole, find_part(whole, mesh.path).faces)
        centred = part.with_positions(part.positions - part.positions.mean(axis=0))
        assert _volume(centred) > 0, mesh.path
        where = part.positions[part.face_indices]
        layer = tmp_path / f"{mesh.path.split('/')[2]}.usda"
        results = UsdResults(attributes={"where": where}, uvs=("flat", where[:, :2], np.arange(24)))
        write_usd_over(layer, tmp_path / "mirrored.usda", [mesh.path], part, results, world=True)
        assert complaints(layer) == []
        over = Usd.Stage.Open(str(layer))
        prim = UsdGeom.Mesh(over.GetPrimAtPath(mesh.path))
        values = np.array(UsdGeom.PrimvarsAPI(prim).GetPrimvar("where").Get())
        flat = np.array(UsdGeom.PrimvarsAPI(prim).GetPrimvar("flat").ComputeFlattened())
        points = np.array(prim.GetPointsAttr().Get())[np.array(prim.GetFaceVertexIndicesAttr().Get())]
        placed = points @ mesh.to_world[:3, :3] + mesh.to_world[3, :3]
        np.testing.assert_allclose(values, placed, atol=1e-5)
        np.testing.assert_allclose(flat, placed[:, :2], atol=1e-5)
        again = read_attributes(layer, extract_faces(read_usd(layer), find_part(whole, mesh.path).faces))["where"]
        np.testing.assert_allclose(again, where, atol=1e-5)


@pytest.mark.parametrize("inner", ["", "/Box/in"])
def test_instances_are_meshes_that_a_layer_can_reach(inner: str, tmp_path: Path) -> None:
    """Also those of an instance inside of another."""
    with stage_at(tmp_path / "inner.usda") as innermost:
        innermost.SetDefaultPrim(UsdGeom.Xform.Define(innermost, "/In").GetPrim())
        usd_mesh(innermost, "/In/m", cube())
    with stage_at(tmp_path / "box.usda") as prototype:
        prototype.SetDefaultPrim(UsdGeom.Xform.Define(prototype, "/Box").GetPrim())
        nested = UsdGeom.Xform.Define(prototype, inner or "/Box").GetPrim()
        nested.GetReferences().AddReference("./inner.usda")
        nested.SetInstanceable(bool(inner))
    with stage_at(tmp_path / "scene.usda", ("Y", 1)) as stage:
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
        for number in range(2):
            placed = UsdGeom.Xform.Define(stage, f"/World/box{number}")
            placed.GetPrim().GetReferences().AddReference("./box.usda")
            placed.GetPrim().SetInstanceable(True)
            placed.AddTranslateOp().Set((9.0 * number, 0, 0))
    paths = [f"/World/box{number}{inner.removeprefix('/Box')}/m" for number in range(2)]
    assert [mesh.path for mesh in read_usd_meshes(tmp_path / "scene.usda")] == paths
    whole = read_usd(tmp_path / "scene.usda")
    part = extract_faces(whole, find_part(whole, paths[1]).faces)
    points = UsdResults(points=part.positions + 1)
    write_usd_over(tmp_path / "over.usda", tmp_path / "scene.usda", paths[1:], part, points, world=True)
    first, second = read_usd_meshes(tmp_path / "over.usda")
    np.testing.assert_allclose(first.control.positions, cube().positions, atol=1e-6)
    np.testing.assert_allclose(second.control.positions, cube().positions + 1, atol=1e-6)


def test_new_points_over_a_mesh_have_none_of_its_normals(tmp_path: Path) -> None:
    with stage_at(tmp_path / "box.usda") as stage:
        mesh = usd_mesh(stage, "/A/m", cube())
        mesh.CreateNormalsAttr().Set([(0, 1, 0)] * 8, 1.0)
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "vertex").Set(
            [(0, 1, 0)] * 8
        )
    (read,) = read_usd_meshes(tmp_path / "box.usda")
    for name, results, kept in (
        ("moved", UsdResults(points=read.control.positions[:, ::-1]), False),
        ("same", UsdResults(attributes={"height": np.arange(8.0)}), True),
    ):
        write_usd_over(tmp_path / f"{name}.usda", tmp_path / "box.usda", [read.path], read.control, results)
        composed = Usd.Stage.Open(str(tmp_path / f"{name}.usda"))
        over = UsdGeom.Mesh(composed.GetPrimAtPath("/A/m"))
        assert over.GetNormalsAttr().HasValue() == kept
        assert UsdGeom.PrimvarsAPI(over).GetPrimvar("normals").HasValue() == kept
        assert complaints(tmp_path / f"{name}.usda") == []


def test_stand_ins_and_primvars_that_say_nothing_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with stage_at(tmp_path / "asset.usda") as stage:
        mesh = usd_mesh(stage, "/A/m", cube())
        for purpose in ("guide", "proxy"):
            UsdGeom.Imageable(usd_mesh(stage, f"/A/{purpose}", cube())).CreatePurposeAttr(purpose)
        UsdGeom.Imageable(UsdGeom.Xform.Define(stage, "/A/off")).MakeInvisible()
        usd_mesh(stage, "/A/off/hidden", cube())
        api, names = UsdGeom.PrimvarsAPI(mesh), Sdf.ValueTypeNames
        api.CreatePrimvar("empty", names.FloatArray, "vertex").Set([])
        api.CreatePrimvar("frames", names.Matrix4dArray, "vertex").Set([Gf.Matrix4d(1)] * 8)
        api.CreatePrimvar("height", names.FloatArray, "vertex").Set([1.0] * 8)
    (read,) = read_usd_meshes(tmp_path / "asset.usda")
    assert read.path == "/A/m"
    assert (
        "invisible meshes, previews and prototypes: /A/guide, /A/proxy, /A/off/hidden; make them visible, of"
        in caplog.text
    )
    assert list(read.attributes) == ["height"]


def test_subsets_that_overlap_are_parts_of_their_own(tmp_path: Path) -> None:
    with stage_at(tmp_path / "asset.usda") as stage:
        mesh = usd_mesh(stage, "/A/m", cube())
        for name, faces in (("one", [0, 5]), ("two", [5, 4]), ("three", [1])):
            UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", faces, "picked")
    whole = read_usd(tmp_path / "asset.usda")
    for name, faces in (("one", [0, 5]), ("group:two", [4, 5]), ("three", [1])):
        np.testing.assert_array_equal(find_part(whole, name).faces, faces)


def test_a_target_that_is_gone_has_no_units_and_that_is_said(folder: Path, tmp_path: Path) -> None:
    result = tmp_path / "R"
    shutil.copytree(folder / "R", result)
    np.savez(tmp_path / "side.npz", side=np.ones(creature().n_vertices))
    layer = tmp_path / "side.usda"
    request = TransferRequest(result, tmp_path / "out.npz", attribute=tmp_path / "side.npz", usd=layer)
    assert "units, up axis and transform are not known" in run_transfer(request, Stages())[0]
    _, warnings = run_wrap(WrapRequest((result,), tmp_path / "wrapped.usda"), Stages())
    assert any("units, up axis and transform are not known" in text for text in warnings)


def test_values_under_a_changed_name_take_no_other_primvars_place(tmp_path, capfd):
    mesh = full_cube()
    write_usd(tmp_path / "cube.usda", mesh, UsdResults(attributes={"fur_length": np.arange(8.0)}))
    given = {"fur length": -np.arange(8.0), mesh.uv_name or "st": np.zeros((8, 2))}
    write_usd_over(tmp_path / "over.usda", tmp_path / "cube.usda", ["/Asset/mesh"], mesh, UsdResults(attributes=given))
    assert capfd.readouterr().err == ""  # nor does USD look for what lies below in a wrong folder
    (read,) = read_usd_meshes(tmp_path / "over.usda")
    np.testing.assert_array_equal(read.attributes["fur_length"], np.arange(8))
    np.testing.assert_array_equal(read.attributes["fur_length_2"], -np.arange(8))
    np.testing.assert_allclose(read.control.uvs[read.control.uv_indices], mesh.uvs[mesh.uv_indices])  # type: ignore[index]


def test_a_constant_colour_of_the_material_s_own_inputs_is_read(tmp_path: Path) -> None:
    with stage_at(tmp_path / "cube.usda") as stage:
        mesh, (material, surface) = usd_mesh(stage, "/cube", cube()), define_material(stage, "/skin")
        stated = material.CreateInput("baseColor", Sdf.ValueTypeNames.Color3f)
        stated.Set((0.125, 0.25, 0.5))
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(stated)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    np.testing.assert_array_equal(read_usd(tmp_path / "cube.usda").material_colors, [[0.125, 0.25, 0.5]])


def test_curves_copies_and_values_of_as_many_faces_as_vertices_are_left_out_aloud(tmp_path, caplog):
    ring = torus()
    assert ring.n_faces == ring.n_vertices
    with stage_at(tmp_path / "ring.usda") as stage:
        mesh = usd_mesh(stage, "/copies/ring", ring)
        mesh.CreateDisplayColorPrimvar("uniform").Set([(1, 0, 0)] * ring.n_faces)
        UsdGeom.PointInstancer.Define(stage, "/copies").CreatePrototypesRel().SetTargets(["/copies/ring"])
        UsdGeom.BasisCurves.Define(stage, "/hair")
        UsdGeom.Sphere.Define(stage, "/control").CreatePurposeAttr("guide")
    (read,) = read_usd_meshes(tmp_path / "ring.usda")
    np.testing.assert_allclose(read.control.vertex_colors, np.tile([1.0, 0.0, 0.0], (40, 1)))
    assert not read.attributes
    said, *others = (one.getMessage() for one in caplog.records)
    assert "left out what is no mesh: /hair (BasisCurves), /copies (PointInstancer);" in said
    assert [one.partition("ring.usda: ")[2][:40] for one in others] == ["/copies/ring: primvar displayColor of fa"]


@pytest.mark.parametrize("orientation", ["leftHanded", "rightHanded"])
def test_values_of_vertices_stay_with_them_where_there_are_as_many_corners(orientation: str, tmp_path: Path) -> None:
    """Faces that share no vertex: numbers of rows do not say what is a vertex's, so those of corners become that."""
    corners = np.array([2, 0, 1, 5, 4, 3])
    with stage_at(tmp_path / "soup.usda") as stage:
        soup = ControlMesh(np.eye(3)[[0, 1, 2, 1, 0, 2]], np.array([0, 3, 6]), corners)
        mesh = usd_mesh(stage, "/m", soup)
        mesh.CreateOrientationAttr(orientation)
        for kind in ("vertex", "faceVarying"):
            primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(f"of_{kind}", Sdf.ValueTypeNames.FloatArray, kind)
            primvar.Set(list(map(float, range(6))))
    (read,) = read_usd_meshes(tmp_path / "soup.usda")
    np.testing.assert_array_equal(read.attributes["of_vertex"], np.arange(6))
    np.testing.assert_array_equal(read.attributes["of_faceVarying"][corners], np.arange(6))
    results = UsdResults(attributes={"back": read.attributes["of_vertex"]})
    write_usd_over(tmp_path / "over.usda", tmp_path / "soup.usda", ["/m"], read.control, results)
    (again,) = read_usd_meshes(tmp_path / "over.usda")
    np.testing.assert_array_equal(again.attributes["back"], np.arange(6))


def test_values_of_corners_that_would_be_taken_for_vertices_are_left_out(tmp_path, caplog):
    """As many vertices as corners, of which two share one and one is in no face."""
    with stage_at(tmp_path / "m.usda") as stage:
        corners = np.array([0, 1, 2, 2, 1, 3])
        mesh = usd_mesh(stage, "/m", ControlMesh(np.eye(3)[[0, 1, 2, 1, 0, 2]], np.array([0, 3, 6]), corners))
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "faceVarying")
        primvar.Set(list(map(float, range(6))))
    (read,) = read_usd_meshes(tmp_path / "m.usda")
    assert not read.attributes
    assert "primvar heat of corners is left out: there are as many vertices" in caplog.text


def test_a_part_has_the_uv_set_of_its_mesh_in_use(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The other mesh's set holds nothing for it."""
    places = cube().positions[:, :2]
    for name in ("st", "UVMap"):
        mesh = cube().with_uvs(places, cube().face_indices)
        write_usd(tmp_path / f"{name}.usda", replace(mesh, uv_name=name))
    with stage_at(tmp_path / "pair.usda") as stage:
        for name in ("st", "UVMap"):
            given = Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usda"))
            Sdf.CopySpec(given, "/Asset/mesh", stage.GetRootLayer(), f"/{name}_mesh")
    pair = read_usd(tmp_path / "pair.usda")
    assert "UV set" not in caplog.text, "no image is asked for"
    for name in ("st", "UVMap"):
        part = extract_faces(pair, find_part(pair, f"{name}_mesh").faces)
        assert part.uv_name == name
        assert part.has_layout
    request = MatchRequest(tmp_path / "st.usda", tmp_path / "pair.usda", tmp_path / "R", source_part="UVMap_mesh")
    assert not [note for note in read_inputs(request).notes if "uv-set" in note]
    (note,) = (note for note in read_inputs(replace(request, source_uv_set="st")).notes if "uv-set" in note)
    said = "--source-uv-set st: pair.usda: the part /UVMap_mesh has no texture coordinates there"
    assert note == f"{said}, UVMap is used"
    each = MatchRequest(tmp_path / "pair.usda", tmp_path / "pair.usda", tmp_path / "R", part="each", source_uv_set="st")
    assert f"{said}, no image is baked there: match it alone" in read_inputs(each).notes
    write_result(tmp_path / "R", identity_result(1, (pair, pair)))
    bake = TransferRequest(tmp_path / "R", tmp_path / "o.png", bake=("ao",), rays=1, size=8)
    said = "6 faces of pair.usda (/UVMap_mesh) have no texture coordinates in its UV set st, so that no image is baked"
    assert any(said in text for text in run_transfer(bake, Stages())[1])
    wrap = WrapRequest((tmp_path / "R",), tmp_path / "w.obj", normal_map=tmp_path / "n.png", size=8)
    assert any(said in text for text in run_wrap(wrap, Stages())[1])


def test_large_whole_numbers_are_written_unchanged(tmp_path: Path) -> None:
    ids = {
        "int64": 2**40 + np.arange(8),
        "uint32": np.arange(2**32 - 8, 2**32, dtype=np.uint32),
        "uint64": np.arange(8, dtype=np.uint64) + np.uint64(2**63),
    }
    write_usd(tmp_path / "cube.usda", cube(), UsdResults(attributes=ids))
    (read,) = read_usd_meshes(tmp_path / "cube.usda")
    for name, values in ids.items():
        np.testing.assert_array_equal(read.attributes[name], values)


def test_creasing_that_usd_has_no_word_for_is_left_out_aloud(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for creasing in ("uniform", "chaikin"):
        scheme = CatmullClark(creasing=creasing)
        assert not caplog.text
        write_usd(tmp_path / f"{creasing}.usda", replace(cube(), scheme=scheme))
    assert "creasing chaikin has no place in USD" in caplog.text


@pytest.mark.parametrize(("scale", "said"), [((-2, 2, 2), "mirrors"), ((1, 1, 3), "distorts"), ((-2, -2, 2), "")])
def test_a_transform_that_changes_the_shape_of_an_only_mesh_is_said(scale, said, tmp_path, caplog):
    with stage_at(tmp_path / "scaled.usda") as stage:
        UsdGeom.Xform.Define(stage, "/x").AddScaleOp().Set(scale)
        usd_mesh(stage, "/x/box", cube())
    np.testing.assert_allclose(read_usd(tmp_path / "scaled.usda").positions, cube().positions)
    assert (f"scaled.usda: the transform of /x/box {said} it, but the points are taken" in caplog.text) == bool(said)


def test_a_mirrored_mesh_is_shown_upright(tmp_path: Path) -> None:
    """Local x points up in the world, along Z; it stays up although it is the mirrored axis."""
    with stage_at(tmp_path / "mirrored.usda") as stage:
        UsdGeom.SetStageUpAxis(stage, "Z")
        mesh = usd_mesh(stage, "/mesh", cube())
        mesh.AddRotateYOp().Set(90.0)
        mesh.AddScaleOp().Set((-1.0, 2.0, 3.0))
    turn = read_usd(tmp_path / "mirrored.usda").upright
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)
    np.testing.assert_allclose([1, 0, 0] @ turn, [0, 1, 0], atol=1e-12)


def test_several_meshes_are_upright_as_their_world(tmp_path: Path) -> None:
    """A transform of a mesh is in its points; what is stored knows the up axis too."""
    with stage_at(tmp_path / "two.usda") as stage:
        UsdGeom.SetStageUpAxis(stage, "Z")
        usd_mesh(stage, "/one", cube()).AddRotateYOp().Set(90.0)
        usd_mesh(stage, "/two", cube())
    whole = read_usd(tmp_path / "two.usda")
    arrays = control_to_arrays(extract_faces(whole, np.arange(6)), "")
    stored = control_from_arrays(Archive(tmp_path, arrays, ""), "", (), "one")
    for mesh in (whole, stored):
        np.testing.assert_array_equal([0, 0, 1] @ mesh.upright, [0, 1, 0])


def test_groups_come_back_by_the_names_that_were_written(tmp_path: Path) -> None:
    """`arm.L` is no name of a prim; a name with blanks would be two groups."""
    mesh = replace(cube(), face_groups=np.array([0, 0, 1, 1, 1, 1]), group_names=("arm.L", "leg"))
    write_usd(tmp_path / "box.usda", mesh)
    assert read_usd(tmp_path / "box.usda").group_names == ("arm.L", "leg")
    stage = Usd.Stage.Open(str(tmp_path / "box.usda"))
    stage.GetPrimAtPath("/Asset/mesh/leg").SetDisplayName("left leg")
    stage.GetRootLayer().Save()
    assert read_usd(tmp_path / "box.usda").group_names == ("arm.L", "leg")


def test_subsets_of_faces_that_are_not_there_are_left_out_aloud(tmp_path, caplog):
    with stage_at(tmp_path / "asset.usda") as stage:
        mesh = usd_mesh(stage, "/A/m", cube())
        UsdGeom.Subset.CreateGeomSubset(mesh, "one", "face", [0, 5], "picked")
        UsdGeom.Subset.CreateGeomSubset(mesh, "far", "face", [1, 6], "picked")
    assert read_usd(tmp_path / "asset.usda").group_names == ("one", "")
    (said,) = caplog.messages
    assert "/A/m: subset far is left out: expected faces from 0 to 5, got 1 to 6" in said
