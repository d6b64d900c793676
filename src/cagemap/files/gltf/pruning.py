"""Drop arrays of a glTF document that nothing in it uses any more."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from cagemap.files.gltf.binary import NGONS
from cagemap.files.gltf.entries import Document, view_bytes

# Extensions that name no accessors or buffer views; with others nothing is dropped.
_KNOWN = {NGONS, "KHR_mesh_quantization", "KHR_texture_transform", "KHR_lights_punctual", "VRM"}
_KNOWN_FAMILIES = ("KHR_materials_", "VRMC_")

_Holder = tuple[dict[str, Any], str]


def without_unused(document: Document) -> Document:
    """The document without accessors, buffer views and bytes that nothing uses; as it is with unknown extensions.

    Meshes, textures and images stay, used or not, since extensions name them by number.
    """
    used = document.entries("extensionsUsed")
    if not all(str(name) in _KNOWN or str(name).startswith(_KNOWN_FAMILIES) for name in used):
        return document
    top = json.loads(json.dumps(document.json))
    top["accessors"] = _kept(top.get("accessors", []), list(_of_accessors(top)))
    views = [dict(view, number=number) for number, view in enumerate(top.get("bufferViews", []))]
    chunks, length = [], 0
    top["bufferViews"] = _kept(views, list(_of_views(top)))
    for view in top["bufferViews"]:
        data = bytes(view_bytes(document, view.pop("number"), "glTF"))
        view |= {"buffer": 0, "byteOffset": length}
        chunks += [data, b"\0" * (-len(data) % 4)]
        length += len(data) + -len(data) % 4
    top["buffers"] = [{"byteLength": length}] if length else []
    top = {name: value for name, value in top.items() if value != []}
    return Document(top, (b"".join(chunks),) if length else (), document.file)


def _kept(entries: list[Any], holders: list[_Holder]) -> list[Any]:
    """Entries that are named, and their new numbers written where they are named."""
    used = sorted({holder[key] for holder, key in holders})
    number = {old: new for new, old in enumerate(used)}
    for holder, key in holders:
        holder[key] = number[holder[key]]
    return [entries[old] for old in used]


def _of_accessors(top: dict[str, Any]) -> Iterator[_Holder]:
    """Every place of the JSON that names an accessor."""
    for mesh in top.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            for table in (primitive.get("attributes", {}), *primitive.get("targets", [])):
                yield from ((table, name) for name in table)
            yield from _stated(primitive, "indices")
    for skin in top.get("skins", []):
        yield from _stated(skin, "inverseBindMatrices")
    for animation in top.get("animations", []):
        for sampler in animation.get("samplers", []):
            yield from ((sampler, "input"), (sampler, "output"))


def _of_views(top: dict[str, Any]) -> Iterator[_Holder]:
    """Every place of the JSON that names a buffer view."""
    for entry in (*top["accessors"], *top.get("images", [])):
        yield from _stated(entry, "bufferView")
        for part in entry.get("sparse", {}).values():
            if isinstance(part, dict):
                yield from _stated(part, "bufferView")


def _stated(entry: dict[str, Any], key: str) -> Iterator[_Holder]:
    if entry.get(key) is not None:
        yield entry, key
