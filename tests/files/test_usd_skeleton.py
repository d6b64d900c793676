"""UsdSkel skeletons in and out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.character.joints import Skeleton
from cagemap.errors import FormatError, ParameterError
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import file_hash
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.rigs import read_shapes, read_skeleton, write_skeleton
from cagemap.mesh.parts import extract_faces
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages, logged_warnings
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result, textured_cube

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdGeom, UsdSkel
from usd_rigs import cube_skeleton, write_rigged

from cagemap.files.usd.prims import transform_points
from cagemap.files.usd.read import UsdMesh, read_usd_meshes
from cagemap.files.usd.results import bind_textures
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.transforms import local_to_world
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over
from cagemap.files.usd.write_mesh import write_primvar

from refusals import refuses
from usd_scenes import complaints, skinned_points, stage_at, usd_mesh


def _at_rest(path: Path, prim_path: str) -> np.ndarray:
    """What USD's own skinning makes of the points of a mesh, in world space, with every joint where it was bound."""
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath(prim_path)
    to_world = local_to_world(UsdSkel.BindingAPI(prim).GetInheritedSkeleton().GetPrim())
    return transform_points(skinned_points(prim, Usd.TimeCode.Default()), to_world)


def test_a_skeleton_comes_back_from_usd_and_skins_to_rest(tmp_path: Path) -> None:
    path = tmp_path / "rigged.usda"
    write_rigged(path, "rigged.usda")
    assert complaints(path) == []
    found, given = read_usd_skeleton(path), cube_skeleton()
    order = [found.names.index(name) for name in given.names]
    assert [found.parents[k] for k in order] == list(given.parents)
    np.testing.assert_allclose(found.heads[order], given.heads, atol=1e-6)
    np.testing.assert_allclose(found.axes[order], given.axes, atol=1e-6)
    # Columns of weights follow the skeleton's own order.
    weights = np.random.default_rng(3).random((8, 4))
    table = read_attributes(path)["skel:jointWeights"]
    np.testing.assert_allclose(table[:, order], weights / weights.sum(axis=1, keepdims=True), atol=1e-6)
    mesh = read_usd_meshes(path)[0]
    np.testing.assert_allclose(_at_rest(path, "/Asset/mesh"), mesh.control.positions, atol=1e-6)
    np.testing.assert_allclose(read_shapes([path], mesh.control)["smile"][2], [0, 0, 1], atol=1e-6)
    write_skeleton(tmp_path / "rig.json", found)
    again = read_skeleton(tmp_path / "rig.json")
    np.testing.assert_array_equal(again.axes, found.axes)
    assert again.names == found.names


def test_vertices_without_weights_stay_and_all_joints_are_kept(tmp_path: Path) -> None:
    names = tuple(f"joint{number}" for number in range(9))
    heads = np.arange(27.0).reshape(9, 3)
    skeleton = Skeleton(names, ("", *names[:-1]), heads, heads + 1.0)
    weights = np.ones((8, 9)) / 9.0
    weights[5:] = 0.0
    cube = textured_cube("c", 1.0)
    write_usd(tmp_path / "c.usda", cube, UsdResults(attributes={"skel:jointWeights": weights}, skeleton=skeleton))
    np.testing.assert_allclose(_at_rest(tmp_path / "c.usda", "/Asset/mesh"), cube.positions, atol=1e-5)
    (read,) = read_usd_meshes(tmp_path / "c.usda")
    np.testing.assert_allclose(read.attributes["skel:jointWeights"][:5], weights[:5], atol=1e-6)


