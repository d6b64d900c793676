"""Colours and images on the models of the studio, seams in them, and downloads of textured models."""

import base64
import io
import json
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pygltflib
import pytest
import trimesh
from examples.shapes import creature, triangulated
from scipy.spatial import cKDTree

from cagemap.files.gltf.document import read_document
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.space import StageSpace
from cagemap.files.usd.write import write_usd
from cagemap.mesh.control_mesh import UvSet
from cagemap.numerics.arrays import encode_srgb as to_display
from cagemap.studio.compute import (
    ShowBaked,
    run_task,
)
from cagemap.studio.downloads import textured_model
from cagemap.studio.finish import FinishOptions, finish_commands
from cagemap.studio.glb import MeshPart, pack_glb
from cagemap.studio.models import with_texture
from cagemap.studio.opening import default_files
from cagemap.studio.shape import refined_shape
from cagemap.studio.skins import (
    SEAM_TOLERANCE,
    DrawnModel,
    Look,
    PreviewMap,
    seam_triangles,
    source_skin,
    target_skin,
    texture_colors,
)
from cagemap.studio.state import Output, StudioState
from cagemap.subdivision import refine
from cagemap.tasks.requests.catalogue import all_options

from studio_boxes import opened_pair, unwrapped_cube
from textured_files import write_skin, write_textured_usd


def read_back(data: bytes) -> list[trimesh.Trimesh]:
    return list(trimesh.load(io.BytesIO(data), file_type="glb").geometry.values())


def attributes_of(data: bytes, name: str) -> dict[str, np.ndarray]:
    """Attributes of a mesh of a binary glTF file, and the corners of its triangles."""
    document = pygltflib.GLTF2.load_from_bytes(data)
    (part,) = next(mesh for mesh in document.meshes if mesh.name == name).primitives

    def array(number: int) -> np.ndarray:
        accessor = document.accessors[number]
        view = document.bufferViews[accessor.bufferView]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor.componentType]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor.type]
        found = np.frombuffer(document.binary_blob(), kind, accessor.count * columns, view.byteOffset)
        return found.reshape(accessor.count, columns)

    found = {key: array(number) for key, number in vars(part.attributes).items() if isinstance(number, int)}
    return found | {"corners": array(part.indices).reshape(-1, 3)}


