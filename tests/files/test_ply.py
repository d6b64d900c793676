"""PLY, OFF and STL files: what is written or written by others is read exactly, and what is wrong is named."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from examples.shapes import creature, cube, grid, icosahedron, pyramid, triangulated
from hypothesis import given, settings
from hypothesis import strategies as st
from test_obj import QUICK, polygon_meshes

from cagemap.errors import FormatError
from cagemap.files.gltf.primitives import material_names
from cagemap.files.meshes import ply
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.meshes.ply import read_ply, write_ply
from cagemap.files.usd.prims import transform_points
from cagemap.files.usd.space import to_standard
from cagemap.mesh import ControlMesh, Plain
from cagemap.numerics.arrays import encode_srgb

from ply_text import write_text_ply
from refusals import refuses

HEADER = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\n" + "".join(
    f"property float {c}\n" for c in "xyz"
)
FACES = "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
BODY = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


def read_bytes(folder: Path, content: bytes | str) -> ControlMesh:
    file = folder / "mesh.ply"
    file.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    return read_ply(file)


def assert_same(a: ControlMesh, b: ControlMesh) -> None:
    np.testing.assert_array_equal(a.positions, b.positions)
    np.testing.assert_array_equal(a.face_offsets, b.face_offsets)
    np.testing.assert_array_equal(a.face_indices, b.face_indices)
    assert (a.uvs is None) == (b.uvs is None)
    if a.uvs is not None and b.uvs is not None:
        np.testing.assert_array_equal(a.uvs[a.uv_indices], b.uvs[b.uv_indices])


@settings(QUICK)
@given(mesh=polygon_meshes(materials=False), text=st.booleans())
def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path, mesh: ControlMesh, text: bool) -> None:
    path = tmp_path / f"{text}.ply"
    (write_text_ply if text else write_ply)(path, mesh)
    assert_same(read_ply(path), mesh)


def test_real_meshes_round_trip_with_their_seams(shared_data: Path, tmp_path: Path) -> None:
    for name in ("animals/spot.obj", "animals/cow.obj", "heads/deer_head.obj"):
        mesh = read_mesh(shared_data / name)
        write_mesh(tmp_path / "mesh.ply", mesh)
        again = read_mesh(tmp_path / "mesh.ply")
        assert_same(again, mesh)
        if mesh.uv_indices is not None and again.uv_indices is not None:
            # Corners share a texture vertex in one where they do in the other.
            pairs = np.unique(np.column_stack([mesh.uv_indices, again.uv_indices]), axis=0)
            assert len(pairs) == len(np.unique(mesh.uv_indices)) == len(np.unique(again.uv_indices))


def test_vertices_on_one_spot_of_the_texture_stay_apart(tmp_path: Path) -> None:
    mesh = cube().with_uvs(np.zeros((8, 2)), cube().face_indices)
    write_ply(tmp_path / "mesh.ply", mesh)
    again = read_ply(tmp_path / "mesh.ply").uv_indices
    assert len(np.unique(np.column_stack([again, mesh.face_indices]), axis=0)) == len(np.unique(again)) == 8


@pytest.mark.parametrize("size", [127, 128, 200, 300])  # list lengths of one byte end between
def test_large_polygons_fit(tmp_path: Path, size: int) -> None:
    angle = np.arange(size) * (2 * np.pi / size)
    positions = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    mesh = ControlMesh.from_faces(positions, [np.arange(size), [0, 1, 2]])
    mesh = mesh.with_uvs(positions[:, :2], mesh.face_indices)
    for write in (write_text_ply, write_ply):
        path = tmp_path / f"{write.__name__}.ply"
        write(path, mesh)
        assert_same(read_ply(path), mesh)


@pytest.mark.parametrize("order", ["<", ">", "="])
@pytest.mark.parametrize("mixed", [False, True])
def test_another_writer_agrees(tmp_path: Path, order: str, mixed: bool) -> None:
    plyfile = pytest.importorskip("plyfile", reason="the oracle is under the GPL and not required")
    mesh = (
        grid(3, 2) if not mixed else ControlMesh.from_faces(grid(3, 2).positions, [(0, 1, 5, 4), (1, 2, 6), (1, 6, 5)])
    )
    vertices = np.zeros(mesh.n_vertices, dtype=[("nx", "f4"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("red", "u1")])
    for i, axis in enumerate("xyz"):
        vertices[axis] = mesh.positions[:, i]
    faces = np.zeros(mesh.n_faces, dtype=[("flag", "i2"), ("vertex_index", "O"), ("note", "O")])
    for i in range(mesh.n_faces):
        faces[i] = (7, mesh.face(i).astype("u4"), np.arange(i, dtype="u1"))
    edges = np.array([([0.5, 0.5], 3)], dtype=[("extra", "f4", (2,)), ("vertex1", "i4")])
    elements = [
        plyfile.PlyElement.describe(edges, "edge"),
        plyfile.PlyElement.describe(vertices, "vertex"),
        plyfile.PlyElement.describe(
            faces, "face", len_types={"note": "u1"}, val_types={"vertex_index": "u4", "note": "u1"}
        ),
    ]
    plyfile.PlyData(elements, text=order == "=", byte_order=order).write(str(tmp_path / "mesh.ply"))
    assert_same(read_ply(tmp_path / "mesh.ply"), mesh)


def test_texture_coordinates_at_vertices(tmp_path: Path) -> None:
    for names in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
        header = HEADER + "".join(f"property float {name}\n" for name in names) + FACES
        body = "0 0 0 .5 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n3 0 1 2\n3 0 2 3\n"
        mesh = read_bytes(tmp_path, header + body)
        assert mesh.uvs.tolist() == [[0.5, 0], [1, 0], [1, 1], [0, 1]]
        np.testing.assert_array_equal(mesh.uv_indices, mesh.face_indices)


def test_faces_without_texture_coordinates_lie_in_one_point(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    header = HEADER + FACES.replace("end_", "property list uchar float texcoord\nend_")
    mesh = read_bytes(tmp_path, header + BODY[:24] + "3 0 1 2 6 .5 .5 1 0 0 1\n3 0 2 3 0\n")
    assert mesh.uvs[mesh.uv_indices].tolist() == [[0.5, 0.5], [1, 0], [0, 1]] + [[0.5, 0.5]] * 3
    assert len(set(mesh.uv_indices[3:].tolist()) - set(mesh.uv_indices[:3].tolist())) == 1  # an island of their own
    assert "1 of 2 faces have no texture coordinates" in caplog.text


def test_faces_of_several_images_have_a_material_for_each(tmp_path: Path) -> None:
    header = HEADER + FACES.replace("end_", "property int texnumber\nend_")
    mesh = read_bytes(tmp_path, header + BODY[:24] + "3 0 1 2 4\n3 0 2 3 1\n")
    assert [mesh.material_names[number] for number in mesh.face_materials] == ["texture 4", "texture 1"]
    assert read_bytes(tmp_path, header + BODY[:24] + "3 0 1 2 4\n3 0 2 3 4\n").material_names == ()


COLORED_FACES = FACES.replace("end_", "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_")


def test_faces_of_several_colours_have_a_material_for_each(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = read_bytes(tmp_path, HEADER + COLORED_FACES + BODY[:24] + "3 0 1 2 255 0 16\n3 0 2 3 1 128 0\n")
    assert [mesh.material_names[number] for number in mesh.face_materials] == ["#ff0010", "#018000"]
    colors = 255 * encode_srgb(mesh.material_colors[mesh.face_materials])
    np.testing.assert_allclose(colors, [[255, 0, 16], [1, 128, 0]], rtol=0, atol=1e-9)
    write_ply(tmp_path / "again.ply", mesh)  # they are written as well
    again = read_ply(tmp_path / "again.ply")
    assert (again.material_names, *again.face_materials) == (mesh.material_names, *mesh.face_materials)
    one = read_bytes(tmp_path, HEADER + COLORED_FACES + BODY[:24] + "3 0 1 2 9 9 9\n3 0 2 3 9 9 9\n")
    assert one.material_names == ("#090909",)
    assert not caplog.text
    floats = COLORED_FACES.replace("uchar red", "float red").replace("uchar green", "float green")
    floats = floats.replace("uchar blue", "float blue")
    some = read_bytes(tmp_path, HEADER + floats + BODY[:24] + "3 0 1 2 1 0 0\n3 0 2 3 nan 0 0\n")
    assert [some.material_names[number] for number in some.face_materials] == ["#ff0000", "no colour"]
    images = COLORED_FACES.replace("end_", "property int texnumber\nend_")
    named = "ply\ncomment TextureFile a.png\ncomment TextureFile b.png" + (HEADER + images).removeprefix("ply")
    assert read_bytes(tmp_path, HEADER + images + BODY[:24] + "3 0 1 2 1 2 3 0\n3 0 2 3 1 2 3 0\n").material_names
    numbered = read_bytes(tmp_path, HEADER + images + BODY[:24] + "3 0 1 2 1 2 3 0\n3 0 2 3 1 2 3 1\n")
    assert numbered.material_names == ("#010203",)  # numbers of no images
    assert not caplog.text
    read_bytes(tmp_path, named + BODY[:24] + "3 0 1 2 1 2 3 1\n3 0 2 3 1 2 3 1\n")
    assert caplog.text.count("colours of its faces are left out, since its faces have images") == 1


def test_faces_without_a_colour_are_written_grey(tmp_path: Path) -> None:
    mesh = replace(
        cube(),
        face_materials=np.array([0, 1, -1, 0, 0, 0]),
        material_names=("red", "unknown"),
        material_colors=np.array([[1.0, 0.0, 0.0], [np.nan] * 3]),
    )
    write_ply(tmp_path / "some.ply", mesh)
    again = read_ply(tmp_path / "some.ply")
    assert [again.material_names[number] for number in again.face_materials] == [
        "#ff0000",
        *["#e7e7e7"] * 2,
        *["#ff0000"] * 3,
    ]


def test_faces_of_too_many_colours_are_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    header = (HEADER + COLORED_FACES).replace("face 2", "face 257")
    body = BODY[:24] + "".join(f"3 0 1 2 {k % 256} {k // 256} 0\n" for k in range(257))
    assert read_bytes(tmp_path, header + body).material_names == ()
    assert "the 257 colours of its faces are left out" in caplog.text


BAD_FILES = {
    "empty": ("", "empty file"),
    "another format": ("solid mesh\n", "begins with 'ply'"),
    "no end of header": (HEADER, "'end_header'"),
    "no format": ("ply\nelement vertex 1\nproperty float x\nend_header\n0\n", "'format' line"),
    "unknown format": ("ply\nformat middle_endian 1.0\nend_header\n", "line 2"),
    "unknown type": (
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n",
        "line 4: .*'property half x'",
    ),
    "fractional count": ("ply\nformat ascii 1.0\nelement vertex 1.5\nend_header\n", "line 3"),
    "negative count": ("ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "line 3"),
    "property before element": ("ply\nformat ascii 1.0\nproperty float x\nend_header\n", "line 3"),
    "property twice": (HEADER + "property float x\n" + FACES + BODY, "line 8"),
    "float as length": (HEADER + FACES.replace("uchar", "float") + BODY, "line 9"),
    "no positions": (HEADER.replace("float z", "float w") + FACES + BODY, "x, y and z"),
    "vertices without properties": ("ply\nformat ascii 1.0\nelement vertex 3\n" + FACES + BODY, "x, y and z"),
    "no vertices": (HEADER.replace("vertex 4", "vertex 0") + FACES.replace("2", "0"), "x, y and z"),
    "points only": (HEADER + "end_header\n" + BODY[:24], "no polygon"),
    "strips": (
        HEADER + "element tristrips 1\nproperty list int int vertex_indices\nend_header\n" + BODY[:24] + "4 0 1 2 3",
        "strips are not",
    ),
    "cut within vertices": (HEADER + FACES + BODY[:14], "4 records 'vertex'.*number 2"),
    "cut within faces": (HEADER + FACES + BODY[:-4], "2 records 'face'.*number 1"),
    "cut before faces": (HEADER + FACES + BODY[:24], "2 records 'face'.*number 0"),
    "many vertices promised": (HEADER.replace("4", "400000000000") + FACES + BODY, "cut short"),
    "word": (HEADER + FACES + BODY.replace("1 1 0", "1 one 0"), "b'one' in line 3"),
    "NaN": (HEADER + FACES + BODY.replace("1 1 0", "1 nan 0"), r"finite positions.*1 vertices.*: 2"),
    "out of range": (HEADER + FACES + BODY.replace("3 0 2 3", "3 0 2 4"), "from 0 to 3.*1 face.*: 1"),
    "negative": (HEADER + FACES + BODY.replace("3 0 2 3", "3 0 2 -1"), "from 0 to 3.*: 1"),
    "fraction": (HEADER + FACES + BODY.replace("3 0 2 3", "3 0 2 2.5"), "from 0 to 3.*: 1"),
    "no corners": (HEADER + FACES + BODY.replace("3 0 2 3", "0"), "from 0 to 3.*: 1"),
    "no corners at first": (HEADER + FACES + BODY.replace("3 0 1 2", "0"), "from 0 to 3.*: 0"),
    "infinite length": (HEADER + FACES + BODY.replace("3 0 2 3", "inf 0 2 3"), "face 1.*length"),
    "NaN length": (HEADER + FACES + BODY.replace("3 0 1 2", "nan 0 2 3"), "face 0.*length"),
    "negative length": (HEADER + FACES + BODY.replace("3 0 2 3", "-3 0 2 3"), "face 1.*length"),
    "UVs of some corners": (
        HEADER
        + FACES.replace("end_", "property list uchar float texcoord\nend_")
        + BODY[:24]
        + "3 0 1 2 6 0 0 0 0 0 0\n3 0 2 3 2 0 0\n",
        "two texture coordinates per corner.*: 1",
    ),
    "UVs not finite": (
        HEADER
        + FACES.replace("end_", "property list uchar float texcoord\nend_").replace("2", "1")
        + BODY[:24]
        + "3 0 1 2 6 0 0 0 inf 0 0\n",
        "finite texture",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_with_the_place(tmp_path: Path, case: str) -> None:
    content, message = BAD_FILES[case]
    refuses(FormatError, r"(?s)mesh\.ply.*" + message, read_bytes, tmp_path, content)


@pytest.mark.parametrize("text", [False, True])
def test_vertex_colours_come_back_as_bytes(tmp_path: Path, text: bool) -> None:
    # The darkest: one of 255 is no full colour.
    for colors in (np.arange(24).reshape(8, 3) / 255, np.tile([1 / 255, 0, 0], (8, 1))):
        (write_text_ply if text else write_ply)(tmp_path / "c.ply", replace(cube(), vertex_colors=colors))
        read = read_ply(tmp_path / "c.ply")
        np.testing.assert_allclose(read.vertex_colors, colors, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(read.positions, cube().positions)


def test_images_are_found_without_reading_the_body(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``end_header`` in a comment does not end the header."""
    scan = tmp_path / "scan.ply"
    (tmp_path / "a.png").write_bytes(b"image")
    head = b"ply\ncomment before end_header\ncomment TextureFile a.png\nend_header\n"
    scan.write_bytes(head + bytes(3 << 20))
    read = list[int]()
    whole = ply.read_bytes
    monkeypatch.setattr(ply, "read_bytes", lambda *given: (content := whole(*given), read.append(len(content)))[0])
    assert ply.ply_images(scan) == [tmp_path / "a.png"]
    assert ply.ply_image(scan) == tmp_path / "a.png"
    assert material_names(ply.ply_document(scan, cube())) == ("texture 0",)
    assert len(read) >= 3
    assert max(read) <= 1 << 20


