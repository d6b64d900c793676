"""Binary glTF that the page draws: named meshes whose attributes its shaders read, and named images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from cagemap.files.gltf.binary import VERTICES, Binary
from cagemap.files.gltf.document import glb_bytes
from cagemap.files.gltf.entries import image_suffix
from cagemap.numerics.arrays import IndexArray

# Modes of glTF, by corners.
_LINES, _TRIANGLES = 1, 4


@dataclass(frozen=True, eq=False)
class Drawn:
    """Triangles or lines of one kind.

    Attributes
    ----------
    name : str
    attributes : mapping of str to (n, q) array
        By glTF's names; own ones begin with ``_``. POSITION is in the view's coordinates. Texture coordinates: v up.
    corners : (t, 3) or (s, 2) int64
    """

    name: str
    attributes: Mapping[str, NDArray[Any]]
    corners: IndexArray


def glb(parts: Sequence[Drawn], images: Mapping[str, bytes] = MappingProxyType({})) -> bytes:
    """Pack parts and images (PNG or JPEG) into one binary glTF file; parts without corners are left out."""
    binary, meshes = Binary(), []
    for part in parts:
        if not len(part.corners):
            continue
        attributes = {
            name: binary.places(values) if name == "POSITION" else binary.accessor(_stored(name, values), VERTICES)
            for name, values in part.attributes.items()
        }
        mode = _LINES if part.corners.shape[1] == 2 else _TRIANGLES
        indices = binary.indices(part.corners.ravel())
        meshes.append({"name": part.name, "primitives": [{"attributes": attributes, "indices": indices, "mode": mode}]})
    pictures = [
        {"name": name, "bufferView": binary.view(data), "mimeType": f"image/{(image_suffix(data) or '.png')[1:]}"}
        for name, data in images.items()
    ]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap studio"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": number, "name": mesh["name"]} for number, mesh in enumerate(meshes)],
        "meshes": meshes,
    }
    return glb_bytes(binary.document(document | ({"images": pictures} if pictures else {})))


def _stored(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Single precision; of texture coordinates, v points down in glTF."""
    table = values.astype("<f4")
    if name.startswith("TEXCOORD"):
        table[:, 1] = 1.0 - table[:, 1]
    return table
