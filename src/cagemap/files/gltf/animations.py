"""Animations of a character as entries of a glTF document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.character.values import Animation, Channel, Track
from cagemap.files.gltf.accessors import read_accessor
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.nodes import distinct
from cagemap.numerics.arrays import FloatArray


def animation_entries(
    binary: Binary,
    animations: Sequence[Animation],
    nodes: Sequence[int],
    above: Mapping[int, FloatArray],
    before: Sequence[Any],
    given: Document | None,
    targets: Sequence[int],
) -> list[dict[str, Any]]:
    """Entries of ``animations``: tracks of joints, and of a document's own what moves other things.

    Parameters
    ----------
    binary : Binary
    animations : sequence of Animation
    nodes : sequence of int
        Node of each joint.
    above : dict of int to (4, 4) float64
        See `cagemap.files.gltf.skins.Joints`, by node.
    before : sequence of dict
        Entries of the document, in the order of animations of the same name.
    given : Document or None
        Whose entries these are.
    targets : sequence of int
        Number of blend shapes that each node's mesh has now.
    """
    named = {} if given is None else dict(zip(animation_names(given), before, strict=True))
    times: dict[bytes, int] = {}
    found = []
    for animation in animations:
        old = named.pop(animation.name, {})
        kept = _kept(old, set(nodes), targets, given)
        entry = {name: value for name, value in old.items() if name not in ("samplers", "channels")} | kept
        for track in animation.tracks:
            node = nodes[track.joint]
            key = np.asarray(track.times, "<f4")
            if key.tobytes() not in times:
                times[key.tobytes()] = binary.accessor(key, min=[float(key.min())], max=[float(key.max())])
            output = _to_node(track, above.get(node, np.eye(4)))
            sampler = {
                "input": times[key.tobytes()],
                "interpolation": track.interpolation,
                "output": binary.accessor(output.reshape(-1, output.shape[-1]).astype("<f4")),
            }
            entry["samplers"].append(sampler)
            target = {"node": node, "path": track.channel}
            entry["channels"].append({"sampler": len(entry["samplers"]) - 1, "target": target})
        if entry["channels"]:
            found.append({"name": animation.name} | entry)
    return found


def animation_names(document: Document) -> tuple[str, ...]:
    """Different names of all animations; those without have one of their number."""
    count = len(document.entries("animations"))
    return distinct([document.name("animations", number) or f"animation {number}" for number in range(count)])


def animation_lengths(document: Document) -> tuple[float, ...]:
    """Seconds of every animation, of joints or of anything else.

    Raises
    ------
    FormatError
        If times are no numbers.
    """
    found = []
    for number in range(len(document.entries("animations"))):
        where = f"animations {number}"
        samplers = document.entries("samplers", document.entry("animations", number), where)
        inputs = [sampler.get("input") for sampler in samplers if isinstance(sampler, dict)]
        different = [one for place, one in enumerate(inputs) if one not in inputs[:place]]
        ends = [float(read_accessor(document, one, where, ("SCALAR",)).max()) for one in different]
        found.append(max(ends, default=0.0))
    return tuple(found)


def _kept(
    entry: dict[str, Any], joints: set[int], targets: Sequence[int], given: Document | None
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
        if path == "weights" and node is not None and given is not None:
            keys = given.entry("accessors", sampler["input"])["count"]
            keys *= 3 if sampler.get("interpolation") == "CUBICSPLINE" else 1
            if given.entry("accessors", sampler["output"])["count"] != keys * targets[node]:
                continue
        samplers.append(sampler)
        channels.append(channel | {"sampler": len(samplers) - 1})
    return {"samplers": samplers, "channels": channels}


def in_rig(values: FloatArray, channel: Channel, above: FloatArray, *, tangents: bool) -> FloatArray:
    """Values of a track, stated in the space of the joint's node, in that of its parent in the rig.

    Parameters
    ----------
    values : (k, q) or (k, 3, q) float64
    channel : str
    above : (4, 4) float64
        A similarity.
    tangents : bool
        Whether values stand between their tangents, (k, 3, q).
    """
    if np.array_equal(above, np.eye(4)):
        return values
    size = float(np.cbrt(abs(np.linalg.det(above[:3, :3]))))
    if channel == "scale":
        return values * size
    if channel == "translation":
        moved = values @ above[:3, :3]
        if tangents:
            moved[:, 1] += above[3, :3]
            return moved
        return np.asarray(moved + above[3, :3])
    return _after(values, _quaternion(above[:3, :3] / size))


def _to_node(track: Track, above: FloatArray) -> FloatArray:
    """Undo `in_rig`."""
    tangents = track.interpolation == "CUBICSPLINE"
    return in_rig(track.values, track.channel, np.asarray(np.linalg.inv(above), np.float64), tangents=tangents)


def _after(first: FloatArray, then: FloatArray) -> FloatArray:
    """(..., 4) the rotations ``first``, then one more; linear in both."""
    axis, angle = then[:3], then[3]
    inner, w = first[..., :3], first[..., 3:]
    turned = angle * inner + w * axis + np.cross(axis, inner)
    return np.concatenate([turned, angle * w - inner @ axis[:, None]], axis=-1)


def _quaternion(turn: FloatArray) -> FloatArray:
    """(4,) x, y, z, w of a rotation (3, 3) for points as rows, or of the nearest one."""
    u, _, vt = np.linalg.svd(turn)
    nearest = u @ vt
    return np.asarray(Rotation.from_matrix(nearest.T * np.linalg.det(nearest)).as_quat())
