"""glTF documents: accessors, buffers and compression, and what is refused."""

import base64
import json
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from cagemap.errors import FormatError
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import _normalise_weights, glb_bytes, read_document, write_document
from cagemap.files.gltf.entries import read_accessor
from cagemap.files.gltf.nodes import read_nodes
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.read import contents_of
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import read_image
from cagemap.files.inner_texture import extract_texture
from cagemap.files.meshes.formats import read_mesh

from gltf_scenes import Maker, arm, changed
from refusals import refuses


def test_sparse_strided_and_normalised_accessors() -> None:
    make = Maker()
    block = np.zeros(3, np.dtype([("place", "<i2", 3), ("pad", "V2"), ("uv", "u1", 2), ("pad2", "V2")]))
    block["place"] = [(-32768, 0, 32767)] * 3
    block["uv"] = [(0, 255)] * 3
    view = make.view(block.tobytes(), byteStride=12)
    stated = {"bufferView": view, "count": 3}
    make.accessors += [
        stated | {"componentType": 5122, "type": "VEC3", "normalized": True},
        stated | {"componentType": 5121, "type": "VEC2", "byteOffset": 8, "normalized": True},
    ]
    rows = make.view(np.array([0, 2], "<u2").tobytes())
    values = make.view(np.ones((2, 3), "<f4").tobytes())
    sparse = {"count": 2, "indices": {"bufferView": rows, "componentType": 5123}, "values": {"bufferView": values}}
    make.accessors.append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse})
    document = make.document()
    np.testing.assert_array_equal(read_accessor(document, 0, "t", ("VEC3",)), [(-1, 0, 1)] * 3)
    np.testing.assert_array_equal(read_accessor(document, 1, "t", ("VEC2",)), [(0, 1)] * 3)
    for count in (3, None):
        found = read_accessor(document, 2, "t", ("VEC3",), count)
        np.testing.assert_array_equal(found, [(1, 1, 1), (0, 0, 0), (1, 1, 1)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 4_000_000_000}, "ends before"),
        ({"byteOffset": 2**40}, "byteOffset"),
        ({"count": 0}, "whole number from 1"),
        ({"count": 1.5}, "whole number"),
        ({"componentType": 5124}, "componentType"),
        ({"type": "VEC7"}, "VEC3"),
        ({"bufferView": 99}, "bufferViews"),
        ({"bufferView": None, "count": 4_000_000_000}, "has no data"),
    ],
)
def test_accessors_that_lie_are_refused(changes: dict[str, Any], message: str) -> None:
    document = arm()
    number = document.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    document.json["accessors"][number] |= changes
    refuses(FormatError, message, character_of, document)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"asset": {"version": "1.0"}}, r"version 2\.0"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression.*gltf-transform"),
        ({"extensionsRequired": ["KHR_texture_basisu"]}, "KHR_texture_basisu.*PNG"),
        ({"extensionsRequired": ["ACME_other"]}, "ACME_other"),
        ({"buffers": [{"byteLength": 4, "uri": "../secret.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "%2e%2e/secret.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "https://example.org/a.bin"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "/etc/passwd"}]}, "in the folder of the document"),
        ({"buffers": [{"byteLength": 4, "uri": "absent.bin"}]}, r"made\.gltf names"),
        ({"buffers": [{"byteLength": 400, "uri": "data:;base64,AAAA"}]}, "cut short"),
        ({"buffers": [{"byteLength": 3, "uri": "data:;base64,A*AA"}]}, "data URI is damaged"),
        ({"buffers": [{"byteLength": 4}]}, "no data in the file"),
    ],
)
def test_documents_that_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "made.gltf"
    path.write_text(json.dumps(arm().json | changes))
    refuses(FormatError, message, read_document, path)


def test_a_gltf_with_its_files(tmp_path: Path) -> None:
    document = arm()
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "a.bin").write_bytes(document.buffers[0])
    for name, uri in (
        ("beside.gltf", "sub%20folder/a.bin"),
        ("inside.gltf", "data:application/octet-stream;base64," + base64.b64encode(document.buffers[0]).decode()),
    ):
        buffers = [{"byteLength": len(document.buffers[0]), "uri": uri}]
        (tmp_path / name).write_text(json.dumps(document.json | {"buffers": buffers}))
        assert len(read_character(tmp_path / name).parts) == 2


def test_glbs_that_are_cut_short(tmp_path: Path) -> None:
    content = glb_bytes(arm())
    path = tmp_path / "cut.glb"
    for length in (0, 3, 12, 19, 40, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(FormatError):
            read_document(path)
    path.write_bytes(struct.pack("<4sII", b"glTF", 1, len(content)) + content[12:])
    refuses(FormatError, "version 2, got 1", read_document, path)
    for chunk, message in ((b"\xff\0\0\0JSON", "ends after the file"), (b"\0\0\0\0BIN\0", "expected a JSON chunk")):
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 20) + chunk)
        refuses(FormatError, message, read_document, path)


