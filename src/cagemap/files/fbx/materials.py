"""Materials and textures of FBX scenes as entries of a glTF document."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import ufbx

from cagemap.files.fbx.meshes import finite_array, get, keep_alive, list_attribute
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.textures import CLAMP, REPEAT, AddedTextures, scale_and_angle
from cagemap.files.text import find_image
from cagemap.numerics.arrays import FloatArray

# Material maps of ufbx, and the texture slots of glTF.
_SLOTS = {
    "base_color": "baseColorTexture",
    "normal_map": "normalTexture",
    "emission_color": "emissiveTexture",
    "ambient_occlusion": "occlusionTexture",
}
# Relative to the largest number of a transform.
_MATRIX_ROUNDING = 1e-5


class Materials:
    """Materials, textures and images of a glTF document; textures are searched in the folder of an FBX file."""

    def __init__(self, binary: Binary, path: Path, note: Callable[[str], None]) -> None:
        self._path, self._note = path, note
        self.lists: dict[str, list[Any]] = {"materials": []}
        self._textures = AddedTextures(binary, self.lists)
        self._known: dict[tuple[int, tuple[int, ...]], int] = {}
        self._image_of: dict[int, int | None] = {}  # by the texture's element_id

    def number(self, material: Any, uv_sets: Sequence[str]) -> int:
        """Number in the document of a material of a mesh with UV sets of these names."""
        textures = [get(material, "pbr", source, "texture") for source in _SLOTS]
        shown = [None if texture is None else self._with_image(texture) for texture in textures]
        stated = ["" if texture is None else get(texture, "uv_set") for texture in shown]
        coordinates = tuple(uv_sets.index(name) if name in uv_sets else 0 for name in stated)
        known = get(material, "typed_id"), coordinates
        if known not in self._known:
            self._known[known] = len(self.lists["materials"])
            self.lists["materials"].append(self._entry(material, coordinates))
        return self._known[known]

    def _entry(self, material: Any, coordinates: Sequence[int]) -> dict[str, Any]:
        name, pbr = get(material, "name"), get(material, "pbr")
        slots: dict[str, Any] = {}
        used = []
        for (source, slot), uv_set in zip(_SLOTS.items(), coordinates, strict=True):
            texture = get(pbr, source, "texture")
            if texture is not None:
                used.append(get(texture, "element_id"))
                entry_of_texture = self._texture(texture, f"material {name}: {slot}")
                if entry_of_texture is not None:
                    slots[slot] = entry_of_texture | ({"texCoord": uv_set} if uv_set else {})
        unused = [one for one in list_attribute(material, "textures") if get(one, "texture", "element_id") not in used]
        if unused:
            listed = ", ".join(sorted({get(one, "material_prop") for one in unused}))
            self._note(f"material {name}: textures of {listed} are left out")
        opacity = self._opacity(material)
        color = [1.0] * 3 if "baseColorTexture" in slots else _color(pbr, "base")
        surface: dict[str, Any] = {
            "baseColorFactor": [*color, opacity],
            "metallicFactor": _value(pbr, "metalness", 0.0),
            "roughnessFactor": _value(pbr, "roughness", 1.0),
        }
        glow = [1.0] * 3 if "emissiveTexture" in slots else _color(pbr, "emission")
        finite_array(
            [*surface["baseColorFactor"], surface["metallicFactor"], surface["roughnessFactor"], *glow],
            f"material {name}",
        )
        image = {slot: slots.pop(slot) for slot in ("baseColorTexture",) if slot in slots}
        entry = {"name": name, "pbrMetallicRoughness": surface | image} | slots
        entry |= {"alphaMode": "BLEND"} if opacity < 1.0 else {}
        return entry | ({"emissiveFactor": glow} if any(glow) else {})

    def _opacity(self, material: Any) -> float:
        """Opacity from 0 to 1, from ``Opacity`` or a transparent colour and factor, which some programs invert."""
        numbers = get(material, "props", "find_real")
        color = np.array(list(get(material, "fbx", "transparency_color", "value_vec4")))[:3].max()
        opacity = float(np.clip(min(numbers("Opacity", 1.0), 1.0 - numbers("TransparencyFactor", 0.0) * color), 0, 1))
        if opacity > 0.0:
            return opacity
        self._note(f"material {get(material, 'name')}: its numbers say that it cannot be seen; taken as opaque")
        return 1.0

    def _texture(self, texture: Any, where: str) -> dict[str, Any] | None:
        file = self._with_image(texture)
        if file is not None:
            images = {self._image(one) for one in _layers(texture)} - {None}
            if len(images) > 1:
                self._note(f"{where}: has {len(images)} layers, the first is used")
            transform = _transform(file, where) if get(file, "has_uv_transform") else {}
            if transform is None:
                self._note(f"{where}: is turned and stretched as no glTF texture can be, and taken as it is")
            modes = (get(file, "wrap_u"), get(file, "wrap_v"))
            across, up = (CLAMP if mode == ufbx.WrapMode.CLAMP else REPEAT for mode in modes)
            image = self._image(file)
            assert image is not None
            return self._textures.texture(image, (across, up), transform)
        stated = get(texture, "relative_filename") or get(texture, "filename") or get(texture, "name")
        if any(self._content(one) for one in _layers(texture)):
            self._note(f"{where}: '{stated}' cannot be read as an image and is left out; save it as a PNG")
        else:
            self._note(f"{where}: '{stated}' is not found and left out; put it beside the FBX file")
        return None

    def _with_image(self, texture: Any) -> Any:
        """The texture itself, or its first layer, with a readable image; None without one."""
        return next((one for one in _layers(texture) if self._image(one) is not None), None)

    def _image(self, texture: Any) -> int | None:
        """Number of a texture's image; None if there is no readable one."""
        key = get(texture, "element_id")
        if key not in self._image_of:
            data = self._content(texture)
            self._image_of[key] = (
                self._textures.image(data, PurePosixPath(_file_name(texture)).suffix) if data else None
            )
        return self._image_of[key]

    def _content(self, texture: Any) -> bytes:
        """Content of a texture's image: in the FBX, or in its folder; b"" if missing."""
        file = find_image(self._path, _file_name(texture))
        return bytes(get(texture, "content")) or (b"" if file is None else keep_alive(file.read_bytes()))


