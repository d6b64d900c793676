"""Materials of glTF documents as UsdPreviewSurface, with their images."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import (
    CLAMP,
    MIRROR,
    REPEAT,
    WITHOUT_IMAGE,
    MaterialImage,
    material_images,
    scale_and_angle,
    texture_slots,
)
from cagemap.files.images.image import image_of_bytes, png_bytes
from cagemap.files.ownership import is_own, mark
from cagemap.files.usd.results import connect_texture, define_material, uv_reader
from cagemap.files.usd.stages import identifiers, pxr
from cagemap.numerics.arrays import FloatArray

STRENGTH = "KHR_materials_emissive_strength"
# Extensions of materials and textures that are written.
WRITTEN = ("KHR_texture_transform", "EXT_texture_webp", STRENGTH)
# Words of UsdUVTexture for wrap modes of glTF.
WRAP_WORDS = {REPEAT: "repeat", CLAMP: "clamp", MIRROR: "mirror"}
_COLOR, _METAL, _EMISSION = "baseColorTexture", "metallicRoughnessTexture", "emissiveTexture"
_NORMAL, _OCCLUSION = "normalTexture", "occlusionTexture"


def uv_primvar(number: int) -> str:
    """Name of the primvar of a UV set of glTF, by its number."""
    return f"st{number or ''}"


@dataclass(frozen=True, eq=False)
class UsdMaterials:
    """Materials on a stage by name, and the image files that they use."""

    materials: dict[str, Any] = field(default_factory=dict)
    images: dict[str, bytes] = field(default_factory=dict)  # by file name, in the folder of the layer
    notes: list[str] = field(default_factory=list)  # what UsdPreviewSurface has no place for


def write_materials(
    stage: Any, document: Document, names: Sequence[str], layer: Path, kept: Collection[Path] = ()
) -> UsdMaterials:
    """Define materials of a document below ``/Asset/materials``.

    ``names``: by `cagemap.files.gltf.primitives.material_names`.
    ``layer``: the file of the stage; images are named after it, and never like a file that cagemap did not write.
    ``kept``: resolved paths of files that no image replaces.
    """
    written, file_of = UsdMaterials(), dict[int, str]()
    numbers = material_names(document)
    for label, name in zip(identifiers(names), names, strict=True):
        material, surface = define_material(stage, f"/Asset/materials/{label}")
        material.GetPrim().SetDisplayName(name)
        written.materials[name] = material
        entry = document.entry("materials", numbers.index(name))
        used, holders = {one.slot: one for one in material_images(document, name)}, dict(texture_slots(entry))
        for wanted, slot, channels, scale, bias in _inputs(document, entry, name, holders):
            if slot not in used:
                if slot not in (_NORMAL, _OCCLUSION) and not (slot in holders and slot in WITHOUT_IMAGE):
                    kind, value = ("Color3f", tuple(scale.tolist())) if len(scale) == 3 else ("Float", float(scale[0]))
                    surface.CreateInput(wanted, getattr(pxr.Sdf.ValueTypeNames, kind)).Set(value)
                continue
            number = used[slot].image
            if number not in file_of:
                data, suffix = _readable(document, number)
                file_of[number] = _free_name(
                    layer, f"{label}_{slot.removesuffix('Texture')}", suffix, written.images, kept
                )
                written.images[file_of[number]] = data
            reader = _reader(stage, material.GetPath(), used[slot])
            modes = zip(("wrapS", "wrapT"), used[slot].wraps, strict=True)
            settings = {setting: WRAP_WORDS.get(mode, "repeat") for setting, mode in modes} | _scaling(scale, bias)
            strength = holders[slot].get("scale", 1.0) if slot == _NORMAL else 1.0
            if strength != 1.0:
                written.notes.append(f"{name}: its normal map has strength {strength}, in USD always 1")
            settings |= {"sourceColorSpace": "sRGB"} if slot in (_COLOR, _EMISSION) else {}
            connect_texture(stage, surface, wanted, f"./{file_of[number]}", reader, output=channels, settings=settings)
    return written


def _inputs(
    document: Document, entry: dict[str, Any], name: str, holders: dict[str, dict[str, Any]]
) -> list[tuple[str, str, str, FloatArray, float]]:
    """Inputs of the surface: name, slot, channels of its image, factor (3,) or (1,), bias."""

    def number(of: dict[str, Any], factor: str, default: float) -> float:
        return float(document.numbers([of.get(factor, default)], f"{name}: {factor}", 1)[0])

    base = document.table(entry, "pbrMetallicRoughness", name)
    extensions = document.table(entry, "extensions", name)
    strength = number(document.table(extensions, STRENGTH, name), "emissiveStrength", 1.0)
    color = document.numbers(base.get("baseColorFactor", [1.0] * 4), f"{name}: baseColorFactor", 4)
    emitted = document.numbers(entry.get("emissiveFactor", [0.0] * 3), f"{name}: emissiveFactor", 3)
    share = number(holders.get(_OCCLUSION, {}), "strength", 1.0)
    inputs: list[tuple[str, str, str, FloatArray, float]] = [
        ("diffuseColor", _COLOR, "rgb", color[:3], 0.0),
        ("metallic", _METAL, "b", np.array([number(base, "metallicFactor", 1.0)]), 0.0),
        ("roughness", _METAL, "g", np.array([number(base, "roughnessFactor", 1.0)]), 0.0),
        ("emissiveColor", _EMISSION, "rgb", emitted * strength, 0.0),
        ("normal", _NORMAL, "rgb", np.ones(3), 0.0),
        ("occlusion", _OCCLUSION, "r", np.array([share]), 1.0 - share),
    ]
    mode = entry.get("alphaMode", "OPAQUE")
    if mode != "OPAQUE":
        inputs.append(("opacity", _COLOR, "a", color[3:], 0.0))
    if mode == "MASK":
        inputs.append(("opacityThreshold", "", "", np.array([number(entry, "alphaCutoff", 0.5)]), 0.0))
    return inputs


def _scaling(scale: FloatArray, bias: float) -> dict[str, object]:
    """Settings of the texture shader for a factor (3,) or (1,) and a bias."""
    four = {"scale": np.append(scale, 1.0) if len(scale) == 3 else np.repeat(scale, 4), "bias": np.zeros(4) + bias}
    default = {"scale": 1.0, "bias": 0.0}
    return {name: tuple(values.tolist()) for name, values in four.items() if (values != default[name]).any()}


def _reader(stage: Any, material: Any, image: MaterialImage) -> Any:
    """The shader of an image's texture coordinates, transformed as KHR_texture_transform says."""
    name = uv_primvar(int(image.uv_set.removeprefix("TEXCOORD_")))
    reader = uv_reader(stage, material.AppendChild(f"uv_{name}"), name)
    matrix = image.transform
    if np.allclose(matrix, np.eye(3)):
        return reader
    types = pxr.Sdf.ValueTypeNames
    # With v up: scaled, rotated, moved.
    width, height, angle = scale_and_angle(matrix)
    place = matrix[2, 0] + matrix[1, 0], 1.0 - matrix[2, 1] - matrix[1, 1]
    shader = pxr.UsdShade.Shader.Define(stage, material.AppendChild(f"{image.slot}_transform"))
    shader.CreateIdAttr("UsdTransform2d")
    shader.CreateInput("in", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    shader.CreateInput("scale", types.Float2).Set((width, height))
    shader.CreateInput("rotation", types.Float).Set(float(np.degrees(angle)))
    shader.CreateInput("translation", types.Float2).Set(tuple(map(float, place)))
    shader.CreateOutput("result", types.Float2)
    return shader


def _readable(document: Document, number: int) -> tuple[bytes, str]:
    """An image as PNG or JPEG, which all readers of USD know, with cagemap's mark; and its suffix."""
    data, suffix = image_bytes(document, number)
    if suffix not in (".png", ".jpg"):
        return png_bytes(image_of_bytes(data, suffix, f"{document.file}: images {number}")), ".png"
    if suffix == ".jpg":  # a PNG is marked when it is written
        at = 4 + int.from_bytes(data[4:6], "big") if data[2:4] == b"\xff\xe0" else 2
        text = mark().encode()
        data = data[:at] + b"\xff\xfe" + (len(text) + 2).to_bytes(2, "big") + text + data[at:]
    return data, suffix


def _free_name(layer: Path, name: str, suffix: str, taken: dict[str, bytes], kept: Collection[Path]) -> str:
    """A file name for an image that no other image, no file of others and none that is kept has."""
    names = (f"{layer.stem}_{name}{number or ''}{suffix}" for number in itertools.count())
    used = {one.lower() for one in taken}
    return next(
        one
        for one in names
        if one.lower() not in used
        and (not layer.with_name(one).exists() or is_own(layer.with_name(one)))
        and layer.with_name(one).resolve() not in kept
    )
