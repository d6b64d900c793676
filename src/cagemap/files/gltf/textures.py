"""Textures of materials in glTF documents: read, replaced, added, and copied between documents."""

from __future__ import annotations

import itertools
import json
import logging
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document, image_bytes, image_suffix, image_type
from cagemap.files.gltf.primitives import material_names
from cagemap.files.images.image import Image, Pixels, image_of_bytes, png_bytes
from cagemap.files.ownership import seal
from cagemap.files.text import make_distinct
from cagemap.numerics.arrays import FloatArray

_log = logging.getLogger(__name__)

_COLOR = "baseColorTexture"
WEBP = "EXT_texture_webp"
_TRANSFORM = "KHR_texture_transform"
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
_OF_MATERIALS = ("KHR_materials_", _TRANSFORM, WEBP)


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
            self._binary.extensions.add(_TRANSFORM)
            holder["extensions"] = {_TRANSFORM: transform}
        return holder


def png_or_jpeg(data: bytes, suffix: str) -> bytes | None:
    """The content of an image file, converted to PNG unless it is PNG or JPEG; None if it cannot be read."""
    if image_suffix(data) in (".png", ".jpg"):
        return data
    try:
        return png_bytes(image_of_bytes(data, suffix, "texture"))
    except FormatError:
        return None


@dataclass(frozen=True, eq=False)
class MaterialImage:
    """The texture in one slot of a material."""

    # `material`, `slot`: such as "body" and "baseColorTexture"
    material: str
    slot: str
    image: int  # its number in the document
    uv_set: str  # name of the UV set that it belongs to
    # (3, 3) transform of texture coordinates (u, v, 1), as rows, v down, to coordinates of the image
    transform: FloatArray = field(repr=False)
    wraps: tuple[int, int]  # wrap modes of glTF along u and v

    @property
    def is_normal_map(self) -> bool:
        """Whether its colours are normals in tangent space."""
        return self.slot.lower().endswith("normaltexture")

    def on_image(self, uvs: FloatArray) -> FloatArray:
        """Texture coordinates (m, 2) of the image for those of the mesh, both v up."""
        down = np.column_stack([uvs[:, 0], 1.0 - uvs[:, 1], np.ones(len(uvs))]) @ self.transform
        return np.column_stack([down[:, 0], 1.0 - down[:, 1]])

    def repeats(self, uvs: FloatArray, axes: slice = slice(2)) -> bool:
        """Whether the image repeats along the axes, or all texture coordinates (m, 2) are from 0 to 1."""
        inside = (uvs.min(axis=0) >= 0.0) & (uvs.max(axis=0) <= 1.0)
        return bool((inside | (np.array(self.wraps) == REPEAT))[axes].all())

    def is_repeated_over(self, uvs: FloatArray) -> bool:
        """Whether the image, repeated over texture coordinates (m, 2), shows the texture."""
        return np.allclose(self.transform, np.eye(3)) and self.repeats(uvs)

    def repeating(self, pixels: Pixels, uvs: FloatArray) -> tuple[Pixels, FloatArray]:
        """Pixels enlarged so that repeating them has the effect of the wrap modes, and coordinates (m, 2) on them."""
        for axis, wrap in enumerate(self.wraps):
            size = pixels.shape[1 - axis]
            if self.repeats(uvs, slice(axis, axis + 1)):
                continue
            # Mirrored images repeat after two; of clamped ones, one image on each side is enough.
            first, end = (0, 2) if wrap == MIRROR else (-1, 2)
            texels = np.arange(first * size, end * size)
            texels = np.minimum(texels, 2 * size - 1 - texels) if wrap == MIRROR else texels.clip(0, size - 1)
            # Rows run down, v up.
            pixels = pixels.take(texels if axis == 0 else size - 1 - texels[::-1], axis=1 - axis)
            place = uvs[:, axis] if wrap == MIRROR else uvs[:, axis].clip(first, end)
            uvs = np.array(uvs)
            uvs[:, axis] = (place - first) / (end - first)
        return pixels, uvs


def material_images(document: Document, material: str, only: str | None = None) -> tuple[MaterialImage, ...]:
    """Textures of a material, in all slots or ``only`` one; a warning names images that cagemap cannot read."""
    number = _number(document, material)
    entry = document.entry("materials", number)
    slots = [(slot, holder) for slot, holder in texture_slots(entry) if only in (None, slot)]
    images = (_image(document, material, slot, holder) for slot, holder in slots)
    return tuple(image for image in images if image is not None)


