"""Materials and textures of FBX files, and what of them glTF cannot say."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import image_bytes
from cagemap.files.gltf.material_images import material_images
from cagemap.files.meshes.formats import read_mesh

from fbx_scenes import PNG, Node, add_layer, fbx_arm, fbx_file, layer, properties

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")


@pytest.mark.parametrize("where", ["inside", "below"])
def test_a_texture_inside_the_file_or_beside_it(where: str, tmp_path: Path) -> None:
    made = fbx_arm(image=PNG if where == "inside" else b"")
    if where != "inside":
        material = made.named("Material").properties[0]
        texture = fbx_arm(image=PNG).named("Texture")
        made.add("Texture", "skin", "", *texture.inside, to=material, by="DiffuseColor")
        folder = tmp_path / "textures"
        folder.mkdir()
        (folder / "skin.png").write_bytes(PNG)
    document = read_document(fbx_file(tmp_path, made))
    assert image_bytes(document, 0) == (PNG, ".png")
    assert document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}


@pytest.mark.parametrize(("angle", "across", "deep"), [(30.0, 4.0, 1), (0.0, 2.0, 0), (30.0, 2.0, 1), (0.0, 0.0, 1)])
def test_a_texture_that_is_moved_turned_and_scaled(angle, across, deep, tmp_path, caplog):
    """In FBX the image is scaled, turned and moved over the coordinates: not always what glTF can say.

    The third scale has no effect; assimp writes 0.
    """
    made = fbx_arm(image=PNG)
    texture = made.named("Texture")
    moved = {"Translation": (0.25, 0.5, 0.0), "Rotation": (0.0, 0.0, angle), "Scaling": (across, 4.0, float(deep))}
    texture.inside.append(properties(**moved))
    (image,) = material_images(read_document(fbx_file(tmp_path, made)), "skin")
    on_image = np.random.default_rng(2).uniform(size=(5, 2))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    uvs = on_image * [across, 4.0] @ np.array([[c, s], [-s, c]]) + [0.25, 0.5]
    if (angle and across != 4.0) or not across:
        assert "is turned and stretched" in caplog.text
        on_image = uvs
    np.testing.assert_allclose(image.on_image(uvs), on_image, atol=1e-6)


@pytest.mark.parametrize("layered", [False, True])
@pytest.mark.parametrize(("named", "coordinates"), [("second", 1), ("map", 0), ("unknown", 0)])
def test_a_texture_of_another_uv_set(named: str, coordinates: int, layered: bool, tmp_path: Path) -> None:
    made = fbx_arm(image=PNG)
    add_layer(made, layer("UV", "second", "ByPolygonVertex", UV=np.full(2, 0.25), UVIndex=np.zeros(8, "<i4")))
    texture = made.named("Texture")
    texture.inside.append(properties(UVSet=named))
    if layered:
        number = texture.properties[0]
        of_material = next(one for one in made.connections if one.properties[1] == number and one.properties[0] == "OP")
        above = made.add("LayeredTexture", "layers", "", to=of_material.properties[2], by="DiffuseColor")
        of_material.properties = ("OO", number, above)
    path = fbx_file(tmp_path, made)
    (image,) = material_images(read_document(path), "skin")
    assert image.uv_set == f"TEXCOORD_{coordinates}"
    assert (read_mesh(path).uv_sets[0].uvs == 0.25).all()


def test_further_layers_of_a_texture_are_said_to_be_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = fbx_arm(image=PNG)
    material, texture = (made.named(kind).properties[0] for kind in ("Material", "Texture"))
    above = made.add("LayeredTexture", "layers", "", to=material, by="DiffuseColor")
    made.connections = [one for one in made.connections if one.properties[1:3] != (texture, material)]
    made.connect(texture, above)
    named = [Node("FileName", ("dirt.png",)), Node("RelativeFilename", ("dirt.png",))]
    dirt = made.add("Texture", "dirt", "", *named, to=above)
    made.add("Video", "dirt", "Clip", *named, Node("Content", (PNG + b"2",)), to=dirt)
    assert len(material_images(read_document(fbx_file(tmp_path, made)), "skin")) == 1
    assert "material skin: baseColorTexture: has 2 layers, the first is used" in caplog.text


def test_a_texture_that_is_clamped_stays_so(tmp_path: Path) -> None:
    made = fbx_arm(image=PNG)
    texture = made.named("Texture")
    texture.inside.append(properties(WrapModeU=1, WrapModeV=0))
    document = read_document(fbx_file(tmp_path, made))
    (sampler,) = document.json["samplers"]
    assert document.json["textures"][0]["sampler"] == 0
    assert sampler == {"wrapS": 33071, "wrapT": 10497}


def test_a_texture_that_is_not_there_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "skin.png").write_bytes(PNG)  # outside the folder of the file
    made = fbx_arm(image=b"gone")
    made.objects = [one for one in made.objects if one.name != "Video"]
    document = read_document(fbx_file(folder, made))
    assert "images" not in document.json
    assert "skin.png' is not found and left out" in caplog.text


def test_a_texture_that_cannot_be_read_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document = read_document(fbx_file(tmp_path, fbx_arm(image=b"no image")))
    assert "images" not in document.json
    assert "skin.png' cannot be read as an image and is left out" in caplog.text


@pytest.mark.parametrize(
    ("skin", "alpha", "said"),
    [
        ({}, 1.0, False),
        ({"Opacity": 0.25}, 0.25, False),
        ({"TransparencyFactor": 0.75, "TransparentColor": (1.0, 1.0, 1.0)}, 0.25, False),
        ({"TransparencyFactor": 1.0, "TransparentColor": (0.0, 0.0, 0.0)}, 1.0, False),
        ({"TransparencyFactor": 1.0, "TransparentColor": (1.0, 1.0, 1.0)}, 1.0, True),
    ],
)
def test_opacity_is_kept(skin, alpha, said, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        document = read_document(fbx_file(tmp_path, fbx_arm(**skin)))
    (material,) = document.json["materials"]
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.5, 0.25, 1.0, alpha])
    assert material.get("alphaMode") == ("BLEND" if alpha < 1.0 else None)
    assert ("taken as opaque" in caplog.text) == said
