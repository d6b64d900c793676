"""Textures of materials in glTF documents: images are replaced or added, and materials copied between documents."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document, image_bytes, image_suffix, image_type
from cagemap.files.gltf.primitives import material_names
from cagemap.files.images.image import image_of_bytes, png_bytes
from cagemap.files.text import make_distinct
from cagemap.numerics.arrays import FloatArray

_COLOR = "baseColorTexture"
WEBP = "EXT_texture_webp"
REPEAT, CLAMP, MIRROR = 10497, 33071, 33648  # wrap modes of samplers

# Factors in place of an image that is left out: those of the image would make the surface a mirror, or glow.
WITHOUT_IMAGE: dict[str, dict[str, Any]] = {
    "metallicRoughnessTexture": {"metallicFactor": 0.0, "roughnessFactor": 0.5},
    "emissiveTexture": {"emissiveFactor": [0.0, 0.0, 0.0]},
}


def texture_slots(material: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Texture slots in use of a material and its extensions: name, and the object that refers to the texture."""
    for name, value in material.items():
        if not isinstance(value, dict):
            continue
        if name.endswith("Texture") and isinstance(value.get("index"), int):
            yield name, value
        elif name != "extras":
            yield from texture_slots(value)


def image_number(document: Document, texture: dict[str, Any], where: str) -> Any:
    """The number of a texture's image, of its WebP image if it has no other; None without one."""
    webp = document.table(document.table(texture, "extensions", where), WEBP, where)
    return texture.get("source", webp.get("source"))


def scale_and_angle(transform: FloatArray) -> tuple[float, float, float]:
    """Scales along u and v, and angle in radians, of a transform (3, 3) of texture coordinates as rows, v down.

    It is that of KHR_texture_transform if the transform has no shear.
    """
    across = float(np.hypot(*transform[0, :2]))
    angle = float(np.arctan2(-transform[0, 1], transform[0, 0]))
    return across, float(np.linalg.det(transform[:2, :2])) / max(across, 1e-30), angle


def with_images(document: Document, images: Mapping[tuple[str, str], bytes]) -> Document:
    """A document with new images (PNG or JPEG), given by material and slot names.

    The sampler and the other settings of a slot are kept. A missing slot is added if it is ``baseColorTexture``,
    ``normalTexture``, ``occlusionTexture`` or ``emissiveTexture``.
    """
    if not images:
        return document
    binary, top = Binary(document), json.loads(json.dumps(document.json))
    textures, pictures = top.setdefault("textures", []), top.setdefault("images", [])
    names = material_names(document)
    for (name, slot), data in images.items():
        if name not in names:
            known = ", ".join(names) or "none"
            raise FormatError(f"{document.file}: expected the name of a material ({known}), got {name!r}.")
        holder = _slot(top["materials"][names.index(name)], slot, document)
        suffix = image_suffix(data)
        if suffix is None:
            raise FormatError(f"{document.file}: expected a PNG or JPEG image for {slot} of {name}, got other data.")
        picture = {"bufferView": binary.view(data), "mimeType": image_type(suffix)}
        texture = document.entry("textures", holder["index"], name) if "index" in holder else {}
        # Extensions of a texture refer to other images.
        texture = {key: value for key, value in texture.items() if key != "extensions"}
        image = texture.get("source")
        users = [one for material in top["materials"] for _, one in texture_slots(material)]
        if "index" not in holder or sum(one["index"] == holder["index"] for one in users) > 1:
            holder["index"] = len(textures)
            textures.append(texture)
        if image is None or sum(entry.get("source") == image for entry in textures) > 1:
            image = len(pictures)
            pictures.append({})
        pictures[image] = {key: value for key, value in pictures[image].items() if key not in ("uri", "name")} | picture
        textures[holder["index"]] = texture | {"source": image}
    return binary.document(top)


