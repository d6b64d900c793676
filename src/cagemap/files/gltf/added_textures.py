"""Textures that readers of other formats add to a glTF document, with their images and samplers."""

from __future__ import annotations

from typing import Any

from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import image_suffix, image_type


class AddedTextures:
    """Adds textures to the lists of ``top``, the JSON of a document; equal images and samplers are added once."""

    def __init__(self, binary: Binary, top: dict[str, Any]) -> None:
        self._binary, self._top = binary, top
        self._images: dict[bytes, int | None] = {}

    def image(self, data: bytes, suffix: str) -> int | None:
        """Number of an image; of another format than PNG and JPEG as PNG. None if it cannot be read."""
        if data not in self._images:
            self._images[data] = self._add_image(data, suffix)
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

    def _add_image(self, data: bytes, suffix: str) -> int | None:
        stored = image_suffix(data)
        if stored not in (".png", ".jpg"):
            from cagemap.files.gltf.material_images import png_bytes
            from cagemap.files.images.image import image_of_bytes

            try:
                data, stored = png_bytes(image_of_bytes(data, suffix, "texture")), ".png"
            except FormatError:
                return None
        images: list[Any] = self._top.setdefault("images", [])
        images.append({"bufferView": self._binary.view(data), "mimeType": image_type(stored)})
        return len(images) - 1
