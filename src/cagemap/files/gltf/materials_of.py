"""Materials of one glTF document, with their textures and images, in another one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.nodes import distinct
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import texture_slots

# Extensions of materials and textures; "..._" is a family.
_OF_MATERIALS = ("KHR_materials_", "KHR_texture_transform", "EXT_texture_webp")


def with_materials_of(document: Document, given: Document, names: Sequence[str]) -> tuple[Document, dict[str, str]]:
    """A document with materials of another one.

    Parameters
    ----------
    document, given : Document
    names : sequence of str
        Of materials of ``given``, as `cagemap.files.gltf.primitives.material_names` has them.

    Returns
    -------
    Document
    dict of str to str
        The name that each has there: another one where the document has a material of that name.

    Raises
    ------
    FormatError
        If a texture or an image of them is not there.
    """
    binary, top = Binary(document), json.loads(json.dumps(document.json))
    known = material_names(given)
    there = material_names(document)
    added = distinct([*there, *names])[len(there) :]
    taken: dict[int, int] = {}
    for name, new in zip(names, added, strict=True):
        entry = json.loads(json.dumps(given.entry("materials", known.index(name)))) | {"name": new}
        for _, holder in texture_slots(entry):
            number = int(holder["index"])
            if number not in taken:
                taken[number] = _with_texture(binary, top, given, number)
            holder["index"] = taken[number]
        top.setdefault("materials", []).append(entry)
    used = [word for word in given.entries("extensionsUsed") if str(word).startswith(_OF_MATERIALS)]
    binary.extensions.update(used if names else ())
    return binary.document(top), dict(zip(names, added, strict=True))


def _with_texture(binary: Binary, top: dict[str, Any], given: Document, number: int) -> int:
    """Add a texture of the other document, with its sampler and image; returns its number."""
    entry = json.loads(json.dumps(given.entry("textures", number)))
    for holder in (entry, *entry.get("extensions", {}).values()):
        if holder.get("source") is not None:
            data, suffix = image_bytes(given, holder["source"])
            kind = f"image/{suffix[1:].replace('jpg', 'jpeg')}"
            top.setdefault("images", []).append({"bufferView": binary.view(data), "mimeType": kind})
            holder["source"] = len(top["images"]) - 1
    if entry.get("sampler") is not None:
        top.setdefault("samplers", []).append(given.entry("samplers", entry["sampler"]))
        entry["sampler"] = len(top["samplers"]) - 1
    top.setdefault("textures", []).append(entry)
    return len(top["textures"]) - 1
