"""Animations of one rig expressed for another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.character.bones import humanoid_names
from cagemap.character.poses import pose_towards, require_joints, rest_keys, to_parents, turn_and_scale
from cagemap.character.values import Animation, Rig, Track
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations

# Bones shorter than this, of the size of the rig, have no length to compare.
_SHORTEST_BONE = 1e-6


def retarget(animation: Animation, source: Rig, target: Rig, *, reference: FloatArray | None = None) -> Animation:
    """The same motion for another rig: rotations about the same directions, translations scaled.

    Joints go with those of the same name; where rigs share none, with the same humanoid bones. Directions are the
    world's in the bind poses, turned where one rig as a whole is turned against the other. Translations of the hips and
    of what they hang on scale with the length of the legs, others with the length of their bone.

    Parameters
    ----------
    animation : Animation
        Of ``source``.
    source, target : Rig
    reference : (j, 4, 4) float64, optional
        Transforms of the target's joints in the pose that ``source`` is bound in, where that is not the target's bind
        pose: see `cagemap.character.poses.pose_towards`.

    Returns
    -------
    Animation
        Tracks of joints that the target does not have are left out.

    Raises
    ------
    ParameterError
        If a track is of a joint that the source does not have, or there is not one reference a joint.
    """
    require_joints(source, animation)
    if reference is not None and reference.shape != target.bind.shape:
        raise ParameterError(f"reference: expected one transform a joint {target.bind.shape}, got {reference.shape}")
    pairs = joint_pairs(source, target)
    given = animation.tracks
    if reference is not None:  # joints that do not move stand as in the reference pose
        turned = {track.joint for track in given if track.channel == "rotation"}
        given += rest_keys(source, [joint for joint in pairs if joint not in turned], ("rotation",))
    posed = target if reference is None else replace(target, bind=reference)
    turn, size = turn_and_scale(source, posed, pairs)
    sides = _Axes.of(source), _Axes.of(posed)
    ratio = _Lengths.between(source, target, size)
    tracks = []
    for track in given:
        if track.joint in pairs:
            joints = track.joint, pairs[track.joint]
            values = track.values
            if track.channel == "rotation":
                values = _rotations(track, joints, sides, turn)
            elif track.channel == "translation":
                values = _translations(track, joints, sides, turn, ratio(*joints))
            tracks.append(replace(track, joint=joints[1], values=values))
    return Animation(animation.name, tuple(tracks))


def retargeted(animations: Sequence[Animation], source: Rig, rig: Rig) -> tuple[tuple[Animation, ...], bool]:
    """Animations for a carried rig, and whether they were changed for a body in another pose (T pose, A pose)."""
    reference = None
    if animations and humanoid_names(source):
        posed = pose_towards(rig, source)
        reference = None if np.allclose(posed, rig.bind) else posed
    made = tuple(retarget(one, source, rig, reference=reference) for one in animations)
    return made, reference is not None


def joint_pairs(source: Rig, target: Rig) -> dict[int, int]:
    """Joints of the target by those of the source: of the same names, else the same humanoid bones."""
    numbers = {name: joint for joint, name in enumerate(target.names)}
    same = {joint: numbers[name] for joint, name in enumerate(source.names) if name in numbers}
    bones = humanoid_names(target)
    humanoid = {joint: bones[bone] for bone, joint in humanoid_names(source).items() if bone in bones}
    return max(same, humanoid, key=len)


@dataclass(frozen=True, eq=False)
class _Axes:
    """A rig's bind pose: transforms to the parents, and turns of the joints in the world and against their parents."""

    parents: IndexArray = field(repr=False)
    bind: FloatArray = field(repr=False)
    local: FloatArray = field(repr=False)
    world_turns: Rotation = field(repr=False)
    local_turns: Rotation = field(repr=False)

    @classmethod
    def of(cls, rig: Rig) -> _Axes:
        local = to_parents(rig.bind, rig.parents)
        return cls(rig.parents, rig.bind, local, *(_turns(transforms) for transforms in (rig.bind, local)))

    def parent_axes(self, joint: int) -> FloatArray:
        """Linear part (3, 3) of the transform from the space of a joint's translations to the world."""
        parent = self.parents[joint]
        return np.eye(3) if parent < 0 else self.bind[parent, :3, :3]