def test_images_after_long_comments_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"image")
    comments = f"comment {'long' * 20_000}\n" * 20
    (tmp_path / "scan.ply").write_text(f"ply\n{comments}comment TextureFile a.png\nend_header\n")
    assert ply.ply_image(tmp_path / "scan.ply") == tmp_path / "a.png"


@pytest.mark.parametrize(
    ("vertices", "faces", "numbered"),
    [
        ("", "property int texnumber\n", True),
        ("", "property int area\nproperty int texnumber  \nelement edge 0\n", True),
        ("comment no texnumber\n", "comment property int texnumber\nproperty int texnumbers\n", False),
        ("property int texnumber\n", "", False),
        ("", "element edge 0\nproperty int texnumber\n", False),
    ],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_only_a_property_of_faces_numbers_their_images(vertices, faces, numbered, line_end, tmp_path, caplog):
    """Without it all faces have the first image that exists."""
    (tmp_path / "light.png").write_bytes(b"image")
    images = "comment TextureFile dark.png\ncomment TextureFile light.png\n"
    header = HEADER + vertices + FACES.replace("end_", f"{faces}end_") + BODY
    scan = tmp_path / "scan.ply"
    scan.write_bytes(header.replace("ply\n", f"ply\n{images}").replace("\n", line_end).encode())
    assert ply.ply_image(scan) == (scan if numbered else tmp_path / "light.png")
    assert ("no texnumber of its faces: all have light.png" in caplog.text) is not numbered


def test_colours_become_bytes_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    converted = list[int]()
    as_bytes = ply._as_bytes
    monkeypatch.setattr(ply, "_as_bytes", lambda colors: (converted.append(len(colors)), as_bytes(colors))[1])
    write_ply(tmp_path / "m.ply", replace(cube(), vertex_colors=np.full((8, 3), 0.5)))
    assert converted == [8]


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
