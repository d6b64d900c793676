"""Binary glTF files for the page: named meshes with shader attributes, and named images."""

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

# Drawing modes of glTF.
_LINE_MODE, _TRIANGLE_MODE = 1, 4


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A mesh of triangles or lines."""

    name: str
    # (n, q) by glTF's names; the page's own begin with ``_``. POSITION: in view coordinates. TEXCOORD: v up.
    attributes: Mapping[str, NDArray[Any]]
    corners: IndexArray  # (t, 3) or (s, 2)


def pack_glb(parts: Sequence[MeshPart], images: Mapping[str, bytes] = MappingProxyType({})) -> bytes:
    """Pack nonempty meshes and PNG or JPEG images into one binary glTF file."""
    binary, meshes = Binary(), []
    for part in parts:
        if not len(part.corners):
            continue
        attributes = {
            name: binary.accessor(_to_gltf(name, values), VERTICES, bounds=name == "POSITION")
            for name, values in part.attributes.items()
        }
        mode = _LINE_MODE if part.corners.shape[1] == 2 else _TRIANGLE_MODE
        indices = binary.indices(part.corners.ravel())
        meshes.append({"name": part.name, "primitives": [{"attributes": attributes, "indices": indices, "mode": mode}]})
    image_entries = [
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
    return glb_bytes(binary.document(document | ({"images": image_entries} if image_entries else {})))


def _to_gltf(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Values in single precision, with the v of texture coordinates pointing down."""
    table = values.astype("<f4")
    if name.startswith("TEXCOORD"):
        table[:, 1] = 1.0 - table[:, 1]
    return table
