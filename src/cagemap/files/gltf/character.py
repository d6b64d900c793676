"""Characters of glTF files: parts with weights and shapes, one rig, animations; VRM's humanoid bones."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cagemap.character.poses import quaternion_product
from cagemap.character.values import Animation, Channel, Character, Interpolation, Track
from cagemap.files.gltf.binary import Binary, add_channel
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.nodes import Joints, read_nodes, scale_signs
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.primitives import mesh_shapes
from cagemap.numerics.arrays import FloatArray, nearest_rotations

_log = logging.getLogger(__name__)

_TYPES = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}


def read_character(path: str | Path) -> Character:
    """Read a glTF or VRM file as a character."""
    return character_of(read_document(path))


def character_of(document: Document, *, props: bool = False) -> Character:
    """The character in a document: mesh nodes as parts, joints of all skins as one rig, their animations.

    Warns of tangents of morph targets, which are left out; programs compute them from normals and UVs. ``props``: see
    `read_scene`.
    """
    scene = read_scene(document, props=props)
    rig = None if scene.joints is None else scene.joints.rig
    if any(_has_tangents(document, read_part.node) for read_part in scene.parts):
        _log.warning("%s: tangents of blend shapes are left out; programs compute them", document.file)
    return Character(tuple(read_part.part for read_part in scene.parts), rig, read_animations(scene))


def _has_tangents(document: Document, node: int) -> bool:
    """Whether morph targets of a node's mesh, which was read, have tangents."""
    primitives = document.entries("primitives", document.entry("meshes", document.entry("nodes", node)["mesh"]))
    targets = (target for primitive in primitives for target in document.entries("targets", primitive))
    return any("TANGENT" in target for target in targets)


def humanoid_bones(document: Document) -> dict[str, str]:
    """Names of nodes by VRM's names of humanoid bones; empty if the document is no VRM."""
    extensions = document.table(document.json, "extensions", "glTF")
    names = read_nodes(document).names
    stated: list[tuple[Any, Any]] = []
    for extension in ("VRM", "VRMC_vrm"):
        humanoid = document.table(document.table(extensions, extension, "extensions"), "humanoid", extension)
        bones = humanoid.get("humanBones", {})
        if isinstance(bones, list):  # VRM 0
            stated += [(bone.get("bone"), bone.get("node")) for bone in bones if isinstance(bone, dict)]
        elif isinstance(bones, dict):
            stated += [(name, bone.get("node")) for name, bone in bones.items() if isinstance(bone, dict)]
    return {
        name: names[document.whole(node, f"humanBones {name}: node", 0, len(names) - 1)]
        for name, node in stated
        if isinstance(name, str)
    }


def read_animations(scene: Scene) -> tuple[Animation, ...]:
    """Animations of the joints; channels of other nodes and of morph weights are only in the document."""
    document = scene.document
    animations = []
    for number, name in enumerate(animation_names(document)):
        entry, where = document.entry("animations", number), f"animations {number}"
        tracks = [] if scene.joints is None else _tracks(document, scene.joints, entry, where)
        animations.append(Animation(name, tuple(tracks)))
    return tuple(animations)


# Times (k,), values (k, 1) or (k, 3, 1), and interpolation of a blend shape's weight, as in `Track`.
ShapeKeys = tuple[FloatArray, FloatArray, Interpolation]


def read_shape_keys(scene: Scene, animation: int | None) -> dict[tuple[str, str], ShapeKeys]:
    """Weights of blend shapes, by part and shape: keys of an animation, else the stated weight.

    Shapes that stay at 0 are left out. ``animation``: its number; None for the stated weights alone.
    """
    document, where = scene.document, f"animations {animation}"
    keys: dict[tuple[str, str], ShapeKeys] = {}
    names_of: dict[int, list[tuple[str, str]]] = {}
    for one in scene.parts:
        node = document.entry("nodes", one.node)
        mesh = document.entry("meshes", node["mesh"])
        names_of[one.node] = [(one.part.name, name) for name in mesh_shapes(document, int(node["mesh"]))]
        count = len(names_of[one.node])
        stated = document.numbers(
            node.get("weights", mesh.get("weights", [0.0] * count)), f"nodes {one.node}: weights", count
        )
        keys |= {
            name: (np.zeros(1), weight.reshape(1, 1), "LINEAR")
            for name, weight in zip(names_of[one.node], stated, strict=True)
            if weight
        }
    entry: dict[str, Any] = {} if animation is None else document.entry("animations", animation)
    for number, path, sampler in _channels(document, entry, where):
        names = names_of.get(number, [])
        if path != "weights" or not names:
            continue
        times, last, interpolation = _keys(document, sampler, where)
        between = (3,) if interpolation == "CUBICSPLINE" else ()
        count = len(times) * len(names) * int(np.prod(between))
        values = read_accessor(document, sampler.get("output"), where, ("SCALAR",), count).astype(np.float64)
        values = values.reshape(len(times), *between, len(names))
        values = values[last]
        keys |= {name: (times[last], values[..., [place]], interpolation) for place, name in enumerate(names)}
    return keys


