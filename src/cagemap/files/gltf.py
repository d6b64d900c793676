"""glTF 2.0 as one binary file (``.glb``): an export of refined meshes for viewers and engines."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.atomic import atomic_path
from cagemap.files.marks import mark
from cagemap.geometry.triangles import triangle_normals
from cagemap.mesh import ControlMesh
from cagemap.mesh.measures import fan_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray

_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


def write_glb(path: str | Path, mesh: ControlMesh, *, force: bool = False) -> None:
    """Write a mesh as glTF: polygons as fans of triangles, one primitive a material, vertices parted at UV seams.

    Positions are single precision in the mesh's own unit; glTF says metres. Creases and further UV sets have no place
    in it.

    Raises
    ------
    FormatError
        If the file cannot be written.
    """
    document, blob = _document(mesh)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    with atomic_path(path, force=force) as temporary:
        temporary.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _document(mesh: ControlMesh) -> tuple[dict[str, Any], bytes]:
    corners, corner_faces = _fan_corners(mesh)
    uv_indices = mesh.face_indices if mesh.uv_indices is None else mesh.uv_indices
    pairs = mesh.face_indices * (int(uv_indices.max()) + 1) + uv_indices
    _, first, numbers = np.unique(pairs, return_index=True, return_inverse=True)
    triangles = numbers[corners]
    vertices, uvs = mesh.face_indices[first], uv_indices[first]
    views: list[bytes] = []
    accessors: list[dict[str, Any]] = []

    def add(values: NDArray[Any], target: int) -> int:
        table = values.astype("<f4" if values.dtype.kind == "f" else "<u4")
        entry = {
            "bufferView": len(views),
            "componentType": _FLOAT if values.dtype.kind == "f" else _UNSIGNED,
            "count": len(table),
            "type": _KINDS[1 if table.ndim == 1 else table.shape[1]],
        }
        if target == _VERTICES:
            entry |= {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()}
        views.append(table.tobytes())
        accessors.append(entry)
        return len(accessors) - 1

    attributes = {
        "POSITION": add(mesh.positions[vertices], _VERTICES),
        "NORMAL": add(_vertex_normals(mesh)[vertices], _VERTICES),
    }
    if mesh.uvs is not None:
        # glTF counts v from the top.
        attributes["TEXCOORD_0"] = add(mesh.uvs[uvs] * [1.0, -1.0] + [0.0, 1.0], _VERTICES)
    if mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        attributes["COLOR_0"] = add(mesh.vertex_colors[vertices], _VERTICES)
    numbers_of = np.zeros(mesh.n_faces, dtype=np.int64) if mesh.face_materials is None else mesh.face_materials
    primitives = []
    for material in np.unique(numbers_of[corner_faces]).tolist():
        chosen = triangles[numbers_of[corner_faces] == material].ravel()
        primitive = {"attributes": attributes, "indices": add(chosen, _INDICES)}
        primitives.append(primitive if mesh.face_materials is None else primitive | {"material": material})
    offsets = np.cumsum([0, *map(len, views)]).tolist()  # all entries are of 4 bytes, and so all places are
    targets = [_INDICES if accessor["componentType"] == _UNSIGNED else _VERTICES for accessor in accessors]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap", "extras": {"mark": mark()}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": mesh.name}],
        "meshes": [{"primitives": primitives}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": offset, "byteLength": len(view), "target": target}
            for offset, view, target in zip(offsets, views, targets, strict=False)
        ],
        "buffers": [{"byteLength": offsets[-1]}],
    }
    if mesh.face_materials is not None:
        document["materials"] = [_material(mesh, number) for number in range(len(mesh.material_names))]
    return document, b"".join(views)


def _fan_corners(mesh: ControlMesh) -> tuple[IndexArray, IndexArray]:
    """(t, 3) face corners of the fans' triangles, and (t,) their faces."""
    numbered = ControlMesh(mesh.positions, mesh.face_offsets, np.arange(len(mesh.face_indices)))
    return fan_triangles(numbered)


def _vertex_normals(mesh: ControlMesh) -> FloatArray:
    """(n, 3) unit normals, the mean of the faces around weighted by area; up where there is none."""
    triangles, _ = fan_triangles(mesh)
    sums = np.zeros_like(mesh.positions)
    np.add.at(sums, triangles, triangle_normals(mesh.positions, triangles)[:, None, :])
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0, sums / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])


def _material(mesh: ControlMesh, number: int) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0}
    if mesh.material_colors is not None and np.isfinite(mesh.material_colors[number]).all():
        surface["baseColorFactor"] = [*np.clip(mesh.material_colors[number], 0.0, 1.0).tolist(), 1.0]
    return {"name": mesh.material_names[number], "pbrMetallicRoughness": surface}
