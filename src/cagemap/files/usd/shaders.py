"""UsdPreviewSurface shaders as materials of glTF, with their images."""

from __future__ import annotations

import json
import logging
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document, image_suffix, image_type
from cagemap.files.gltf.material_images import png_bytes
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import REPEAT
from cagemap.files.images.image import image_of_bytes
from cagemap.files.usd.materials import STRENGTH, WRAP_WORDS
from cagemap.files.usd.read import material_labels
from cagemap.files.usd.stages import usd_modules

_log = logging.getLogger(__name__)

# Slots of glTF: the inputs that an image holds, with the output of each.
_SLOTS = {
    "baseColorTexture": {"diffuseColor": "rgb"},
    "metallicRoughnessTexture": {"metallic": "b", "roughness": "g"},
    "normalTexture": {"normal": "rgb"},
    "occlusionTexture": {"occlusion": "r"},
    "emissiveTexture": {"emissiveColor": "rgb"},
}
_WRAP_MODES = {word: mode for mode, word in WRAP_WORDS.items()}


def with_materials(document: Document, stage: Any, users: Mapping[str, tuple[tuple[str, ...], bool]]) -> Document:
    """The document with factors, images and opacity of the materials of a stage.

    ``users``: by name of a material, the names of the UV sets of a mesh that has it, and whether it is double-sided.
    """
    shade = usd_modules().UsdShade
    named = {label: stage.GetPrimAtPath(path) for path, label in material_labels(stage).items()}
    made = _Materials(document)
    for entry, name in zip(made.top.get("materials", []), material_names(document), strict=True):
        sets, double_sided = users[name]
        entry |= {"doubleSided": True} if double_sided else {}
        surface = shade.Material(named[name]).ComputeSurfaceSource()[0] if name in named else None
        if surface and surface.GetIdAttr().Get() == "UsdPreviewSurface":
            entry["name"] = named[name].GetDisplayName() or name
            made.fill(entry, surface, sets)
    return made.binary.document(made.top)


def _source(shader: Any, name: str) -> Any:
    """The attribute with the value of an input: its own, or the output of a shader; None without one."""
    given = shader.GetInput(name)
    sources = given.GetValueProducingAttributes() if given else ()
    return sources[0] if sources else None


def _setting(shader: Any, name: str, default: Any) -> Any:
    source = _source(shader, name)
    value = source.Get() if source else None
    return default if value is None else value


def _shader(shader: Any, name: str, kind: str) -> Any:
    """The shader of a kind whose output an input takes; None if it takes another or none."""
    source = _source(shader, name)
    found = usd_modules().UsdShade.Shader(source.GetPrim()) if source else None
    return found if found and found.GetIdAttr().Get() == kind else None


