"""A rig carried to another body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.character.poses import least_rotation, pose_at, rest_keys, to_parents, turn_and_scale
from cagemap.character.retarget import retarget
from cagemap.character.values import Animation, Rig
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.transfer.skin import carry_joints

# A child whose direction is within this cosine of an axis of its joint ends the joint's bone.
_ALONG_AXIS = 0.99
# Axes of joints that differ less are one convention for all, as in VRM 0.x; transforms that do, the same.
_SAME = 1e-6


def carry_rig(point_map: PointMap, rig: Rig) -> Rig:
    """The rig of the source's body where it belongs in the target's.

    Joints go where the surface around them goes. Axes turn along, so that the axis that points to a joint's child still
    does. Names, parents and scales stay. A rest pose that is not the bind pose is taken over like an animation.

    Parameters
    ----------
    point_map : PointMap
        Of the target's body to the source's, both in the bind pose.
    rig : Rig
        In the source's file units.

    Returns
    -------
    Rig
        In the target's file units.
    """
    heads, turns = carry_joints(point_map, rig.heads)
    bind = rig.bind.copy()
    bind[:, 3, :3] = heads
    bind[:, :3, :3] = rig.bind[:, :3, :3] @ _with_bones(rig, heads, turns)
    if _one_frame(rig):
        pairs = {joint: joint for joint in range(len(rig.names))}
        bind[:, :3, :3] = rig.bind[:, :3, :3] @ turn_and_scale(rig, replace(rig, bind=bind), pairs)[0]
    carried = Rig(rig.names, rig.parents, to_parents(bind, rig.parents), bind)
    rest = _rest_pose(rig)
    if not rest.tracks:
        return carried
    return replace(carried, local=to_parents(pose_at(carried, retarget(rest, rig, carried), 0.0), rig.parents))


def _rest_pose(rig: Rig) -> Animation:
    """One key of every joint whose transform at rest is not that of the bind pose."""
    bound = to_parents(rig.bind, rig.parents)
    apart = np.abs(rig.local - bound).max(axis=(1, 2))
    joints = np.flatnonzero(apart > _SAME * max(1.0, float(np.ptp(rig.heads)))).tolist()
    return Animation("rest", rest_keys(rig, joints, ("translation", "rotation", "scale")))


def _with_bones(rig: Rig, heads: FloatArray, turns: FloatArray) -> FloatArray:
    """Turns of the joints' axes (j, 3, 3) with which bones point to their ends."""
    turned = turns.copy()
    for joint, child in _bone_ends(rig).items():
        turned[joint] = turns[joint] @ least_rotation(
            (rig.heads[child] - rig.heads[joint]) @ turns[joint], heads[child] - heads[joint]
        )
    return turned


def _one_frame(rig: Rig) -> bool:
    """Whether all joints have the same axes, as VRM 0.x asks."""
    axes = nearest_rotations(rig.bind[:, :3, :3])
    return bool(np.abs(axes - axes[:1]).max(initial=0.0) < _SAME)


def _bone_ends(rig: Rig) -> dict[int, int]:
    """The child at the end of each joint's bone: the one along an axis, or the only one."""
    axes = nearest_rotations(rig.bind[:, :3, :3])
    ends: dict[int, int] = {}
    for joint in range(len(rig.names)):
        children = np.flatnonzero(rig.parents == joint)
        ways = rig.heads[children] - rig.heads[joint]
        lengths = np.linalg.norm(ways, axis=1)
        along = np.abs(ways @ axes[joint].T).max(axis=1, initial=0.0) / np.where(lengths > 0, lengths, np.inf)
        if len(children) == 1 or (len(children) and along.max() > _ALONG_AXIS):
            ends[joint] = int(children[along.argmax()])
    return ends
