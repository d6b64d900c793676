"""Colour images that the material files of an OBJ file name."""

from __future__ import annotations

import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.files.gltf.material_images import material_images, read_material_image
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.obj_materials import obj_document, obj_images
from cagemap.files.result.folder import write_result
from cagemap.files.text import find_image
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result

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
