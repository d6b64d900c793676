"""Characters of glTF files: parts with weights and shapes, one rig, animations; VRM's humanoid bones."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cagemap.character.poses import quaternion_product
from cagemap.character.values import Animation, Channel, Character, Interpolation, ShapeTrack, Track
from cagemap.files.gltf.binary import Binary, add_channel, remove_unused
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.nodes import Joints, read_nodes, scale_signs
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.primitives import node_shapes
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
    meshes = [document.entry("meshes", document.entry("nodes", one.node)["mesh"]) for one in scene.parts]
    primitives = [primitive for mesh in meshes for primitive in document.entries("primitives", mesh)]
    if any("TANGENT" in target for primitive in primitives for target in document.entries("targets", primitive)):
        _log.warning("%s: tangents of blend shapes are left out; programs compute them", document.file)
    return Character(tuple(read_part.part for read_part in scene.parts), rig, read_animations(scene))


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
    """Animations of joints and blend shapes; channels of other nodes are only in the document."""
    document, joints = scene.document, scene.joints
    shapes_of = {one.node: (one.part.name, node_shapes(document, one.node)) for one in scene.parts}
    animations = []
    for number, name in enumerate(animation_names(document)):
        entry, where = document.entry("animations", number), f"animations {number}"
        tracks, shape_tracks, samplers = list[Track](), list[ShapeTrack](), dict[int, dict[str, Any]]()
        for node, path, sampler in _channels(document, entry, where):
            part, shapes = shapes_of.get(node, ("", ()))
            if path == "weights" and shapes:
                shape_tracks += _shape_tracks(document, part, shapes, sampler, where)
            elif path != "weights" and joints is not None and joints.joint_of[node] >= 0:
                tracks.append(_track(document, joints, node, cast(Channel, path), sampler, where))
            else:
                continue
            samplers[sampler["input"]] = sampler
        if not all(_keys(document, sampler, where)[1].all() for sampler in samplers.values()):
            _log.warning("%s: %s has several keys at the same time, the last one is used", document.file, where)
        animations.append(Animation(name, tuple(tracks), tuple(shape_tracks)))
    return tuple(animations)


def _shape_tracks(
    document: Document, part: str, shapes: tuple[str, ...], sampler: dict[str, Any], where: str
) -> Iterator[ShapeTrack]:
    """Weights of a part's blend shapes; none, with a warning, if their number is not that of the keys and shapes."""
    times, last, interpolation = _keys(document, sampler, where)
    shape = (len(times), 3, len(shapes)) if interpolation == "CUBICSPLINE" else (len(times), len(shapes))
    count, found = int(np.prod(shape)), document.entry("accessors", sampler["output"], where)["count"]
    if found != count:
        text = "%s: %s: weights of %s are left out: expected %d values, got %d"
        _log.warning(text, document.file, where, part, count, found)
        return
    values = read_accessor(document, sampler["output"], where, ("SCALAR",), count).astype(np.float64)
    yield ShapeTrack(part, shapes, times[last], values.reshape(shape)[last], interpolation)


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
    character: Character,
    joints: Sequence[int],
    parts: Sequence[int],
    above: Mapping[int, FloatArray],
    given: Document,
) -> list[dict[str, Any]]:
    """Entries of ``animations``: tracks of joints and blend shapes, and the given document's channels of other nodes.

    ``joints``, ``parts``: node of each joint and part.
    ``above``: transforms by node, see `cagemap.files.gltf.nodes.Joints`.
    """
    named = dict(zip(animation_names(given), given.entries("animations"), strict=True))
    numbers: dict[bytes, int] = {}
    entries = []

    def add(entry: dict[str, Any], node: int, path: str, track: Track | ShapeTrack, values: FloatArray) -> None:
        times = track.times.astype("<f4")
        key = times.tobytes()
        if key not in numbers:
            numbers[key] = binary.accessor(times, bounds=True)
        output = binary.accessor(values.astype("<f4"))
        add_channel(entry, node, path, {"input": numbers[key], "interpolation": track.interpolation, "output": output})

    for animation in character.animations:
        old = named.pop(animation.name, {})
        entry = {name: value for name, value in old.items() if name not in ("samplers", "channels")}
        entry |= _other_channels(old, set(joints))
        for track in animation.tracks:
            node = joints[track.joint]
            values = transform_track(track, np.asarray(np.linalg.inv(above.get(node, np.eye(4))))).values
            add(entry, node, track.channel, track, values.reshape(-1, values.shape[-1]))
        for part, node in zip(character.parts, parts, strict=True):
            for shape_track in animation.shape_tracks_of(part):
                add(entry, node, "weights", shape_track, shape_track.values_of(part).ravel())
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


def with_starts_at_zero(document: Document) -> tuple[Document, dict[str, float]]:
    """A document whose animations have their first key at 0; and when others started, in seconds, by name.

    A channel with one key is a pose and does not start an animation.
    """
    binary, top = Binary(document), json.loads(json.dumps(document.json))
    starts = dict[str, float]()
    for name, entry in zip(animation_names(document), top.get("animations", []), strict=True):
        inputs = {sampler["input"] for sampler in entry["samplers"]}
        times = {one: read_accessor(document, one, f"animation {name}", ("SCALAR",)) for one in inputs}
        start = min((keys[0] for keys in times.values() if len(keys) > 1), default=0.0)
        if start > 0.0:
            starts[name] = float(start)
            moved = {one: np.maximum(keys - start, 0.0).astype("<f4") for one, keys in times.items()}
            numbers = {one: binary.accessor(keys, bounds=True) for one, keys in moved.items()}
            for sampler in entry["samplers"]:
                sampler["input"] = numbers[sampler["input"]]
    return (remove_unused(binary.document(top)) if starts else document), starts


def _other_channels(entry: dict[str, Any], joints: set[int]) -> dict[str, list[Any]]:
    """Channels of an animation that move neither joints nor blend shapes of a node, with their samplers."""
    channels = [
        channel
        for channel in entry.get("channels", [])
        if (target := channel.get("target", {})).get("node") is None
        or (target.get("path") != "weights" and target["node"] not in joints)
    ]
    samplers = [entry["samplers"][channel["sampler"]] for channel in channels]
    return {"samplers": samplers, "channels": [one | {"sampler": place} for place, one in enumerate(channels)]}


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