def _channels(document: Document, entry: dict[str, Any], where: str) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Node, path and sampler of an animation's channels that move a node."""
    samplers = document.entries("samplers", entry, where)
    for channel in document.entries("channels", entry, where):
        target = document.table(channel, "target", where)
        if target.get("node") is not None and target.get("path") in (*get_args(Channel), "weights"):
            yield target["node"], target["path"], samplers[channel["sampler"]]


def _keys(
    document: Document, sampler: dict[str, Any], where: str
) -> tuple[FloatArray, NDArray[np.bool_], Interpolation]:
    """Times (k,) of a sampler, which keys to use (the last one of several at the same time), and its interpolation."""
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in get_args(Interpolation):
        document.refuse(where, f"expected the interpolation {', '.join(get_args(Interpolation))}")
    times = read_accessor(document, sampler.get("input"), where, ("SCALAR",)).astype(np.float64)
    steps = np.diff(times)
    if (steps < 0.0).any():
        document.refuse(where, "expected rising times")
    return times, np.append(steps > 0.0, True), interpolation


def _tracks(document: Document, joints: Joints, entry: dict[str, Any], where: str) -> list[Track]:
    channels = [
        (node, cast(Channel, path), sampler)
        for node, path, sampler in _channels(document, entry, where)
        if path != "weights" and joints.joint_of[node] >= 0
    ]
    tracks = [_track(document, joints, *channel, where) for channel in channels]
    inputs = {sampler["input"]: sampler for _, _, sampler in channels}
    if not all(_keys(document, sampler, where)[1].all() for sampler in inputs.values()):
        _log.warning("%s: %s has several keys at the same time, the last one is used", document.file, where)
    return tracks


def _track(
    document: Document, joints: Joints, node: int, channel: Channel, sampler: dict[str, Any], where: str
) -> Track:
    where = f"{where}: {channel} of {joints.rig.names[joints.joint_of[node]]}"
    times, last, interpolation = _keys(document, sampler, where)
    keys = 3 if interpolation == "CUBICSPLINE" else 1
    values = read_accessor(document, sampler.get("output"), where, (_TYPES[channel],), keys * len(times))
    values = values.astype(np.float64)
    if keys == 3:
        values = values.reshape(len(times), 3, -1)
    values = to_rig_space(values[last], channel, joints.above[node])
    signs = scale_signs(document, node)
    if channel == "scale":
        values = values * signs
    elif channel == "rotation" and (signs < 0.0).any():  # two of them: half a turn about the third axis
        values = quaternion_product(values, np.append(signs > 0.0, 0.0))
    if channel == "rotation" and keys == 1:
        lengths = np.linalg.norm(values, axis=-1, keepdims=True)
        if not (lengths > 0.0).all():
            document.refuse(where, "expected rotations, got quaternions of length 0")
        values = values / lengths
    return Track(int(joints.joint_of[node]), channel, times[last], values, interpolation)


