"""Textures, layouts and colours of a rigged body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.character.values import Character, Part
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.textures import material_images, read_material_image
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import Image, png_bytes, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.tasks.carry_character import with_part
from cagemap.tasks.rig_character import read_body
from cagemap.tasks.rig_materials import with_uvs_in_unit_square

from command_line import Run
from example_character import ball, character, with_material, write_character
from example_result import textured_cube
from rigged import part_named, rig_done, same_order


def test_images_that_lie_on_no_uvs_are_left_out_aloud(run: Run, files: Character) -> None:
    document = read_document("C.glb")
    material = document.json["materials"][0]
    color = material["pbrMetallicRoughness"]["baseColorTexture"]
    material["emissiveTexture"] = {"index": color["index"]}
    color["texCoord"] = 3
    document.json["textures"].append({"extensions": {"KHR_texture_basisu": {"source": 0}}})
    material["normalTexture"] = {"index": len(document.json["textures"]) - 1}
    write_document("C.glb", document)
    said = run.done("rig B.glb --like C.glb -o OUT.glb").err
    assert "body: its baseColorTexture is left out: body has no UV set TEXCOORD_3" in said
    assert "normalTexture has no PNG, JPEG or WebP image (KHR_texture_basisu) and is left out; convert it" in said
    (image,) = material_images(read_document("OUT.glb"), "body")
    assert image.slot == "emissiveTexture"
    assert "baseColorTexture" not in read_document("OUT.glb").json["materials"][0]["pbrMetallicRoughness"]


@pytest.mark.slow
@pytest.mark.parametrize(("wrap", "sign"), [(33648, -1.0), (10497, 1.0)])
def test_a_texture_continues_outside_the_unit_square_by_its_sampler(run, files, body, wrap, sign):
    """Mirrored or repeated: a layout beyond u = 1 reads the same image."""
    rig_done(run)
    (before,) = material_images(read_document("OUT.glb"), "body")
    expected = read_material_image(read_document("OUT.glb"), before).pixels.astype(float)
    write_character(Path("C.glb"), character(replace(body, uvs=sign * body.uvs + [2 if sign < 0 else 1, 0])))
    document = read_document("C.glb")
    document.json["samplers"] = [{"wrapS": wrap, "wrapT": wrap}]
    for texture in document.json["textures"]:
        texture["sampler"] = 0
    write_document("C.glb", document)
    rig_done(run)
    (after,) = material_images(read_document("OUT.glb"), "body")
    assert np.abs(read_material_image(read_document("OUT.glb"), after).pixels - expected).mean() < 1.0


@pytest.mark.slow
def test_textures_of_the_body_and_of_its_own_parts_stay(run: Run, files: Character, body: ControlMesh) -> None:
    own = ball("my_eye", body.positions[np.argmax(body.positions[:, 1])] - [0, 0.3, 0], 0.1)
    own = replace(own.with_uvs(own.positions[:, :2] % 1.0, own.face_indices), material_names=("eye",))
    images = {
        (name, "baseColorTexture"): png_bytes(Image(np.full((4, 4, 3), grey, np.uint8)))
        for name, grey in (("body", 10), ("eye", 20))
    }
    given = Character((Part("body", with_material(body)), Part("my_eye", own)))
    write_document("B.glb", character_glb(given, images=images), force=True)
    for words in ((), ("--keep-textures", "--force")):
        made = rig_done(run, *words)
        document = read_document("OUT.glb")
        greys = {}
        for part in made.parts:
            (name,) = part.mesh.material_names
            found = material_images(document, name)
            greys[part.name] = [int(read_material_image(document, one).pixels.max()) for one in found]
        assert greys["my_eye"] == [20]
        assert (greys["body"] == [10]) == bool(words)
        assert greys["hat"] == []


@pytest.mark.slow
def test_a_kept_texture_keeps_its_layout(run: Run, files: Character, body: ControlMesh) -> None:
    """A character without materials: the body keeps its own, its UVs in several unit squares, and gets no tint."""
    spread = replace(body, uvs=3 * body.uvs)
    image = png_bytes(Image(np.zeros((4, 4, 3), np.uint8)))
    own = character_glb(Character((Part("body", with_material(spread)),)), images={("body", "baseColorTexture"): image})
    write_document("B.glb", own, force=True)
    plain = replace(files.parts[0], mesh=replace(body, name="body", vertex_colors=np.full_like(body.positions, 0.5)))
    write_document("C.glb", character_glb(replace(files, parts=(plain,))), force=True)
    mesh = part_named(rig_done(run), "body").mesh
    assert [one.name for one in mesh.all_uv_sets] == ["TEXCOORD_0"]
    np.testing.assert_allclose(np.ptp(mesh.uvs, axis=0), np.ptp(spread.uvs, axis=0), atol=1e-5)
    assert mesh.vertex_colors is None


def test_uv_sets_of_a_body_in_tiles_stay(body: ControlMesh) -> None:
    own = replace(
        body, uvs=3 * body.uvs, uv_name="TEXCOORD_0", uv_sets=(UvSet("TEXCOORD_1", body.uvs, body.uv_indices),)
    )
    packed = with_uvs_in_unit_square(own)
    assert [one.name for one in packed.all_uv_sets] == ["TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2"]
    assert [one.uvs is given.uvs for one, given in zip(packed.uv_sets, own.all_uv_sets, strict=True)] == [True, True]


@pytest.mark.slow
@pytest.mark.parametrize("has_colors", [True, False])
def test_vertex_colors_come_with_the_texture_they_tint(
    run: Run, files: Character, body: ControlMesh, *, has_colors: bool
) -> None:
    colors = np.linspace(0.2, 0.9, body.n_vertices * 3).reshape(-1, 3)
    given = part_named(files, "body")
    tinted = replace(given, mesh=replace(given.mesh, vertex_colors=colors if has_colors else None))
    write_character(Path("C.glb"), with_part(files, given, tinted))
    write_mesh("B.glb", replace(body, vertex_colors=np.tile([1.0, 0.0, 0.0], (body.n_vertices, 1))), force=True)
    found = part_named(rig_done(run), "body")
    if has_colors:
        np.testing.assert_allclose(found.mesh.vertex_colors[same_order(found, given)], colors, atol=1e-4)
    else:
        assert found.mesh.vertex_colors is None
    kept = part_named(rig_done(run, "--keep-textures"), "body")
    np.testing.assert_allclose(
        kept.mesh.vertex_colors, np.tile([1.0, 0.0, 0.0], (len(kept.mesh.positions), 1)), atol=1e-4
    )


def test_a_body_of_an_obj_file_keeps_the_image_of_its_material(tmp_path: Path) -> None:
    file = tmp_path / "B.obj"
    mesh = textured_cube(file.name)
    write_mesh(file, replace(mesh, face_materials=np.zeros(mesh.n_faces, np.int64), material_names=("skin",)))
    file.write_text(f"mtllib B.mtl\n{file.read_text()}")
    (tmp_path / "B.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    write_image(tmp_path / "skin.png", np.full((2, 2, 3), 200, np.uint8))
    document, made = read_body(file)
    write_document(tmp_path / "C.glb", character_glb(made, document))
    assert [image.slot for image in material_images(read_document(tmp_path / "C.glb"), "skin")] == ["baseColorTexture"]
    assert read_mesh(tmp_path / "C.glb").material_names == ("skin",)


def test_a_body_whose_uvs_are_all_in_one_point_is_unwrapped() -> None:
    mesh = textured_cube("B.obj").with_uvs(np.zeros((1, 2)), np.zeros(24, np.int64))
    assert not mesh.has_layout
    assert with_uvs_in_unit_square(mesh).has_layout


def test_a_body_whose_layout_lies_over_itself_is_said(run, files, monkeypatch):
    monkeypatch.setattr("cagemap.tasks.rig_materials.target_overlap_warnings", lambda control: ["it lies over itself"])
    assert "it lies over itself" in run.done("rig B.glb --like C.glb -o OUT.glb --size 16").err


def test_a_body_without_uvs_is_unwrapped_in_its_own_stage_if_the_character_has_images(
    run: Run, files: Character, body: ControlMesh
) -> None:
    write_mesh("B.glb", replace(body, uvs=None, uv_indices=None), force=True)
    said = run.done("-v rig B.glb --like C.glb -o OUT.glb").err
    assert "stage: unwrap" in said
    write_document("C.glb", character_glb(files), force=True)
    said = run.done("-v rig B.glb --like C.glb -o OUT.glb --force").err
    assert "stage: unwrap" not in said
    assert part_named(read_character("OUT.glb"), "body").mesh.uvs is None