def _is_plain(texture: Any, slot: str) -> bool:
    """Whether glTF reads an image as a texture shader does: its colour space, scale and bias."""
    scale, bias = (np.array(_setting(texture, name, (1.0 - k,) * 4))[:3] for k, name in enumerate(("scale", "bias")))
    is_color = slot in ("baseColorTexture", "emissiveTexture")
    if str(_setting(texture, "sourceColorSpace", "auto")) == ("raw" if is_color else "sRGB"):
        return False
    if slot == "normalTexture":  # without scale and bias, programs take an image as a normal map all the same
        return any(np.allclose([scale, bias], [[k], [1.0 - k]]) for k in (1.0, 2.0))
    return bool(np.allclose(bias, 1.0 - scale if slot == "occlusionTexture" else 0.0))


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
        self._file, self._known = document.file, dict[str, int]()

    def fill(self, entry: dict[str, Any], surface: Any, sets: tuple[str, ...]) -> None:
        """Set an entry by the inputs of a surface."""

        def factor(name: str, default: float | tuple[float, ...]) -> Any:
            """Value of an input; with an image, its scale."""
            texture = _shader(surface, name, "UsdUVTexture")
            value = _setting(surface, name, default) if texture is None else _setting(texture, "scale", (1.0,) * 4)
            if texture is not None:
                output = _source(surface, name).GetBaseName()
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
        opacity = _shader(surface, "opacity", "UsdUVTexture")
        if opacity or alpha < 1.0:
            entry |= {"alphaMode": "MASK", "alphaCutoff": threshold} if threshold > 0.0 else {"alphaMode": "BLEND"}
        for slot, outputs in {**_SLOTS, "": {"opacity": "a"}}.items():
            pairs = {name: _shader(surface, name, "UsdUVTexture") for name in outputs}
            if not any(pairs.values()):
                continue
            images = {self._image(texture) for texture in pairs.values()}
            fits = [_source(surface, name).GetBaseName() for name in outputs if pairs[name]] == list(outputs.values())
            if not slot:  # the opacity of glTF is in the image of the colour
                fits &= images == {self._image(_shader(surface, "diffuseColor", "UsdUVTexture"))}
            if len(images) > 1 or None in images or not fits:
                text = "%s: %s: the image of its %s is left out; give one PNG or JPEG with the channels of glTF"
                _log.warning(text, self._file, entry["name"], "/".join(outputs))
            elif slot:
                texture = next(iter(pairs.values()))
                if not _is_plain(texture, slot):
                    text = "%s: %s: the image of its %s is taken as it is, without scale, bias or colour space of USD"
                    _log.warning(text, self._file, entry["name"], "/".join(outputs))
                in_base = slot in ("baseColorTexture", "metallicRoughnessTexture")
                holder = {"index": images.pop()} | self._coordinates(texture, sets)
                if slot == "occlusionTexture":
                    holder["strength"] = float(np.clip(factor("occlusion", 1.0), 0.0, 1.0))
                (base if in_base else entry)[slot] = holder

    def _image(self, texture: Any) -> int | None:
        """Number of the glTF texture for a texture shader, added once; None if its image cannot be read."""
        if texture is None:
            return None
        file = _setting(texture, "file", None)
        path = "" if file is None else str(file.resolvedPath)
        wrap = {name: _WRAP_MODES.get(str(_setting(texture, name, "repeat")), REPEAT) for name in ("wrapS", "wrapT")}
        key = f"{path} {wrap}"
        if key not in self._known:
            data = _content(path)
            if data is None:
                return None
            suffix = image_suffix(data)
            if suffix not in (".png", ".jpg"):
                name = path.rstrip("]")
                data, suffix = png_bytes(image_of_bytes(data, Path(name).suffix, name)), ".png"
            for kind, item in (
                ("images", {"bufferView": self.binary.view(data), "mimeType": image_type(suffix)}),
                ("samplers", wrap),
                ("textures", {"source": len(self.top.get("images", ())), "sampler": len(self.top.get("samplers", ()))}),
            ):
                self.top.setdefault(kind, []).append(item)
            self._known[key] = len(self.top["textures"]) - 1
        return self._known[key]

    def _coordinates(self, texture: Any, sets: tuple[str, ...]) -> dict[str, Any]:
        """UV set and transform of a texture in glTF; the inverse of `cagemap.files.usd.materials`."""
        holder: dict[str, Any] = {}
        transform = _shader(texture, "st", "UsdTransform2d")
        if transform:
            width, height = map(float, _setting(transform, "scale", (1.0, 1.0)))
            right, up = map(float, _setting(transform, "translation", (0.0, 0.0)))
            angle = float(np.radians(_setting(transform, "rotation", 0.0)))
            offset = [right - height * np.sin(angle), 1.0 - up - height * np.cos(angle)]
            stated = {"offset": offset, "rotation": angle, "scale": [width, height]}
            holder["extensions"] = {"KHR_texture_transform": stated}
            self.binary.extensions.add("KHR_texture_transform")
        reader = _shader(transform or texture, "in" if transform else "st", "UsdPrimvarReader_float2")
        name = str(_setting(reader, "varname", "")) if reader else ""
        return holder | ({"texCoord": sets.index(name)} if name in sets[1:] else {})
