"""Subdivision tags, objects, groups, vertex colours and images of materials in OBJ files."""

import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron
from hypothesis import given, settings
from hypothesis import strategies as st
from test_obj import assert_same_arrays

from cagemap.errors import FormatError, ParameterError
from cagemap.files.gltf.textures import material_images, read_material_image
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.obj import read_obj
from cagemap.files.meshes.obj_materials import obj_document, obj_images
from cagemap.files.meshes.obj_write import write_obj
from cagemap.files.result.folder import write_result
from cagemap.files.text import find_image
from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop, Scheme
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result
from refusals import refuses

# A cube as OpenSubdiv's shape files have it: tags are 0-based, faces 1-based.
TAGGED = """\
o box
g lower
v -1 -1 -1
v 1 -1 -1 0.5 0.25 1
v 1 1 -1
v -1 1 -1
g lid upper
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
f 1 4 3 2
f 5 6 7 8
g
f 1 2 6 5
f 2 3 7 6
o other
f 3 4 8 7
f 4 1 5 8
t crease 2/1/0 4 5 2.5 # a comment
t crease 2/1/0 5 6 10
t corner 1/1/0 0 1.25
t interpolateboundary 1/0/0 2
t facevaryinginterpolateboundary 1/0/0 4
t creasemethod 0/0/1 chaikin
t hole 2/0/0 1 3
t somethingelse 1/1/1 0 0.5 x
"""


