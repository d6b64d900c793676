"""OFF and STL files: what is written or written by others is read, and what is wrong is named."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from examples.shapes import creature, cube, icosahedron, pyramid, triangulated

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.prims import transform_points
from cagemap.files.usd.space import to_standard
from cagemap.mesh import ControlMesh, Plain

from refusals import refuses

BOX = """OFF # a square and a triangle
# by hand
5 2 0
0 0 0
1 0 0
1 1 0
0 1 0.5e0
0 2 0

4 0 1 2 3 255 0 0
3 3 2 4
"""


@pytest.mark.parametrize("mesh", [cube(), icosahedron(), pyramid(), triangulated(creature())])
def test_what_is_written_is_read(mesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.off", mesh)
    again = read_mesh(tmp_path / "m.off")
    np.testing.assert_array_equal(again.positions, mesh.positions)
    np.testing.assert_array_equal(again.face_indices, mesh.face_indices)
    np.testing.assert_array_equal(again.face_offsets, mesh.face_offsets)


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("OFF", "4OFF", "another beginning"),
        ("5 2 0", "5 3 0", "a line for each"),
        ("5 2 0", "x 2 0", "a line for each"),
        ("5 2 0", "-1 2 0", "a line for each"),
        ("3 3 2 4", "3 3 2 5", "from 0 to 4, got 5"),
        ("3 3 2 4", "9 3 2 4", "as many vertices"),
        ("3 3 2 4", "99999999999999999999 3 2 4", "as many vertices"),
        ("1 1 0\n", "1 1 nan\n", "three finite numbers"),
        ("1 1 0\n", "1 1\n", "three finite numbers"),
    ],
)
def test_what_is_wrong_is_named(was: str, now: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text(BOX.replace(was, now))
    refuses(FormatError, said, read_mesh, tmp_path / "m.off")


def _corners(mesh: ControlMesh) -> np.ndarray:
    return mesh.positions[mesh.face_indices].reshape(-1, 3, 3)


@pytest.mark.parametrize("name", ["mesh.usda", "mesh.glb"])
def test_a_mesh_of_an_stl_file_stands_upright_in_other_formats(name: str, tmp_path: Path) -> None:
    """STL has Z up; `to_standard` is metres with Y up."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    shape = triangulated(creature())
    trimesh.Trimesh(shape.positions, shape.face_indices.reshape(-1, 3)).export(tmp_path / "mesh.stl")
    mesh = read_mesh(tmp_path / "mesh.stl")
    write_mesh(tmp_path / name, mesh, like=tmp_path / "mesh.stl")
    found = transform_points(read_mesh(tmp_path / name).positions, to_standard(tmp_path / name))
    expected = np.column_stack([mesh.positions[:, 0], mesh.positions[:, 2], -mesh.positions[:, 1]])
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), atol=1e-5)


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
        np.testing.assert_array_equal([0, 0, 1] @ found.upright, [0, 1, 0])  # most STL files have +Z up
        assert found.scheme == Plain()
    file.write_text(text)
    refuses(FormatError, "cut short", read_mesh, file)
    file.write_text(text.replace("vertex", "vertex x", 1) + "endsolid")
    refuses(FormatError, "three vertices", read_mesh, file)
    file.write_text("solid nothing\nendsolid nothing\n")
    refuses(FormatError, "expected triangles", read_mesh, file)
