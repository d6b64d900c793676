"""OBJ files: what is read is what stands in the file, what is written reads back exactly, bad files are named."""

import json
import unicodedata
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from examples.shapes import cube
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cagemap.errors import FormatError
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import check_mesh_path, read_mesh, referred_files, write_mesh
from cagemap.files.meshes.obj import read_obj
from cagemap.files.meshes.obj_write import write_obj, write_obj_layout, write_obj_positions
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import pair_by_name
from cagemap.mesh.parts import find_part

from example_result import textured_cube
from refusals import refuses

FINITE = st.floats(allow_nan=False, allow_infinity=False)
# What str.splitlines and friends take for line ends or blanks may stand inside a name.
NAME = st.text(st.characters(exclude_characters="\r\n\0\t\\#", exclude_categories=["Cs", "Zs", "Cc"]), max_size=6)
QUICK = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@st.composite
def polygon_meshes(draw: st.DrawFn, *, materials: bool = True) -> ControlMesh:
    """Draw polygons that form no surface: the files must not care."""
    n = draw(st.integers(3, 9))
    positions = draw(st.lists(st.tuples(FINITE, FINITE, FINITE), min_size=n, max_size=n))
    corners = st.lists(st.integers(0, n - 1), min_size=1, max_size=7)
    mesh = ControlMesh.from_faces(positions, draw(st.lists(corners, min_size=1, max_size=6)))
    if draw(st.booleans()):
        uvs = draw(st.lists(st.tuples(FINITE, FINITE), min_size=1, max_size=9))
        c = len(mesh.face_indices)
        indices = draw(st.lists(st.integers(0, len(uvs) - 1), min_size=c, max_size=c))
        mesh = mesh.with_uvs(np.array(uvs), np.array(indices))
    if materials and draw(st.booleans()):
        names = draw(st.lists(NAME, min_size=1, max_size=3, unique=True))
        m = mesh.n_faces
        used = draw(st.lists(st.integers(0, len(names) - 1), min_size=m, max_size=m))
        # A file knows materials by their use only, and numbers them in that order.
        kept = list(dict.fromkeys(used))
        colors = draw(st.lists(st.tuples(FINITE, FINITE, FINITE), min_size=len(kept), max_size=len(kept)))
        mesh = replace(
            mesh,
            face_materials=np.array([kept.index(i) for i in used]),
            material_names=tuple(names[i] for i in kept),
            material_colors=np.array(colors),
        )
    return mesh


def assert_same(a: ControlMesh, b: ControlMesh) -> None:
    assert a.material_names == b.material_names
    names = "positions face_offsets face_indices uvs uv_indices face_materials material_colors"
    assert_same_arrays(a, b, names.split())


def assert_same_arrays(a: ControlMesh, b: ControlMesh, names: list[str]) -> None:
    for field in names:
        x, y = getattr(a, field), getattr(b, field)
        assert (x is None) == (y is None), field
        if x is not None:
            np.testing.assert_array_equal(x, y, err_msg=field)  # bit for bit, NaN equal to NaN
            assert x.dtype == y.dtype, field


def read_text(folder: Path, text: str | bytes, name: str = "mesh.obj") -> ControlMesh:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return read_obj(file)


def slow_read(path: Path) -> tuple[list[list[float]], list[list[int]], list[list[int]]]:
    """Definition of what the plain lines of an OBJ mean, one at a time."""
    positions, faces, uv_faces = [], [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            positions.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([int(word.split("/")[0]) - 1 for word in words[1:]])
            if "/" in line:
                uv_faces.append([int(word.split("/")[1]) - 1 for word in words[1:]])
    return positions, faces, uv_faces


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.slow
@QUICK
@given(mesh=polygon_meshes())
def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path, mesh: ControlMesh) -> None:
    write_obj(tmp_path / "mesh.obj", mesh)
    assert_same(read_obj(tmp_path / "mesh.obj"), mesh)


