"""Characters of glTF files: parts with weights and shapes, one rig, animations; humanoid bones of VRM."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from cagemap.character.values import Animation, Channel, Character, Interpolation, Track
from cagemap.files.gltf.accessors import read_accessor
from cagemap.files.gltf.animations import animation_names, in_rig
from cagemap.files.gltf.document import Document, read_document
from cagemap.files.gltf.nodes import read_nodes
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.skins import Joints

_TYPES = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}


def read_character(path: str | Path) -> Character:
    """Read a glTF or VRM file as a character.

    Raises
    ------
    FormatError
        As `cagemap.files.gltf.document.read_document`; also if the scene has no triangles, or arrays do not fit
        together.
    """
    return character_of(read_document(path))


def character_of(document: Document) -> Character:
    """The character in a document: mesh nodes as parts, joints of all skins as one rig, their animations."""
    scene = read_scene(document)
    rig = None if scene.joints is None else scene.joints.rig
    return Character(tuple(one.part for one in scene.parts), rig, read_animations(scene))


def humanoid_bones(document: Document) -> dict[str, str]:
    """Names of nodes by VRM's names of humanoid bones; empty where a document is no VRM.

    Raises
    ------
    FormatError
        If a bone is no node.
    """
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
    """Animations of the joints; channels of other nodes and of morph weights stay in the document."""
    document = scene.document
    found = []
    for number, name in enumerate(animation_names(document)):
        entry, where = document.entry("animations", number), f"animations {number}"
        tracks = [] if scene.joints is None else _tracks(document, scene.joints, entry, where)
        found.append(Animation(name, tuple(tracks)))
    return tuple(found)


def _tracks(document: Document, joints: Joints, entry: dict[str, Any], where: str) -> list[Track]:
    samplers = document.entries("samplers", entry, where)
    tracks = []
    for channel in document.entries("channels", entry, where):
        if not isinstance(channel, dict):
            document.refuse(where, "expected objects as channels")
        target = document.table(channel, "target", where)
        path = target.get("path")
        if target.get("node") is None or path not in get_args(Channel):
            continue
        node = document.whole(target["node"], f"{where}: node", 0, len(joints.joint_of) - 1)
        sampler = samplers[document.whole(channel.get("sampler"), f"{where}: sampler", 0, len(samplers) - 1)]
        if not isinstance(sampler, dict):
            document.refuse(where, "expected objects as samplers")
        if joints.joint_of[node] >= 0:
            tracks.append(_track(document, joints, node, cast(Channel, path), sampler, where))
    return tracks


def _track(
    document: Document, joints: Joints, node: int, channel: Channel, sampler: dict[str, Any], where: str
) -> Track:
    where = f"{where}: {channel} of {joints.rig.names[joints.joint_of[node]]}"
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in get_args(Interpolation):
        document.refuse(where, f"expected the interpolation {', '.join(get_args(Interpolation))}")
    times = read_accessor(document, sampler.get("input"), where, ("SCALAR",)).astype(np.float64)
    if np.any(np.diff(times) <= 0.0):
        document.refuse(where, "expected rising times")
    keys = 3 if interpolation == "CUBICSPLINE" else 1
    values = read_accessor(document, sampler.get("output"), where, (_TYPES[channel],), keys * len(times))
    values = values.astype(np.float64)
    if keys == 3:
        values = values.reshape(len(times), 3, -1)
    values = in_rig(values, channel, joints.above[node], tangents=keys == 3)
    if channel == "rotation" and keys == 1:
        lengths = np.linalg.norm(values, axis=-1, keepdims=True)
        if not (lengths > 0.0).all():
            document.refuse(where, "expected rotations, got quaternions of length 0")
        values = values / lengths
    return Track(int(joints.joint_of[node]), channel, times, values, interpolation)
