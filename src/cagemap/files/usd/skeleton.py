"""Skeletons and animations in USD: `UsdSkel` joints, `SkelAnimation` prims with joints and weights of blend shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.joints import Skeleton, tails_of
from cagemap.character.poses import interpolate_keys, parent_transforms, rest_tracks, rotations_of
from cagemap.character.values import Animation, Interpolation, Part, Rig, Track
from cagemap.errors import FormatError
from cagemap.files.usd.prims import bind_transform, index_array, transform_points
from cagemap.files.usd.read import one_mesh, read_usd_meshes
from cagemap.files.usd.stages import damage_as_error, identifiers, open_stage, pxr
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray, IndexArray


def read_usd_skeleton(path: str | Path, control: ControlMesh | None = None) -> Skeleton | None:
    """The skeleton of a mesh in a USD file in its bind pose, in the space of `read_usd`; None without one.

    Tails of joints are at their children.

    ``control``: the mesh; needed if the file has several.
    """
    meshes = read_usd_meshes(path)
    chosen = one_mesh(path, meshes, control)
    stage = open_stage(path)
    prim = stage.GetPrimAtPath(chosen.path)
    skeleton = pxr.UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
    if not skeleton:
        return None
    where = f"{path}: {skeleton.GetPath()}"
    with damage_as_error(path):
        joints, binds = joints_of(path, skeleton)
        bound_at = bind_transform(prim)
    if not np.isfinite(bound_at).all() or abs(np.linalg.det(bound_at)) < 1e-12:
        raise FormatError(f"{where}: the mesh's bind transform has no inverse. Export the skeleton again.")
    placed = binds @ np.linalg.inv(bound_at) @ (chosen.to_world if len(meshes) > 1 else np.eye(4))
    names, parents, heads = joint_names(joints), joint_parents(joints), placed[:, 3, :3]
    above = tuple(names[parent] if parent >= 0 else "" for parent in parents)
    return Skeleton(tuple(names), above, heads, tails_of(heads, parents), placed[:, :3, :3])


def joints_of(path: str | Path, skeleton: Any) -> tuple[list[str], FloatArray]:
    """Joints of a skeleton and their bind transforms (j, 4, 4)."""
    joints = [str(joint) for joint in skeleton.GetJointsAttr().Get() or []]
    binds = np.array(skeleton.GetBindTransformsAttr().Get() or [], dtype=np.float64).reshape(-1, 4, 4)
    if not joints or len(binds) != len(joints) or len(set(joints)) != len(joints) or not np.isfinite(binds).all():
        raise FormatError(
            f"{path}: {skeleton.GetPath()}: expected joints of different names with a finite bind transform each, got "
            f"{len(joints)} joints and {len(binds)} transforms. Export the skeleton again."
        )
    return joints, binds


def joint_names(joints: list[str]) -> list[str]:
    """Names of joints: the last parts of their paths, if these are unique."""
    leaves = [path.rpartition("/")[2] for path in joints]
    return leaves if len(set(leaves)) == len(leaves) else joints


def joint_parents(joints: list[str]) -> IndexArray:
    """(j,) number of each joint's parent, its nearest listed ancestor in UsdSkel; -1 for a root."""
    return index_array(pxr.UsdSkel.Topology(joints).GetParentIndices())


def write_usd_skeleton(stage: Any, prim: Any, skeleton: Skeleton, to_root: FloatArray) -> None:
    """Define a skeleton in the `SkelRoot` of a mesh and bind the mesh to it; its joints are in the order of weights.

    ``skeleton``: in the mesh's local space.
    ``to_root``: (4, 4), from that space to the space of the topmost prim.
    """
    top = prim.GetPath().GetPrefixes()[0]
    paths = joint_paths(skeleton.names, skeleton.parents)
    order = sorted(range(len(paths)), key=lambda joint: (paths[joint].count("/"), joint))
    axes = np.eye(3) if skeleton.axes is None else skeleton.axes
    binds = np.tile(np.eye(4), (len(paths), 1, 1))
    binds[:, :3, :3] = rotations_of(np.broadcast_to(axes @ to_root[:3, :3], (len(paths), 3, 3)))
    binds[:, 3, :3] = transform_points(skeleton.heads, to_root)
    binds = binds[order]
    path = top.AppendChild("skeleton")
    if stage.GetPrimAtPath(path):  # a skeleton of the asset, which is not changed
        path = top.AppendChild("cagemap_skeleton")
    in_order = [paths[joint] for joint in order]
    define_skeleton(stage, path, in_order, binds, parent_transforms(binds, joint_parents(in_order)))
    binding = pxr.UsdSkel.BindingAPI.Apply(prim)
    binding.CreateSkeletonRel().SetTargets([path])
    binding.CreateJointsAttr(paths)
    binding.CreateGeomBindTransformAttr(pxr.Gf.Matrix4d(*to_root.ravel().tolist()))