def _turns(transforms: FloatArray) -> Rotation:
    """Rotations of transforms (j, 4, 4) that act on rows."""
    return Rotation.from_matrix(nearest_rotations(transforms[:, :3, :3]).transpose(0, 2, 1))


def _rotations(track: Track, joints: tuple[int, int], sides: tuple[_Axes, _Axes], turn: FloatArray) -> FloatArray:
    """Quaternions of a track in the target's axes."""
    source, target = sides
    own, other = joints
    # From the source joint's axes to the target joint's, by way of the world.
    through = target.world_turns[other].inv() * Rotation.from_matrix(turn.T) * source.world_turns[own]
    before = target.local_turns[other] * through * source.local_turns[own].inv()
    return _product(_product(before.as_quat(), track.values), through.inv().as_quat())


def _translations(
    track: Track, joints: tuple[int, int], sides: tuple[_Axes, _Axes], turn: FloatArray, ratio: float
) -> FloatArray:
    """Translations of a track in the target's parent's axes: the way from the bind pose, scaled."""
    before, after = (side.local[joint, 3, :3] for side, joint in zip(sides, joints, strict=True))
    axes = [side.parent_axes(joint) for side, joint in zip(sides, joints, strict=True)]
    linear = ratio * axes[0] @ turn @ np.linalg.inv(axes[1])
    if track.interpolation == "CUBICSPLINE":  # tangents have no place
        before, after = (np.stack([np.zeros(3), place, np.zeros(3)]) for place in (before, after))
    return (track.values - before) @ linear + after


def _product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Products of quaternions (..., 4), x, y, z, w: linear in each, so that tangents of splines go along."""
    vectors, scalars = (first[..., :3], second[..., :3]), (first[..., 3:], second[..., 3:])
    vector = scalars[0] * vectors[1] + scalars[1] * vectors[0] + np.cross(*vectors)
    return np.concatenate([vector, scalars[0] * scalars[1] - (vectors[0] * vectors[1]).sum(-1, keepdims=True)], axis=-1)


@dataclass(frozen=True, eq=False)
class _Lengths:
    """Lengths of a rig's bones, from parent to joint, against another's."""

    bones: tuple[FloatArray, FloatArray] = field(repr=False)
    shortest: float
    size: float
    legs: float
    carriers: frozenset[int]

    @classmethod
    def between(cls, source: Rig, target: Rig, size: float) -> _Lengths:
        named = humanoid_names(source), humanoid_names(target)
        legs = [_leg_length(rig, bones) for rig, bones in zip((source, target), named, strict=True)]
        joint, carriers = named[0].get("hips", -1), set(np.flatnonzero(source.parents < 0).tolist())
        while joint >= 0:
            carriers.add(joint)
            joint = int(source.parents[joint])
        bones = tuple(
            np.linalg.norm(
                rig.heads - rig.heads[np.where(rig.parents < 0, np.arange(len(rig.names)), rig.parents)], axis=1
            )
            for rig in (source, target)
        )
        shortest = _SHORTEST_BONE * float(np.ptp(source.heads, axis=0).max())
        ratio = legs[1] / legs[0] if min(legs) > 0 else size
        return cls((bones[0], bones[1]), shortest, size, ratio, frozenset(carriers))

    def __call__(self, own: int, other: int) -> float:
        """What translations of a joint of the source are scaled with."""
        if own in self.carriers:
            return self.legs
        if self.bones[0][own] <= self.shortest:
            return self.size
        return float(self.bones[1][other] / self.bones[0][own])


def _leg_length(rig: Rig, bones: Mapping[str, int]) -> float:
    """Mean length of the legs from hip to ankle; 0 where no leg has names."""
    legs = [[bones.get(side + bone, -1) for bone in ("UpperLeg", "LowerLeg", "Foot")] for side in ("left", "right")]
    lengths = [np.linalg.norm(np.diff(rig.heads[leg], axis=0), axis=1).sum() for leg in legs if min(leg) >= 0]
    return float(np.mean(lengths)) if lengths else 0.0
