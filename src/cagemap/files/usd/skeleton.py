"""Skeletons in USD: `UsdSkel` joints with their bind transforms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.joints import Skeleton, tails_of
from cagemap.character.poses import parent_transforms, rotations_of
from cagemap.errors import FormatError
from cagemap.files.usd.prims import bind_transform, index_array, transform_points
from cagemap.files.usd.read import one_mesh, read_usd_meshes
from cagemap.files.usd.stages import damage_as_error, identifiers, open_stage, pxr
from cagemap.mesh import ControlMesh
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