def animation_entries(
    binary: Binary,
    animations: Sequence[Animation],
    nodes: Sequence[int],
    above: Mapping[int, FloatArray],
    before: Sequence[Any],
    given: Document,
    shapes: Mapping[int, tuple[Sequence[str], Sequence[str]]],
) -> list[dict[str, Any]]:
    """Entries of ``animations``: tracks of joints, and the given document's other channels.

    ``nodes``: node of each joint.
    ``above``: transforms by node, see `cagemap.files.gltf.nodes.Joints`.
    ``before``: entries of ``given``, in its order.
    ``given``: the document of these entries.
    ``shapes``: names of blend shapes by node, in the given document and now; weights of new ones are 0.
    """
    named = dict(zip(animation_names(given), before, strict=True))
    times: dict[bytes, int] = {}
    entries = []
    for animation in animations:
        old = named.pop(animation.name, {})
        entry = {name: value for name, value in old.items() if name not in ("samplers", "channels")}
        entry |= _other_channels(binary, old, set(nodes), shapes, given)
        for track in animation.tracks:
            node = nodes[track.joint]
            key = np.asarray(track.times, "<f4").tobytes()
            if key not in times:
                times[key] = binary.times(track.times)
            output = transform_track(track, np.asarray(np.linalg.inv(above.get(node, np.eye(4))))).values
            values = binary.accessor(output.reshape(-1, output.shape[-1]).astype("<f4"))
            sampler = {"input": times[key], "interpolation": track.interpolation, "output": values}
            add_channel(entry, node, track.channel, sampler)
        if entry["channels"]:
            entries.append({"name": animation.name} | entry)
    return entries


def animation_names(document: Document) -> tuple[str, ...]:
    """Unique names of all animations; unnamed ones are called by their number."""
    return document.unique_names("animations", "animation")


def animation_lengths(document: Document) -> tuple[float, ...]:
    """Duration in seconds of every animation, whatever it moves."""
    lengths = []
    for number in range(len(document.entries("animations"))):
        where = f"animations {number}"
        samplers = document.entries("samplers", document.entry("animations", number), where)
        inputs = {sampler["input"] for sampler in samplers}
        ends = [float(read_accessor(document, accessor, where, ("SCALAR",)).max()) for accessor in inputs]
        lengths.append(max(ends, default=0.0))
    return tuple(lengths)


def _other_channels(
    binary: Binary,
    entry: dict[str, Any],
    joints: set[int],
    shapes: Mapping[int, tuple[Sequence[str], Sequence[str]]],
    given: Document,
) -> dict[str, list[Any]]:
    """Channels of an animation that move no joints, with their samplers."""
    samplers: list[Any] = []
    channels: list[Any] = []
    for channel in entry.get("channels", []):
        target = channel.get("target", {})
        node, path = target.get("node"), target.get("path")
        sampler = entry["samplers"][channel["sampler"]]
        if node in joints and path != "weights":
            continue
        if path == "weights" and node is not None:
            before, now = shapes.get(node, ((), ()))
            keys = given.entry("accessors", sampler["input"])["count"]
            keys *= 3 if sampler.get("interpolation") == "CUBICSPLINE" else 1
            count = given.entry("accessors", sampler["output"])["count"]
            if not set(before) & set(now) or count != keys * len(before):
                continue
            if list(before) != list(now):
                values = read_accessor(given, sampler["output"], "animations", ("SCALAR",)).astype(np.float64)
                table = reorder_columns(values.reshape(-1, len(before)), before, now)
                sampler = sampler | {"output": binary.accessor(table.astype("<f4").ravel())}
        samplers.append(sampler)
        channels.append(channel | {"sampler": len(samplers) - 1})
    return {"samplers": samplers, "channels": channels}


def reorder_columns(values: FloatArray, before: Sequence[str], now: Sequence[str]) -> FloatArray:
    """Columns (k, before) in the order of other names (k, now); 0 for names that were not there before."""
    number = {name: place for place, name in enumerate(before)}
    columns = [values[:, number[name]] if name in number else np.zeros(len(values)) for name in now]
    return np.column_stack(columns)


def transform_track(track: Track, above: FloatArray) -> Track:
    """A track of a joint whose parent's space is transformed by a similarity (4, 4)."""
    return replace(track, values=to_rig_space(track.values, track.channel, above))


def to_rig_space(values: FloatArray, channel: Channel, above: FloatArray) -> FloatArray:
    """Values of a track, converted from the space of the joint's node to that of its parent in the rig.

    ``values``: (k, q), or between their tangents (k, 3, q).
    ``above``: (4, 4), a similarity.
    """
    if np.array_equal(above, np.eye(4)):
        return values
    size = float(np.cbrt(np.linalg.det(above[:3, :3])))  # negative for a mirror: its scales are negative too
    if channel == "scale":
        return values * size
    if channel == "translation":
        moved = values @ above[:3, :3]
        if values.ndim == 3:
            moved[:, 1] += above[3, :3]
            return moved
        return np.asarray(moved + above[3, :3])
    turn = nearest_rotations(above[None, :3, :3] / size)[0]
    return quaternion_product(Rotation.from_matrix(turn.T).as_quat(), values)