def _slot(material: dict[str, Any], slot: str, document: Document) -> dict[str, Any]:
    for name, holder in texture_slots(material):
        if name == slot:
            return holder
    if slot == _COLOR:
        material = material.setdefault("pbrMetallicRoughness", {})
    elif slot not in ("normalTexture", "occlusionTexture", "emissiveTexture"):
        raise FormatError(f"{document.file}: expected a texture slot of glTF, got {slot!r}.")
    material[slot] = {}
    added: dict[str, Any] = material[slot]
    return added


# Extensions of materials and textures, or their beginnings.
_OF_MATERIALS = ("KHR_materials_", "KHR_texture_transform", WEBP)


def with_materials_of(document: Document, given: Document, names: Sequence[str]) -> tuple[Document, dict[str, str]]:
    """A document with materials of another one added, and their new names.

    ``names``: materials of ``given``, named as by `cagemap.files.gltf.primitives.material_names`. A new name differs
    only if the document has a material of that name.
    """
    binary, top = Binary(document), json.loads(json.dumps(document.json))
    known = material_names(given)
    present = material_names(document)
    added = make_distinct([*present, *names])[len(present) :]
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


def _add_image(binary: Binary, top: dict[str, Any], data: bytes) -> int:
    entry = {"bufferView": binary.view(data), "mimeType": image_type(image_suffix(data) or ".png")}
    top.setdefault("images", []).append(entry)
    return len(top["images"]) - 1


def _with_texture(binary: Binary, top: dict[str, Any], given: Document, number: int) -> int:
    """Add a texture of ``given`` with its sampler and image; returns its number."""
    entry = json.loads(json.dumps(given.entry("textures", number)))
    for holder in (entry, *entry.get("extensions", {}).values()):
        if holder.get("source") is not None:
            holder["source"] = _add_image(binary, top, image_bytes(given, holder["source"])[0])
    if entry.get("sampler") is not None:
        top.setdefault("samplers", []).append(given.entry("samplers", entry["sampler"]))
        entry["sampler"] = len(top["samplers"]) - 1
    top.setdefault("textures", []).append(entry)
    return len(top["textures"]) - 1


class AddedTextures:
    """Adds textures to the lists of ``top``, the JSON of a document; equal images and samplers are added once."""

    def __init__(self, binary: Binary, top: dict[str, Any]) -> None:
        self._binary, self._top = binary, top
        self._images: dict[bytes, int | None] = {}

    def image(self, data: bytes, suffix: str) -> int | None:
        """Number of an image; of another format than PNG and JPEG as PNG. None if it cannot be read."""
        if data not in self._images:
            stored = png_or_jpeg(data, suffix)
            self._images[data] = None if stored is None else _add_image(self._binary, self._top, stored)
        return self._images[data]

    def texture(self, image: int, wraps: tuple[int, int], transform: dict[str, Any] | None = None) -> dict[str, Any]:
        """What refers to a new texture; ``transform``: that of KHR_texture_transform."""
        sampler = dict(zip(("wrapS", "wrapT"), wraps, strict=True))
        samplers: list[Any] = self._top.setdefault("samplers", [])
        if sampler not in samplers:
            samplers.append(sampler)
        entry = {"source": image, "sampler": samplers.index(sampler)}
        textures: list[Any] = self._top.setdefault("textures", [])
        if entry not in textures:
            textures.append(entry)
        holder: dict[str, Any] = {"index": textures.index(entry)}
        if transform:
            self._binary.extensions.add("KHR_texture_transform")
            holder["extensions"] = {"KHR_texture_transform": transform}
        return holder


def png_or_jpeg(data: bytes, suffix: str) -> bytes | None:
    """The content of an image file, converted to PNG unless it is PNG or JPEG; None if it cannot be read."""
    if image_suffix(data) in (".png", ".jpg"):
        return data
    try:
        return png_bytes(image_of_bytes(data, suffix, "texture"))
    except FormatError:
        return None
