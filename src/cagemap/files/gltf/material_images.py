"""Images of materials in a glTF document, with their texture transforms and UV sets."""

from __future__ import annotations

import itertools
import json
import logging
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import MIRROR, REPEAT, WITHOUT_IMAGE, image_number, texture_slots
from cagemap.files.images.image import Image, Pixels, image_of_bytes
from cagemap.files.ownership import seal
from cagemap.numerics.arrays import FloatArray

_log = logging.getLogger(__name__)

_TRANSFORM = "KHR_texture_transform"


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
    """Textures of a material, in all slots or ``only`` one; images that cagemap cannot read are left out aloud."""
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
