"""STL files: corners at one place are one vertex, damaged files are refused by name."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import icosahedron

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh import ControlMesh


def _corners(mesh: ControlMesh) -> np.ndarray:
    return mesh.positions[mesh.face_indices].reshape(-1, 3, 3)


def test_stl_corners_at_one_place_are_one_vertex(tmp_path: Path) -> None:
    mesh, file = icosahedron(), tmp_path / "mesh.stl"
    triangles = _corners(mesh)
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    # Binary files may begin with 'solid' as well.
    file.write_bytes(b"solid scan".ljust(80) + struct.pack("<I", len(triangles)) + records)
    text = "solid scan\n" + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle.tolist())
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    padded = file.read_bytes() + bytes(2)
    for write in (lambda: None, lambda: file.write_bytes(padded), lambda: file.write_text(text + "endsolid scan\n")):
        write()
        found = read_mesh(file)
        assert found.n_vertices == 12
        assert np.allclose(_corners(found), triangles, atol=1e-6)
        first = np.unique(found.face_indices, return_index=True)[1]
        assert np.array_equal(first, np.sort(first))  # numbered as they appear
    file.write_text(text)
    with pytest.raises(FormatError, match="cut short"):
        read_mesh(file)
    file.write_text(text.replace("vertex", "vertex x", 1) + "endsolid")
    with pytest.raises(FormatError, match="three vertices"):
        read_mesh(file)
    file.write_text("solid nothing\nendsolid nothing\n")
    with pytest.raises(FormatError, match="expected triangles"):
        read_mesh(file)
