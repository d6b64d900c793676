"""Binary glTF of a coloured or textured mesh: what the page's viewer takes for anything but plain meshes.

Its light is worked out here, once for every vertex: lights stand still with the model, so what a matt surface sends to
the eye is the same from everywhere. A machine that draws without a graphics card, or beside a computation, then turns
models several times as fast as with lights worked out for every pixel of every picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.gltf.binary import INDICES, VERTICES, Binary
from cagemap.files.gltf.document import glb_bytes

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
    binary = Binary()
    materials: list[dict[str, Any]] = []
    parts: list[dict[str, Any]] = []
    for part in primitives:
        if not len(part.triangles):
            continue
        positions = np.ascontiguousarray(part.positions, dtype=np.float32)
        bounds = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
        opaque = np.full((len(positions), 4), _WHITE, dtype=np.uint16)
        opaque[:, :3] = np.rint(_WHITE * np.clip(part.colors, 0.0, 1.0))
        attributes = {
            "POSITION": binary.accessor(positions, VERTICES, **bounds),
            "COLOR_0": binary.accessor(opaque, VERTICES, normalized=True),
        }
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.85}
        if part.uvs is not None and texture is not None:
            # glTF's v points down.
            uvs = np.column_stack([part.uvs[:, 0], 1.0 - part.uvs[:, 1]]).astype(np.float32)
            attributes["TEXCOORD_0"] = binary.accessor(uvs, VERTICES)
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
        indices = binary.accessor(np.ascontiguousarray(part.triangles, dtype=np.uint32).ravel(), INDICES)
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
        document["images"] = [{"bufferView": binary.view(texture), "mimeType": "image/jpeg"}]
        document["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    return glb_bytes(binary.document(document))
