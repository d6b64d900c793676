"""Poses of a rig: from an animation, or aligned with another rig."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.character.bones import BODY_SIDES, humanoid_joints
from cagemap.character.values import Animation, Channel, Interpolation, Rig, Track
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations

# Largest error of the joints with a rotation, over the error without one, where rigs differ by that rotation.
MAX_TURN_ERROR = 0.5
# Radians; bones whose directions differ by less have one pose. Different bodies alone make 10 degrees.
MIN_BONE_ANGLE = np.radians(20.0)
# Radians; where no bone of an animal differs by more, the poses are the same: a wolf's paw and a
# fox's differ by 36 degrees (docs/lab/characters.md).
MIN_POSE_ANGLE = np.radians(45.0)
# Of the direction to a child with an axis of its joint, where the joint's bone ends at that child.
MIN_BONE_COSINE = 0.99
# Second over first singular value of joints that are nearly on a line, such as spine and head alone.
MAX_LINE_SPREAD = 0.2
# Weight of the joints' axes beside their positions: decides the rotation where all joints lie on a line.
AXES_WEIGHT = 1e-9
# Joints whose positions in the body do not depend on the pose.
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
# Humanoid bones that `aligned_pose` turns, and the bones where they end.
BONE_ENDS: Mapping[str, str] = {"spine": "neck", "neck": "head"} | {
    side + start: side + end for side in ("left", "right") for start, end in _LIMBS + _FINGERS
}


def example_times(animation: Animation) -> tuple[float, FloatArray]:
    """Time of an animation's first key, and (3,) times of poses to look at, between its first and its last key.

    Tracks with a single key hold one pose, and their times are ignored.
    """
    keys = np.concatenate([track.times for track in animation.tracks if len(track.times) > 1] or [np.zeros(1)])
    return float(keys.min()), np.quantile([keys.min(), keys.max()], (0.25, 0.5, 0.75))


def pose_at(rig: Rig, animation: Animation, time: float) -> FloatArray:
    """World transforms of all joints, (j, 4, 4) float64, at a time of an animation.

    Parameters
    ----------
    rig : Rig
    animation : Animation
        Channels without a track stay at rest.
    time : float
        Seconds; before the first key its value holds, after the last key that one's.

    Raises
    ------
    ParameterError
        If a track is of a joint that the rig does not have.
    """
    check_joints(rig, animation)
    channels_of: dict[int, dict[str, FloatArray]] = {}
    for track in animation.tracks:
        channels_of.setdefault(track.joint, {})[track.channel] = track_value(track, time)
    local = rig.local.copy()
    for joint, channels in channels_of.items():
        translation, rotation, scale = decompose(local[joint])
        if "rotation" in channels:
            rotation = Rotation.from_quat(channels["rotation"]).as_matrix().T
        local[joint, :3, :3] = channels.get("scale", scale)[:, None] * rotation
        local[joint, 3, :3] = channels.get("translation", translation)
    return world_transforms(local, rig.parents)


def check_joints(rig: Rig, animation: Animation) -> None:
    """Raise if an animation has tracks of joints that a rig does not have.

    Raises
    ------
    ParameterError
    """
    unknown = sorted({track.joint for track in animation.tracks if not 0 <= track.joint < len(rig.names)})
    if unknown:
        raise ParameterError(
            f"animation {animation.name}: expected tracks of joints 0 to {len(rig.names) - 1}, got {unknown[:5]}: it "
            "belongs to another rig"
        )


def track_value(track: Track, time: float) -> FloatArray:
    """Value of a track at a time, (3,) or (4,) float64, interpolated as glTF 2.0 says."""
    quaternions = track.channel == "rotation"
    return interpolate_keys(track.times, track.values, track.interpolation, np.array([time]), quaternions=quaternions)[
        0
    ]


def interpolate_keys(
    times: FloatArray, values: FloatArray, interpolation: Interpolation, wanted: FloatArray, *, quaternions: bool
) -> FloatArray:
    """Values (m, q) of keys at the ``wanted`` times (m,); before the first and after the last key, theirs.

    ``times``, ``values``: of the keys, see `cagemap.character.values.Track`.
    ``quaternions``: whether the values are quaternions.
    """
    keys = values[:, 1] if interpolation == "CUBICSPLINE" else values
    if len(times) == 1:
        return np.repeat(keys, len(wanted), axis=0)
    next_key = np.clip(np.searchsorted(times, wanted, side="right"), 1, len(times) - 1)
    last_key = next_key - 1
    span = (times[next_key] - times[last_key])[:, None]
    share = np.clip((wanted[:, None] - times[last_key, None]) / span, 0.0, 1.0)
    start, end = keys[last_key], keys[next_key]
    if interpolation == "STEP":
        between = start
    elif interpolation == "CUBICSPLINE":
        leaving, arriving = span * values[last_key, 2], span * values[next_key, 0]
        square, cube = share**2, share**3
        between = (2 * cube - 3 * square + 1) * start + (cube - 2 * square + share) * leaving
        between = between + (3 * square - 2 * cube) * end + (cube - square) * arriving
        between = between / np.linalg.norm(between, axis=1, keepdims=True) if quaternions else between
    elif quaternions:
        first = Rotation.from_quat(start)
        change = (first.inv() * Rotation.from_quat(end)).as_rotvec()
        between = (first * Rotation.from_rotvec(share * change)).as_quat()
    else:
        between = (1 - share) * start + share * end
    between = np.where(wanted[:, None] <= times[0], keys[0], between)
    return np.where(wanted[:, None] >= times[-1], keys[-1], between)


def world_transforms(local: FloatArray, parents: IndexArray) -> FloatArray:
    """Transforms (j, 4, 4) to the world from transforms to the parents; parents stand before children."""
    world = local.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[joint] = local[joint] @ world[parent]
    return world


def parent_transforms(world: FloatArray, parents: IndexArray) -> FloatArray:
    """Transforms (j, 4, 4) to the parents from transforms to the world."""
    local = world.copy()
    has_parent = parents >= 0
    local[has_parent] = world[has_parent] @ np.linalg.inv(world[parents[has_parent]])
    return local


def decompose(transform: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Translation (3,), rotation (3, 3) and scale (3,) of a transform (4, 4) without shear."""
    scale = np.linalg.norm(transform[:3, :3], axis=1)
    if np.linalg.det(transform[:3, :3]) < 0:
        scale = -scale
    rotation = transform[:3, :3] / np.where(scale == 0, 1.0, scale)[:, None]
    return transform[3, :3], rotation, scale


