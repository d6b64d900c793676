"""Welding: files whose vertices are split at seams become one surface, and values keep the file's numbering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature, cube, grid

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.values.part_numbering import FileRows
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.parts import extract_faces, find_part, join_meshes, numbers_on_part
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.weld import coincident_vertices, weld_mesh, weld_tolerance

from plain_meshes import animal, soup, split_at_seams


def jittered(mesh: ControlMesh, share: float) -> ControlMesh:
    """Every vertex moved by less than a share of the bounding-box diagonal."""
    moves = np.random.default_rng(0).uniform(-1, 1, mesh.positions.shape)
    size = np.linalg.norm(np.ptp(mesh.positions, axis=0))
    return mesh.with_positions(mesh.positions + share * size / 4 * moves)


def test_a_mesh_split_at_seams_becomes_the_one_before() -> None:
    body = creature()
    corners = np.arange(len(body.face_indices))
    body = body.with_uvs(np.random.default_rng(1).uniform(size=(len(corners), 2)), corners)
    split = split_at_seams(body)
    assert len(check_mesh(split).component_sizes) > 1
    welded = weld_mesh(split)
    require_valid(welded.mesh)
    assert welded.mesh.n_vertices == body.n_vertices
    order = welded.mesh.positions[welded.mesh.face_indices]
    np.testing.assert_array_equal(order, body.positions[body.face_indices])
    np.testing.assert_array_equal(welded.mesh.uvs[welded.mesh.uv_indices], body.uvs)
    np.testing.assert_array_equal(welded.mesh.positions[welded.vertex_of], split.positions)
    assert "became 1 piece" in welded.notes[0]


def test_every_file_vertex_is_named_once() -> None:
    split = split_at_seams(creature())
    welded = weld_mesh(split)
    named = np.concatenate([welded.mesh.file_vertices, welded.mesh.file_copies[:, 1]])
    np.testing.assert_array_equal(np.sort(named), np.arange(split.n_vertices))
    np.testing.assert_array_equal(welded.vertex_of[welded.mesh.file_copies[:, 1]], welded.mesh.file_copies[:, 0])
    number = int(welded.mesh.file_vertices[-1])
    named = welded.mesh.file_vertex(welded.mesh.n_vertices - 1)
    assert number >= welded.mesh.n_vertices
    assert named == split.file_vertex(number) != split.file_vertex(number - 1)


def test_surfaces_that_only_touch_stay_apart() -> None:
    box = cube()
    beside = box.with_positions(box.positions + np.array([2.0, 0, 0]))
    both = join_meshes([box, beside])
    assert len(np.unique(both.positions, axis=0)) == 12
    assert weld_tolerance(both) is None
    welded = weld_mesh(both, 0.0)
    assert welded.mesh is both
    assert "no border vertices" in welded.notes[0]


@pytest.mark.parametrize(("share", "expected"), [(0.0, 0.0), (5e-7, 1e-6), (5e-6, 1e-5), (1e-3, None)])
def test_the_tolerance_that_makes_one_surface_is_found(share: float, expected: float | None) -> None:
    split = jittered(split_at_seams(creature()), share)
    assert weld_tolerance(split) == expected
    if expected is not None:
        assert len(check_mesh(weld_mesh(split).mesh).component_sizes) == 1


def test_the_tolerance_is_relative_to_the_size_and_inclusive_of_chains() -> None:
    strip = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (0, 1, 0), (-1, 0, 0)], [(0, 1, 2), (3, 4, 5)]
    )
    for scale in (1e-30, 1.0, 1e30):
        moved = strip.with_positions(scale * (strip.positions + 1e-7 * (np.arange(6) > 2)[:, None]))
        assert weld_mesh(moved, 0.0).mesh.n_vertices == 6
        assert weld_mesh(moved, 1e-6).mesh.n_vertices == 4
    fan = np.array([[0, 0, 0], [0.8e-6, 0, 0], [1.6e-6, 0, 0], [1, 0, 0]])
    apart = ControlMesh.from_faces(np.repeat(fan, 3, axis=0) + np.tile(np.eye(3)[[2, 1, 0]] * [[0], [1], [1]], (4, 1)),
                                   np.arange(12).reshape(4, 3))  # fmt: skip
    assert len(np.unique(coincident_vertices(apart, 1e-6)[[0, 3, 6]])) == 1


def test_faces_that_collapse_go_and_creases_stay() -> None:
    thin = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1e-4, 0, 0), (0, 1e-4, 0)],
        [(0, 4, 5), (4, 1, 2, 3, 5)],
    ).with_creases([[1, 2], [0, 4]], [2.0, 1.0])
    welded = weld_mesh(thin, 1e-3)
    assert welded.mesh.face_indices.tolist() == [0, 1, 2, 3]
    assert any("1 faces collapsed" in note for note in welded.notes)
    np.testing.assert_array_equal(welded.mesh.crease_edges, [[1, 2]])
    require_valid(welded.mesh)
    ribbon = [(0.05 * (number // 2), 0.05 * (number % 2), 0) for number in range(60)]
    with pytest.raises(InvalidMeshError, match=r"got none\. Give a smaller"):
        weld_mesh(ControlMesh.from_faces(ribbon, np.arange(58)[:, None] + np.arange(3)), 0.1)


def test_a_crease_on_a_seam_is_one() -> None:
    strip = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (0, 1, 0), (-1, 0, 0)], [(0, 1, 2), (3, 4, 5)]
    ).with_creases([[0, 2], [4, 3]], [1.0, 3.0])
    strip = strip.with_corners([0, 3, 5], [1.0, 2.0, 4.0])
    mesh = weld_mesh(strip).mesh
    np.testing.assert_array_equal(mesh.crease_edges, [[0, 2]])
    np.testing.assert_array_equal(mesh.crease_sharpness, [3.0])
    np.testing.assert_array_equal(mesh.corner_vertices, [0, 3])
    np.testing.assert_array_equal(mesh.corner_sharpness, [2.0, 4.0])


def test_colours_of_welded_vertices_are_averaged_and_said() -> None:
    body = creature()
    split = split_at_seams(replace(body, vertex_colors=np.full((body.n_vertices, 3), 0.5)))
    assert len(weld_mesh(split).notes) == 1
    first = weld_mesh(split).mesh.file_copies[0]
    colors = np.array(split.vertex_colors)
    colors[first[1]] = 1.0
    welded = weld_mesh(replace(split, vertex_colors=colors))
    assert any("colours of 2 joined vertices differ" in note for note in welded.notes)
    np.testing.assert_allclose(welded.mesh.vertex_colors[first[0]], 0.75)


@pytest.mark.parametrize("tolerance", [-1.0, 0.5, np.nan, np.inf])
def test_other_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(ParameterError, match=r"from 0 to 0\.1"):
        weld_mesh(grid(), tolerance)


def _rows() -> tuple[FileRows, ControlMesh]:
    split = split_at_seams(creature())
    return FileRows(weld_mesh(split).mesh, split), split


def test_values_of_the_file_come_and_go_at_welded_vertices(caplog: pytest.LogCaptureFixture) -> None:
    rows, split = _rows()
    np.testing.assert_array_equal(rows.to_file(rows.to_part(split.positions)), split.positions)
    np.testing.assert_array_equal(rows.placed(rows.part.positions), split.positions)
    assert not caplog.text
    own, further = rows.copies[0]
    values = np.zeros(split.n_vertices)
    values[further] = 1.0
    sharing = 1 + np.sum(rows.copies[:, 0] == own)
    assert rows.to_part(values)[own] == 1.0 / sharing
    assert "values differ at 1 vertices that were welded: averaged" in caplog.text
    caplog.clear()
    numbers = np.arange(split.n_vertices)
    np.testing.assert_array_equal(rows.to_part(numbers), rows.vertices)
    assert "those of the first are taken" in caplog.text
    corners = split.positions[split.face_indices]
    np.testing.assert_array_equal(rows.to_file(rows.to_part(corners)), corners)


def test_corners_of_a_mended_mesh_are_those_of_its_vertices() -> None:
    body = replace(creature(), name="mixed")
    faces = [body.face(number)[::-1] if number % 5 == 0 else body.face(number) for number in range(body.n_faces)]
    faces[3:4] = [faces[3][:3], faces[3][[0, 2, 3]]]  # two triangles: all are split
    mixed = ControlMesh.from_faces(body.positions, faces)
    ready = plain_mesh(mixed).mesh
    assert ready.is_triangle_mesh
    taken = FileRows(ready, mixed).to_part(mixed.positions[mixed.face_indices])
    np.testing.assert_array_equal(taken, ready.positions[ready.face_indices])


def test_plain_meshes_give_values_to_the_vertices_that_were_joined() -> None:
    given = soup(animal(1))
    rows = FileRows(plain_mesh(given).mesh, given)
    np.testing.assert_array_equal(rows.to_file(rows.part.positions), given.positions)


def test_parts_of_a_welded_mesh_keep_the_copies() -> None:
    split = split_at_seams(creature())
    far = replace(split, positions=split.positions + np.array([9.0, 0, 0]))
    welded = weld_mesh(join_meshes([split, far])).mesh
    parts = [extract_faces(welded, find_part(welded, f"component:{number}").faces) for number in (1, 0)]
    joined = join_meshes(parts)
    whole = join_meshes([split, far])
    for mesh in (*parts, joined):
        rows = FileRows(mesh, whole)
        found = rows.to_file(mesh.positions, below=whole.positions)
        np.testing.assert_array_equal(found, whole.positions)
    assert len(joined.file_copies) == whole.n_vertices - welded.n_vertices


def test_every_copy_of_a_welded_vertex_has_its_number() -> None:
    mesh = split_at_seams(creature())
    welded = weld_mesh(mesh)
    assert welded.mesh.n_vertices < mesh.n_vertices
    np.testing.assert_array_equal(numbers_on_part(welded.mesh, mesh), welded.vertex_of)
    sheet = grid(8, 8)  # a vertex where two places of the sheet touch becomes two
    touching = replace(sheet, face_indices=np.where(sheet.face_indices == 10, 50, sheet.face_indices))
    plain = plain_mesh(touching)
    assert len(np.unique(plain.mesh.file_vertices)) < plain.mesh.n_vertices
    np.testing.assert_array_equal(numbers_on_part(plain.mesh, touching), plain.vertex_of)


def test_plain_pieces_set_aside_are_said_with_the_tolerance_that_joins_them() -> None:
    near = jittered(split_at_seams(animal(1)), 5e-7)
    (note,) = (note for note in plain_mesh(near).notes if "set aside" in note)
    assert "`weld_mesh(mesh, 1e-06)` joins" in note
    apart = jittered(split_at_seams(animal(1)), 1e-2)
    (note,) = (note for note in plain_mesh(apart).notes if "set aside" in note)
    assert "`find_part` each" in note