def test_glb_is_read_by_others_as_it_was_written() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    attributes = {"POSITION": points, "TEXCOORD_0": points[:, :2], "_TRUST": points[:, 0]}
    none = MeshPart("none", attributes, np.zeros((0, 3), dtype=np.int64))
    data = pack_glb([MeshPart("model", attributes, np.array([[0, 1, 2], [0, 2, 3]])), none])
    (mesh,) = read_back(data)
    np.testing.assert_allclose(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    read = attributes_of(data, "model")
    np.testing.assert_allclose(read["TEXCOORD_0"], points[:, :2] * [1, -1] + [0, 1])  # glTF's v points down
    np.testing.assert_allclose(read["_TRUST"].ravel(), points[:, 0])


def test_a_bake_in_a_new_layout_lies_on_the_model_as_it_is_shown(tmp_path: Path) -> None:
    """A scan is not subdivided for it, and one whose z axis points up stays upright."""
    shape = creature().with_uvs(None, None)
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, shape)
    laid_out = shape.with_uvs(shape.positions[:, :2] / 100 + 0.5, shape.face_indices)
    write_mesh(tmp_path / "c_unwrapped.obj", laid_out)
    write_image(tmp_path / "c.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    for scheme in ("none", "bilinear", None):
        paths = tmp_path / "a.obj", tmp_path / "b.obj"
        opening, cache, opened = opened_pair(*paths, schemes=(scheme, scheme), ups=("z", None))
        task = ShowBaked(opening, tmp_path / "c.png", tmp_path / "c_unwrapped.obj", None, None)
        _, skin = run_task(cache, task, lambda _: None)
        (plain,), (shown,) = (read_back(one) for one in (opened.skins[0], skin))
        assert b'"baked"' in skin
        assert cKDTree(plain.vertices).query(shown.vertices)[0].max() < 1e-6


def identity(n: int, triangles: np.ndarray) -> PreviewMap:
    """Every vertex of a shape to itself."""
    first = np.zeros(n, dtype=np.int64)
    first[triangles.ravel()] = np.repeat(np.arange(len(triangles)), 3)
    return PreviewMap(first, (triangles[first] == np.arange(n)[:, None]).astype(float), np.ones(n))


@pytest.mark.parametrize("channels", [1, 3])
def test_an_image_of_floats_is_shown_as_linear(tmp_path: Path, channels: int) -> None:
    write_image(tmp_path / "skin.exr", np.full((8, 8, channels), 0.21586, dtype=np.float32))
    shown = with_texture(Look(), tmp_path / "skin.exr").texture
    np.testing.assert_array_equal(shown, np.full((8, 8, 3), 128))


def test_colours_at_the_border_of_an_image_are_not_those_of_the_opposite_border() -> None:
    image = np.zeros((2, 2, 3), dtype=np.uint8)
    image[..., 0], image[..., 1] = [0, 255], [[0], [255]]
    look = Look(texture=image)
    corners = np.array([(0.0, 1.0), (1.0, 1.0), (0.0, 0.0), (1.0, 0.0)])
    for step in (0.0, 1e-9, -1e-9):
        np.testing.assert_array_equal(texture_colors(look, corners + step), image.reshape(-1, 3))
    np.testing.assert_array_equal(texture_colors(look, np.array([(1.25, -0.25), (-0.25, 1.25)])), image[[0, 1], [0, 1]])


def test_every_tile_of_an_image_is_shown_on_its_faces(tmp_path: Path) -> None:
    tiles = {1001: (255, 0, 0), 1002: (0, 255, 0), 1011: (0, 0, 255)}
    for number, color in tiles.items():
        side = 2 if number == 1001 else 8  # none loses detail by another one
        write_image(tmp_path / f"skin.{number}.png", np.full((side, side, 3), color, dtype=np.uint8))
    look = with_texture(Look(), tmp_path / "skin.<UDIM>.png")
    places = np.array([[0.1, 0.9], [1.9, 0.1], [0.9, 1.1], [1.5, 1.5]])
    assert look.texture.shape == (16, 16, 3)
    np.testing.assert_array_equal(texture_colors(look, places), [*(255 * np.eye(3)), np.zeros(3)])
    # The page's card has the whole of it between 0 and 1.
    mesh = unwrapped_cube()
    shape = refined_shape(refine(mesh.with_uvs(2 * mesh.uvs, mesh.uv_indices), 1))
    drawn = attributes_of(source_skin(DrawnModel(shape, look)), "model")
    assert shape.uvs.max() > 1.9
    assert 0.9 < drawn["TEXCOORD_0"].max() < 1.0


def test_a_bake_in_the_second_uv_set_is_shown_in_it(tmp_path: Path) -> None:
    mesh = unwrapped_cube()
    second = UvSet("TEXCOORD_1", 0.5 * mesh.uvs, mesh.uv_indices)
    write_mesh(tmp_path / "box.glb", replace(mesh, uv_sets=(second,)))
    write_skin(tmp_path, name="t.png")
    files = default_files(tmp_path / "box.glb", tmp_path / "box.glb", None)
    opening, cache, _ = opened_pair(tmp_path / "box.glb", tmp_path / "box.glb")
    for uv_set, factor in ((None, 1.0), ("TEXCOORD_1", 0.5)):
        largest = factor * mesh.uvs[:, 0].max()
        _, skin = run_task(cache, ShowBaked(opening, tmp_path / "t.png", None, uv_set, None), lambda _: None)
        assert 0.9 * largest < attributes_of(skin, "model")["TEXCOORD_1"][:, 0].max() < 1.01 * largest
        outputs = (Output(tmp_path / "t.png", "texture", uv_set),)
        (tmp_path / "out.glb").write_bytes(textured_model(StudioState(files=files, outputs=outputs), None))
        assert read_mesh(tmp_path / "out.glb").uvs[:, 0].max() == pytest.approx(largest, abs=1e-6)


def _downloaded(folder: Path, target: Path, *outputs: Path) -> pygltflib.GLTF2:
    """The model to download of a target with the image ``t.png`` and further outputs."""
    write_skin(folder, name="t.png")
    files = default_files(target, target, None)
    listed = tuple(Output(path, "texture") for path in (folder / "t.png", *outputs))
    return pygltflib.GLTF2.load_from_bytes(textured_model(StudioState(files=files, outputs=listed), None))


def test_a_download_shows_the_image_without_the_models_own_colours(tmp_path: Path) -> None:
    """glTF multiplies them."""
    write_mesh(tmp_path / "box.ply", replace(unwrapped_cube(), vertex_colors=np.full((8, 3), 0.5)))
    document = _downloaded(tmp_path, tmp_path / "box.ply")
    assert document.meshes[0].primitives[0].attributes.COLOR_0 is None


@pytest.mark.parametrize("layout", [False, True])
def test_a_download_of_a_usd_model_is_in_metres_with_y_up(layout: bool, tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    to_world = np.eye(4)
    to_world[3, :3] = [100.0, 0.0, 200.0]
    mesh = unwrapped_cube()
    write_usd(tmp_path / "box.usda", mesh, space=StageSpace("Z", 0.01, to_world))
    write_mesh(tmp_path / "t_unwrapped.obj", mesh)
    document = _downloaded(tmp_path, tmp_path / "box.usda", *[tmp_path / "t_unwrapped.obj"] * layout)
    matrix = np.reshape(document.nodes[0].matrix, (4, 4))
    np.testing.assert_allclose([0.0, 0.0, 0.0, 1.0] @ matrix, [1.0, 2.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose([0.0, 0.0, 1.0, 0.0] @ matrix, [0.0, 0.01, 0.0, 0.0], atol=1e-12)


def test_a_download_of_a_model_with_z_up_is_turned_with_a_new_layout_too(tmp_path: Path) -> None:
    mesh = triangulated(unwrapped_cube())
    trimesh.Trimesh(mesh.positions, mesh.face_indices.reshape(-1, 3)).export(tmp_path / "scan.stl")
    write_mesh(tmp_path / "t_unwrapped.obj", mesh)
    document = _downloaded(tmp_path, tmp_path / "scan.stl", tmp_path / "t_unwrapped.obj")
    matrix = np.reshape(document.nodes[0].matrix, (4, 4))
    np.testing.assert_allclose([0.0, 0.0, 1.0, 1.0] @ matrix, [0.0, 1.0, 0.0, 1.0], atol=1e-12)


def test_the_image_inside_a_glb_is_the_texture_where_none_is_named(tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.obj", unwrapped_cube())
    write_image(tmp_path / "t.png", np.full((8, 8, 3), [255, 0, 0], dtype=np.uint8))
    files = default_files(tmp_path / "box.obj", tmp_path / "box.obj", None)
    model = textured_model(StudioState(files=files, outputs=(Output(tmp_path / "t.png", "texture"),)), None)
    (tmp_path / "box.glb").write_bytes(model)
    given = tmp_path / "box.obj", tmp_path / "box.glb"
    for _ in range(2):  # the file that was put there is used again
        _, _, opened = opened_pair(*given)
        assert opened.source.texture == tmp_path / "box_texture.png"
    np.testing.assert_array_equal(np.unique(opened.source.look.texture[..., 0]), [255])
    (tmp_path / "box_texture.png").write_bytes(b"another's")
    assert opened_pair(*given)[2].source.texture == tmp_path / "box_texture1.png"
    assert (tmp_path / "box_texture.png").read_bytes() == b"another's"
    assert opened_pair(*given, texture=tmp_path / "t.png")[2].source.texture == tmp_path / "t.png"


def test_each_material_of_a_glb_is_shown_with_its_own_image(tmp_path: Path) -> None:
    """The page gets one image with both; a bake reads them from the model's file."""
    mesh = unwrapped_cube()
    halves = (np.arange(mesh.n_faces) % 2).astype(np.int64)
    painted = replace(mesh, face_materials=halves, material_names=("red", "blue"), material_colors=np.ones((2, 3)))
    write_mesh(tmp_path / "made.glb", painted)
    made = read_document(tmp_path / "made.glb")
    document, data = json.loads(json.dumps(made.json)), bytes(made.buffers[0])
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document |= {"buffers": [{"byteLength": len(data), "uri": uri}]}
    document |= {"textures": [{"source": 0}, {"source": 1}], "images": [{"uri": "red.png"}, {"uri": "blue.png"}]}
    for name, color in (("red", [255, 0, 0]), ("blue", [0, 0, 255])):
        write_image(tmp_path / f"{name}.png", np.full((8, 8, 3), color, dtype=np.uint8))
        material = next(one for one in document["materials"] if one["name"] == name)
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": ["red", "blue"].index(name)}
    (tmp_path / "box.gltf").write_text(json.dumps(document))
    _, _, opened = opened_pair(tmp_path / "box.gltf", tmp_path / "box.gltf")
    assert opened.source.texture == tmp_path / "box.gltf"
    shape, look = opened.source.shape, opened.source.look
    middles = shape.uvs[shape.uv_triangles].mean(axis=1)
    shown = texture_colors(look, middles)
    of_triangle = opened.source.control.face_materials[shape.faces]
    meant = np.array([[255, 0, 0], [0, 0, 255]])[of_triangle]
    assert np.abs(shown.astype(int) - meant).max() < 60  # JPEG
    files = default_files(tmp_path / "box.gltf", tmp_path / "box.gltf", opened.source.texture)
    commands = finish_commands(all_options(), files, FinishOptions(), use_landmarks=False)
    assert any(command.output.name == "box_from_box.png" for command in commands)


def test_the_image_inside_a_usd_file_is_the_texture_where_none_is_named(tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    write_textured_usd(tmp_path, unwrapped_cube())
    write_mesh(tmp_path / "bare.usda", unwrapped_cube())
    for name, texture in (("box.usda", tmp_path / "box_texture.png"), ("bare.usda", None)):
        _, _, opened = opened_pair(tmp_path / "bare.usda", tmp_path / name)
        assert opened.source.texture == texture
        assert (opened.source.look.texture is None) == (texture is None)


def test_seams_are_found_where_texture_coordinates_jump() -> None:
    shape = refined_shape(refine(unwrapped_cube(), 3))
    mapped = identity(len(shape.positions), shape.triangles)
    uvs = mapped.pull_back(shape.uv_triangles, shape.uvs)
    crossing = seam_triangles(shape, shape, mapped, shape.positions, uvs)
    # Under the identity a triangle crosses a seam if it has a vertex on one and lies on another face than its image.
    island = shape.faces
    own = island[mapped.triangle[shape.triangles]]
    np.testing.assert_array_equal(crossing, (own != own[:, :1]).any(axis=1))


def test_compiled_seams_are_those_of_numpy() -> None:
    rng, shape = np.random.default_rng(5), refined_shape(refine(unwrapped_cube(), 2))
    count = len(shape.positions)
    triangle = np.where(rng.random(count) < 0.1, 40, 0)
    mapped = PreviewMap(triangle, rng.dirichlet(np.ones(3), count), np.ones(count))
    images, steps = rng.normal(size=(count, 3)), rng.normal(size=(count, 2))
    uvs = np.einsum("nij,nj->ni", shape.uv_jacobians[triangle], images) + 0.1 * steps
    expected = np.zeros(len(shape.triangles), dtype=bool)
    for start, end in zip(shape.triangles.T, np.roll(shape.triangles.T, -1, axis=0), strict=True):
        predicted = np.einsum("tij,tj->ti", shape.uv_jacobians[triangle[start]], images[end] - images[start])
        error = np.linalg.norm(uvs[end] - uvs[start] - predicted, axis=1)
        expected |= error > SEAM_TOLERANCE * np.linalg.norm(predicted, axis=1) + 0.01
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(seam_triangles(shape, shape, mapped, images, uvs), expected)


def test_borders_of_materials_and_seams_are_sampled_between_vertices() -> None:
    """Under the identity the samples of a triangle are the source's own colours, whatever corners they lie between."""
    mesh = replace(unwrapped_cube(), face_materials=np.arange(6), material_names=tuple("abcdef"))
    colors = np.random.default_rng(3).random((6, 3))
    shape = refined_shape(refine(mesh, 3))
    images = identity(len(shape.positions), shape.triangles)
    pixels = np.random.default_rng(4).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    for look in (Look(colors=colors), Look(texture=pixels, jpeg=b"\xff\xd8\xff")):
        data = target_skin(DrawnModel(shape, Look()), DrawnModel(shape, look), images)
        picture = imageio.imread(data[data.index(b"\x89PNG") :], extension=".png")
        seams = attributes_of(data, "seams")
        corners = seams["corners"]
        side = np.sqrt(picture.shape[0] * picture.shape[1] / len(corners))
        column, row = (seams["TEXCOORD_0"][corners].mean(axis=1) * picture.shape[1::-1]).astype(int).T
        centre = seams["POSITION"][corners].mean(axis=1)
        around = shape.to_view(shape.positions[shape.triangles].mean(axis=1))
        triangle = cKDTree(around).query(centre)[1]
        if look.colors is None:
            uvs = shape.uvs[shape.uv_triangles[triangle]].mean(axis=1)
            wanted = texture_colors(look, uvs)
        else:
            wanted = np.rint(255 * to_display(colors[shape.faces[triangle]]))
        found = picture[row, column]
        assert side >= 3
        assert (np.abs(found.astype(float) - wanted).max(axis=1) < 2).mean() > (0.95 if look.texture is None else 0.3)
