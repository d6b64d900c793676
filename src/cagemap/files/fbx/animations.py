"""Animations of FBX scenes as entries of a glTF document, sampled for linear interpolation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import ufbx

from cagemap.files.fbx.meshes import FbxMesh, finite_array, get, keep_alive, list_attribute
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
    meshes: Mapping[int, FbxMesh],
    note: Callable[[str], None],
) -> dict[str, Any]:
    """Entry of ``animations`` for an animation stack; without channels if nothing moves.

    ``nodes``: entries of the nodes, at rest.
    ``before``: transforms in the file of nodes whose entries were changed; used where no track moves such a node.
    ``numbers``: number of each node by its ``typed_id``.
    ``meshes``: meshes by the numbers of their nodes.
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
    tracks += _weights(baked, meshes, where)
    begin = min((float(times.min()) for _, _, times, _ in tracks), default=0.0)
    if begin < 0.0:  # which glTF does not allow
        note(f"animation {name} begins {-begin:g} s before 0 and is moved to begin at 0")
    entry: dict[str, Any] = {"name": name, "samplers": [], "channels": []}
    for node, path, times, values in tracks:
        sampler = {"input": binary.times(times - min(begin, 0.0)), "output": binary.accessor(values.astype("<f4"))}
        add_channel(entry, node, path, sampler)
    return entry


def _weights(
    baked: Any, meshes: Mapping[int, FbxMesh], where: str
) -> Iterator[tuple[int, str, FloatArray, FloatArray]]:
    """Node, path, times (k,) and weights (k shapes,) of the shapes of every mesh with moving shapes."""
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
