"""Odd but legal mesh files, as other programs write them, and vertex colours as shares of full light."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import read_accessor
from cagemap.files.meshes.colors import to_unit_range
from cagemap.files.meshes.formats import read_mesh, write_mesh

from refusals import refuses

SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=np.float64)
V = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
F = "f 1 2 3 4\n"

OBJ = {
    "a comment behind numbers that ends in a backslash": V.replace("v 1 0 0", "v 1 0 0 # C:\\old\\") + F,
    "a backslash at the end of the file": V + "f 1 2 3 4\\",
    "a continued line, carriage returns alone": (V + "f 1 2 \\\n3 4\n").replace("\n", "\r"),
    "free-form elements": "vp 0.1 0.2\n" + V + "cstype bezier\ndeg 3 3\nsurf 0 1 0 1 1 2 3 4\nparm u 0 1\nend\n" + F,
    "faces before vertices": F + V,
    "corners that end in slashes": V + "f 1/ 2// 3/ 4//\n",
    "the end of a DOS file": V + F + "\x1a",
}
_PLY = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
_FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
_ROWS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
_END = "4 0 1 2 3\n"
_PLAIN = _PLY + _FACE + _ROWS + _END
PLY = {
    "lines of Windows": _PLAIN.replace("\n", "\r\n"),
    "lines of an old Mac": _PLAIN.replace("\n", "\r"),
    "a comment that has the last word of a header": _PLY.replace("ply\n", "ply\ncomment no end_header\n", 1)
    + (_FACE + _ROWS + _END),
    "faces first": "ply\nformat ascii 1.0\nelement face 1\nproperty list char float vertex_index\n"
    + (_PLY[21:] + "end_header\n" + _END + _ROWS),
    "other elements between": _PLY.replace("element vertex", "element none 3\nelement paint 1\nproperty list uint "
    "uchar a\nelement vertex") + "element edge 1\nproperty int vertex1\n" + _FACE + "2 65 66\n" + _ROWS + "7\n" + _END,
    "a list that is called red": _PLY + "property list uchar uchar red\nproperty uchar green\nproperty uchar blue\n"
    + _FACE + "".join(f"{row} 2 7 7 1 1\n" for row in _ROWS.splitlines()) + _END,
    "a number that is none, of no account": _PLY.replace("element vertex 4", "element vertex 4\nproperty float quality")
    + _FACE + "".join(f"nan {row}\n" for row in _ROWS.splitlines()) + _END,
}  # fmt: skip
OFF = {
    "with colours": "COFF\n4 1 0\n" + _ROWS.replace(" 0\n", " 0 255 0 0 255\n") + _END,
    "with normals and texture coordinates": "STNOFF\n4 1 0\n" + _ROWS.replace(" 0\n", " 0 0 0 1 .5 .5\n") + _END,
    "counts right behind the first word": "OFF4 1 0\n" + _ROWS + _END,
    "small letters": "off 4 1\n" + _ROWS + _END,
    "comments, and colours of faces": "OFF # a square\n# by hand\u2028 9 9 9\n4 1 0\n"
    + _ROWS
    + "\n4 0 1 2 3 255 0 0\n",
    "texture coordinates first": "STCNOFF\n4 1 0\n" + _ROWS.replace(" 0\n", " 0 0.5 0.5 9 9 9 255 0 0 1\n") + _END,
    "of MeshLab": "NCSTOFF\n4 1 0\n" + _ROWS.replace(" 0\n", " 0 0 0 1 255 0 0 1 .5 .5\n") + _END,
}
FILES = {"obj": OBJ, "ply": PLY, "off": OFF}


@pytest.mark.parametrize(("kind", "case"), [(kind, case) for kind, texts in FILES.items() for case in texts])
def test_odd_files_are_read(tmp_path: Path, kind: str, case: str) -> None:
    _is_the_square(tmp_path / f"mesh.{kind}", FILES[kind][case].encode())


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
def test_binary_ply_of_both_byte_orders_and_any_line_ends(tmp_path: Path, order: str, line_end: bytes) -> None:
    """The body begins with a byte that is a line feed too."""
    header = (
        f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement head 1\nproperty uchar a\n"
        "element vertex 4\nproperty double x\nproperty float y\nproperty short z\nelement face 1\n"
        "property uchar flags\nproperty list ushort uint vertex_indices\nproperty list uint short more\nend_header\n"
    )
    body = b"\n" + b"".join(struct.pack(order + "dfh", x, y, int(z)) for x, y, z in SQUARE.tolist())
    body += struct.pack(order + "BH4II2h", 9, 4, 0, 1, 2, 3, 2, -1, -1)
    _is_the_square(tmp_path / "mesh.ply", header.encode().replace(b"\n", line_end) + body)


@pytest.mark.parametrize(
    ("kind", "full", "one"),
    [("uchar", 255, 1 / 255), ("ushort", 65535, 1 / 65535), ("float", 1, 1.0), ("float", 255, 1 / 255)],
)
@pytest.mark.parametrize("prefix", ["", "diffuse_"])
def test_colours_of_ply_are_shares_of_what_their_type_holds(tmp_path, kind, full, one, prefix):
    channels = "".join(f"property {kind} {prefix}{name}\n" for name in ("red", "green", "blue"))
    for top in {full, 1} if kind != "float" else {full}:
        rows = _ROWS.replace(" 0\n", f" 0 {top} 1 0\n")
        (tmp_path / "mesh.ply").write_text(_PLY + channels + _FACE + rows + _END)
        colors = read_mesh(tmp_path / "mesh.ply").vertex_colors
        np.testing.assert_allclose(colors, np.tile([top / full, one, 0], (4, 1)), rtol=1e-12)


def test_means_of_bytes_are_bytes_too(tmp_path: Path) -> None:
    channels = "".join(f"property float {name}\n" for name in ("red", "green", "blue"))
    rows = _ROWS.replace(" 0\n", " 0 204 127.5 0\n")
    (tmp_path / "mesh.ply").write_text(_PLY + channels + _FACE + rows + _END)
    np.testing.assert_allclose(read_mesh(tmp_path / "mesh.ply").vertex_colors, np.tile([0.8, 0.5, 0], (4, 1)))


def test_a_colour_that_is_no_number_is_none(tmp_path: Path) -> None:
    channels = "".join(f"property float {name}\n" for name in ("red", "green", "blue"))
    rows = _ROWS.replace(" 0\n", " 0 0.5 1 0\n").replace("0.5", "nan", 1)
    (tmp_path / "mesh.ply").write_text(_PLY + channels + _FACE + rows + _END)
    colors = read_mesh(tmp_path / "mesh.ply").vertex_colors
    np.testing.assert_array_equal(colors, [[np.nan] * 3, *([[0.5, 1, 0]] * 3)])


def test_colours_of_obj_may_be_bytes(tmp_path: Path) -> None:
    for values, expected in (
        ("255 51 0", [1, 0.2, 0]),
        ("0.5 1 0", [0.5, 1, 0]),
        ("2.5 1 0", [2.5, 1, 0]),
        ("204 127.5 0", [0.8, 0.5, 0]),
    ):
        (tmp_path / "mesh.obj").write_text(V.replace(" 0\n", f" 0 {values}\n") + F)
        colors = read_mesh(tmp_path / "mesh.obj").vertex_colors
        np.testing.assert_allclose(colors, np.tile(expected, (4, 1)), rtol=1e-12)


@pytest.mark.parametrize("name", ["a vertex of mine", "vertex 1 2 3", ""])
@pytest.mark.parametrize("capitals", [False, True])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r", " "])
def test_odd_stl_files_are_read(tmp_path: Path, name: str, capitals: bool, line_end: str) -> None:
    """Words may share a line, all of them too: where a line ends means nothing but for names."""
    triangles = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(" vertex {!r} {!r} {!r}\n".format(*SQUARE[i].tolist()) for i in corners)
        + "endloop\nendfacet\n"
        for corners in ((0, 1, 2), (0, 2, 3))
    )
    text = f"\ufeffsolid {name}\n{triangles}endsolid {name}\n"
    (tmp_path / "mesh.stl").write_bytes((text.upper() if capitals else text).replace("\n", line_end).encode())
    mesh = read_mesh(tmp_path / "mesh.stl")
    np.testing.assert_array_equal(mesh.positions, SQUARE)
    np.testing.assert_array_equal(mesh.face_indices, [0, 1, 2, 0, 2, 3])


@pytest.mark.parametrize("extra", [-1, 0, 49, 50])
def test_a_binary_stl_may_be_padded_by_less_than_a_triangle(tmp_path: Path, extra: int) -> None:
    corners = SQUARE[[0, 1, 2, 0, 2, 3]].reshape(2, 9)
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *row, 0) for row in corners.tolist())
    content = b"scan".ljust(80) + struct.pack("<I", 2) + records + bytes(50)
    (tmp_path / "m.stl").write_bytes(content[: 84 + 100 + extra])
    if not 0 <= extra < 50:
        refuses(FormatError, "expected an STL file", read_mesh, tmp_path / "m.stl")
        return
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.stl").positions, SQUARE)


def _is_the_square(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    mesh = read_mesh(file)
    np.testing.assert_array_equal(mesh.positions, SQUARE)
    np.testing.assert_array_equal(mesh.face_offsets, [0, 4])
    np.testing.assert_array_equal(mesh.face_indices, [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("largest", "full"),
    [
        (1.0, 1.0),
        (2.0, 255.0),  # whole numbers beyond 1
        (1.5, 1.0),  # light brighter than white
        (15.9, 1.0),
        (16.1, 255.0),  # means of bytes
    ],
)
def test_numbers_far_beyond_1_or_whole_are_bytes(largest: float, full: float) -> None:
    colors = np.array([[0.0, 1.0, largest], [np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(to_unit_range(colors), colors / full)


def test_the_file_says_what_is_full() -> None:
    np.testing.assert_allclose(to_unit_range(np.array([[0.0, 512.0, 1023.0]]), 1023.0), [[0.0, 512 / 1023, 1.0]])


def test_colours_of_gltf_and_usd_are_linear(tmp_path: Path) -> None:
    colors = np.random.default_rng(3).random((8, 3))
    colors[0] = [0.0, 0.5, 1.0]
    mesh = replace(cube(), vertex_colors=colors)
    write_mesh(tmp_path / "cube.glb", mesh)
    document = read_document(tmp_path / "cube.glb")
    (primitive,) = document.entry("meshes", 0)["primitives"]
    stored = read_accessor(document, primitive["attributes"]["COLOR_0"], "COLOR_0", ("VEC3",))
    np.testing.assert_allclose(stored[0], [0.0, 0.21404, 1.0], atol=1e-5)
    np.testing.assert_allclose(read_mesh(tmp_path / "cube.glb").vertex_colors, colors, atol=1e-6)
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    write_mesh(tmp_path / "cube.usda", mesh)
    stage = usd.Stage.Open(str(tmp_path / "cube.usda"))
    prim = stage.GetPrimAtPath("/Asset/mesh")
    np.testing.assert_allclose(prim.GetAttribute("primvars:displayColor").Get()[0], [0.0, 0.21404, 1.0], atol=1e-5)
    np.testing.assert_allclose(read_mesh(tmp_path / "cube.usda").vertex_colors, colors, atol=1e-6)