def test_tags_names_and_colours_are_read(tmp_path: Path) -> None:
    path = tmp_path / "tagged.obj"
    path.write_text(TAGGED)
    mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.crease_edges, [[4, 5], [5, 6]])
    np.testing.assert_array_equal(mesh.crease_sharpness, [2.5, 10])
    np.testing.assert_array_equal(mesh.corner_vertices, [0])
    np.testing.assert_array_equal(mesh.corner_sharpness, [1.25])
    np.testing.assert_array_equal(mesh.hole_faces, [1, 3])
    assert mesh.scheme == CatmullClark("edge_only", "boundaries", "chaikin")
    assert mesh.object_names == ("box", "other")
    np.testing.assert_array_equal(mesh.face_objects, [0, 0, 0, 0, 1, 1])
    assert mesh.group_names == ("lid upper", "")
    np.testing.assert_array_equal(mesh.face_groups, [0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(mesh.vertex_colors[1], [0.5, 0.25, 1])
    assert np.isnan(np.delete(mesh.vertex_colors, 1, axis=0)).all()


@st.composite
def tagged_meshes(draw: st.DrawFn) -> ControlMesh:
    """A cube or an icosahedron with any of what an OBJ keeps."""
    mesh = draw(st.sampled_from([cube(), icosahedron()]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    m, n = mesh.n_faces, mesh.n_vertices
    if draw(st.booleans()):
        corners = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
        chosen = np.unique(np.sort(corners, axis=1), axis=0)[rng.permutation(10)]
        mesh = mesh.with_creases(chosen, np.append(rng.random(9) * 11, np.inf))
    if draw(st.booleans()):
        mesh = mesh.with_corners(rng.permutation(n)[:3], np.append(rng.random(2) * 11, np.inf))
    if draw(st.booleans()):
        mesh = replace(mesh, hole_faces=np.sort(rng.permutation(m)[:2]))
    if draw(st.booleans()):
        kinds = [CatmullClark, Bilinear, *([Loop] if mesh.is_triangle_mesh else [])]
        options = st.tuples(
            st.sampled_from(["none", "edge_only", "edge_and_corner"]),
            st.sampled_from(["none", "corners_only", "corners_plus1", "corners_plus2", "boundaries", "all"]),
            st.sampled_from(["uniform", "chaikin"]),
            st.sampled_from(["catmull_clark", "smooth"]),
        )
        scheme: Scheme = draw(st.sampled_from(kinds))(*draw(options))
        mesh = replace(mesh, scheme=scheme)
    if draw(st.booleans()):
        colors = rng.random((n, 3))
        colors[rng.random(n) < 0.3] = np.nan
        colors[0] = 0.5
        mesh = replace(mesh, vertex_colors=colors)
    if draw(st.booleans()):
        numbers = np.concatenate([[0, 1, 2], rng.integers(0, 3, m - 3)])
        mesh = replace(mesh, face_objects=numbers, object_names=("", "eye left", "body"))
    if draw(st.booleans()):
        numbers = np.concatenate([[0, 1], rng.integers(0, 2, m - 2)])
        mesh = replace(mesh, face_groups=numbers, group_names=("a", "b"))
    return mesh


@pytest.mark.slow
@settings(max_examples=60, derandomize=True)
@given(mesh=tagged_meshes())
def test_what_is_written_is_read_again(mesh: ControlMesh, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("obj") / "mesh.obj"
    write_obj(path, mesh)
    again = read_obj(path)
    names = "positions face_indices crease_edges crease_sharpness corner_vertices corner_sharpness hole_faces"
    assert_same_arrays(again, mesh, [*names.split(), "vertex_colors", "face_objects", "face_groups"])
    assert (again.object_names, again.group_names) == (mesh.object_names, mesh.group_names)
    assert again.scheme == mesh.scheme


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("t crease 2/1/0 0 1", "as many values"),
        ("t crease 2/1/0 0 1 x", "as many values"),
        ("t crease 1/1/0 0 1", "0-based vertices and a sharpness"),
        ("t crease 2/1/0 0 8 1", "vertices from 0 to 7"),
        ("t crease 2/1/0 -1 0 1", "vertices from 0 to 7"),
        ("t crease 2/1/0 0 1 nan", "a sharpness"),
        ("t crease 2/1/0 0 1 -2", "a sharpness"),
        ("t corner 1/1/0 99999999999999999999999999 1", "vertices from 0 to 7"),
        ("t hole 1/0/0 6", "faces from 0 to 5"),
        ("t interpolateboundary 1/0/0 3", "from 0 to 2"),
        ("t creasemethod 0/0/1 sharp", "normal, chaikin"),
        ("t crease", "three counts"),
        ("t crease 2/1 0 1 1", "three counts"),
    ],
)
def test_malformed_tags_are_refused(line: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_text(TAGGED + line + "\n")
    with pytest.raises(FormatError, match=expected) as refusal:
        read_obj(path)
    assert f"line {TAGGED.count(chr(10)) + 1}:" in str(refusal.value)


@pytest.mark.parametrize("values", ["0.5 green 1", "1 1 1 x"])
def test_a_malformed_vertex_colour_is_named(values: str, tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text(TAGGED.replace("0.5 0.25 1", values))
    refuses(FormatError, "three colour values", read_obj, tmp_path / "bad.obj")


def test_polypaint_becomes_vertex_colours(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\n#MRGB ff102030ff405060\n#MRGB ff708090\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(text)
    colors = np.array([[0x10, 0x20, 0x30], [0x40, 0x50, 0x60], [0x70, 0x80, 0x90]]) / 255
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").vertex_colors, colors)
    (tmp_path / "a.obj").write_text(text.replace("f 1 2 3", "f 1 2 \\\n3"))  # a continued line takes comments away
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").vertex_colors, colors)
    (tmp_path / "a.obj").write_text(text.replace("v 1 1 0", "v 1 1 0 1 0.5 0"))  # what the vertices themselves say wins
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").vertex_colors[2], [1, 0.5, 0])
    for old, new in (
        ("ff708090", "ff70809"),
        ("ff708090", "ff7080zz"),
        ("#MRGB ff708090\n", ""),
        ("ff7", "ff1122ffff7"),
    ):
        (tmp_path / "a.obj").write_text(text.replace(old, new))
        with pytest.raises(FormatError, match="#MRGB"):
            read_obj(tmp_path / "a.obj")


@pytest.mark.parametrize(
    ("lines", "first"),
    [
        (["0 0 0 .1 .2 .3 1", "1 0 0 .4 .5 .6 1", "0 1 0 1 1 1 .5"], [0.1, 0.2, 0.3]),  # opacity last
        (["0 0 0 1 .1 .2 .3", "1 0 0 1 .4 .5 .6", "0 1 0 1 1 1 1"], [0.1, 0.2, 0.3]),  # the position's weight first
        (["0 0 0 1 1 1 1", "1 0 0 1 0 0 1", "0 1 0 1 0 0 1"], [1, 1, 1]),
        (["0 0 0 .1 .2 .3 1", "1 0 0", "0 1 0 .5 .5 .5"], [0.1, 0.2, 0.3]),
    ],
)
def test_a_colour_with_opacity_or_a_weighted_position_is_read(tmp_path, lines, first):
    (tmp_path / "a.obj").write_text("".join(f"v {line}\n" for line in lines) + "f 1 2 3\n")
    colors = read_obj(tmp_path / "a.obj").vertex_colors
    np.testing.assert_allclose(colors[0], first)


COLORS = {"skin": (200, 30, 10), "head": (10, 200, 30)}


def write_obj_with_images(folder: Path, skin: str = "skin.png", head: str = "head.png") -> Path:
    """Write box.obj with a material file of three materials, two with images; returns the OBJ file."""
    for name, color in COLORS.items():
        write_image(folder / f"{name}.png", np.full((8, 8, 3), color, dtype=np.uint8))
    (folder / "box.mtl").write_text(
        f"newmtl red\nKd 1 1 1\nmap_Kd {skin}\n"
        f"newmtl green\nmap_Bump bumps.png\n  map_Kd\t{head}\r\nnewmtl blue\nKd 0 0 1\n"
    )
    (folder / "box.obj").write_text("mtllib box.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    return folder / "box.obj"


@pytest.mark.parametrize("mostly_blue", [False, True])
def test_each_material_of_an_obj_file_is_baked_with_its_own_image(mostly_blue: bool, tmp_path: Path) -> None:
    """Two materials whose images lie over each other in the layout, and one with a colour alone, also on most faces."""
    result = identity_result()
    target = result.target.control
    middles = target.uvs[target.uv_indices.reshape(target.n_faces, -1)].mean(axis=1)
    materials = np.arange(target.n_faces).clip(0, 2) if mostly_blue else np.arange(target.n_faces) % 3
    source = replace(
        target,
        face_materials=materials,
        material_names=("red", "green", "blue"),
        material_colors=np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
    )
    write_result(tmp_path / "RESULT", replace(result, source=result.source.with_control(source)))
    request = TransferRequest(
        tmp_path / "RESULT", tmp_path / "out.png", texture=write_obj_with_images(tmp_path), size=64
    )
    _, warnings = run_transfer(request, Stages())
    assert not any("lie over each other" in text for text in warnings)
    rows, columns = (64 * (1.0 - middles[:, 1])).astype(int), (64 * middles[:, 0]).astype(int)
    meant = np.array([*COLORS.values(), (0, 0, 255)])[materials]
    np.testing.assert_array_equal(read_image(tmp_path / "out.png").pixels[rows, columns], meant)


@pytest.mark.parametrize(
    ("stated", "scale", "offset", "wraps"),
    [
        ("head.png", (1, 1), (0, 0), (10497, 10497)),
        ("-s 2 3 1 -o 0.25 0.5 0 -clamp on head.png", (2, 3), (0.25, 0.5), (33071, 33071)),
        ("-bm 0.5 -mm 0 1 -o 0.25 -imfchan l C:\\work\\head.png # of the head", (1, 1), (0.25, 0), (10497, 10497)),
    ],
)
def test_options_of_an_image(stated, scale, offset, wraps, tmp_path):
    document = obj_document(write_obj_with_images(tmp_path, head=stated))
    (image,) = material_images(document, "green")
    np.testing.assert_array_equal(read_material_image(document, image).pixels[0, 0], COLORS["head"])
    uvs = np.random.default_rng(3).uniform(size=(5, 2))
    np.testing.assert_allclose(image.on_image(uvs), uvs * scale + offset, atol=1e-12)
    assert image.wraps == wraps


def test_an_image_of_another_format_is_read_and_names_may_have_blanks(tmp_path: Path) -> None:
    path = write_obj_with_images(tmp_path, head="my head.tif")
    write_image(tmp_path / "my head.tif", np.full((8, 8, 3), 7, dtype=np.uint8))
    document = obj_document(path)
    (image,) = material_images(document, "green")
    assert (read_material_image(document, image).pixels == 7).all()


@pytest.mark.parametrize(
    ("stated", "name"),
    [("coat #2.png", "coat #2.png"), ("-s 1 1 7", "7"), ("-s 1 1 1 7 8", "7 8"), ("7 #1.png # red", "7 #1.png")],
)
def test_names_of_images_may_have_number_signs_and_digits(stated: str, name: str, tmp_path: Path) -> None:
    path = write_obj_with_images(tmp_path, head=stated)
    (tmp_path / "head.png").rename(tmp_path / name)
    document = obj_document(path)
    (image,) = material_images(document, "green")
    np.testing.assert_array_equal(read_material_image(document, image).pixels[0, 0], COLORS["head"])


def test_a_scale_that_is_no_finite_number_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not material_images(obj_document(write_obj_with_images(tmp_path, head="-s nan 1 head.png")), "green")
    assert "material green: 'nan 1 head.png' is not found" in caplog.text


@pytest.mark.parametrize(("content", "problem"), [(None, "is not found"), (b"none", "cannot be read as an image")])
def test_an_image_that_cannot_be_read_is_said(content, problem, tmp_path, caplog):
    path = write_obj_with_images(tmp_path, head="hat.png")
    if content is not None:
        (tmp_path / "hat.png").write_bytes(content)
    assert not material_images(obj_document(path), "green")
    assert f"box.obj: material green: 'hat.png' {problem}" in caplog.text


def test_an_obj_file_without_images_is_refused(tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    path = write_obj_with_images(tmp_path)
    (tmp_path / "box.mtl").unlink()
    with pytest.raises(ParameterError, match=r"box.obj: expected a colour image .* --material-colors"):
        run_transfer(TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=path), Stages())


def test_a_material_file_in_a_folder_names_images_of_another_folder_of_the_model(tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    (folder / "mats").mkdir(parents=True)
    path = write_obj_with_images(folder, skin="../maps/my skin.png", head="../../head.png")
    (folder / "box.mtl").rename(folder / "mats" / "box.mtl")
    path.write_text(path.read_text().replace("box.mtl", "mats/box.mtl"))
    (folder / "maps").mkdir()
    (folder / "skin.png").rename(folder / "maps" / "my skin.png")
    (folder / "head.png").rename(tmp_path / "head.png")  # outside of the model's folder
    assert obj_images(path) == [folder / "maps" / "my skin.png"]


def test_images_that_are_links_to_other_folders_are_found_and_names_outside_are_not(tmp_path: Path) -> None:
    """As in a folder of a version control system that keeps large files elsewhere."""
    folder, store = tmp_path / "model", tmp_path / "store"
    (folder / "maps").mkdir(parents=True)
    store.mkdir()
    (store / "abc").write_bytes(b"image")
    (folder / "maps" / "skin.png").symlink_to(store / "abc")
    for name in ("maps/skin.png", ".\\maps\\skin.png", "x/../maps/skin.png", str(folder / "maps" / "skin.png")):
        assert find_image(folder / "a.mtl", name) == folder / "maps" / "skin.png"
    assert [find_image(folder / "a.mtl", name) for name in ("../store/abc", str(store / "abc"), "..")] == [None] * 3


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_images_are_found_whatever_the_unicode_forms_of_folder_and_name(form: str, tmp_path: Path) -> None:
    folder = tmp_path / unicodedata.normalize("NFC" if form == "NFD" else "NFD", "josé") / "modèle"
    folder.mkdir(parents=True)
    image = folder / unicodedata.normalize(form, "été.png")
    image.write_bytes(b"image")
    for stated in ("NFC", "NFD"):
        assert find_image(folder / "a.mtl", unicodedata.normalize(stated, "été.png")) == image