@pytest.mark.parametrize(("text", "message"), [("[]", "with an asset, got other JSON"), ('{"a": NaN}', "number NaN")])
def test_other_json_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "other.gltf").write_text(text)
    refuses(FormatError, message, read_document, tmp_path / "other.gltf")


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([{"children": [1]}, {"children": [0], "mesh": 0}], "own ancestors"),
        ([{"children": [2]}, {"children": [2]}, {"mesh": 0}], "two parents"),
        ([{"mesh": 0, "scale": [1, 1]}], "3 finite numbers"),
        ([{"mesh": 0, "matrix": [1e200] * 16}], "16 finite numbers"),
        ([{"mesh": 0, "rotation": [10**400, 0, 0, 1]}], "4 finite numbers"),
    ],
)
def test_nodes_that_are_refused(nodes: list[dict[str, Any]], message: str) -> None:
    refuses(FormatError, message, read_nodes, changed(arm(), nodes=nodes, scenes=[{"nodes": [0]}]))


@pytest.mark.slow
def test_draco(shared_data: Path) -> None:
    pytest.importorskip("DracoPy")
    place = shared_data / "characters"
    packed = read_character(place / "foreign" / "mh_male_young_draco.glb")
    plain = read_character(place / "rigs" / "character_A.glb")
    for one, other in zip(packed.parts, plain.parts, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.mesh.positions.max(axis=0), other.mesh.positions.max(axis=0), atol=1e-4)
        assert list(one.shapes) == list(other.shapes)
    assert "KHR_draco" not in json.dumps(read_document(place / "foreign" / "mh_male_young_draco.glb").json)


def test_weights_of_draco_have_sums_of_one_or_none() -> None:
    weights = np.array([[1, 2, 1, 0], [0, 0, 0, 0]], dtype=np.float32)
    (found,) = _normalise_weights({"WEIGHTS_0": weights}).values()
    np.testing.assert_array_equal(found, weights / 4)


def test_draco_without_its_library(monkeypatch: pytest.MonkeyPatch, shared_data: Path) -> None:
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(FormatError, match=r"cagemap\[draco\].*gltf-transform"):
        read_document(shared_data / "characters" / "foreign" / "mh_male_young_draco.glb")


def test_sparse_positions_need_no_buffer_view(tmp_path: Path) -> None:
    """Rows that are not listed are 0; a count beyond the document's bytes is refused."""
    make = Maker()
    indices, values = make.view(np.array([1, 2], "u1").tobytes()), make.view(np.eye(3, dtype="f4")[:2].tobytes())
    sparse = {"count": 2, "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}}
    entry = {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}
    top = {
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    write_document(tmp_path / "sparse.glb", make.document(accessors=[entry], **top))
    np.testing.assert_array_equal(read_mesh(tmp_path / "sparse.glb").positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    write_document(tmp_path / "huge.glb", make.document(accessors=[entry | {"count": 3_000_000_000}], **top))
    refuses(FormatError, "has no data", read_mesh, tmp_path / "huge.glb")


def test_textures_that_are_webp_alone_are_read_and_written_as_png(tmp_path: Path) -> None:
    """Their extension may be required, refers to no accessor, and its format is listed."""
    output = oiio.ImageOutput.create(str(tmp_path / "image.webp"))
    pixels = np.full((4, 4, 3), 200, dtype=np.uint8)
    assert output.open(str(tmp_path / "image.webp"), oiio.ImageSpec(4, 4, 3, "uint8"))
    assert output.write_image(pixels)
    output.close()
    given = arm()
    binary, top = Binary(given), json.loads(json.dumps(given.json))
    top["meshes"][0]["primitives"][0]["material"] = 0
    top |= {
        "extensionsUsed": ["EXT_texture_webp"],
        "extensionsRequired": ["EXT_texture_webp"],
        "materials": [{"name": "skin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"extensions": {"EXT_texture_webp": {"source": 0}}}],
        "images": [{"bufferView": binary.view((tmp_path / "image.webp").read_bytes()), "mimeType": "image/webp"}],
    }
    file = tmp_path / "hero.glb"
    write_document(file, binary.document(top))
    document = read_document(file)
    assert contents_of(read_scene(document)).textures == ("skin baseColor (webp)",)
    rebuilt, plain = (character_glb(character_of(one), one) for one in (document, changed(document, extensionsUsed=[])))
    assert len(rebuilt.json["accessors"]) == len(plain.json["accessors"])
    texture = extract_texture(file, read_mesh(file), tmp_path)
    assert texture == tmp_path / "hero_texture.png"
    np.testing.assert_array_equal(read_image(texture).pixels, read_image(tmp_path / "image.webp").pixels)
