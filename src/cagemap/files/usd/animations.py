"""Skeletons and animations of characters in USD: `SkelAnimation` prims with joints and weights of blend shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cagemap.character.poses import interpolate_keys, rest_tracks
from cagemap.character.values import Animation, Interpolation, Part, Rig, Track
from cagemap.files.usd.skeleton import define_skeleton, joint_paths
from cagemap.files.usd.stages import identifiers, pxr
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray

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
        for keys_of_part in keys_of:
            weights = keys_of_part | weights  # the first part with a shape decides
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
        columns = np.moveaxis(track.values_of(part.shapes), -1, 0)[..., None]
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
