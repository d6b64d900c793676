"""Animations of FBX scenes, sampled so that straight lines between keys do, as entries of a glTF document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ufbx

from cagemap.files.fbx.meshes import get, held, items
from cagemap.files.gltf.binary import Binary
from cagemap.numerics.arrays import FloatArray

_CHANNELS = {"translation": "translation_keys", "rotation": "rotation_keys", "scale": "scale_keys"}
# Values that differ less from those at rest do not move anything.
_SAME = 1e-6


def animation_entry(
    binary: Binary,
    scene: Any,
    stack: Any,
    nodes: Sequence[Mapping[str, Any]],
    before: Mapping[int, Mapping[str, Any]],
    numbers: Mapping[int, int],
    channels: Mapping[int, tuple[int, int, int]],
) -> dict[str, Any]:
    """Entry of ``animations`` for an animation stack; without channels where it moves nothing.

    ``nodes``: entries of the nodes, at rest.
    ``before``: transforms of the file, of nodes that have others now: where an animation does not move them.
    ``numbers``: number of each node by its ``typed_id``.
    ``channels``: by ``element_id`` of a blend channel: the mesh's node, which of its shapes, and how many it has.
    """
    baked = held(
        ufbx.bake_anim(
            scene, get(stack, "anim"), trim_start_time=True, key_reduction_enabled=True, key_reduction_rotation=True
        )
    )
    found = {
        (node, path): (np.zeros(1), np.array([stated[path]])) for node, stated in before.items() for path in _CHANNELS
    }
    for moved in items(baked, "nodes"):
        node = numbers.get(get(moved, "typed_id"))
        for path, name in _CHANNELS.items():
            times, values = _keys(moved, name)
            if node is not None and len(times):
                found[node, path] = times, values
    tracks = [
        (node, path, times, values)
        for (node, path), (times, values) in found.items()
        if np.abs(values - nodes[node][path]).max() > _SAME
    ]
    tracks += [(node, "weights", times, values.ravel()) for node, (times, values) in _weights(baked, channels).items()]
    entry: dict[str, Any] = {"name": get(stack, "name"), "samplers": [], "channels": []}
    for node, path, times, values in tracks:
        key = times.astype("<f4")
        sampler = {
            "input": binary.accessor(key, min=[float(key.min())], max=[float(key.max())]),
            "output": binary.accessor(values.astype("<f4")),
        }
        entry["channels"].append({"sampler": len(entry["samplers"]), "target": {"node": node, "path": path}})
        entry["samplers"].append(sampler)
    return entry


def _weights(baked: Any, channels: Mapping[int, tuple[int, int, int]]) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Times (k,) and amounts (k, shapes) of the shapes of each mesh node whose shapes move."""
    found: dict[int, dict[int, tuple[FloatArray, FloatArray]]] = {}
    for element in items(baked, "elements"):
        if get(element, "element_id") in channels:
            node, place, _ = channels[get(element, "element_id")]
            for prop in items(element, "props"):
                if get(prop, "name") == "DeformPercent":
                    times, values = _keys(prop, "keys")
                    found.setdefault(node, {})[place] = times, values[:, 0] / 100.0
    counts = {node: count for node, _, count in channels.values()}
    made = {}
    for node, keys in found.items():
        times = np.unique(np.concatenate([own for own, _ in keys.values()]))
        amounts = np.zeros((len(times), counts[node]))
        for place, (own, values) in keys.items():
            amounts[:, place] = np.interp(times, own, values)
        made[node] = times, amounts
    return made


def _keys(value: Any, name: str) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and values (k, q) of keys; of those at one time the last."""
    keys = items(value, name)
    times = np.array([get(key, "time") for key in keys], dtype=np.float64)
    values = np.array([list(get(key, "value")) for key in keys], dtype=np.float64)
    last = np.append(np.diff(times.astype("<f4")) > 0.0, True)[: len(times)]
    return times[last], values[last]
