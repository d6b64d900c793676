"""glTF 2.0 as one binary file (``.glb``): an export of refined meshes for viewers and engines."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.triangles import fan_triangles, vertex_normals

# What an array in the file is for.
VERTICES, INDICES = 34962, 34963
# By kind and size: one type has different letters on different systems.
_COMPONENTS = {"f4": 5126, "u2": 5123, "u4": 5125}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Binary:
    """What a file holds beside its JSON: arrays and other bytes, and where each of them lies."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._length = 0

    def view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the number of their buffer view."""
        entry: dict[str, Any] = {"buffer": 0, "byteOffset": self._length, "byteLength": len(data)}
        self._views.append(entry if target is None else entry | {"target": target})
        self._chunks.append(data + b"\0" * (-len(data) % 4))
        self._length += len(self._chunks[-1])
        return len(self._views) - 1

    def accessor(self, array: NDArray[Any], target: int, **extra: Any) -> int:
        """Add an array (n,) or (n, q) of single precision or unsigned numbers; returns the number of its accessor."""
        entry = {
            "bufferView": self.view(array.tobytes(), target),
            "componentType": _COMPONENTS[f"{array.dtype.kind}{array.dtype.itemsize}"],
            "count": len(array),
            "type": _SHAPES[1 if array.ndim == 1 else array.shape[1]],
        }
        self._accessors.append(entry | extra)
        return len(self._accessors) - 1

    def packed(self, document: dict[str, Any]) -> bytes:
        """The whole file: a document, to which accessors, views and the buffer are added, and the bytes."""
        buffers = [{"byteLength": self._length}]
        document = document | {"accessors": self._accessors, "bufferViews": self._views, "buffers": buffers}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", self._length, b"BIN\0")
        return b"".join([struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + self._length), chunks, *self._chunks])


def write_glb(path: str | Path, mesh: ControlMesh, *, to_metres: FloatArray | None = None, force: bool = False) -> None:
    """Write a mesh as glTF: polygons as fans of triangles, one primitive a material, vertices parted at UV seams.

    Positions are single precision in the mesh's own unit. Creases and further UV sets have no place in it.

    Parameters
    ----------
    path : path
    mesh : ControlMesh
    to_metres : (4, 4) float64, optional
        From the mesh's space, rows times it, to metres with Y up, as glTF has them: the transform of its node.
    force : bool

    Raises
    ------
    FormatError
        If the file cannot be written.
    """
    write_whole(path, _packed(mesh, to_metres), force=force)


def _packed(mesh: ControlMesh, to_metres: FloatArray | None) -> bytes:
    corners, corner_faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    uv_indices = mesh.face_indices if mesh.uv_indices is None else mesh.uv_indices
    pairs = mesh.face_indices * (int(uv_indices.max()) + 1) + uv_indices
    _, first, numbers = np.unique(pairs, return_index=True, return_inverse=True)
    triangles = numbers[corners]
    vertices, uvs = mesh.face_indices[first], uv_indices[first]
    binary = Binary()

    def add(values: NDArray[Any], target: int) -> int:
        table = values.astype("<f4" if values.dtype.kind == "f" else "<u4")
        bounds = {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()} if target == VERTICES else {}
        return binary.accessor(table, target, **bounds)

    normals = vertex_normals(mesh.positions, mesh.face_indices[corners])
    normals[~normals.any(axis=1)] = [0.0, 0.0, 1.0]
    attributes = {
        "POSITION": add(mesh.positions[vertices], VERTICES),
        "NORMAL": add(normals[vertices], VERTICES),
    }
    if mesh.uvs is not None:
        # glTF counts v from the top.
        attributes["TEXCOORD_0"] = add(mesh.uvs[uvs] * [1.0, -1.0] + [0.0, 1.0], VERTICES)
    if mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        attributes["COLOR_0"] = add(mesh.vertex_colors[vertices], VERTICES)
    numbers_of = np.zeros(mesh.n_faces, dtype=np.int64) if mesh.face_materials is None else mesh.face_materials
    primitives = []
    for material in np.unique(numbers_of[corner_faces]).tolist():
        chosen = triangles[numbers_of[corner_faces] == material].ravel()
        primitive = {"attributes": attributes, "indices": add(chosen, INDICES)}
        primitives.append(primitive if mesh.face_materials is None else primitive | {"material": material})
    # Columns one after the other, for points as columns: the rows of a matrix for points as rows.
    placed = {} if to_metres is None else {"matrix": to_metres.ravel().tolist()}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap", "extras": {"mark": mark()}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": mesh.name} | placed],
        "meshes": [{"primitives": primitives}],
    }
    if mesh.face_materials is not None:
        document["materials"] = [_material(mesh, number) for number in range(len(mesh.material_names))]
    return binary.packed(document)


def _material(mesh: ControlMesh, number: int) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0}
    if mesh.material_colors is not None and np.isfinite(mesh.material_colors[number]).all():
        surface["baseColorFactor"] = [*np.clip(mesh.material_colors[number], 0.0, 1.0).tolist(), 1.0]
    return {"name": mesh.material_names[number], "pbrMetallicRoughness": surface}
