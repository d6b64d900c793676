"""UsdPreviewSurface shaders as materials of glTF, with their images."""

from __future__ import annotations

import json
import logging
import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import REPEAT, WITHOUT_IMAGE, AddedTextures, png_or_jpeg
from cagemap.files.images.image import UDIM_MARK, Image, Pixels, image_of_bytes, png_bytes
from cagemap.files.usd.materials import STRENGTH, WRAP_WORDS
from cagemap.files.usd.read import material_labels
from cagemap.files.usd.shader_inputs import setting_of, shader_of, source_of, uv_name, uv_transform
from cagemap.files.usd.stages import pxr
from cagemap.mesh.mesh_report import first_few

_log = logging.getLogger(__name__)

# Slots of glTF: the inputs that an image holds, with the output of each.
_SLOTS = {
    "baseColorTexture": {"diffuseColor": "rgb"},
    "metallicRoughnessTexture": {"metallic": "b", "roughness": "g"},
    "normalTexture": {"normal": "rgb"},
    "occlusionTexture": {"occlusion": "r"},
    "emissiveTexture": {"emissiveColor": "rgb"},
}
_CHANNELS = ("r", "g", "b")
_WRAP_MODES = {word: mode for mode, word in WRAP_WORDS.items()}


def with_materials(
    document: Document, stage: Any, uv_sets: Mapping[str, Sequence[tuple[str, ...]]], double_sided: Collection[str]
) -> Document:
    """The document with factors, images and opacity of the materials of a stage.

    ``uv_sets``: by name of a material: names of the UV sets of each mesh that has it.
    ``double_sided``: names of materials.
    """
    named = {label: stage.GetPrimAtPath(path) for path, label in material_labels(stage).items()}
    made = _Materials(document)
    for entry, name in zip(made.top.get("materials", []), material_names(document), strict=True):
        entry |= {"doubleSided": True} if name in double_sided else {}
        material = pxr.UsdShade.Material(named[name]) if name in named else None
        surface = material.ComputeSurfaceSource()[0] if material else None
        if surface and surface.GetIdAttr().Get() == "UsdPreviewSurface":
            made.fill(entry, surface, uv_sets[name])
        elif material and material.GetSurfaceOutputs():
            text = "%s: %s: has no UsdPreviewSurface: its colours and images are left out; add one to keep them"
            _log.warning(text, document.file, name)
    return replace(made.binary.document(made.top), uv_names=made.color_uv_names)


def _is_plain(texture: Any, slot: str) -> bool:
    """Whether glTF reads an image as a texture shader does: its colour space, scale and bias."""
    scale, bias = (np.array(setting_of(texture, name, (1.0 - k,) * 4))[:3] for k, name in enumerate(("scale", "bias")))
    is_color = slot in ("baseColorTexture", "emissiveTexture")
    if str(setting_of(texture, "sourceColorSpace", "auto")) == ("raw" if is_color else "sRGB"):
        return False
    if slot == "normalTexture":  # without scale and bias, programs take an image as a normal map all the same
        return any(np.allclose([scale, bias], [[k], [1.0 - k]]) for k in (1.0, 2.0))
    return bool(np.allclose(bias, 1.0 - scale if slot == "occlusionTexture" else 0.0))


def _transform_of(texture: Any) -> dict[str, Any] | None:
    """A texture shader's transform as glTF's KHR_texture_transform; `usd.materials` converts the other way."""
    transform = uv_transform(texture)
    if not transform:
        return None
    width, height = map(float, setting_of(transform, "scale", (1.0, 1.0)))
    right, up = map(float, setting_of(transform, "translation", (0.0, 0.0)))
    angle = float(np.radians(setting_of(transform, "rotation", 0.0)))
    offset = [right - height * np.sin(angle), 1.0 - up - height * np.cos(angle)]
    return {"offset": offset, "rotation": angle, "scale": [width, height]}


def _as_bytes(pixels: Pixels) -> NDArray[np.uint8]:
    """Pixels as 8-bit integers."""
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1
    return np.asarray(np.rint(pixels.astype(np.float64).clip(0, full) * (255 / full)), dtype=np.uint8)


def _content(path: str) -> bytes | None:
    """A file, or one in a package (``PACKAGE.usdz[NAME]``); None if it cannot be read."""
    package, inside, name = path.removesuffix("]").rpartition("[")
    try:
        if not inside or Path(path).is_file():
            return Path(path).read_bytes()
        with zipfile.ZipFile(package) as archive:
            return archive.read(name)
    except (OSError, KeyError, zipfile.BadZipFile):
        return None