def define_skeleton(stage: Any, path: Any, joints: Sequence[str], binds: FloatArray, rests: FloatArray) -> Any:
    """Define a skeleton of joints, given by their paths, parents before children.

    ``binds``, ``rests``: (j, 4, 4), from a joint's space to the skeleton's, and to its parent's at rest.
    """
    skeleton = pxr.UsdSkel.Skeleton.Define(stage, path)
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr(_matrices(binds))
    skeleton.CreateRestTransformsAttr(_matrices(rests))
    return skeleton


def joint_paths(names: Sequence[str], parents: Sequence[str]) -> list[str]:
    """Paths of joints in UsdSkel, from their names and the names of their parents ('' for a root)."""
    number = {name: joint for joint, name in enumerate(names)}
    words: dict[int, str] = {}
    for parent in dict.fromkeys(parents):
        siblings = [joint for joint, above in enumerate(parents) if above == parent]
        words |= zip(siblings, identifiers(names[joint].rpartition("/")[2] for joint in siblings), strict=True)

    def path(joint: int) -> str:
        parts = [words[joint]]
        seen = {joint}
        while parents[joint]:
            joint = number[parents[joint]]
            if joint in seen:
                raise FormatError(f"skeleton: joint {names[joint]} is its own parent. Repair the hierarchy.")
            seen.add(joint)
            parts.append(words[joint])
        return "/".join(reversed(parts))

    return [path(joint) for joint in range(len(names))]


def _matrices(values: FloatArray) -> Any:
    return pxr.Vt.Matrix4dArray([pxr.Gf.Matrix4d(*value.ravel().tolist()) for value in values])


# Whole frames at one of these rates, if all keys are; otherwise at the last one.
_RATES = (24, 25, 30, 24000 / 1001, 23.976, 30000 / 1001, 29.97, 48, 50, 60)
# Frames: times that differ less from a frame are rounded to it, since glTF stores them in single precision.
_FRAME_ROUNDING = 2e-4
# Frames before the next key at which a stepped value is written once more, since USD interpolates.
_STEP = 1e-3
# Times (k,), values (k, q) or (k, 3, q), and interpolation, as in `Track`.
_Keys = tuple[FloatArray, FloatArray, Interpolation]
# Keys of a blend shape whose weight is 0.
_REST: _Keys = np.zeros(1), np.zeros((1, 1)), "LINEAR"
SKELETON, _ANIMATIONS = "/Asset/skeleton", "/Asset/animations"


def write_rig(stage: Any, rig: Rig, animations: Sequence[Animation], parts: Sequence[Part]) -> list[str]:
    """Write a skeleton and its animations, with the first one bound; returns notes.

    Joints have no scale in the bind pose. Splines are sampled at every frame.
    """
    rig, animations = remove_scale(rig, animations)
    paths = joint_paths(rig.names, [rig.names[parent] if parent >= 0 else "" for parent in rig.parents])
    skeleton = define_skeleton(stage, SKELETON, paths, rig.bind, rig.local)
    skeleton.CreateJointNamesAttr(rig.names)
    notes = []
    clips: dict[str, tuple[tuple[Track, ...], dict[str, _Keys]]] = {}
    for animation in animations or [Animation("rest", ())]:
        name, weights = animation.name, dict[str, _Keys]()
        keys_of = [_shape_keys(part, animation) for part in parts]
        for shape, keys in (item for keys_of_part in keys_of for item in keys_of_part.items()):
            weights.setdefault(shape, keys)  # the first part with a shape decides
        others = [
            f"{shape} of {part.name}"
            for part, keys_of_part in zip(parts, keys_of, strict=True)
            for shape in part.shapes
            if shape in weights and not _same_keys(keys_of_part.get(shape, _REST), weights[shape])
        ]
        if others:
            text = f"other parts decide the weights of {first_few(others)}"
            notes.append(f"{name}: {text}, since USD has one weight for shapes of one name")
        if animation.tracks or weights:
            clips[name] = animation.tracks, weights
    if not clips:
        return notes
    times = np.concatenate(
        [
            *(track.times for tracks_of, _ in clips.values() for track in tracks_of),
            *(keys[0] for _, weights in clips.values() for keys in weights.values()),
        ]
    )
    rates = (rate for rate in _RATES if np.array_equal(frames := _frames(times, rate), np.rint(frames)))
    rate = next(rates, _RATES[-1])
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(float(_frames(times, rate).min()))
    stage.SetEndTimeCode(float(_frames(times, rate).max()))
    labels = identifiers(clips)
    pxr.UsdGeom.Scope.Define(stage, _ANIMATIONS)
    for label, name in zip(labels, clips, strict=True):
        prim = _write_animation(stage, f"{_ANIMATIONS}/{label}", rig, paths, *clips[name], rate)
        prim.SetDisplayName(name)
    pxr.UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(
        [f"{_ANIMATIONS}/{labels[0]}"]
    )
    if len(clips) > 1:
        first, *others = clips
        notes.append(f"USD plays one animation, {first}; bind {first_few(others)} in {_ANIMATIONS} to play them")
    return notes