def test_real_meshes_read_as_a_plain_reader_does_and_round_trip(shared_data: Path, tmp_path: Path) -> None:
    for name in ("animals/cow.obj", "animals/spot.obj", "heads/mh_head_male_young.obj", "humans/anny5pc_neutral.obj"):
        mesh = read_mesh(shared_data / name)
        positions, faces, uv_faces = slow_read(shared_data / name)
        np.testing.assert_array_equal(mesh.positions, positions)
        assert [mesh.face(i).tolist() for i in range(mesh.n_faces)] == faces
        if uv_faces:
            np.testing.assert_array_equal(mesh.uv_indices, np.concatenate(uv_faces))
        write_mesh(tmp_path / "again.obj", mesh)
        assert_same(read_mesh(tmp_path / "again.obj"), mesh)


def test_negative_indices_count_back_from_their_own_line(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nf -3/-1 -2/-1 -1/-1\nv 5 5 5\nvt 1 1\nf -4/1 -1/-1 2/2\n"
    mesh = read_text(tmp_path, text)
    assert mesh.face_indices.tolist() == [0, 1, 2, 0, 3, 1]
    assert mesh.uv_indices.tolist() == [0, 0, 0, 0, 1, 1]


@pytest.mark.parametrize("corner", ["{0}", "{0}/{1}", "{0}//{1}", "{0}/{1}/{1}", "{0}/"])
def test_every_form_of_a_corner(tmp_path: Path, corner: str) -> None:
    face = "f " + " ".join(corner.format(i, 5 - i) for i in (1, 2, 3, 4))
    mesh = read_text(tmp_path, SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n" + face)
    assert mesh.face_indices.tolist() == [0, 1, 2, 3]
    has_uv = "/{1}" in corner and "//" not in corner
    assert (mesh.uv_indices is not None) == has_uv
    if mesh.uv_indices is not None:
        assert mesh.uv_indices.tolist() == [3, 2, 1, 0]


@pytest.mark.parametrize(
    "text",
    [
        SQUARE.replace("\n", "\r\n") + "f 1 2 3 4\r\n",
        SQUARE.replace("\n", "\r") + "f 1 2 3 4",
        SQUARE + "f 1 2 \\\n3 4\n",
        SQUARE + "f 1 2 \\\r\n  3\\  \n 4\n",
        "# made in C:\\models\\\n" + SQUARE + "f 1 2 3 4  # a face\n",
        SQUARE.replace("v ", "  v\t") + "\tf\t1  2 3   4 \n",
        SQUARE.replace(" 0\n", " 0 1.0\n") + "f 1 2 3 4\n",
        SQUARE.replace(" 0\n", " 0 0.5 0.25 1\n") + "f 1 2 3 4\n",
        "v 0 0 0 # corner\nv 1 0 0 0.5 0.5 0.5\nv +1 1.0e0 0 1\nv 0 1 0\n" + "f 1 2 3 4",
        "o a\n" + SQUARE + "g x y\ns off\np 1\nl 1 2 3\nvn 0 0 1\nvp 1\nf 1 2 3 4\nmg 1 2\n",
        "\ufeff" + SQUARE + "fo 1 2 3 4\n",
    ],
)
def test_one_square_in_many_spellings(tmp_path: Path, text: str) -> None:
    mesh = read_text(tmp_path, text)
    np.testing.assert_array_equal(mesh.positions, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert mesh.face_offsets.tolist() == [0, 4]
    assert mesh.face_indices.tolist() == [0, 1, 2, 3]
    assert mesh.uvs is None
    assert mesh.name == "mesh.obj"


def test_short_texture_vertices_are_completed_with_zero(tmp_path: Path) -> None:
    mesh = read_text(tmp_path, SQUARE + "vt 0.5\nvt 0.25 0.75 0\nf 1/1 2/2 3/2\n")
    assert mesh.uvs.tolist() == [[0.5, 0.0], [0.25, 0.75]]


def test_materials_with_blanks_accents_and_missing_colours(tmp_path: Path) -> None:
    (tmp_path / "my materials.mtl").write_text(
        "newmtl Äußere Haut\nKd 0.1 0.2 0.3 # skin\nnewmtl grey\nKd 0.5\nnewmtl glow\nKd spectral x.rfl\n", "utf-8"
    )
    faces = (
        "f 1 2 3\nusemtl Äußere Haut\nf 1 2 4\nusemtl grey\nf 1 3 4\nusemtl glow\nf 2 3 4\nusemtl nowhere\nf 4 3 2\n"
    )
    mesh = read_text(tmp_path, "mtllib my materials.mtl\n" + SQUARE + faces)
    assert mesh.material_names == ("", "Äußere Haut", "grey", "glow", "nowhere")
    assert mesh.face_materials.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(mesh.material_colors[1:3], [[0.1, 0.2, 0.3], [0.5, 0.5, 0.5]])
    assert np.isnan(mesh.material_colors[[0, 3, 4]]).all()


@pytest.mark.parametrize("stored", ["NFC", "NFD"])
@pytest.mark.parametrize("stated", ["NFC", "NFD"])
def test_accents_are_found_in_both_forms_of_unicode(tmp_path: Path, stored: str, stated: str) -> None:
    """Files copied from a Mac have names whose accents are decomposed, texts that name them seldom."""
    on_disk, in_text = (partial(unicodedata.normalize, form) for form in (stored, stated))
    (tmp_path / on_disk("Kör per.mtl")).write_text("newmtl a\nKd 1 0 0\n")
    mesh = read_text(tmp_path, f"mtllib {in_text('Kör per.mtl')}\n{SQUARE}g {on_disk('Füße')}\nusemtl a\nf 1 2 3\n")
    assert mesh.material_colors.tolist() == [[1.0, 0.0, 0.0]]
    assert find_part(mesh, in_text("Füße")).faces.tolist() == [0]
    (tmp_path / on_disk("größe.bin")).write_bytes(b"1")
    (tmp_path / "a.gltf").write_text(json.dumps({"buffers": [{"uri": in_text("größe.bin")}]}))
    assert referred_files(tmp_path / "a.gltf") == [tmp_path / on_disk("größe.bin")]
    for name, form in (("t", stored), ("s", stated)):
        point = {"name": unicodedata.normalize(form, "Öse"), "vertex": 0}
        (tmp_path / f"{name}.json").write_text(json.dumps({"points": [point]}, ensure_ascii=False), "utf-8")
    target, source = (read_points(tmp_path / f"{name}.json") for name in ("t", "s"))
    assert pair_by_name(target, source, cube(), cube())[0].names == ("Öse",)


def test_materials_of_one_name_stay_two(tmp_path: Path) -> None:
    names = ("red", "red", "red.001", "red")
    colors = np.array([[1.0, 0, 0], [0.5, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
    mesh = replace(cube(), face_materials=np.array([0, 1, 2, 3, 1, 0]), material_names=names, material_colors=colors)
    write_obj(tmp_path / "mesh.obj", mesh)
    found = read_obj(tmp_path / "mesh.obj")
    assert found.material_names == ("red", "red_2", "red.001", "red_3")
    np.testing.assert_array_equal(found.material_colors[found.face_materials], colors[mesh.face_materials])


def test_missing_material_file_leaves_colours_unknown(tmp_path: Path) -> None:
    mesh = read_text(tmp_path, "mtllib gone.mtl\n" + SQUARE + "usemtl a\nf 1 2 3\n")
    assert np.isnan(mesh.material_colors).all()


def test_several_material_files_on_one_line(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / f"{name}.mtl").write_text(f"newmtl {name}\nKd 1 0 0\n")
    mesh = read_text(tmp_path, "mtllib a.mtl b.mtl\n" + SQUARE + "usemtl b\nf 1 2 3\n")
    assert mesh.material_colors.tolist() == [[1.0, 0.0, 0.0]]


BAD_FILES = {
    "empty": ("", "empty file"),
    "blank": (" \n\n", "empty file"),
    "no vertices": ("f 1 2 3\n", "'v' lines"),
    "no faces": (SQUARE, "no 'f' line"),
    "prose": ("It was the best of times,\nit was the worst of times.\n", "'v' lines"),
    "binary": (b"v 0 0 0\n\x00\x01\x02", "binary"),
    "utf-16": (SQUARE.encode("utf-16"), "UTF-16"),
    "short position": ("v 0 0 0\nv 1 0\nf 1 2 1\n", "line 2: .*at least 3 numbers.*'v 1 0'"),
    "word as position": ("v 0 0 0\n# x\nv 1 zero 0\nf 1 2 1\n", "line 3: .*'v 1 zero 0'"),
    "underscore number": ("v 0 0 0\nv 1_0 0 0\nf 1 2 1\n", "line 2"),
    "NaN position": (SQUARE + "v nan 0 0\nf 1 2 3\n", "line 5: expected finite positions"),
    "infinite position": (SQUARE + "v 0 1e999 0\nf 1 2 3\n", "line 5: expected finite positions"),
    "NaN texture": (SQUARE + "vt 0 nan\nf 1/1 2/1 3/1\n", "line 5: expected finite texture"),
    "beyond the end": (SQUARE + "f 1 2 3\nf 1 2 5\n", "line 6: expected vertex numbers from 1 to 4.*names 5"),
    "zero": (SQUARE + "f 0 1 2\n", "line 5: expected vertex numbers from 1"),
    "before the start": (SQUARE + "f -5 1 2\n", "line 5: expected vertex numbers"),
    "huge": (SQUARE + "f 99999999999999999999999 1 2\n", "line 5: expected vertex numbers"),
    "hugely negative": (SQUARE + "f -99999999999999999999999 1 2\n", "line 5: expected vertex numbers"),
    "texture beyond the end": (
        SQUARE + "vt 0 0\nf 1/1 2/2 3/1\n",
        "line 6: expected texture vertex numbers from 1 to 1",
    ),
    "no texture vertices": (SQUARE + "f 1/1 2/1 3/1\n", "line 5: expected texture vertex numbers"),
    "fraction": (SQUARE + "f 1 2.5 3\n", "line 5: expected 'f' and corners"),
    "letters": (SQUARE + "f 1 2 3\nf a b c\n", "line 6: expected 'f' and corners"),
    "other digits": (SQUARE + "f 1 2 ٣\n", "line 5: expected 'f' and corners"),
    "lone sign": (SQUARE + "f 1 2 -\n", "line 5"),
    "lone sign before the next line": (SQUARE + "f 1 2 -\nf 1 2 3\n", "line 5"),
    "sign within": (SQUARE + "f 1 2-3 4\n", "line 5"),
    "two signs": (SQUARE + "f 1 --2 3\n", "line 5"),
    "lone slash": (SQUARE + "f 1 / 3\n", "line 5"),
    "no vertex number": (SQUARE + "f 1 /2 3\n", "line 5"),
    "four numbers": (SQUARE + "vt 0 0\nf 1/1 2/1 3/1\nf 1/1/1/1 2/1/1 3/1/1\n", "line 7: expected 'f' and corners"),
    "bare f": (SQUARE + "f 1 2 3\nf\n", "line 6"),
    "only bare f": (SQUARE + "f\n", "line 5"),
    "line after a continuation": (SQUARE + "f 1 2 \\\n3\nf 1 2 9\n", "line 7"),
    "some corners without texture": (SQUARE + "vt 0 0\nf 1 2 4\nf 1/1 2 3/1\n", "1 face.s. with some: 1 .*line 7"),
    "cut within a face": (SQUARE + "vt 0 0\nf 1/1 2/1 3/1 4/1\nf 1/1 2/1 3", "with some: 1"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_with_the_place(tmp_path: Path, case: str) -> None:
    text, message = BAD_FILES[case]
    refuses(FormatError, r"(?s)mesh\.obj.*" + message, read_text, tmp_path, text)


def test_faces_without_texture_coordinates_lie_in_one_point(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = read_text(tmp_path, SQUARE + "f 1 3 4\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/-3 2/2 3/3\nf 1 2 4\n")
    assert mesh.uvs[mesh.uv_indices].tolist() == [[0.5, 0.5]] * 3 + [[0, 0], [1, 0], [0, 1]] + [[0.5, 0.5]] * 3
    assert "2 of 3 faces have no texture coordinates" in caplog.text


@pytest.mark.parametrize("color", ["red", "0.1 0.2", "nan 0 0", ""])
def test_malformed_colour_names_line_of_the_material_file(tmp_path: Path, color: str) -> None:
    (tmp_path / "m.mtl").write_text(f"newmtl a\n\nKd {color}\n")
    refuses(FormatError, r"m\.mtl, line 3", read_text, tmp_path, "mtllib m.mtl\n" + SQUARE + "usemtl a\nf 1 2 3\n")


def test_missing_file_folder_and_unknown_extension(tmp_path: Path) -> None:
    refuses(FormatError, "no such file", read_mesh, tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    refuses(FormatError, "folder", read_mesh, tmp_path / "folder.obj")
    for call in (read_mesh, check_mesh_path):
        refuses(FormatError, r"\.obj, \.ply, .*, got \.blend", call, tmp_path / "mesh.blend")
    for name in ("mesh", "mesh.usdz"):
        refuses(FormatError, r"\.obj, \.ply", write_mesh, tmp_path / name, cube())
    refuses(FormatError, "cannot be read", read_obj, "nul\0byte.obj")


def test_names_that_cannot_stand_on_a_line_are_refused(tmp_path: Path) -> None:
    mesh = replace(cube(), face_materials=np.zeros(6, dtype=np.int64), material_names=("two\nlines",))
    refuses(FormatError, "line breaks", write_obj, tmp_path / "mesh.obj", mesh)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("on_another_drive", [False, True])
@pytest.mark.parametrize("folder", ["scene", "my scene"])
@pytest.mark.parametrize(
    "names",
    [
        "a.mtl b.mtl gone.mtl",
        "a b.mtl",
        f"a.mtl {60 * 'gone.mtl '}b.mtl",
        "\\\n a.mtl",
        "..\\mats/a.mtl",
        "a\u0308.mtl",
    ],
)
def test_material_files_are_named_from_the_folder_of_a_copy(tmp_path, monkeypatch, names, folder, on_another_drive):
    scene = tmp_path / folder
    for place in (scene, tmp_path / "mats", tmp_path / "deep/er"):
        place.mkdir(parents=True)
    (tmp_path / "copies").symlink_to(tmp_path / "deep/er")
    for file in ("a.mtl", "b.mtl", "a b.mtl", "\u00e4.mtl", "../mats/a.mtl"):
        (scene / file).write_text(f"newmtl {Path(file).stem}\nKd 0.5 0.25 1\n")
    used = unicodedata.normalize("NFC", Path(names.replace("\\", "/").split(".mtl")[0]).stem.strip())
    mesh = read_text(scene, f"mtllib {names}\n{SQUARE}usemtl {used}\nf 1 2 3\n")
    if on_another_drive:
        monkeypatch.setattr("os.path.relpath", Mock(side_effect=ValueError))
    write_obj_positions(tmp_path / "copies/moved.obj", scene / "mesh.obj", mesh)
    write_mesh(tmp_path / "copies/fine.obj", mesh, like=scene / "mesh.obj")
    for copy in ("moved", "fine"):
        found = read_obj(tmp_path / "copies" / f"{copy}.obj")
        assert_same_arrays(found, mesh, ["positions", "face_indices", "material_colors"])
    assert not list((tmp_path / "copies").glob("*.mtl"))


def test_a_layout_over_a_file_of_others_writes_nothing(tmp_path: Path) -> None:
    mesh = textured_cube("a.obj")
    write_mesh(tmp_path / "a.obj", mesh)
    (tmp_path / "o.obj").write_text("mine")
    refuses(FormatError, "not written by cagemap", write_obj_layout, tmp_path / "o.obj", tmp_path / "a.obj", mesh, {})
    assert not (tmp_path / "o.mtl").exists()


def test_objects_of_one_name_without_common_vertices_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    quads = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nv 5 0 0\nv 6 0 0\nv 6 1 0\nv 5 1 0\n"
    (tmp_path / "one.obj").write_text(quads + "o body\nf 1 2 3 4\no hat\nf 7 8 9 10\no body\nf 2 5 6 3\n")
    assert read_obj(tmp_path / "one.obj").object_names == ("body", "hat")
    assert not caplog.messages
    (tmp_path / "two.obj").write_text(quads + "o body\nf 1 2 3 4\nf 2 5 6 3\no body\nf 7 8 9 10\n")
    assert read_obj(tmp_path / "two.obj").object_names == ("body",)
    assert caplog.messages == [
        f"{tmp_path / 'two.obj'}: 2 objects are named body and become one. Give each its own name to match or select "
        "them apart."
    ]
