"""USD characters as glTF documents: what cagemap wrote, and files of other programs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.poses import pose_at
from cagemap.character.values import skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.character import animation_names, character_of
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character, usd_document
from cagemap.files.usd.read import place_in_world, read_usd_meshes
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.mesh.faces import reversed_corners
from cagemap.numerics.arrays import encode_srgb
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from refusals import refuses
from usd_characters import lively, painted, posed, shape_keys, with_shape_track
from usd_scenes import skinned_points, stage_at, usd_mesh


def test_a_written_character_comes_back(tmp_path: Path) -> None:
    """Names, rest pose, weights, shapes, all animations and their weights of shapes."""
    weights = np.array([[0.0, 0.0], [1.0, 0.25], [0.5, 1.0]])
    made = with_shape_track(lively(), "walk | fast", weights)
    write_usd_character(tmp_path / "C.usdz", made, read_scene(character_glb(made)))
    given, direct = document_and_character(tmp_path / "C.usdz")
    assert [track.part for track in direct.animations[0].shape_tracks] == ["body"]  # others have no such shapes
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
    keys = shape_keys(given, 0)
    for place, shape in enumerate(("raise", "wide")):
        times, values, _ = keys["body", shape]
        np.testing.assert_allclose(times, [0, 1, 2], atol=1e-6)
        np.testing.assert_allclose(values[:, 0], weights[:, place], atol=1e-6)


def test_static_weights_of_a_clip_stay_in_it(tmp_path: Path) -> None:
    """Also of a clip without motion; only those of a file's one clip are at rest."""
    made = with_shape_track(lively(), "walk | fast", np.array([[1, 0.5]]))
    walk, steps, _ = made.animations
    made = replace(made, animations=(replace(walk, tracks=()), steps))
    write_usd_character(tmp_path / "C.usda", made, read_scene(character_glb(made)))
    found = usd_document(tmp_path / "C.usda")
    keys = {name: shape_keys(found, number) for number, name in enumerate(animation_names(found))}
    assert {name: values.item() for (_, name), (_, values, _) in keys[walk.name].items()} == {"raise": 1.0, "wide": 0.5}
    assert keys[steps.name] == shape_keys(found, None) == {}


@pytest.mark.parametrize("is_animated", [False, True])
def test_weights_at_rest_that_all_clips_have_come_back(tmp_path: Path, is_animated: bool) -> None:
    """One shape is at 0.5 throughout; a clip moves the other one, or none does."""
    made = lively()
    walk = made.animations[0].name
    if is_animated:
        made = with_shape_track(made, walk, np.array([[0.5, 0.0], [0.5, 1.0], [0.5, 0.0]]))
    body = replace(made.parts[0], shape_weights={"raise": 0.5, "wide": 0.0})
    made = replace(made, parts=(body, *made.parts[1:]))
    document = character_glb(made)
    write_usd_character(tmp_path / "C.usda", made, read_scene(document))
    found = usd_document(tmp_path / "C.usda")
    assert animation_names(found) == animation_names(document)
    for number in (None, *range(len(made.animations))):
        keys = shape_keys(found, number)
        assert set(np.ravel(keys["body", "raise"][1])) == {0.5}
        assert (("body", "wide") in keys) == (is_animated and number == 0)
    moving = [
        one["name"]
        for one in found.json["animations"]
        if any(c["target"]["path"] == "weights" for c in one["channels"])
    ]
    assert moving == ([walk] if is_animated else [])


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


def test_several_skeletons_are_refused(painted_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with stage_at(painted_path) as stage:
        other = UsdSkel.Skeleton.Define(stage, "/Asset/other")
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/hat")).GetSkeletonRel().SetTargets([other.GetPath()])
    refuses(FormatError, "expected one skeleton, got /Asset/skeleton, /Asset/other", usd_document, painted_path)
    run_check(CheckRequest((painted_path,)), Stages())
    assert "no character for `cagemap rig`" in caplog.text


@pytest.mark.parametrize("rate", [23.976, 24000 / 1001, 29.97, 48.0, 50.0])
def test_frames_of_film_and_television_come_back(painted_path: Path, tmp_path: Path, rate: float) -> None:
    stage, frames = Usd.Stage.Open(str(painted_path)), [1001.0, 1002.0, 1040.0]
    stage.RemovePrim("/Asset/animations")
    stage.SetTimeCodesPerSecond(rate)
    walk = UsdSkel.Animation.Define(stage, "/Asset/walk")
    walk.CreateJointsAttr(UsdSkel.Skeleton(stage.GetPrimAtPath("/Asset/skeleton")).GetJointsAttr().Get()[:1])
    for frame in frames:
        walk.CreateTranslationsAttr().Set([(0.0, frame, 0.0)], frame)
    stage.GetRootLayer().Save()
    document, character = document_and_character(painted_path)
    write_usd_character(tmp_path / "again.usda", character, read_scene(document))
    again = Usd.Stage.Open(str(tmp_path / "again.usda"))
    assert again.GetTimeCodesPerSecond() == pytest.approx(rate, rel=1e-4)
    (walk,) = (UsdSkel.Animation(prim) for prim in again.Traverse() if prim.IsA(UsdSkel.Animation))
    assert walk.GetTranslationsAttr().GetTimeSamples() == frames


@pytest.mark.parametrize("still", [False, True])
@pytest.mark.parametrize("what", ["points", "visibility", "above", "suffix", "skeleton"])
def test_motion_that_is_no_joint_s_is_named(
    painted_path: Path, caplog: pytest.LogCaptureFixture, what: str, still: bool
) -> None:
    """Transforms with a suffix too; several equal samples, as exporters bake them, are no motion."""
    with stage_at(painted_path) as stage:
        hat = UsdGeom.Mesh(stage.GetPrimAtPath("/Asset/hat"))
        moves = {"points": hat.GetPointsAttr(), "visibility": hat.CreateVisibilityAttr()}
        above = {"above": "/Asset", "suffix": "/Asset", "skeleton": "/Asset/skeleton"}
        if what in above:
            placed = UsdGeom.Xformable(stage.GetPrimAtPath(above[what]))
            moves[what] = placed.AddTranslateOp(opSuffix="anim" if what == "suffix" else "").GetAttr()
        points = np.array(hat.GetPointsAttr().Get())
        for frame in (0.0, 0.0 if still else 5.0):
            values = {"points": points + frame, "visibility": "invisible" if frame else "inherited"}
            moves[what].Set(values.get(what, (frame, 0.0, 0.0)), frame)
        if still:
            moves[what].Set(moves[what].Get(0.0), 5.0)
    usd_document(painted_path)
    both = "/Asset/body, /Asset/hat"
    named = {"above": both, "suffix": both, "skeleton": "/Asset/skeleton"}.get(what, "/Asset/hat")
    assert (f"the animation of {named}" in caplog.text) != still
    assert ("is left out" in caplog.text) != still


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
