"""What the studio shows: clicks on the smooth surface, skins through a map, seams, and the answers of its bench."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import trimesh
from examples.shapes import creature, cube

from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.pictures import Y_UP, Z_UP
from cagemap.studio.autosave import FileTracker
from cagemap.studio.compute import (
    FindMap,
    OpenModels,
    ShowPosed,
    run_task,
)
from cagemap.studio.finish import FinishOptions, finish_commands
from cagemap.studio.landmark_files import load_landmarks, save_landmarks
from cagemap.studio.models import open_model
from cagemap.studio.opening import default_files
from cagemap.studio.places import hit_place, nearest_place
from cagemap.studio.scene import part_name
from cagemap.studio.shape import Hit, pick, refined_shape
from cagemap.studio.skins import (
    PreviewMap,
    align_facing,
)
from cagemap.subdivision import refine
from cagemap.tasks.requests.catalogue import all_options

from example_once import example_pair
from studio_boxes import landmarks, opened_pair, unwrapped_cube


@pytest.mark.parametrize("quarters", range(4))
def test_a_source_is_seen_from_the_side_that_the_target_is_seen_from(quarters: int) -> None:
    mesh = creature()
    level = refine(mesh, 1)
    target = refined_shape(level)
    about = np.linalg.matrix_power(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), quarters)
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # of a file whose z is up
    other = mesh.with_positions(mesh.positions @ about @ upright.T + [3.0, 1.0, 2.0])
    source = refined_shape(refine(other, 1), rotation=upright)
    owner = np.zeros(len(target.positions), dtype=np.int64)
    owner[target.triangles.ravel()] = np.arange(target.triangles.size)
    images = PreviewMap(owner // 3, np.eye(3)[owner % 3], np.ones(len(owner)))
    seen = align_facing(source, target, images)
    np.testing.assert_allclose(seen.to_view(seen.positions), target.to_view(target.positions), atol=1e-9)
    np.testing.assert_allclose(seen.to_file(target.to_view(target.positions)), source.positions, atol=1e-9)
    assert align_facing(seen, target, images) is seen
    assert align_facing(source, target, None) is source


def test_a_model_whose_z_axis_points_up_stands_upright(tmp_path: Path) -> None:
    mesh = creature()
    # As its file has it: what is up lies along z, as in Blender.
    lying = mesh.with_positions(mesh.positions[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    for name, one in (("upright", mesh), ("lying", lying)):
        write_mesh(tmp_path / f"{name}.obj", one)
    upright = open_model(tmp_path / "upright.obj", None, None, 300).shape
    turned = open_model(tmp_path / "lying.obj", None, "z", 300).shape
    places = upright.to_view(upright.positions)
    np.testing.assert_allclose(turned.to_view(turned.positions), places, atol=1e-6)
    np.testing.assert_allclose(turned.directions_to_view(turned.normals), upright.normals, atol=1e-5)
    np.testing.assert_allclose(turned.to_file(places), turned.positions, atol=1e-6)
    # What is clicked is what is seen, in the file's own units.
    ray = np.array([0.1, 0.2, 3.0]), np.array([-0.02, -0.05, -1.0])
    one, other = (pick(shape, *ray) for shape in (upright, turned))
    assert one.triangle == other.triangle
    np.testing.assert_allclose(other.position[[0, 2, 1]] * [1.0, 1.0, -1.0], one.position, atol=1e-5)


def test_other_up_axes_keep_the_map(tmp_path: Path) -> None:
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, creature())
    opening, cache, opened = opened_pair(tmp_path / "a.obj", tmp_path / "b.obj", schemes=("none", None))
    known: Any = MagicMock()
    cache = replace(cache, free_match=known)
    turned, skins = run_task(cache, ShowPosed(replace(opening, ups=("z", None)), "", None), lambda _: None)
    assert turned.free_match is known
    np.testing.assert_array_equal(turned.target.shape.rotation, Z_UP)
    np.testing.assert_array_equal(turned.source.shape.rotation, cache.source.shape.rotation)
    assert skins[0] != opened.skins[0]
    assert skins[1] == opened.skins[1]
    other = replace(opening, schemes=(None, None), ups=("z", None))
    for task in (OpenModels(opening), ShowPosed(other, "", None)):
        assert run_task(cache, task, lambda _: None)[0].free_match is None


def test_pieces_that_are_set_aside_are_drawn_in_grey(tmp_path: Path) -> None:
    large, small = creature(), cube()
    positions = np.vstack([large.positions, small.positions + 2 * large.positions.max(0)])
    faces = [*cage_triangles(large)[0], *(len(large.positions) + cage_triangles(small)[0])]
    trimesh.Trimesh(positions, faces, process=False).export(tmp_path / "a.stl")
    model = open_model(tmp_path / "a.stl", "none", None, 300)
    assert len(model.look.other_parts.triangles) == 12
    np.testing.assert_allclose(model.look.other_parts.positions.min(0), positions[-8:].min(0), rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "mesh", "turned", "up"),
    [
        ("a.obj", example_pair(8).target, Z_UP.T, [0, 0, 1]),  # a deer on its feet
        ("a.glb", example_pair(8).target, Z_UP.T, [0, 0, 1]),
        ("a.stl", example_pair(8).target, Y_UP, [0, 1, 0]),
        ("a.stl", cube(), Y_UP, [0, 0, 1]),  # no shape that tells: as STL files usually are
        ("a.obj", cube(), Y_UP, [0, 1, 0]),
    ],
)
def test_a_model_stands_as_its_shape_or_its_format_tells(tmp_path, name, mesh, turned, up):
    path, triangles = tmp_path / name, cage_triangles(mesh)[0]
    trimesh.Trimesh(mesh.positions @ turned, triangles, process=False).export(path)
    shape = open_model(path, "none", None, 300).shape
    np.testing.assert_allclose(shape.directions_to_view(np.array([up], dtype=float)), [[0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_an_obj_shows_the_images_of_its_materials(tmp_path: Path, count: int) -> None:
    mesh = unwrapped_cube()
    mesh = replace(mesh, face_materials=np.array([0, 0, 0, 0, 1, 1]), material_names=("skin", "hair"))
    write_mesh(tmp_path / "a.obj", mesh)
    text = (tmp_path / "a.obj").read_text()
    (tmp_path / "a.obj").write_text(f"mtllib own.mtl\n{re.sub('mtllib.*', '', text)}")
    images = ["map_Kd -s 1 1 1 skin.png", "map_Kd the hair.png"][:count]
    lines = [f"newmtl {name}\n{image}\n" for name, image in zip(("skin", "hair"), images, strict=False)]
    (tmp_path / "own.mtl").write_text("".join(lines) + "newmtl away\nmap_Kd ../outside.png\n")
    for name, grey in (("skin", 90), ("the hair", 60)):
        write_image(tmp_path / f"{name}.png", np.full((8, 8, 3), grey, dtype=np.uint8))
    source = opened_pair(tmp_path / "a.obj", tmp_path / "a.obj")[2].source
    assert source.texture == (None, tmp_path / "a_texture.png", tmp_path / "a.obj")[count]


def test_a_usd_file_says_itself_which_axis_points_up(tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    write_mesh(tmp_path / "a.usda", cube())
    written = (tmp_path / "a.usda").read_text()
    turns = {}
    for axis in ("Y", "Z"):
        file = tmp_path / f"{axis}.usda"
        file.write_text(re.sub(r'upAxis = "\w"', f'upAxis = "{axis}"', written))
        turns[axis] = [open_model(file, None, up, 300).shape.rotation for up in (None, "y")]
    np.testing.assert_allclose(turns["Y"], [np.eye(3)] * 2, atol=1e-12)
    np.testing.assert_allclose(np.array([1.0, 2.0, 3.0]) @ turns["Z"][0], [1.0, 3.0, -2.0], atol=1e-12)
    np.testing.assert_array_equal(turns["Z"][1], np.eye(3))


@pytest.mark.slow
def test_a_mesh_as_it_is_keeps_the_numbers_of_its_file(tmp_path: Path) -> None:
    mesh = refine(creature(), 2).finest
    points = mesh.positions
    # Ahead of the creature stand vertices of a speck that is set aside.
    speck = ControlMesh.from_faces(
        np.concatenate([[[9.0, 0, 0], [9.1, 0, 0], [9.1, 0.1, 0], [9.0, 0.1, 0]], points]),
        [[0, 1, 2, 3], *(mesh.faces + 4).tolist()],
    )
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, speck)
    opening, cache, opened = opened_pair(tmp_path / "a.obj", tmp_path / "b.obj", schemes=("none", "none"))
    assert any("set aside" in note for note in opened.target.notes)
    shape = opened.scene.target
    np.testing.assert_allclose(shape.positions, points)
    files = default_files(opening.target, opening.source, None, opening.schemes)
    scene = opened.scene
    picked = landmarks(cache, 3, 40, 90)
    save_landmarks(files.landmarks, picked, scene, files, FileTracker())
    stored = json.loads(files.landmarks.read_text())["pairs"]
    assert [pair["target"] for pair in stored] == [7, 44, 94]
    again, _ = load_landmarks(files.landmarks, None, scene, files, FileTracker())
    assert [item.target for item in again.items] == [item.target for item in picked.items]
    # The finish says so too, and the map of a mesh onto itself takes vertices to themselves.
    assert finish_commands(all_options(), files, FinishOptions(), use_landmarks=True)[0].request.target_scheme == "none"
    cache, found = run_task(cache, FindMap(opening, landmarks(cache, 0, 17, 33, 60, 90, 120)), lambda _: None)
    places = found.preview_map.pull_back(opened.scene.source.triangles, opened.scene.source.positions)
    assert np.median(np.linalg.norm(places - points, axis=1)) < 0.02 * shape.radius
    assert found.map_state.suggestion is not None


def test_a_click_lands_where_the_ray_meets_the_smooth_surface() -> None:
    shape = refined_shape(refine(cube(), 4))
    for direction in ([0.0, 0.0, -1.0], [0.3, -0.2, -1.0], [1.0, 1.0, -1.0]):
        ray = np.array(direction) / np.linalg.norm(direction)
        hit = pick(shape, -3 * ray, ray)
        # On the ray, on the near side, and on the triangle that is named.
        view = shape.to_view(hit.position)
        np.testing.assert_allclose(np.cross(view, ray), 0, atol=1e-12)
        assert view @ ray < 0
        np.testing.assert_allclose(hit.barycentric @ shape.positions[shape.triangles[hit.triangle]], hit.position)
    assert pick(shape, np.array([5.0, 5.0, 5.0]), np.array([1.0, 0.0, 0.0])) is None


def test_a_click_at_a_control_vertex_means_it() -> None:
    shape = refined_shape(refine(cube(), 4))
    corner = shape.to_view(shape.positions[3])
    ray = -corner / np.linalg.norm(corner)
    hit = pick(shape, corner - 3 * ray, ray)
    place = hit_place(shape, hit)
    np.testing.assert_allclose(place.position, shape.positions[3], atol=1e-9)
    np.testing.assert_allclose(np.array(place.weights) @ np.eye(8)[list(place.corners)], np.eye(8)[3], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [cube(), creature()], ids=["cube", "creature"])
def test_a_place_lies_where_it_was_wanted(mesh: ControlMesh) -> None:
    shape = refined_shape(refine(mesh, 4))
    rng = np.random.default_rng(3)
    triangles, weights = rng.integers(0, len(shape.triangles), 60), rng.dirichlet(np.ones(3), 60)
    missed = []
    for triangle, inside in zip(triangles, weights, strict=True):
        position = inside @ shape.positions[shape.triangles[triangle]]
        found = np.array(hit_place(shape, Hit(int(triangle), inside, position)).position)
        missed.append(np.linalg.norm(found - position) / shape.radius)
        assert np.linalg.norm(np.array(nearest_place(shape, found).position) - found) < 0.01 * shape.radius
    assert np.median(missed) < 1e-3
    assert max(missed) < 0.005


def test_parts_have_names_and_triangles_belong_to_them() -> None:
    mesh = cube()
    numbers = np.array([0, 0, 0, 1, 1, 1])
    named = replace(mesh, face_objects=numbers, object_names=("head", "body"), face_materials=numbers * 0)
    shape = refined_shape(refine(replace(named, material_names=("skin",)), 2))
    assert part_name(shape, 0) == "head, skin"
    assert part_name(shape, len(shape.triangles) - 1) == "body, skin"
    assert part_name(refined_shape(refine(mesh, 2)), 0) == ""
