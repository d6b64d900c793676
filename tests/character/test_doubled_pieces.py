"""Pieces of a carried mesh at whose place the target has its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cagemap.character.doubled_pieces import doubled_meshes, doubled_pieces, pieces_in_surface
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import join_meshes
from cagemap.surface.triangle_surface import TriangleSurface

from example_character import ball


def balls(*sizes: tuple[float, float]) -> ControlMesh:
    """Balls of centres along x and radii."""
    made = [ball("ball", np.array([x, 0.0, 0.0]), radius) for x, radius in sizes]
    return join_meshes([replace(one, face_objects=None, object_names=()) for one in made])


@pytest.mark.parametrize(
    ("own", "doubled"),
    [
        ([(0.0, 1.0)], [0]),
        ([(0.1, 1.5)], [0]),  # an ear of another size
        ([(5.0, 1.2), (0.2, 1.0)], [0, 1]),
        ([(2.5, 1.0)], []),  # between both
        ([(0.0, 6.0)], []),  # around them
        ([(0.0, 0.2)], []),  # a button on it
    ],
)
def test_a_piece_where_the_target_has_its_own_is_found(own: list[tuple[float, float]], doubled: list[int]) -> None:
    carried = balls((0.0, 1.0), (5.0, 1.0))
    size = carried.n_faces // 2
    found = doubled_pieces([carried], [balls(*own)])
    assert [set(faces.tolist()) for _, _, faces in found] == [set(range(k * size, (k + 1) * size)) for k in doubled]


def test_a_piece_of_the_target_stands_for_one_piece() -> None:
    """A hat on hair is carried to a body that has hair."""
    hats = balls((9.0, 1.0)), balls((0.0, 1.1), (0.0, 1.0))
    ((row, number, hair),) = doubled_pieces(hats, [balls((5.0, 1.0)), balls((0.0, 1.02))])
    assert (row, number) == (1, 1)
    assert hair.tolist() == list(range(hats[0].n_faces, 2 * hats[0].n_faces))


@pytest.mark.parametrize(
    ("carried", "own", "doubled"),
    [
        ([[(0.0, 1.0), (5.0, 1.0)]], [[(0.4, 0.9), (4.8, 1.1)]], [(0, 0)]),  # eyes of a face of other proportions
        ([[(0.0, 1.0), (0.0, 1.1), (5.0, 1.0), (5.0, 1.1)]], [[(0.4, 0.9), (4.8, 1.1)]], [(0, 0)]),  # with corneas
        ([[(0.0, 1.0), (5.0, 1.0)]], [[(0.4, 0.9)], [(4.8, 1.1)]], [(0, 0), (0, 1)]),
        ([[(0.0, 1.0)], [(5.0, 1.0)]], [[(0.4, 0.9), (4.8, 1.1)]], [(0, 0), (1, 0)]),
        ([[(0.0, 1.0), (5.0, 1.0)]], [[(0.4, 0.9)]], []),  # the other eye is missing
        ([[(0.0, 1.0), (5.0, 1.0)]], [[(0.4, 9.0), (4.8, 9.0)]], []),
        ([[(0.0, 9.0), (50.0, 9.0)]], [[(6.0, 9.0), (45.0, 9.0)]], []),  # too large to be rigid
    ],
)
def test_rigid_parts_of_one_place_are_found_without_names(carried, own, doubled) -> None:
    surface = TriangleSurface.from_faces(200.0 * np.eye(3), np.array([[0, 1, 2]]))
    meshes = [balls(*one) for one in carried]
    found = doubled_meshes(meshes, [balls(*one) for one in own], surface)
    assert sorted({pair[:2] for pair in found}) == doubled
    for row in {pair[0] for pair in found}:
        faces = np.concatenate([of for one, _, of in found if one == row])
        np.testing.assert_array_equal(np.unique(faces), np.arange(balls(*carried[row]).n_faces))
    unused = [replace(mesh, positions=np.vstack([mesh.positions, np.zeros(3)])) for mesh in meshes]
    assert len(doubled_meshes(unused, [balls(*one) for one in own], surface)) == len(found)


@pytest.mark.parametrize(
    ("pieces", "doubled"),
    [
        ([(1.0, 0.5), (-1.0, 0.5)], [0]),
        ([(1.0, 0.7)], [0]),  # an ear of another size
        ([(3.0, 0.5)], []),  # away from the body
        ([(0.0, 1.1)], []),  # a suit around all of it
    ],
)
def test_a_piece_that_the_surface_of_the_target_has_itself_is_found(pieces, doubled):
    """The map takes one end of a ball to a point: the source lacks it."""
    whole = ball("body", np.zeros(3), 1.0)
    surface = TriangleSurface.from_faces(whole.positions, whole.face_indices.reshape(-1, 3))
    vertices = np.arange(surface.n)
    is_end = whole.positions[:, 0] > 0.5
    vertices[is_end] = vertices[is_end][0]
    carried = balls(*pieces)
    size = carried.n_faces // len(pieces)
    found = pieces_in_surface(carried, carried, PointMap.from_vertices(surface, surface, vertices))
    assert [int(faces[0]) // size for faces in found] == doubled
    shoes = replace(carried, face_materials=np.zeros(carried.n_faces, dtype=np.int64), material_names=("shoes",))
    assert pieces_in_surface(shoes, shoes, PointMap.from_vertices(surface, surface, vertices)) == []
