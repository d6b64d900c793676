"""Retargeting: animations of one rig for another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.character.bones import humanoid_joints
from cagemap.character.poses import (
    aligned_pose,
    check_joints,
    decompose,
    fit_rotation_and_scale,
    parent_transforms,
    quaternion_product,
    rest_tracks,
    rotations_of,
)
from cagemap.character.values import Animation, Rig, Track
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray

# Of the rig's size: shorter bones do not scale translations.
MIN_BONE_LENGTH = 1e-6


def retarget(animation: Animation, source: Rig, target: Rig, *, reference: FloatArray | None = None) -> Animation:
    """The same motion for another rig: rotations about the same directions, translations scaled.

    Joints correspond by name; where rigs share no names, by humanoid bone. Directions are the world's in the bind
    poses, rotated where one rig as a whole is rotated against the other. Translations of the hips and of their parents
    scale with the length of the legs, others with the length of their bone. Scales are relative to the bind poses.

    Parameters
    ----------
    animation : Animation
        Of ``source``.
    source, target : Rig
    reference : (j, 4, 4) float64, optional
        World transforms of the target's joints in the source's bind pose, where the target's bind pose is another: see
        `cagemap.character.poses.aligned_pose`.

    Returns
    -------
    Animation
        Tracks of joints that the target does not have are left out.

    Raises
    ------
    ParameterError
        If a track is of a joint that the source does not have, or there is not one reference a joint.
    """
    check_joints(source, animation)
    if reference is not None and reference.shape != target.bind.shape:
        raise ParameterError(f"reference: expected one transform a joint {target.bind.shape}, got {reference.shape}")
    pairs = joint_pairs(source, target)
    source_tracks = animation.tracks
    if reference is not None:  # joints without a rotation track stand as in the reference pose
        rotated = {track.joint for track in source_tracks if track.channel == "rotation"}
        source_tracks += rest_tracks(source, [joint for joint in pairs if joint not in rotated], ("rotation",))
    target_in_pose = target if reference is None else replace(target, bind=reference)
    turn, scale = fit_rotation_and_scale(source, target_in_pose, pairs)
    bind_poses = _BindPose.of(source), _BindPose.of(target_in_pose)
    scales = _translation_scales(source, target, pairs, scale)
    tracks = []
    for track in source_tracks:
        if track.joint in pairs:
            joints = track.joint, pairs[track.joint]
            values = track.values
            if track.channel == "rotation":
                values = _convert_rotations(track, joints, bind_poses, turn)
            elif track.channel == "translation":
                values = _convert_translations(track, joints, bind_poses, turn, scales[track.joint])
            else:
                values = _convert_scales(track, joints, bind_poses, turn)
            tracks.append(replace(track, joint=joints[1], values=values))
    return replace(animation, tracks=tuple(tracks))


def retarget_all(animations: Sequence[Animation], source: Rig, target: Rig) -> tuple[tuple[Animation, ...], bool]:
    """Animations for another rig, and whether its bind pose differs (T pose, A pose)."""
    reference = bind_pose_difference(target, source) if animations else None
    retargeted = tuple(retarget(animation, source, target, reference=reference) for animation in animations)
    return retargeted, reference is not None


def bind_pose_difference(target: Rig, source: Rig) -> FloatArray | None:
    """The target's bind pose (j, 4, 4) turned into the source's (T pose, A pose); None if they are equal or unknown."""
    if not humanoid_joints(source) and source.names != target.names:
        return None
    pose = aligned_pose(target, source)
    return None if np.allclose(pose, target.bind) else pose


def joint_pairs(source: Rig, target: Rig) -> dict[int, int]:
    """Joints of the target by joints of the source: by name or humanoid bone.

    The way that gives more pairs is used.
    """
    numbers = {name: joint for joint, name in enumerate(target.names)}
    by_name = {joint: numbers[name] for joint, name in enumerate(source.names) if name in numbers}
    bones = humanoid_joints(target)
    by_bone = {joint: bones[bone] for bone, joint in humanoid_joints(source).items() if bone in bones}
    return max(by_name, by_bone, key=len)


@dataclass(frozen=True, eq=False)
class _BindPose:
    """A rig's bind pose: transforms to the world and to the parents, and their rotations."""

    parents: IndexArray = field(repr=False)
    bind: FloatArray = field(repr=False)
    local: FloatArray = field(repr=False)
    world_rotations: Rotation = field(repr=False)
    local_rotations: Rotation = field(repr=False)

    @classmethod
    def of(cls, rig: Rig) -> _BindPose:
        local = parent_transforms(rig.bind, rig.parents)
        return cls(rig.parents, rig.bind, local, *(_rotations(transforms) for transforms in (rig.bind, local)))

    def parent_axes(self, joint: int) -> FloatArray:
        """Linear part (3, 3) of the transform from the space of a joint's translations to the world."""
        parent = self.parents[joint]
        return np.eye(3) if parent < 0 else self.bind[parent, :3, :3]


