"""Animations of FBX scenes as entries of a glTF document, sampled for linear interpolation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import ufbx

from cagemap.files.fbx.meshes import finite_array, get, keep_alive, list_attribute
from cagemap.files.gltf.binary import Binary, add_channel
from cagemap.numerics.arrays import FloatArray

_CHANNELS = {"translation": "translation_keys", "rotation": "rotation_keys", "scale": "scale_keys"}
# Tracks whose values differ by less from those at rest are left out.
_SAME_VALUE = 1e-6


def animation_entry(
    binary: Binary,
    scene: Any,
    stack: Any,
    nodes: Sequence[Mapping[str, Any]],
    before: Mapping[int, Mapping[str, Any]],
    numbers: Mapping[int, int],
    channels: Mapping[int, list[tuple[int, int, list[float]]]],
    note: Callable[[str], None],
) -> dict[str, Any]:
    """Entry of ``animations`` for an animation stack; without channels if nothing moves.

    ``nodes``: entries of the nodes, at rest.
    ``before``: transforms in the file of nodes whose entries were changed; used where no track moves such a node.
    ``numbers``: number of each node by its ``typed_id``.
    ``channels``: by ``element_id`` of a blend channel, for each node with its mesh: the node, number of the shape,
        weights of all its shapes at rest.
    """
    name = get(stack, "name")
    where = f"animation {name}: keys"
    baked = keep_alive(
        ufbx.bake_anim(
            scene, get(stack, "anim"), trim_start_time=True, key_reduction_enabled=True, key_reduction_rotation=True
        )
    )
    sampled = {
        (node, path): (np.zeros(1), np.array([stated[path]])) for node, stated in before.items() for path in _CHANNELS
    }
    for moved in list_attribute(baked, "nodes"):
        node = numbers.get(get(moved, "typed_id"))
        for path, keys in _CHANNELS.items():
            times, values = _keys(moved, keys, where)
            if node is not None and len(times):
                sampled[node, path] = times, values
    tracks = [
        (node, path, times, values)
        for (node, path), (times, values) in sampled.items()
        if np.abs(values - nodes[node][path]).max() > _SAME_VALUE
    ]
    tracks += [
        (node, "weights", times, values.ravel()) for node, (times, values) in _weights(baked, channels, where).items()
    ]
    begin = min((float(times.min()) for _, _, times, _ in tracks), default=0.0)
    if begin < 0.0:  # which glTF does not allow
        note(f"animation {name} begins {-begin:g} s before 0 and is moved to begin at 0")
    entry: dict[str, Any] = {"name": name, "samplers": [], "channels": []}
    for node, path, times, values in tracks:
        sampler = {"input": binary.times(times - min(begin, 0.0)), "output": binary.accessor(values.astype("<f4"))}
        add_channel(entry, node, path, sampler)
    return entry


def _weights(
    baked: Any, channels: Mapping[int, list[tuple[int, int, list[float]]]], where: str
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Times (k,) and weights (k, shapes) of the shapes of every mesh node with moving shapes."""
    keys_of: dict[int, dict[int, tuple[FloatArray, FloatArray]]] = {}
    for element in list_attribute(baked, "elements"):
        for node, place, _ in channels.get(get(element, "element_id"), []):
            for prop in list_attribute(element, "props"):
                if get(prop, "name") == "DeformPercent":
                    times, values = _keys(prop, "keys", where)
                    keys_of.setdefault(node, {})[place] = times, values[:, 0] / 100.0
    at_rest = {node: amounts for users in channels.values() for node, _, amounts in users}
    tracks = {}
    for node, keys in keys_of.items():
        times = np.unique(np.concatenate([key_times for key_times, _ in keys.values()]))
        amounts = np.tile(at_rest[node], (len(times), 1))
        for place, (key_times, values) in keys.items():
            amounts[:, place] = np.interp(times, key_times, values)
        tracks[node] = times, amounts
    return tracks


def _keys(value: Any, name: str, where: str) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and values (k, q) of keys; the last one of several at the same time."""
    keys = list_attribute(value, name)
    times = np.array([get(key, "time") for key in keys], dtype=np.float64)
    values = finite_array([list(get(key, "value")) for key in keys], where)
    last = np.append(np.diff(times.astype("<f4")) > 0.0, True)[: len(times)]
    return times[last], values[last]