def _layers(texture: Any) -> list[Any]:
    return [texture, *list_attribute(texture, "file_textures")]


def _file_name(texture: Any) -> str:
    return str(get(texture, "relative_filename") or get(texture, "filename"))


def _value(pbr: Any, name: str, default: float) -> float:
    stated = get(pbr, name)
    return float(np.clip(get(stated, "value_vec4").x, 0.0, 1.0)) if get(stated, "has_value") else default


def _color(pbr: Any, name: str) -> list[float]:
    """Colour multiplied by its factor, within 0 and 1."""
    color = np.array(list(get(pbr, f"{name}_color", "value_vec4")))[:3]
    return np.clip(color * _value(pbr, f"{name}_factor", 1.0), 0.0, 1.0).tolist()


def _transform(texture: Any, where: str) -> dict[str, Any] | None:
    """KHR_texture_transform of a texture: scale, rotation and offset; None if it has shear too, or no inverse."""
    flip = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 1.0]])  # v down in glTF; for rows
    # Its inverse in the file is that in three dimensions, and zero if the scale along z is: assimp writes 1, 1, 0.
    stated = finite_array(list(get(texture, "texture_to_uv")), f"{where}: transform")
    rows = np.eye(3)
    rows[:2, :2], rows[2, :2] = stated[:2, :2], stated[3, :2]
    if np.linalg.det(rows) == 0.0:
        return None
    down: FloatArray = flip @ np.linalg.inv(rows) @ flip
    *scale, angle = scale_and_angle(down)
    c, s = np.cos(angle), np.sin(angle)
    if np.abs(np.diag(scale) @ [[c, -s], [s, c]] - down[:2, :2]).max() > _MATRIX_ROUNDING * max(map(abs, scale)):
        return None
    return {"offset": down[2, :2].tolist(), "rotation": angle, "scale": scale}