def rotations_of(transforms: FloatArray) -> FloatArray:
    """(j, 3, 3) rotations of transforms (j, 4, 4); of mirrors those of `decompose`, with negative scales."""
    linear = transforms[:, :3, :3]
    signs = np.where(np.linalg.det(linear) < 0.0, -1.0, 1.0)
    return nearest_rotations(signs[:, None, None] * linear)


def quaternion_product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Products of quaternions (..., 4), x, y, z, w; also of tangents of splines."""
    vectors, scalars = (first[..., :3], second[..., :3]), (first[..., 3:], second[..., 3:])
    vector = scalars[0] * vectors[1] + scalars[1] * vectors[0] + np.cross(*vectors)
    return np.concatenate([vector, scalars[0] * scalars[1] - (vectors[0] * vectors[1]).sum(-1, keepdims=True)], axis=-1)


def rest_tracks(rig: Rig, joints: list[int], channels: tuple[Channel, ...]) -> tuple[Track, ...]:
    """Tracks of one key that keep joints at rest."""
    tracks = []
    for joint in joints:
        translation, rotation, scale = decompose(rig.local[joint])
        quaternion = Rotation.from_matrix(rotation.T).as_quat()
        keys = {"translation": translation, "rotation": quaternion, "scale": scale}
        tracks += [Track(joint, channel, np.zeros(1), keys[channel][None]) for channel in channels]
    return tuple(tracks)


def aligned_pose(rig: Rig, reference: Rig) -> FloatArray:
    """World transforms (j, 4, 4) of a rig's joints in the bind pose of a reference rig.

    Limbs, fingers, spine and neck turn by the least rotation that gives each bone the direction of the reference's
    bone. A bone that needs less than `MIN_BONE_ANGLE` keeps its direction, unless a bone above it was turned. Lengths
    stay. Of animals, without humanoid limbs, all bones turn after the first joint with several children, if one of them
    needs `MIN_POSE_ANGLE`.

    Raises
    ------
    ParameterError
        If the rigs have neither a humanoid bone in common nor the same names.
    """
    bones, reference_bones = humanoid_joints(rig), humanoid_joints(reference)
    shared = [bone for bone in bones if bone in reference_bones]
    common = {reference_bones[bone]: bones[bone] for bone in shared}
    ends = {
        reference_bones[start]: reference_bones[end]
        for start, end in BONE_ENDS.items()
        if start in reference_bones and end in reference_bones
    }
    least_angle = 0.0
    if rig.names == reference.names and not any(bone.startswith(BODY_SIDES) for bone in shared):
        common, ends = {joint: joint for joint in range(len(rig.names))}, bone_ends(reference)
        limbs_begin = [joint for joint in common if (rig.parents == joint).sum() > 1]
        trunk = min(limbs_begin, default=0)
        ends, least_angle = {start: end for start, end in ends.items() if start > trunk}, MIN_POSE_ANGLE
    if not common:
        raise ParameterError(
            "poses: expected two rigs with humanoid bones in common, got none; name joints as VRM, Mixamo, Rigify, "
            "MakeHuman, Unreal or Character Creator do"
        )
    turn = fit_rotation_and_scale(reference, rig, common)[0]
    directions = {
        common[start]: (common[end], (reference.heads[end] - reference.heads[start]) @ turn)
        for start, end in ends.items()
        if start in common and end in common
    }
    angles = [
        Rotation.from_matrix(least_rotation(rig.heads[end] - rig.heads[joint], direction)).magnitude()
        for joint, (end, direction) in directions.items()
    ]
    if max(angles, default=0.0) < least_angle:
        return rig.bind.copy()
    local, posed = parent_transforms(rig.bind, rig.parents), rig.bind.copy()
    inverse, is_turned = np.linalg.inv(rig.bind), np.zeros(len(rig.parents), dtype=np.bool_)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            posed[joint], is_turned[joint] = local[joint] @ posed[parent], is_turned[parent]
        if joint in directions:
            end, direction = directions[joint]
            current = (rig.heads[end] - rig.heads[joint]) @ (inverse[joint] @ posed[joint])[:3, :3]
            bend = least_rotation(current, direction)
            is_turned[joint] |= Rotation.from_matrix(bend).magnitude() > MIN_BONE_ANGLE
            if is_turned[joint]:
                posed[joint, :3, :3] = posed[joint, :3, :3] @ bend
    return posed


def bone_ends(rig: Rig) -> dict[int, int]:
    """The child at the end of each bone: along an axis, or the only child."""
    axes = rotations_of(rig.bind)
    ends: dict[int, int] = {}
    for joint in range(len(rig.names)):
        children = np.flatnonzero(rig.parents == joint)
        directions = rig.heads[children] - rig.heads[joint]
        lengths = np.linalg.norm(directions, axis=1)
        cosines = np.abs(directions @ axes[joint].T).max(axis=1, initial=0.0) / np.where(lengths > 0, lengths, np.inf)
        if len(children) == 1 or (len(children) and cosines.max() > MIN_BONE_COSINE):
            ends[joint] = int(children[cosines.argmax()])
    return ends


def least_rotation(start: FloatArray, end: FloatArray) -> FloatArray:
    """Smallest rotation (3, 3) from one direction (3,) to another; the identity if one has length 0."""
    axis = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(axis)), float(start @ end)
    if sine == 0.0 and cosine < 0:  # opposite directions: any perpendicular axis
        axis = np.cross(start, np.eye(3)[np.abs(start).argmin()])
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return np.eye(3)
    return Rotation.from_rotvec(np.arctan2(sine, cosine) / length * axis).as_matrix().T


def fit_rotation_and_scale(source: Rig, target: Rig, pairs: Mapping[int, int]) -> tuple[FloatArray, float]:
    """Rotation (3, 3), for rows, and scale that take the source's bind pose to the target's."""
    if not pairs:
        return np.eye(3), 1.0
    bones = humanoid_joints(source)
    listed = [[bone for bone in names if bones.get(bone) in pairs] for names in (_TORSO, _PELVIS)]
    # Spine and head alone are nearly on a line: any rotation about it fits.
    found = [names for names in listed if len(names) > 3 and any(name.startswith(BODY_SIDES) for name in names)]
    joint_sets = [np.array([bones[name] for name in names]) for names in found] or [np.array(list(pairs))]
    # Both must agree: a bent back turns the torso alone.
    fits = [
        _fit_rotation(source, target, source_joints, np.array([pairs[joint] for joint in source_joints.tolist()]))
        for source_joints in joint_sets
    ]
    is_turned = all(error <= MAX_TURN_ERROR * plain_error for _, _, error, plain_error in fits)
    if not found and is_turned:  # joints on a line turn as a whole, or it is bent
        spreads = np.linalg.svd(source.heads[[*pairs]] - source.heads[[*pairs]].mean(axis=0), compute_uv=False)
        is_line = spreads[1:2].sum() < MAX_LINE_SPREAD * spreads[0]
        is_turned = not is_line or _bones_agree(source, target, pairs, fits[0][0])
    return (fits[0][0] if is_turned else np.eye(3)), fits[0][1]


def _bones_agree(source: Rig, target: Rig, pairs: Mapping[int, int], turn: FloatArray) -> bool:
    """Whether each bone of the source, turned (3, 3), is within `MIN_BONE_ANGLE` of the target's."""
    bones = [(joint, parent) for joint, parent in enumerate(source.parents.tolist()) if {joint, parent} <= pairs.keys()]
    images = [(pairs[joint], pairs[parent]) for joint, parent in bones]
    before, after = (
        np.array([rig.heads[joint] - rig.heads[parent] for joint, parent in of]).reshape(-1, 3)
        for rig, of in ((source, bones), (target, images))
    )
    before = before @ turn
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return bool((np.einsum("bd,bd->b", before, after) >= np.cos(MIN_BONE_ANGLE) * lengths).all())


