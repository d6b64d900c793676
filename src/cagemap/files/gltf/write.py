"""glTF 2.0 as one binary file (``.glb``): an export of refined meshes for viewers and engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.atomic import write_whole
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.document import glb_bytes
from cagemap.files.gltf.geometry import mesh_entry
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray


def write_glb(path: str | Path, mesh: ControlMesh, *, to_metres: FloatArray | None = None, force: bool = False) -> None:
    """Write a mesh as glTF: polygons as fans of triangles, one primitive a material, vertices parted at UV seams.

    Positions are single precision in the mesh's own unit. Creases have no place in it.

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
    # Columns one after the other, for points as columns: the rows of a matrix for points as rows.
    placed = {} if to_metres is None else {"matrix": to_metres.ravel().tolist()}
    binary = Binary()
    count = 0 if mesh.face_materials is None else len(mesh.material_names)
    top: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": mesh.name} | placed],
        "meshes": [mesh_entry(binary, mesh, range(count))],
    }
    if count:
        top["materials"] = [material_entry(mesh, number) for number in range(count)]
    return glb_bytes(binary.document(top))


def material_entry(mesh: ControlMesh, number: int) -> dict[str, Any]:
    """Entry of ``materials`` with the name and the colour that a mesh states."""
    surface: dict[str, Any] = {"metallicFactor": 0.0}
    if mesh.material_colors is not None and np.isfinite(mesh.material_colors[number]).all():
        surface["baseColorFactor"] = [*np.clip(mesh.material_colors[number], 0.0, 1.0).tolist(), 1.0]
    return {"name": mesh.material_names[number], "pbrMetallicRoughness": surface}