class _Materials:
    """Materials of a document that are filled one by one."""

    def __init__(self, document: Document) -> None:
        self.binary, self.top = Binary(document), json.loads(json.dumps(document.json))
        self._file, self._textures = document.file, AddedTextures(self.binary, self.top)
        self._image_of: dict[str, bytes | None] = {}  # PNG or JPEG by path
        self.color_uv_names: dict[str, str] = {}  # UV set of the colour image by material
        self._reported: set[tuple[str, str]] = set()  # materials and UV sets

    def fill(self, entry: dict[str, Any], surface: Any, sets: Sequence[tuple[str, ...]]) -> None:
        """Set an entry by the inputs of a surface; ``sets``: names of the UV sets of each mesh that has it."""

        def factor(name: str, default: float | tuple[float, ...]) -> Any:
            """Value of an input; with an image, its scale."""
            texture = shader_of(surface, name, "UsdUVTexture")
            value = setting_of(surface, name, default) if texture is None else setting_of(texture, "scale", (1.0,) * 4)
            if texture is not None:
                output = source_of(surface, name).GetBaseName()
                value = value["rgba".index(output)] if len(output) == 1 else value[:3]
            if not np.isfinite(value).all():
                raise ValueError(f"{name} is not finite")
            return value

        alpha, threshold = float(factor("opacity", 1.0)), float(factor("opacityThreshold", 0.0))
        base = entry.setdefault("pbrMetallicRoughness", {})
        base["baseColorFactor"] = [*map(float, factor("diffuseColor", (0.18,) * 3)), alpha]
        base |= {"metallicFactor": float(factor("metallic", 0.0)), "roughnessFactor": float(factor("roughness", 0.5))}
        emitted = np.maximum(factor("emissiveColor", (0.0,) * 3), 0.0)
        strength = max(1.0, float(emitted.max()))
        entry["emissiveFactor"] = (emitted / strength).tolist()
        if strength > 1.0:
            entry["extensions"] = {STRENGTH: {"emissiveStrength": strength}}
            self.binary.extensions.add(STRENGTH)
        opacity = shader_of(surface, "opacity", "UsdUVTexture")
        if opacity or alpha < 1.0:
            entry |= {"alphaMode": "MASK", "alphaCutoff": threshold} if threshold > 0.0 else {"alphaMode": "BLEND"}
        for slot, outputs in {**_SLOTS, "": {"opacity": "a"}}.items():
            pairs = {name: texture for name in outputs if (texture := shader_of(surface, name, "UsdUVTexture"))}
            found = self._find_image(entry["name"], surface, slot, pairs) if pairs else None
            table = base if slot in ("baseColorTexture", "metallicRoughnessTexture") else entry
            if pairs and found is None:
                defaults = WITHOUT_IMAGE.get(slot, {})
                names = [of.removesuffix("Color") for of in pairs]
                table |= {key: value for key, value in defaults.items() if key.startswith(tuple(names))}
                if slot == "emissiveTexture":
                    entry.pop("extensions", None)
            elif found is not None and slot:
                if not all(_is_plain(texture, slot) for texture in pairs.values()):
                    text = "%s: %s: the image of its %s is taken as it is, without scale, bias or colour space of USD"
                    _log.warning(text, self._file, entry["name"], "/".join(outputs))
                holder = self._holder(*found, next(iter(pairs.values())), entry["name"], sets)
                if slot == "occlusionTexture":
                    holder["strength"] = float(np.clip(factor("occlusion", 1.0), 0.0, 1.0))
                if slot == "baseColorTexture":
                    stated, first = uv_name(pairs["diffuseColor"]), {names[0] for names in sets if names}
                    if any(stated in names for names in sets):
                        self.color_uv_names[entry["name"]] = stated
                    elif len(first) == 1:
                        self.color_uv_names[entry["name"]] = first.pop()
                table[slot] = holder

    def _find_image(
        self, material: str, surface: Any, slot: str, pairs: dict[str, Any]
    ) -> tuple[bytes, tuple[int, int]] | None:
        """Image and wrap modes of the textures of some inputs; None, with a warning, if glTF cannot express them."""
        outputs = _SLOTS.get(slot, {"opacity": "a"})
        images = {self._image_and_wraps(texture) for texture in pairs.values()}
        named = {name: source_of(surface, name).GetBaseName() for name in pairs}
        fits = len(images) == 1 and named == outputs
        if not slot:  # the opacity of glTF is in the image of the colour
            fits &= images == {self._image_and_wraps(shader_of(surface, "diffuseColor", "UsdUVTexture"))}
        if not fits and slot == "metallicRoughnessTexture" and (packed := self._pack_channels(surface, pairs)):
            return packed
        image, wraps = next(iter(images))
        if len(images) == 1 and image is None:
            stated = [str(setting_of(texture, "file", "")).strip("@") for texture in pairs.values()]
            is_set = any(UDIM_MARK in one for one in stated)
            reason = "a set of tiles (transfer them by this name)" if is_set else "not found or cannot be read"
            text = "%s: %s: the image of its %s (%s) is %s, and is left out"
            _log.warning(text, self._file, material, "/".join(outputs), first_few(dict.fromkeys(stated)), reason)
        elif not fits or image is None:
            text = "%s: %s: the image of its %s is left out; give one PNG or JPEG with the channels of glTF"
            _log.warning(text, self._file, material, "/".join(outputs))
        else:
            return image, wraps
        return None

    def _pack_channels(self, surface: Any, pairs: dict[str, Any]) -> tuple[bytes, tuple[int, int]] | None:
        """Roughness in green and metallic in blue, of images that are placed in one way; None if they are not."""
        texels: dict[str, Pixels] = {}
        places = []
        for name, texture in pairs.items():
            image, wraps = self._image_and_wraps(texture)
            channel = str(source_of(surface, name).GetBaseName())
            if image is None or channel not in _CHANNELS:
                return None
            places.append((wraps, uv_name(texture), _transform_of(texture)))
            path = str(setting_of(texture, "file", None).resolvedPath)
            try:
                pixels = image_of_bytes(_content(path) or b"", Path(path.rstrip("]")).suffix, path).pixels
            except FormatError:
                return None
            of_color = pixels.shape[2] > 2  # otherwise grey, with opacity or without
            texels[name] = _as_bytes(pixels[:, :, _CHANNELS.index(channel) if of_color else 0])
        if places.count(places[0]) != len(places):
            return None
        height, width = np.max([one.shape for one in texels.values()], axis=0)
        packed = np.full((height, width, 3), 255, dtype=np.uint8)
        for name, one in texels.items():
            rows, columns = np.arange(height) * len(one) // height, np.arange(width) * one.shape[1] // width
            packed[:, :, 1 if name == "roughness" else 2] = one[np.ix_(rows, columns)]
        return png_bytes(Image(packed)), places[0][0]

    def _image_and_wraps(self, texture: Any) -> tuple[bytes | None, tuple[int, int]]:
        """A texture shader's image as PNG or JPEG, None if it cannot be read, and its wrap modes in glTF."""
        file = None if texture is None else setting_of(texture, "file", None)
        path = "" if file is None else str(file.resolvedPath)
        if path not in self._image_of:
            data = _content(path)
            self._image_of[path] = None if data is None else png_or_jpeg(data, Path(path.rstrip("]")).suffix)
        if texture is None:
            return self._image_of[path], (REPEAT, REPEAT)
        words = (str(setting_of(texture, name, "repeat")) for name in ("wrapS", "wrapT"))
        across, up = (_WRAP_MODES.get(word, REPEAT) for word in words)
        return self._image_of[path], (across, up)

    def _holder(
        self, image: bytes, wraps: tuple[int, int], texture: Any, material: str, sets: Sequence[tuple[str, ...]]
    ) -> dict[str, Any]:
        """What refers to a texture shader's image in glTF; adds the image."""
        name, number = uv_name(texture), self._textures.image(image, "")
        assert number is not None
        holder = self._textures.texture(number, wraps, _transform_of(texture))
        place = next((names.index(name) for names in sets if name in names), 0)
        is_elsewhere = any(names and name not in names[place : place + 1] for names in sets)
        if name and is_elsewhere and (material, name) not in self._reported:
            self._reported.add((material, name))
            text = "%s: %s: some of its meshes lack its UV set %s, or have it at another number, and show it wrongly%s"
            remedy = "; give each mesh a material of its own"
            if not any(name in names for names in sets):
                text, remedy = "%s: %s: no mesh has its UV set %s, so that the first one is used%s", "; rename that one"
            _log.warning(text, self._file, material, name, remedy)
        return holder | ({"texCoord": place} if place else {})
