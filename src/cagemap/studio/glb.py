"""Binary glTF of a coloured or textured mesh: what the page's viewer takes for anything but plain meshes.

Its light is worked out here, once for every vertex: lights stand still with the model, so what a matt surface sends to
the eye is the same from everywhere. A machine that draws without a graphics card, or beside a computation, then turns
models several times as fast as with lights worked out for every pixel of every picture.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ARRAY_BUFFER, _ELEMENT_BUFFER = 34962, 34963
_COMPONENT = {"f": 5126, "H": 5123, "I": 5125}
_SHAPE = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# Colours are linear: 8 bits would show steps in the dark.
_WHITE = 65535
# Matt and already lit: https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_materials_unlit
_UNLIT = "KHR_materials_unlit"


@dataclass(frozen=True, eq=False)
class Primitive:
    """Triangles with one material.

    Attributes
    ----------
    positions : (n, 3) array
    triangles : (t, 3) array
    colors : (n, 3) array
        Linear, from 0 to 1, in the light that falls on every vertex; a texture is multiplied by them.
    uvs : (n, 2) array or None
        Texture coordinates, v up, into the texture of the file.
    opacity : float
    two_sided : bool
        Whether triangles that look away are drawn.
    """

    positions: NDArray[Any]
    triangles: NDArray[Any]
    colors: NDArray[Any]
    uvs: NDArray[Any] | None = None
    opacity: float = 1.0
    two_sided: bool = True


def glb(primitives: Sequence[Primitive], texture: bytes | None = None) -> bytes:
    """Pack primitives into one binary glTF file.

    Parameters
    ----------
    primitives : sequence of Primitive
        Those without triangles are left out.
    texture : bytes or None
        A JPEG file, for the primitives that have texture coordinates.
    """
    chunks: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    parts: list[dict[str, Any]] = []

    def view(data: bytes, target: int | None = None) -> int:
        entry: dict[str, Any] = {"buffer": 0, "byteOffset": sum(map(len, chunks)), "byteLength": len(data)}
        views.append(entry if target is None else entry | {"target": target})
        chunks.append(data + b"\0" * (-len(data) % 4))
        return len(views) - 1

    def accessor(array: NDArray[Any], target: int, **extra: Any) -> int:
        width = 1 if array.ndim == 1 else array.shape[1]
        accessors.append(
            {
                "bufferView": view(array.tobytes(), target),
                "componentType": _COMPONENT[array.dtype.char],
                "count": len(array),
                "type": _SHAPE[width],
            }
            | extra
        )
        return len(accessors) - 1

    for part in primitives:
        if not len(part.triangles):
            continue
        positions = np.ascontiguousarray(part.positions, dtype=np.float32)
        bounds = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
        opaque = np.full((len(positions), 4), _WHITE, dtype=np.uint16)
        opaque[:, :3] = np.rint(_WHITE * np.clip(part.colors, 0.0, 1.0))
        attributes = {
            "POSITION": accessor(positions, _ARRAY_BUFFER, **bounds),
            "COLOR_0": accessor(opaque, _ARRAY_BUFFER, normalized=True),
        }
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.85}
        if part.uvs is not None and texture is not None:
            # glTF's v points down.
            uvs = np.column_stack([part.uvs[:, 0], 1.0 - part.uvs[:, 1]]).astype(np.float32)
            attributes["TEXCOORD_0"] = accessor(uvs, _ARRAY_BUFFER)
            surface["baseColorTexture"] = {"index": 0}
        material: dict[str, Any] = {
            "pbrMetallicRoughness": surface,
            "doubleSided": part.two_sided,
            "extensions": {_UNLIT: {}},
        }
        if part.opacity < 1:
            surface["baseColorFactor"] = [1.0, 1.0, 1.0, part.opacity]
            material["alphaMode"] = "BLEND"
        materials.append(material)
        indices = accessor(np.ascontiguousarray(part.triangles, dtype=np.uint32).ravel(), _ELEMENT_BUFFER)
        parts.append({"attributes": attributes, "indices": indices, "material": len(materials) - 1})

    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap studio"},
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": parts}],
        "materials": materials,
    }
    if texture is not None:
        document["images"] = [{"bufferView": view(texture), "mimeType": "image/jpeg"}]
        document["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    binary = b"".join(chunks)
    document |= {"buffers": [{"byteLength": len(binary)}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    header = struct.pack("<4sII", b"glTF", 2, total)
    return b"".join(
        [header, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    )
