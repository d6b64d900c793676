"""Conversion of an FBX scene to a glTF document, in a child process (`cagemap.files.fbx.read`)."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import ufbx

from cagemap.errors import FormatError
from cagemap.files.fbx.materials import Materials
from cagemap.files.fbx.meshes import (
    FbxMesh,
    finite_array,
    get,
    keep_alive,
    list_attribute,
    node_name,
    read_fbx_mesh,
    row_matrix,
)
from cagemap.files.fbx.read import REFUSED
from cagemap.files.gltf.binary import Binary, add_channel
from cagemap.files.gltf.document import glb_bytes
from cagemap.files.gltf.geometry import mesh_entry, uv_sets_in_order
from cagemap.files.gltf.nodes import REST, decompose_transform, is_invertible, transform
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray

Note = Callable[[str], None]

_AXES = ufbx.CoordinateAxes(
    ufbx.CoordinateAxis.POSITIVE_X, ufbx.CoordinateAxis.POSITIVE_Y, ufbx.CoordinateAxis.POSITIVE_Z
)
# Conventions of glTF: metres, Y up, right-handed; nodes have only translation, rotation and scale.
_SPACE: dict[str, Any] = {
    "target_axes": _AXES,
    "target_unit_meters": 1.0,
    "space_conversion": ufbx.SpaceConversion.MODIFY_GEOMETRY,
    "geometry_transform_handling": ufbx.GeometryTransformHandling.PRESERVE,
    "inherit_mode_handling": ufbx.InheritModeHandling.COMPENSATE,
    "pivot_handling": ufbx.PivotHandling.ADJUST_TO_PIVOT,
    "handedness_conversion_axis": ufbx.MirrorAxis.X,
}
# Relative to the largest number of a transform: joints that differ by less are in their bind pose.
_MOVED = 1e-4
_CHANNELS = {"translation": "translation_keys", "rotation": "rotation_keys", "scale": "scale_keys"}
# Tracks whose values differ by less from those at rest are left out.
_SAME_VALUE = 1e-6
_LEFT_OUT = {
    "nurbs_surfaces": "NURBS surface",
    "nurbs_curves": "curve",
    "line_curves": "line",
    "lights": "light",
    "cameras": "camera",
    "cache_deformers": "geometry cache",
    "constraints": "constraint",
}


def main() -> None:
    """Read FBX from standard input, write GLB to standard output, notes and errors to standard error."""
    warnings.simplefilter("ignore")
    status = 0
    try:
        sys.stdout.buffer.write(fbx_glb(sys.stdin.buffer.read(), Path(sys.argv[2]), _note))
    except (ufbx.UfbxError, FormatError) as error:
        _note(str(error).replace("\n", " "))
        status = REFUSED
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # without freeing anything, see `cagemap.files.fbx.meshes`


def _note(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def fbx_glb(content: bytes, path: Path, note: Note) -> bytes:
    """An FBX file as GLB.

    ``path``: the FBX file, beside which textures are searched.
    ``note``: called with a line of text for everything that is left out.
    """
    scene = keep_alive(ufbx.load_memory(content, file_format=ufbx.FileFormat.FBX, **_SPACE))
    for warning in list_attribute(scene, "metadata", "warnings"):
        note(f"the FBX library says: {get(warning, 'description')} ({get(warning, 'count')} times)")
    left = [count_noun(len(found), what) for name, what in _LEFT_OUT.items() if (found := list_attribute(scene, name))]
    if left:
        note(f"left out: {', '.join(left)}")
    return _Scene(scene, path, note).glb()


# ``typed_id`` of a mesh, and the matrix that places it in the space of its node.
_Instance = tuple[int, bytes]


def _instance(node: Any) -> _Instance:
    return get(node, "mesh", "typed_id"), row_matrix(get(node, "geometry_to_node")).tobytes()


def _is_hidden(node: Any) -> bool:
    """Whether a node, or one above it whose visibility it inherits, is invisible."""
    while node is not None:
        if not get(node, "visible"):
            return True
        inherits = get(node, "props").find_bool("Visibility Inheritance", True)
        node = get(node, "parent") if inherits else None
    return False


class _Scene:
    """A glTF document built from an FBX scene."""

    def __init__(self, scene: Any, path: Path, note: Note) -> None:
        self._scene, self._note = scene, note
        self._nodes = [node for node in list_attribute(scene, "nodes") if not get(node, "is_root")]
        self._number = {get(node, "typed_id"): number for number, node in enumerate(self._nodes)}
        self._binary = Binary()
        self._materials = Materials(self._binary, path, note)
        self._read: dict[_Instance, FbxMesh | None] = {}
        self._meshes: list[dict[str, Any]] = []
        self._skins: list[dict[str, Any]] = []
        self._mesh_of: dict[tuple[_Instance, tuple[int, ...]], int] = {}
        self._skin_of: dict[_Instance, int] = {}

    def glb(self) -> bytes:
        """The document as GLB."""
        entries = [self._node(node) for node in self._nodes]
        before = self._in_bind_pose(entries)
        top: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "cagemap"},
            "scene": 0,
            "scenes": [{"nodes": [n for n, node in enumerate(self._nodes) if self._parent(node) is None]}],
            "nodes": entries,
        }
        mesh_of_node = {n: self._mesh(node) for n, node in enumerate(self._nodes) if "mesh" in entries[n]}
        meshes = {number: mesh for number, mesh in mesh_of_node.items() if mesh is not None}
        stacks = list_attribute(self._scene, "anim_stacks")
        moving = [self._animation(stack, entries, before, meshes) for stack in stacks]
        helpers = {n for n, node in enumerate(self._nodes) if get(node, "is_scale_helper") and "mesh" not in entries[n]}
        for entry in moving:
            kept = [channel for channel in entry["channels"] if channel["target"]["node"] not in helpers]
            if left := len(entry["channels"]) - len(kept):
                scales = count_noun(left, "moving scale")
                self._note(
                    f"animation {entry['name']}: {scales} left out, which children inherit otherwise than in glTF"
                )
            entry["channels"] = kept
            if not entry["channels"]:
                self._note(f"animation {entry['name']} moves nothing and is left out")
        for entry in entries:
            if "skin" in entry and "children" not in entry:  # without effect: the joints place a skinned mesh
                for name in REST:
                    entry.pop(name)
        lists = {
            "meshes": self._meshes,
            "skins": self._skins,
            "animations": [entry for entry in moving if entry["channels"]],
            **self._materials.lists,
        }
        document = self._binary.document(top | {name: entries for name, entries in lists.items() if entries})
        return glb_bytes(document)

    def _animation(
        self, stack: Any, entries: list[dict[str, Any]], before: dict[int, dict[str, Any]], meshes: dict[int, FbxMesh]
    ) -> dict[str, Any]:
        """Entry of an animation stack; without channels if nothing moves. ``before``: as by `_in_bind_pose`."""
        name = get(stack, "name")
        where = f"animation {name}: keys"
        baked = keep_alive(
            ufbx.bake_anim(
                self._scene,
                get(stack, "anim"),
                trim_start_time=True,
                key_reduction_enabled=True,
                key_reduction_rotation=True,
            )
        )
        sampled = {
            (node, path): (np.zeros(1), np.array([stated[path]]))
            for node, stated in before.items()
            for path in _CHANNELS
        }
        for moved in list_attribute(baked, "nodes"):
            node = self._number.get(get(moved, "typed_id"))
            for path, keys in _CHANNELS.items():
                times, values = _keys(moved, keys, where)
                if node is not None and len(times):
                    sampled[node, path] = times, values
        tracks = [
            (node, path, times, values)
            for (node, path), (times, values) in sampled.items()
            if np.abs(values - entries[node][path]).max() > _SAME_VALUE
        ]
        tracks += _weights(baked, meshes, where)
        begin = min((float(times.min()) for _, _, times, _ in tracks), default=0.0)
        if begin < 0.0:  # which glTF does not allow
            self._note(f"animation {name} begins {-begin:g} s before 0 and is moved to begin at 0")
        entry: dict[str, Any] = {"name": name, "samplers": [], "channels": []}
        for node, path, times, values in tracks:
            sampler = {
                "input": self._binary.accessor((times - min(begin, 0.0)).astype("<f4"), bounds=True),
                "output": self._binary.accessor(values.astype("<f4")),
            }
            add_channel(entry, node, path, sampler)
        return entry

    def _parent(self, node: Any) -> int | None:
        parent = get(node, "parent")
        return None if parent is None else self._number.get(get(parent, "typed_id"))

    def _node(self, node: Any) -> dict[str, Any]:
        name, rest = node_name(node), get(node, "local_transform")
        entry: dict[str, Any] = {"name": name}
        for part in REST:
            entry[part] = finite_array(list(getattr(rest, part)), f"node {name}: transform").tolist()
        children = [self._number[get(child, "typed_id")] for child in list_attribute(node, "children")]
        if children:
            entry["children"] = children
        mesh = self._mesh(node)
        if mesh is None:
            return entry
        if _is_hidden(node):
            self._note(f"{get(node, 'name')} is hidden and left out")
            return entry
        instance = _instance(node)
        uv_sets = [one.name for one in uv_sets_in_order(mesh.part.mesh)]
        materials = tuple(self._materials.number(material, uv_sets) for material in list_attribute(node, "materials"))
        if (instance, materials) not in self._mesh_of:
            self._mesh_of[instance, materials] = len(self._meshes)
            slots = range(len(mesh.part.mesh.material_names))
            numbers = [materials[slot] if slot < len(materials) else None for slot in slots]
            self._meshes.append(mesh_entry(self._binary, mesh.part, numbers))
        entry["mesh"] = self._mesh_of[instance, materials]
        if mesh.bones:
            if instance not in self._skin_of:
                self._skin_of[instance] = len(self._skins)
                joints = [self._number[bone] for bone in mesh.bones]
                inverse = self._binary.accessor(mesh.inverse_bind.reshape(-1, 16).astype("<f4"))
                self._skins.append({"joints": joints, "inverseBindMatrices": inverse})
            entry["skin"] = self._skin_of[instance]
        return entry

    def _in_bind_pose(self, entries: list[dict[str, Any]]) -> dict[int, dict[str, Any]]:
        """Move the joints to the bind pose; returns the transforms in the file of those that moved."""
        bind: dict[int, FloatArray] = {}
        for number, node in enumerate(self._nodes):
            if "skin" in entries[number] and (mesh := self._mesh(node)) is not None:
                sound = is_invertible(mesh.inverse_bind)
                to_world = row_matrix(get(node, "node_to_world"))
                for bone, inverse in zip(np.array(mesh.bones)[sound].tolist(), mesh.inverse_bind[sound], strict=True):
                    bind.setdefault(self._number[bone], np.linalg.inv(inverse) @ to_world)
        world: list[FloatArray] = []
        before: dict[int, dict[str, Any]] = {}
        for number, entry in enumerate(entries):
            local = transform(*(np.array(entry[name]) for name in REST))
            parent = self._parent(self._nodes[number])
            above = np.eye(4) if parent is None else world[parent]
            if number in bind and is_invertible(above[None]).all():
                bound = finite_array(bind[number] @ np.linalg.inv(above), f"node {entry['name']}: transform")
                pose = REST | decompose_transform(bound)
                if "matrix" not in pose and np.abs(bound - local).max() > _MOVED * max(np.abs(local).max(), 1e-30):
                    before[number] = {name: entry[name] for name in pose}
                    entry |= pose
                    local = bound
            world.append(local @ above)
        if before and not list_attribute(self._scene, "anim_stacks"):
            self._note(
                f"{len(before)} joints are posed in the file; they are taken in the pose in which meshes were bound"
            )
        return before

    def _mesh(self, node: Any) -> FbxMesh | None:
        if get(node, "mesh") is None:
            return None
        instance = _instance(node)
        if instance not in self._read:
            self._read[instance] = read_fbx_mesh(node, self._note)
        return self._read[instance]


def _weights(
    baked: Any, meshes: Mapping[int, FbxMesh], where: str
) -> Iterator[tuple[int, str, FloatArray, FloatArray]]:
    """Node, path, times (k,) and weights (k * s,) of the s shapes of every mesh with moving shapes."""
    props = {get(one, "element_id"): list_attribute(one, "props") for one in list_attribute(baked, "elements")}
    for node, mesh in meshes.items():
        keys = {}
        for place, channel in enumerate(mesh.channels):
            for prop in props.get(get(channel, "element_id"), []):
                if get(prop, "name") == "DeformPercent":
                    keys[place] = _keys(prop, "keys", where)
        if keys:
            times = np.unique(np.concatenate([key_times for key_times, _ in keys.values()]))
            rest = [mesh.part.shape_weights.get(name, 0.0) for name in mesh.part.shapes]
            amounts = np.tile(rest, (len(times), 1))
            for place, (key_times, values) in keys.items():
                amounts[:, place] = np.interp(times, key_times, values[:, 0] / 100.0)
            yield node, "weights", times, amounts.ravel()


def _keys(value: Any, name: str, where: str) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and values (k, q) of keys; the last one of several at the same time."""
    keys = list_attribute(value, name)
    times = np.array([get(key, "time") for key in keys], dtype=np.float64)
    values = finite_array([list(get(key, "value")) for key in keys], where)
    last = np.append(np.diff(times.astype("<f4")) > 0.0, True)[: len(times)]
    return times[last], values[last]