def test_a_topmost_mesh_stays_a_mesh(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It cannot be the SkelRoot that it needs above it."""
    with stage_at(tmp_path / "cube.usda") as stage:
        usd_mesh(stage, "/cube", textured_cube("c", 1.0))
    (mesh,) = read_usd_meshes(tmp_path / "cube.usda")
    results = UsdResults(attributes={"skel:jointWeights": np.full((8, 4), 0.25)}, skeleton=cube_skeleton())
    write_usd_over(tmp_path / "over.usda", tmp_path / "cube.usda", [mesh.path], mesh.control, results)
    (read,) = read_usd_meshes(tmp_path / "over.usda")
    np.testing.assert_allclose(read.attributes["skel:jointWeights"], 0.25)
    assert "/cube is the topmost prim" in caplog.text


def test_the_parent_of_a_joint_is_its_nearest_listed_ancestor(tmp_path: Path) -> None:
    """A Blender export of deform bones alone leaves out joints in the middle of paths."""
    path = tmp_path / "deform.usda"
    write_rigged(path, "deform.usda")
    with stage_at(path) as stage:
        skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton"))
        order = list(skeleton.GetJointsAttr().Get())
        paths = {"hips": "hips", "chest": "hips/control/chest", "left": "hips/control/chest/aim/left"}
        paths["right"] = "hips/control/chest/aim/right"
        joints = [paths[joint.rpartition("/")[2]] for joint in order]
        skeleton.GetJointsAttr().Set(joints)
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh")).GetJointsAttr().Clear()
    found, given = read_usd_skeleton(path), cube_skeleton()
    parents = dict(zip(found.names, found.parents, strict=True))
    assert parents == dict(zip(given.names, given.parents, strict=True))
    tails = dict(zip(found.names, found.tails.tolist(), strict=True))
    np.testing.assert_allclose(tails["chest"], [0, 0.9, 0], atol=1e-6)  # between its children
    np.testing.assert_allclose(tails["hips"], [0, 0.5, 0], atol=1e-6)


def test_a_mesh_without_a_skeleton_and_a_damaged_one(tmp_path: Path) -> None:
    write_usd(tmp_path / "bare.usda", textured_cube("bare.usda"))
    assert read_usd_skeleton(tmp_path / "bare.usda") is None
    refuses(FormatError, "bound to none", read_skeleton, tmp_path / "bare.usda")
    path = tmp_path / "rigged.usda"
    write_rigged(path, "rigged.usda")
    stage = Usd.Stage.Open(str(path))
    UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton")).GetBindTransformsAttr().Set([Gf.Matrix4d(1.0)] * 3)
    stage.Save()
    refuses(FormatError, "got 4 joints and 3 transforms", read_usd_skeleton, path)
    UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton")).GetJointsAttr().Set(["hips"])
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh")).GetJointsAttr().Clear()
    stage.Save()
    refuses(FormatError, "of 1, or joints that the skeleton has not", read_usd_meshes, path)


def test_joints_without_an_identifier_of_their_own_stay_apart(tmp_path: Path) -> None:
    skeleton = replace(cube_skeleton(), names=("胸", "腰", "左手", "右手"), parents=("腰", "", "胸", "胸"))
    weights = np.eye(4)[np.arange(8) % 4]
    write_usd(
        tmp_path / "rig.usda",
        textured_cube("rig.usda", 1.0),
        UsdResults(attributes={"skel:jointWeights": weights}, skeleton=skeleton),
    )
    found = read_usd_skeleton(tmp_path / "rig.usda")
    assert len(set(found.names)) == 4
    table = read_attributes(tmp_path / "rig.usda")["skel:jointWeights"]
    heads = table @ found.heads
    np.testing.assert_allclose(heads, weights @ skeleton.heads, atol=1e-6)


def test_weights_arrive_with_their_skeleton(folder: Path) -> None:
    request = TransferRequest(
        folder / "RESULT", folder / "weights.npz", weights=folder / "small.usda", usd=folder / "rig.usda"
    )
    run_transfer(request, Stages())
    assert complaints(folder / "rig.usda") == []
    own = read_usd_skeleton(folder / "rig.usda")
    given = read_usd_skeleton(folder / "small.usda")
    assert own.names == given.names
    assert own.parents == given.parents
    # The target is the source twice as large: so is its rig, in the mesh's own space, wherever the mesh stands.
    np.testing.assert_allclose(own.heads, 2 * given.heads, atol=1e-5)
    np.testing.assert_allclose(own.axes, given.axes, atol=1e-5)
    mesh = read_usd_meshes(folder / "rig.usda")[0]
    np.testing.assert_allclose(
        mesh.attributes["skel:jointWeights"], read_attributes(folder / "small.usda")["skel:jointWeights"], atol=1e-5
    )
    np.testing.assert_allclose(
        _at_rest(folder / "rig.usda", mesh.path), transform_points(mesh.control.positions, mesh.to_world), atol=1e-5
    )
    joints = TransferRequest(folder / "RESULT", folder / "rig.json", joints=folder / "small.usda")
    run_transfer(joints, Stages())
    np.testing.assert_allclose(read_skeleton(folder / "rig.json").heads, 2 * given.heads, atol=1e-5)
    shapes = TransferRequest(
        folder / "RESULT", folder / "shapes.npz", blend_shapes=(folder / "small.usda",), usd=folder / "shaped.usda"
    )
    run_transfer(shapes, Stages())
    carried = read_usd_meshes(folder / "shaped.usda")[0].attributes["blendShape:smile"]
    np.testing.assert_allclose(carried[2], [0, 0, 2], atol=1e-5)
    assert complaints(folder / "shaped.usda") == []


def test_values_of_a_rigged_file_are_its_primvars(folder: Path) -> None:
    """Weights and shapes as plain values would be in the source's units, and replace those of `--blend-shapes`."""
    source, layer = folder / "small.usda", folder / "rig.usda"
    shapes = TransferRequest(folder / "RESULT", folder / "shapes.npz", blend_shapes=(source,), usd=layer)
    values = TransferRequest(folder / "RESULT", folder / "values.npz", attribute=source, usd=layer)
    run_transfer(shapes, Stages())
    says = "expected primvars of vertices, faces or face corners, got skel:jointWeights, blendShape:smile. Give"
    refuses(ParameterError, says, run_transfer, values, Stages())
    with stage_at(source) as stage:
        write_primvar(stage.GetPrimAtPath("/Asset/mesh"), textured_cube("small", 1.0), "fur", np.arange(8.0))
    summary, notes = run_transfer(values, Stages())
    assert "fur (8,)" in summary
    assert ["left out skel:jointWeights, blendShape:smile" in note for note in notes] == [True]
    found = read_usd_meshes(layer)[0].attributes
    np.testing.assert_array_equal(found["fur"], np.arange(8.0))
    np.testing.assert_allclose(found["blendShape:smile"][2], [0, 0, 2], atol=1e-5)


@pytest.mark.parametrize(
    ("level", "output", "textured"),
    [(0, "cube.usda", True), (1, "cube.usda", False), (0, "cube.glb", True), (0, "cube.obj", False)],
)
def test_what_a_refined_mesh_lacks_of_its_file_is_named(
    tmp_path: Path, level: int, output: str, textured: bool
) -> None:
    """Once, without images of materials that no mesh has, and without a second message about the file."""
    file = tmp_path / "small.usda"
    write_rigged(file, "small.usda")
    with stage_at(file) as stage:
        prim = stage.GetPrimAtPath("/Asset/mesh")
        write_primvar(prim, textured_cube("small", 1.0), "fur", np.arange(8.0))
        UsdGeom.Mesh.Define(stage, "/Asset/empty").MakeInvisible()
        bind_textures(stage, prim if textured else stage.GetPrimAtPath("/Asset/empty"), {"color": "./skin.png"}, "st")
        move = UsdSkel.Animation.Define(stage, "/Asset/move").CreateTranslationsAttr()
        for frame in (1.0, 2.0):
            move.Set([(frame, 0.0, 0.0)], frame)
    request = RefineRequest(mesh=file, output=tmp_path / output, level=level, scheme="bilinear")
    with logged_warnings() as logged:
        notes = run_refine(request, Stages())[1]
    held = "fur, skinning weights, blend shapes, skeleton, animations"
    assert notes == [f"{output}: left out of small.usda: {held}{', images of materials' * textured}"]
    assert sum("/Asset/empty" in text for text in logged) == 1
    again = RefineRequest(mesh=tmp_path / "cube.usda", output=tmp_path / "again.usda", level=1, scheme="bilinear")
    assert output != "cube.usda" or run_refine(again, Stages())[1] == []


@pytest.mark.parametrize("factor", [0.01, 1.0, 100.0])
def test_joints_in_other_units_than_the_source_are_reported(folder: Path, factor: float) -> None:
    skeleton = read_usd_skeleton(folder / "small.usda")
    scaled = replace(skeleton, heads=factor * skeleton.heads, tails=factor * skeleton.tails)
    write_skeleton(folder / "unitless.json", scaled)
    request = TransferRequest(folder / "RESULT", folder / "rig.json", joints=folder / "unitless.json")
    _, warnings = run_transfer(request, Stages())
    assert any("check that both have the same units and place" in text for text in warnings) == (factor != 1.0)


@pytest.mark.parametrize("output", ["table.csv", "arrays.npz"])
def test_tables_of_weights_name_their_columns_by_joints(folder: Path, output: str) -> None:
    run_transfer(TransferRequest(folder / "RESULT", folder / output, weights=folder / "small.usda"), Stages())
    found, table = read_attributes(folder / output), read_attributes(folder / "small.usda")["skel:jointWeights"]
    skeleton = read_usd_skeleton(folder / "small.usda")
    assert set(found) == {"chest", "hips", "left", "right"}
    for name, column in zip(skeleton.names, table.T, strict=True):
        np.testing.assert_allclose(found[name], column, atol=1e-5)
    # What was written is taken again, also with the joints that its columns are named after.
    write_skeleton(folder / "names.json", skeleton, force=True)
    again = folder / f"again_{output}"
    run_transfer(
        TransferRequest(folder / "RESULT", again, weights=folder / output, joints=folder / "names.json"), Stages()
    )
    assert list(read_attributes(again)) == list(found)


def test_joints_of_a_whole_body_are_right_for_its_part(folder: Path) -> None:
    controls = [textured_cube("large.usda", 2.0), textured_cube("small.usda")]
    target, source = (extract_faces(control, np.arange(5)) for control in controls)
    write_result(folder / "RESULT", identity_result(1, (target, source)), force=True)
    skeleton = replace(cube_skeleton(), heads=cube_skeleton().heads - 4.0)
    write_skeleton(folder / "rig.json", skeleton)
    _, warnings = run_transfer(
        TransferRequest(folder / "RESULT", folder / "o.json", joints=folder / "rig.json"), Stages()
    )
    assert not [text for text in warnings if "same units and place" in text]


@pytest.mark.parametrize(("given", "offset", "factor"), [("gone.obj", 0.0, 100.0), ("small.obj", -4.0, 1.0)])
def test_joints_far_from_a_welded_body_are_reported(given: str, offset: float, factor: float, tmp_path: Path) -> None:
    """By their size if the body's file is gone, else by their distance too."""
    write_mesh(tmp_path / "small.obj", textured_cube("small.obj"))
    welded = extract_faces(textured_cube(given), np.arange(6))
    result = identity_result(1, (textured_cube("large.obj", 2.0), welded))
    inputs = {"source": {"file": given, "path": f"../{given}", "sha256": file_hash(tmp_path / "small.obj")}}
    write_result(tmp_path / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    skeleton = cube_skeleton()
    ends = {name: factor * getattr(skeleton, name) + offset for name in ("heads", "tails")}
    write_skeleton(tmp_path / "rig.json", replace(skeleton, **ends))
    request = TransferRequest(tmp_path / "R", tmp_path / "o.json", joints=tmp_path / "rig.json")
    assert any("same units and place" in text for text in run_transfer(request, Stages())[1])


def test_weights_are_read_with_their_joints_without_the_source_s_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[str] = []

    def read(path: str | Path) -> tuple[UsdMesh, ...]:
        reads.append(Path(path).name)
        return read_usd_meshes(path)

    for module in ("values.attributes", "usd.skeleton", "usd.space"):
        monkeypatch.setattr(f"cagemap.files.{module}.read_usd_meshes", read)
    request = TransferRequest(folder / "RESULT", folder / "weights.npz", weights=folder / "small.usda")
    run_transfer(request, Stages())
    assert reads.count("small.usda") <= 2