def _rotations(transforms: FloatArray) -> Rotation:
    """Rotations of transforms (j, 4, 4) that act on rows."""
    return Rotation.from_matrix(rotations_of(transforms).transpose(0, 2, 1))


def _axes_change(joints: tuple[int, int], bind_poses: tuple[_BindPose, _BindPose], turn: FloatArray) -> Rotation:
    """Rotation from the axes of a source's joint to those of a target's joint, in the bind poses."""
    source, target = (pose.world_rotations[joint] for pose, joint in zip(bind_poses, joints, strict=True))
    return target.inv() * Rotation.from_matrix(turn.T) * source


def _convert_rotations(
    track: Track, joints: tuple[int, int], bind_poses: tuple[_BindPose, _BindPose], turn: FloatArray
) -> FloatArray:
    """Quaternions of a track in the target's axes."""
    (source, target), (source_joint, target_joint) = bind_poses, joints
    to_target = _axes_change(joints, bind_poses, turn)
    left = target.local_rotations[target_joint] * to_target * source.local_rotations[source_joint].inv()
    return quaternion_product(quaternion_product(left.as_quat(), track.values), to_target.inv().as_quat())


def _convert_translations(
    track: Track, joints: tuple[int, int], bind_poses: tuple[_BindPose, _BindPose], turn: FloatArray, scale: float
) -> FloatArray:
    """Translations of a track, relative to the bind pose, scaled, in the target's axes."""
    source_bind, target_bind = (pose.local[joint, 3, :3] for pose, joint in zip(bind_poses, joints, strict=True))
    axes = [pose.parent_axes(joint) for pose, joint in zip(bind_poses, joints, strict=True)]
    linear = scale * axes[0] @ turn @ np.linalg.inv(axes[1])
    if track.interpolation == "CUBICSPLINE":  # tangents are not relative to the bind pose
        source_bind, target_bind = (
            np.stack([np.zeros(3), position, np.zeros(3)]) for position in (source_bind, target_bind)
        )
    return (track.values - source_bind) @ linear + target_bind


def _convert_scales(
    track: Track, joints: tuple[int, int], bind_poses: tuple[_BindPose, _BindPose], turn: FloatArray
) -> FloatArray:
    """Scales of a track, relative to the bind pose, each along the target's nearest axis."""
    source_bind, target_bind = (decompose(pose.local[joint])[2] for pose, joint in zip(bind_poses, joints, strict=True))
    axes = np.abs(_axes_change(joints, bind_poses, turn).as_matrix()).argmax(axis=1)
    return (track.values / np.where(source_bind == 0, 1.0, source_bind))[..., axes] * target_bind


def _translation_scales(source: Rig, target: Rig, pairs: Mapping[int, int], rig_ratio: float) -> FloatArray:
    """(j,) factors of the translations of the source's joints: ratios of bone lengths, from parent to joint."""
    bones = humanoid_joints(source), humanoid_joints(target)
    legs = [_leg_length(rig, joints) for rig, joints in zip((source, target), bones, strict=True)]
    lengths = [
        np.linalg.norm(rig.heads - rig.heads[np.where(rig.parents < 0, np.arange(len(rig.names)), rig.parents)], axis=1)
        for rig in (source, target)
    ]
    min_length = MIN_BONE_LENGTH * float(np.ptp(source.heads, axis=0).max())
    scales = np.full(len(source.names), rig_ratio)
    for joint, paired in pairs.items():
        if lengths[0][joint] > min_length:
            scales[joint] = lengths[1][paired] / lengths[0][joint]
    joint, hip_chain = bones[0].get("hips", -1), np.flatnonzero(source.parents < 0).tolist()
    while joint >= 0:
        hip_chain.append(joint)
        joint = int(source.parents[joint])
    scales[hip_chain] = legs[1] / legs[0] if min(legs) > 0 else rig_ratio
    return scales


def _leg_length(rig: Rig, bones: Mapping[str, int]) -> float:
    """Mean length of the legs from hip to ankle; 0 where no leg has names."""
    legs = [[bones.get(side + bone, -1) for bone in ("UpperLeg", "LowerLeg", "Foot")] for side in ("left", "right")]
    lengths = [np.linalg.norm(np.diff(rig.heads[leg], axis=0), axis=1).sum() for leg in legs if min(leg) >= 0]
    return float(np.mean(lengths)) if lengths else 0.0
