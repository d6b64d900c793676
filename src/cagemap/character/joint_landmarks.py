"""Landmarks of two bodies from the joints of their rigs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cagemap.character.bones import SIDES, humanoid_names
from cagemap.character.poses import pose_towards, turn_and_scale
from cagemap.character.values import Rig
from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray

# Bones that end at the tip of a part, and the bones before them, which say where the tip lies.
_TIPS: Mapping[str, str] = {"head": "neck"} | {
    side + bone: side + before
    for side in SIDES
    for bone, before in (
        ("MiddleDistal", "MiddleIntermediate"),
        ("LittleDistal", "LittleIntermediate"),
        ("ThumbDistal", "ThumbProximal"),
        ("Toes", "Foot"),
    )
}
# Bones in the middle of the body, which has a front and a back there.
_MIDDLE = ("spine", "chest", "neck")
# Bones that say which way the body faces.
_FACING = ("spine", "neck", "leftUpperArm", "rightUpperArm")


def joint_landmarks(target: ControlMesh, target_rig: Rig, source: ControlMesh, source_rig: Rig) -> Landmarks:
    """Points of two bodies that correspond because their joints do: tips of head, fingers and toes, front and back.

    A ray from a joint of the source leaves its surface at one point, a ray from the target's joint, turned as the bone
    is, at the other. Poses may differ. Landmarks are as far apart as the joints of two makers are.

    Parameters
    ----------
    target, source : ControlMesh
    target_rig, source_rig : Rig
        In the poses of the meshes, which are their bind poses.

    Returns
    -------
    Landmarks
        At most 15; fewer where bones have no names or rays miss.

    Raises
    ------
    ParameterError
        If the rigs do not have the bones that say which way the bodies face.
    """
    own, other = humanoid_names(source_rig), humanoid_names(target_rig)
    common = {bone: (joint, other[bone]) for bone, joint in own.items() if bone in other}
    missing = [bone for bone in _FACING if bone not in common]
    if missing:
        raise ParameterError(f"rigs: expected both to have {', '.join(_FACING)}, got none for {', '.join(missing)}")
    heads = {bone: source_rig.heads[joints[0]] for bone, joints in common.items()}
    rays = {f"{bone} tip": (bone, heads[bone] - heads[end]) for bone, end in _TIPS.items() if {bone, end} <= set(heads)}
    front = np.cross(heads["leftUpperArm"] - heads["rightUpperArm"], heads["neck"] - heads["spine"])
    for bone in _MIDDLE:
        if bone in common:
            rays |= {f"{bone} front": (bone, front), f"{bone} back": (bone, -front)}
    # From the source's directions to the target's: as each bone is turned, then the body as a whole.
    posed = np.linalg.inv(source_rig.bind) @ pose_towards(source_rig, target_rig, own, other)
    turn = turn_and_scale(source_rig, target_rig, dict(common.values()))[0]
    points: tuple[list[_Hit], list[_Hit]] = ([], [])
    names = []
    for name, (bone, direction) in rays.items():
        joints = common[bone]
        turned = direction @ posed[joints[0], :3, :3] @ turn
        hits = _leaves(target, target_rig.heads[joints[1]], turned), _leaves(source, heads[bone], direction)
        if hits[0] is not None and hits[1] is not None:
            names.append(name)
            points[0].append(hits[0])
            points[1].append(hits[1])
    if not names:
        return Landmarks.none()
    there, here = (CagePoints(*(np.array(arrays) for arrays in zip(*hits, strict=True))) for hits in points)
    return Landmarks(tuple(names), there.vertices, here.vertices, target.name, source.name, there, here)


_Hit = tuple[IndexArray, FloatArray]


def _leaves(mesh: ControlMesh, start: FloatArray, direction: FloatArray) -> _Hit | None:
    """Corners (3,) and their weights (3,) where a ray first comes out of a mesh (Moller and Trumbore 1997)."""
    corners = cage_triangles(mesh)[0]
    first, one, other = (mesh.positions[corners[:, k]] for k in range(3))
    one, other = one - first, other - first
    normals = np.cross(one, other)
    ahead = np.flatnonzero(normals @ direction > 0)
    first, one, other, normals = (array[ahead] for array in (first, one, other, normals))
    away = start - first
    across = np.cross(away, direction)
    # Solves start + t direction = first + u one + v other, by Cramer's rule.
    size = normals @ direction
    u, v = -np.einsum("nd,nd->n", across, other) / size, np.einsum("nd,nd->n", across, one) / size
    t = -np.einsum("nd,nd->n", away, normals) / size
    hit = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))
    if not len(hit):
        return None
    at = hit[t[hit].argmin()]
    return corners[ahead[at]], np.array([1 - u[at] - v[at], u[at], v[at]])