def _fit_rotation(
    source: Rig, target: Rig, source_joints: IndexArray, target_joints: IndexArray
) -> tuple[FloatArray, float, float, float]:
    """Least-squares rotation and scale of joints, their error, and the error without rotation."""
    source_offsets, target_offsets = source.heads[source_joints], target.heads[target_joints]
    source_offsets, target_offsets = (
        source_offsets - source_offsets.mean(axis=0),
        target_offsets - target_offsets.mean(axis=0),
    )
    sizes = float(np.linalg.norm(source_offsets)), float(np.linalg.norm(target_offsets))
    scale = sizes[1] / sizes[0] if min(sizes) > 0 else 1.0
    covariance = source_offsets.T @ target_offsets / max(sizes[0] * sizes[1], np.finfo(np.float64).tiny)
    axes = [rotations_of(rig.bind[joints]) for rig, joints in ((source, source_joints), (target, target_joints))]
    covariance = covariance + AXES_WEIGHT * np.einsum("jab,jac->bc", *axes) / len(source_joints)
    turn = nearest_rotations(covariance[None])[0]
    errors = [
        float(np.linalg.norm(scale * source_offsets @ rotation - target_offsets)) for rotation in (turn, np.eye(3))
    ]
    # The added term keeps rounding errors from counting as a rotation.
    return turn, scale, errors[0] + 1e-9 * sizes[1], errors[1]
