"""Poses of a rig: at a time of an animation, and towards another rig's bind pose."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.character.bones import humanoid_names
from cagemap.character.values import Animation, Channel, Rig, Track
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations

# A rig counts as turned against another where that explains the places of its joints with less than this share of the
# error; else both have the same axes.
_TURN_ERROR = 0.5
# Bones whose directions differ by less, in radians, are in one pose: shapes and places of joints make 10 degrees.
LEAST_TURN = np.radians(20.0)
# Weight of the joints' axes in that fit: they decide where all joints lie on a line.
_AXES_WEIGHT = 1e-9
# Joints that poses leave where they are in the body.
_TORSO = (
    *("hips", "spine", "chest", "upperChest", "neck", "head"),
    *(side + bone for side in ("left", "right") for bone in ("Shoulder", "UpperArm", "UpperLeg")),
)
_PELVIS = ("hips", "spine", "leftUpperLeg", "rightUpperLeg")
_LIMBS = (
    ("UpperLeg", "LowerLeg"),
    ("LowerLeg", "Foot"),
    ("Foot", "Toes"),
    ("Shoulder", "UpperArm"),
    ("UpperArm", "LowerArm"),
    ("LowerArm", "Hand"),
    ("Hand", "MiddleProximal"),
    ("ThumbMetacarpal", "ThumbProximal"),
    ("ThumbProximal", "ThumbDistal"),
)
_PHALANGES = (("Proximal", "Intermediate"), ("Intermediate", "Distal"))
_FINGERS = tuple(
    (finger + start, finger + end) for finger in ("Index", "Middle", "Ring", "Little") for start, end in _PHALANGES
)
# Humanoid bones whose directions make a pose, and the bones where they end.
BONE_ENDS: Mapping[str, str] = {"spine": "neck", "neck": "head"} | {
    side + start: side + end for side in ("left", "right") for start, end in _LIMBS + _FINGERS
}


def pose_at(rig: Rig, animation: Animation, time: float) -> FloatArray:
    """Transforms of all joints to the world, (j, 4, 4) float64, at a time of an animation.

    Parameters
    ----------
    rig : Rig
    animation : Animation
        Channels that it does not have stay at rest.
    time : float
        Seconds; the first and the last key hold before and after them.

    Raises
    ------
    ParameterError
        If a track is of a joint that the rig does not have.
    """
    require_joints(rig, animation)
    given: dict[int, dict[str, FloatArray]] = {}
    for track in animation.tracks:
        given.setdefault(track.joint, {})[track.channel] = value_at(track, time)
    local = rig.local.copy()
    for joint, channels in given.items():
        translation, rotation, scale = decomposed(local[joint])
        if "rotation" in channels:
            rotation = Rotation.from_quat(channels["rotation"]).as_matrix().T
        local[joint, :3, :3] = channels.get("scale", scale)[:, None] * rotation
        local[joint, 3, :3] = channels.get("translation", translation)
    return to_world(local, rig.parents)


def require_joints(rig: Rig, animation: Animation) -> None:
    """Refuse an animation of joints that a rig does not have.

    Raises
    ------
    ParameterError
    """
    wrong = sorted({track.joint for track in animation.tracks if not 0 <= track.joint < len(rig.names)})
    if wrong:
        raise ParameterError(
            f"animation {animation.name}: expected tracks of joints 0 to {len(rig.names) - 1}, got {wrong[:5]}: it "
            "belongs to another rig"
        )


def value_at(track: Track, time: float) -> FloatArray:
    """Value of a track at a time, (3,) or (4,) float64, interpolated as glTF 2.0 says."""
    times = track.times
    keys = track.values[:, 1] if track.interpolation == "CUBICSPLINE" else track.values
    if time <= times[0] or time >= times[-1]:
        return np.asarray(keys[0 if time <= times[0] else -1])
    after = int(np.searchsorted(times, time, side="right"))
    span = times[after] - times[after - 1]
    share = (time - times[after - 1]) / span
    start, end = keys[after - 1], keys[after]
    if track.interpolation == "STEP":
        return np.asarray(start)
    if track.interpolation == "CUBICSPLINE":
        leaving, arriving = span * track.values[after - 1, 2], span * track.values[after, 0]
        square, cube = share**2, share**3
        value = (2 * cube - 3 * square + 1) * start + (cube - 2 * square + share) * leaving
        value = value + (3 * square - 2 * cube) * end + (cube - square) * arriving
        return value / np.linalg.norm(value) if track.channel == "rotation" else value
    if track.channel == "rotation":
        first = Rotation.from_quat(start)
        change = (first.inv() * Rotation.from_quat(end)).as_rotvec()
        return (first * Rotation.from_rotvec(share * change)).as_quat()
    return np.asarray((1 - share) * start + share * end)


def to_world(local: FloatArray, parents: IndexArray) -> FloatArray:
    """Transforms (j, 4, 4) to the world from those to the parents, which stand before their children."""
    world = local.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[joint] = local[joint] @ world[parent]
    return world


def to_parents(world: FloatArray, parents: IndexArray) -> FloatArray:
    """Transforms (j, 4, 4) to the parents from those to the world."""
    local = world.copy()
    inner = parents >= 0
    local[inner] = world[inner] @ np.linalg.inv(world[parents[inner]])
    return local


def decomposed(transform: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Translation (3,), rotation (3, 3) and scale (3,) of a transform (4, 4) without shear."""
    scale = np.linalg.norm(transform[:3, :3], axis=1)
    if np.linalg.det(transform[:3, :3]) < 0:
        scale = -scale
    rotation = transform[:3, :3] / np.where(scale == 0, 1.0, scale)[:, None]
    return transform[3, :3], rotation, scale