def write_numbered(file: Path, data: bytes) -> Path:
    """Write a file; its name gets a number if a file of that name has another content. Returns the path."""
    with tempfile.TemporaryDirectory() as folder:
        marked = Path(folder) / file.name
        marked.write_bytes(data)
        seal(marked)
        contents = data, marked.read_bytes()
    files = (file.with_stem(f"{file.stem}{number or ''}") for number in itertools.count())
    free = next(path for path in files if not path.exists() or path.read_bytes() in contents)
    if not free.exists():
        write_whole(free, data)
    return free


def read_material_image(document: Document, found: MaterialImage) -> Image:
    """The pixels of a material's image."""
    return image_of_bytes(*image_bytes(document, found.image), f"{document.file}: images {found.image}")


def with_copied_materials(
    document: Document, copies: Sequence[tuple[str, str]], kept: Collection[tuple[str, str]]
) -> Document:
    """A document with copies of materials (name, new name), without texture transforms and with the first UV set.

    A copy with an unchanged name replaces its material.
    ``kept``: new names and slots of textures; copies have no others.
    """
    top = json.loads(json.dumps(document.json))
    for name, new_name in copies:
        number = _number(document, name)
        slots = {slot for of, slot in kept if of == new_name}
        entry = _with_slots(json.loads(json.dumps(top["materials"][number])), slots) | {"name": new_name}
        for _, holder in texture_slots(entry):
            holder.pop("texCoord", None)
            extensions = holder.get("extensions", {})
            extensions.pop(_TRANSFORM, None)
            if not extensions:
                holder.pop("extensions", None)
        if name == new_name:
            top["materials"][number] = entry
        else:
            top["materials"].append(entry)
    return Document(top, document.buffers, document.file)


def _with_slots(entry: dict[str, Any], kept: Collection[str]) -> dict[str, Any]:
    """A material without its other textures, and without the factors that they had."""
    others = {slot for slot, _ in texture_slots(entry)} - set(kept)
    tables = {name: _with_slots(value, kept) for name, value in entry.items() if isinstance(value, dict)}
    left = {name: tables.get(name, value) for name, value in entry.items() if name not in others}
    for slot in others.intersection(entry):
        left |= WITHOUT_IMAGE.get(slot, {})
    return left


def _number(document: Document, material: str) -> int:
    names = material_names(document)
    if material not in names:
        raise FormatError(f"{document.file}: expected a material named {material!r}, there is none. Export it again.")
    return names.index(material)


def _image(document: Document, material: str, slot: str, holder: dict[str, Any]) -> MaterialImage | None:
    where = f"material {material}: {slot}"
    texture = document.entry("textures", holder["index"], where)
    source = image_number(document, texture, where)
    if source is None:
        others = ", ".join(texture.get("extensions", ())) or "none stated"
        _log.warning(
            "%s: %s has no PNG, JPEG or WebP image (%s) and is left out; convert it", document.file, where, others
        )
        return None
    document.entry("images", source, where)
    stated = document.table(document.table(holder, "extensions", where), _TRANSFORM, where)
    uv_set = document.whole(stated.get("texCoord", holder.get("texCoord", 0)), f"{where}: texCoord", 0, 15)
    sampler = {} if texture.get("sampler") is None else document.entry("samplers", texture["sampler"], where)
    wraps = sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)
    return MaterialImage(material, slot, int(source), f"TEXCOORD_{uv_set}", _transform(document, stated, where), wraps)


def _transform(document: Document, stated: dict[str, Any], where: str) -> FloatArray:
    """Matrix (3, 3) of KHR_texture_transform: scales, rotates, shifts (u, v, 1) as rows, v down."""
    offset = document.numbers(stated.get("offset", [0, 0]), f"{where}: offset", 2)
    scale = document.numbers(stated.get("scale", [1, 1]), f"{where}: scale", 2)
    angle = float(document.numbers([stated.get("rotation", 0)], f"{where}: rotation", 1)[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.diag([*scale, 1.0]) @ np.array([[c, -s, 0], [s, c, 0], [*offset, 1.0]])
