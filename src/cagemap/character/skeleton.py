"""Transfer of a rig to another body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from cagemap.character.poses import (
    bone_ends,
    fit_rotation_and_scale,
    least_rotation,
    parent_transforms,
    pose_at,
    rest_tracks,
    rotations_of,
)
from cagemap.character.retarget import retarget_all
from cagemap.character.values import Animation, Part, Rig
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, box_diagonal
from cagemap.surface.alignment import fit_similarity
from cagemap.transfer.skin import carry_joints

# Joints' axes, or transforms, that differ less are equal.
AXES_TOLERANCE = 1e-6


def carry_rig(point_map: PointMap, rig: Rig, places: Mapping[int, FloatArray] | None = None) -> Rig:
    """The rig of the source's body, placed in the target's body.

    Joints move with the surface around them. An axis that points to a joint's child still does. Names, parents and
    scales stay. A rest pose that is not the bind pose is retargeted like an animation.

    Parameters
    ----------
    point_map : PointMap
        Of the target's body to the source's, both in the bind pose.
    rig : Rig
        In the source's file units.
    places : mapping of int to (3,) float64, optional
        Known places of joints, see `prop_joints`.

    Returns
    -------
    Rig
        In the target's file units.
    """
    heads, turns = carry_joints(point_map, rig.heads)
    for joint, place in (places or {}).items():
        heads[joint] = place
    bind = rig.bind.copy()
    bind[:, 3, :3] = heads
    bind[:, :3, :3] = rig.bind[:, :3, :3] @ _align_bones(rig, heads, turns)
    if _has_common_axes(rig):
        pairs = {joint: joint for joint in range(len(rig.names))}
        bind[:, :3, :3] = rig.bind[:, :3, :3] @ fit_rotation_and_scale(rig, replace(rig, bind=bind), pairs)[0]
    target_rig = Rig(rig.names, rig.parents, parent_transforms(bind, rig.parents), bind)
    rest_pose = _rest_pose(rig)
    if not rest_pose.tracks:
        return target_rig
    (retargeted,), _ = retarget_all([rest_pose], rig, target_rig)
    return replace(target_rig, local=parent_transforms(pose_at(target_rig, retargeted, 0.0), rig.parents))


def prop_joints(rig: Rig, props: Iterable[tuple[Part, Part]]) -> dict[int, FloatArray]:
    """Places on the target of joints inside a rigid passenger that they move, so that it turns about the same point.

    ``props``: passengers on the source and on the target.
    """
    places = {}
    for part, carried in props:
        joints = set() if part.weights is None else set(part.weights.indices.tolist())
        points, images = part.mesh.positions, carried.mesh.positions
        if len(joints) != 1:
            continue
        (joint,), (rotation, scale, shift) = joints, fit_similarity(points, images)
        head, misfit = rig.heads[joint], np.abs(scale * points @ rotation.T + shift - images).max()
        is_inside = (points.min(axis=0) <= head).all() and (head <= points.max(axis=0)).all()
        if is_inside and misfit < AXES_TOLERANCE * box_diagonal(images):
            places[joint] = scale * rotation @ head + shift
    return places


def _rest_pose(rig: Rig) -> Animation:
    """One key of every joint whose rest transform differs from its bind transform."""
    bind_local = parent_transforms(rig.bind, rig.parents)
    differences = np.abs(rig.local - bind_local).max(axis=(1, 2))
    joints = np.flatnonzero(differences > AXES_TOLERANCE * max(1.0, float(np.ptp(rig.heads)))).tolist()
    return Animation("rest", rest_tracks(rig, joints, ("translation", "rotation", "scale")))


def _align_bones(rig: Rig, heads: FloatArray, turns: FloatArray) -> FloatArray:
    """Rotations of the joints' axes (j, 3, 3), corrected so that bones point to their ends."""
    aligned = turns.copy()
    for joint, child in bone_ends(rig).items():
        aligned[joint] = turns[joint] @ least_rotation(
            (rig.heads[child] - rig.heads[joint]) @ turns[joint], heads[child] - heads[joint]
        )
    return aligned


def _has_common_axes(rig: Rig) -> bool:
    """Whether all joints have the same axes, as VRM 0.x requires."""
    axes = rotations_of(rig.bind)
    return bool(np.abs(axes - axes[:1]).max(initial=0.0) < AXES_TOLERANCE)