def _shape_keys(part: Part, animation: Animation) -> dict[str, _Keys]:
    """Weights of a part's blend shapes in an animation, else at rest; without shapes that stay at 0."""
    stated = {name: part.shape_weights.get(name, 0.0) for name in part.shapes}
    keys: dict[str, _Keys] = {
        name: (np.zeros(1), np.array([[weight]]), "LINEAR") for name, weight in stated.items() if weight
    }
    for track in animation.shape_tracks_of(part):
        columns = np.moveaxis(track.values_of(part), -1, 0)[..., None]
        keys |= {name: (track.times, one, track.interpolation) for name, one in zip(part.shapes, columns, strict=True)}
    return keys


def _same_keys(first: _Keys, second: _Keys) -> bool:
    """Whether two weights have the same keys, or are 0 throughout."""
    return all(map(np.array_equal, first[:2], second[:2])) or not (first[1].any() or second[1].any())


def remove_scale(rig: Rig, animations: Sequence[Animation]) -> tuple[Rig, tuple[Animation, ...]]:
    """The rig and its animations with joints of scale 1 in the bind pose; skinned points are the same.

    USD stores the scales of animations in half precision, and programs expect 1.
    """
    scale = np.cbrt(np.abs(np.linalg.det(rig.bind[:, :3, :3])))
    above = np.where(rig.parents >= 0, scale[rig.parents], 1.0)
    factor = {"translation": above, "rotation": np.ones(len(scale)), "scale": above / scale}
    bind, local = rig.bind.copy(), rig.local.copy()
    bind[:, :3, :3] /= scale[:, None, None]
    local[:, :3, :3] *= factor["scale"][:, None, None]
    local[:, 3, :3] *= above[:, None]
    return replace(rig, bind=bind, local=local), tuple(
        replace(one, tracks=tuple(replace(t, values=t.values * factor[t.channel][t.joint]) for t in one.tracks))
        for one in animations
    )


def _frames(times: FloatArray, rate: float) -> FloatArray:
    """Time codes of seconds."""
    frames = times * rate
    return np.where(np.abs(frames - np.rint(frames)) < _FRAME_ROUNDING, np.rint(frames), frames)


def _write_animation(
    stage: Any,
    path: str,
    rig: Rig,
    paths: Sequence[str],
    tracks: Sequence[Track],
    weights: Mapping[str, _Keys],
    rate: float,
) -> Any:
    """Write a `SkelAnimation` of the joints that tracks move, and of blend shapes."""
    animation = pxr.UsdSkel.Animation.Define(stage, path)
    joints = sorted({track.joint for track in tracks})
    animation.CreateJointsAttr([paths[joint] for joint in joints])
    rests = rest_tracks(rig, joints, ("translation", "rotation", "scale"))
    keys = {(str(one.channel), one.joint): (one.times, one.values, one.interpolation) for one in (*rests, *tracks)}
    for channel, attribute, array, dtype in (
        ("translation", animation.CreateTranslationsAttr(), pxr.Vt.Vec3fArray, np.float32),
        ("rotation", animation.CreateRotationsAttr(), pxr.Vt.QuatfArray, np.float32),
        ("scale", animation.CreateScalesAttr(), pxr.Vt.Vec3hArray, np.float16),
    ):
        rows = [keys[channel, joint] for joint in joints]
        for code, values in _samples(rows, rate, quaternions=channel == "rotation"):
            attribute.Set(array.FromNumpy(values.astype(dtype)), code)
    if weights:
        animation.CreateBlendShapesAttr(list(weights))
        attribute = animation.CreateBlendShapeWeightsAttr()
        for code, values in _samples(list(weights.values()), rate):
            attribute.Set(pxr.Vt.FloatArray.FromNumpy(values[:, 0].astype(np.float32)), code)
    return animation.GetPrim()


def _samples(rows: Sequence[_Keys], rate: float, *, quaternions: bool = False) -> Iterator[tuple[Any, FloatArray]]:
    """Time codes of the keys of all rows, and values (rows, q) at each; without later keys, one default value."""
    timed = [_sample_times(times, interpolation, rate) for times, _, interpolation in rows if len(times) > 1]
    times = np.unique(np.concatenate(timed)) if timed else np.zeros(1)
    values = [interpolate_keys(*keys, times, quaternions=quaternions) for keys in rows]
    for place, frame in enumerate(_frames(times, rate).tolist() if rows else ()):
        yield frame if timed else pxr.Usd.TimeCode.Default(), np.array([of[place] for of in values])


def _sample_times(times: FloatArray, interpolation: str, rate: float) -> FloatArray:
    """Times at which a row is written, so that linear interpolation between them follows it."""
    if interpolation == "STEP":
        return np.concatenate([times, times[1:] - np.minimum(_STEP / rate, np.diff(times) / 2)])
    if interpolation == "CUBICSPLINE":
        first, last = np.ceil(times[0] * rate), np.floor(times[-1] * rate)
        return np.concatenate([times, np.arange(first, last + 1) / rate])
    return times