def rest_keys(rig: Rig, joints: list[int], channels: tuple[Channel, ...]) -> tuple[Track, ...]:
    """Tracks of one key that hold joints as they are at rest."""
    tracks = []
    for joint in joints:
        translation, rotation, scale = decomposed(rig.local[joint])
        turned = Rotation.from_matrix(rotation.T).as_quat()
        keys = {"translation": translation, "rotation": turned, "scale": scale}
        tracks += [Track(joint, channel, np.zeros(1), keys[channel][None]) for channel in channels]
    return tuple(tracks)


def pose_towards(
    rig: Rig, other: Rig, bones: Mapping[str, int] | None = None, other_bones: Mapping[str, int] | None = None
) -> FloatArray:
    """Transforms of a rig's joints to the world, (j, 4, 4) float64, that bring its bind pose to another's.

    Limbs, fingers, spine and neck turn by the least rotation that gives each bone the direction of the other rig's
    bone. A bone that needs less than `LEAST_TURN` keeps its direction, unless a bone above it was turned. Lengths stay.

    Parameters
    ----------
    rig, other : Rig
    bones, other_bones : dict of str to int, optional
        Joints that are humanoid bones, by VRM names; `humanoid_names` if not given.

    Raises
    ------
    ParameterError
        If the rigs have no humanoid bones in common.
    """
    bones = humanoid_names(rig) if bones is None else bones
    other_bones = humanoid_names(other) if other_bones is None else other_bones
    common = {bone: (other_bones[bone], bones[bone]) for bone in bones if bone in other_bones}
    if not common:
        raise ParameterError(
            "poses: expected two rigs with humanoid bones in common, got none; name joints as VRM, Mixamo, Rigify, "
            "MakeHuman, Unreal or Character Creator do"
        )
    turn = turn_and_scale(other, rig, dict(common.values()))[0]
    ends = {
        common[start][1]: (common[end][1], (other.heads[common[end][0]] - other.heads[common[start][0]]) @ turn)
        for start, end in BONE_ENDS.items()
        if start in common and end in common
    }
    local, posed = to_parents(rig.bind, rig.parents), rig.bind.copy()
    inverse, moves = np.linalg.inv(rig.bind), np.zeros(len(rig.parents), dtype=np.bool_)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            posed[joint], moves[joint] = local[joint] @ posed[parent], moves[parent]
        if joint in ends:
            end, wanted = ends[joint]
            along = (rig.heads[end] - rig.heads[joint]) @ (inverse[joint] @ posed[joint])[:3, :3]
            bent = least_rotation(along, wanted)
            moves[joint] |= Rotation.from_matrix(bent).magnitude() > LEAST_TURN
            if moves[joint]:
                posed[joint, :3, :3] = posed[joint, :3, :3] @ bent
    return posed


def least_rotation(start: FloatArray, end: FloatArray) -> FloatArray:
    """Smallest rotation (3, 3) of one row (3,) to the direction of another; the identity where one has no length."""
    axis = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(axis)), float(start @ end)
    if sine == 0.0 and cosine < 0:  # opposite: about any axis across
        axis = np.cross(start, np.eye(3)[np.abs(start).argmin()])
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return np.eye(3)
    return Rotation.from_rotvec(np.arctan2(sine, cosine) / length * axis).as_matrix().T


def turn_and_scale(source: Rig, target: Rig, pairs: Mapping[int, int]) -> tuple[FloatArray, float]:
    """Rotation (3, 3) and scale that take the source's bind pose, as a whole, to the target's; directions are rows."""
    if not pairs:
        return np.eye(3), 1.0
    bones = humanoid_names(source)
    named = [[bones[bone] for bone in names if bones.get(bone) in pairs] for names in (_TORSO, _PELVIS)]
    sets = [np.array(joints) for joints in named if len(joints) > 3] or [np.array(list(pairs))]
    # A bent back turns the torso, not the pelvis.
    fits = [_best_turn(source, target, own, np.array([pairs[joint] for joint in own.tolist()])) for own in sets]
    turned = all(error <= _TURN_ERROR * plain for _, _, error, plain in fits)
    return (fits[0][0] if turned else np.eye(3)), fits[0][1]


def _best_turn(source: Rig, target: Rig, own: IndexArray, other: IndexArray) -> tuple[FloatArray, float, float, float]:
    """Rotation and scale that fit joints best, their error, and the error without rotation."""
    before, after = source.heads[own], target.heads[other]
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    sizes = float(np.linalg.norm(before)), float(np.linalg.norm(after))
    scale = sizes[1] / sizes[0] if min(sizes) > 0 else 1.0
    mixed = before.T @ after / max(sizes[0] * sizes[1], np.finfo(np.float64).tiny)
    axes = [nearest_rotations(rig.bind[joints, :3, :3]) for rig, joints in ((source, own), (target, other))]
    mixed = mixed + _AXES_WEIGHT * np.einsum("jab,jac->bc", *axes) / len(own)
    turn = nearest_rotations(mixed[None])[0]
    errors = [float(np.linalg.norm(scale * before @ rotation - after)) for rotation in (turn, np.eye(3))]
    # Rounding is no reason to turn.
    return turn, scale, errors[0] + 1e-9 * sizes[1], errors[1]
