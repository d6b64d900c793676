"""Weights and shapes of the target's own parts, from its body and from parts of the character."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import grid
from scipy import sparse

from cagemap.character.doubled_pieces import doubled_meshes
from cagemap.character.own_parts import pairs_of_one_kind, with_nearest_values
from cagemap.character.values import Part
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.surface.triangle_surface import TriangleSurface

from example_character import ball

SHIFT = np.array([0.0, 0.0, 1.0])


def sheet(name: str, width: float, height: float) -> ControlMesh:
    """A flat square of 10 x 10 faces, 10 deep, from x = 0 to ``width``, at a height above the body."""
    mesh = grid(10, 10)
    places = mesh.positions[:, :2] - mesh.positions[:, :2].min(axis=0)
    places = np.column_stack([places / places.max(axis=0) * [width, 10.0], np.full(mesh.n_vertices, height)])
    return replace(mesh.with_positions(places), name=name)


def triangles_of(mesh: ControlMesh) -> ControlMesh:
    """A sheet with other faces, so that vertices are compared by their places."""
    return replace(ControlMesh.from_faces(mesh.positions, cage_triangles(mesh)[0]), name=mesh.name)


def weighted(mesh: ControlMesh, joint: int, shapes: dict[str, float] | None = None) -> Part:
    """A part on one of three joints, with shapes that raise it."""
    row = np.eye(3)[joint]
    offsets = {name: np.tile(size * SHIFT, (mesh.n_vertices, 1)) for name, size in (shapes or {}).items()}
    return Part(mesh.name, mesh, sparse.csr_array(np.tile(row, (mesh.n_vertices, 1))), offsets)


def around(own: list[Part], counterparts: list[list[Part]]) -> list[Part]:
    body = weighted(sheet("body", 10.0, 0.0), 0, {"fat": 2.0, "blink": 1.0})
    surface = TriangleSurface(body.mesh.positions, np.array([[0, 1, 11]]))
    return with_nearest_values(own, body, counterparts, replace(surface, scale=0.1), 4)


@pytest.mark.parametrize("height", [1.0, 0.3])  # the counterpart or the body is nearer
def test_a_part_has_values_of_its_counterpart_where_that_is_near(height: float) -> None:
    """Long sleeves over a short one: the counterpart's values above it, the body's beyond."""
    short = weighted(triangles_of(sheet("shirt", 5.0, 0.9)), 1, {"fat": 3.0})
    (made,) = around([Part("my shirt", sheet("my shirt", 10.0, height))], [[short]])
    x = made.mesh.positions[:, 0]
    np.testing.assert_allclose(made.weights.toarray()[x < 5.5], np.tile([0, 1, 0], (np.sum(x < 5.5), 1)), atol=1e-12)
    np.testing.assert_allclose(made.weights.toarray()[x > 7.0], np.tile([1, 0, 0], (np.sum(x > 7.0), 1)), atol=1e-12)
    np.testing.assert_allclose(made.shapes["fat"][x < 5.5, 2], 3.0)
    np.testing.assert_allclose(made.shapes["fat"][x > 7.0, 2], 2.0)
    assert made.shapes["blink"][x < 5.5].max() == 0.0  # the counterpart has no such shape


@pytest.mark.parametrize(("name", "height"), [("eye", 0.1), ("Object_4", -0.1)])
def test_parts_follow_the_shapes_of_the_skin_but_eyes_do_not(name: str, height: float) -> None:
    """Rigid pieces below the skin are eyes whatever their name is."""
    dress, eye = Part("dress", sheet("dress", 10.0, 1.0)), Part(name, ball(name, np.array([5.0, 5.0, height]), 0.2))
    fitted = replace(dress, name="fitted dress", shapes={"fat": np.zeros((dress.mesh.n_vertices, 3))})
    made, made_fitted, made_eye = around([dress, fitted, eye], [[], [], []])
    np.testing.assert_allclose(made.shapes["fat"], np.tile(2.0 * SHIFT, (dress.mesh.n_vertices, 1)))
    assert not made_fitted.shapes["fat"].any()  # its own
    assert made_eye.shapes == {}
    np.testing.assert_allclose(made_eye.weights.toarray(), np.tile([1, 0, 0], (eye.mesh.n_vertices, 1)), atol=1e-12)


def test_of_an_eye_with_a_counterpart_the_iris_follows_too() -> None:
    place = np.array([5.0, 5.0, 0.1])
    eye, iris = ball("eye", place, 0.2), ball("Object_7", place + 0.15 * SHIFT, 0.08)
    given = weighted(ball("Eyes", place, 0.18), 2, {"fat": 1.0})
    for made in around([Part("eye", eye), Part("Object_7", iris)], [[given], []]):
        np.testing.assert_allclose(made.weights.toarray(), np.tile([0, 0, 1], (made.mesh.n_vertices, 1)), atol=1e-9)
        np.testing.assert_allclose(made.shapes["fat"], np.tile(SHIFT, (made.mesh.n_vertices, 1)), atol=1e-9)


@pytest.mark.parametrize(
    ("own", "given", "height", "is_of_one_kind"),
    [
        ("my jeans", "trousers", 1.1, True),
        ("Object_4", "trousers", 1.1, True),
        ("my jeans", "Mesh", 1.1, True),
        ("cap", "eye", 1.1, False),
        ("Object_4", "hat", 2.1, False),  # hair below a hat
    ],
)
def test_parts_are_of_one_kind_by_their_names_or_places(
    own: str, given: str, height: float, is_of_one_kind: bool
) -> None:
    far = [Part("boots", sheet("boots", 1.0, 30.0)), Part("Object_9", sheet("Object_9", 1.0, -30.0))]
    parts = Part(own, sheet(own, 10.0, 1.0)), Part(given, sheet(given, 9.5, height))
    sides = [parts[1], *far[:1]], [parts[0], *far[1:]]
    meshes = ([part.mesh for part in side] for side in sides)
    found = pairs_of_one_kind(*sides, doubled_meshes(*meshes, TriangleSurface(np.eye(3), np.array([[0, 1, 2]]))))
    assert {pair[:2] for pair in found} == ({(0, 0)} if is_of_one_kind else set())


@pytest.mark.filterwarnings("error")
def test_brows_on_the_skin_have_its_values() -> None:
    brows = Part("brows", sheet("brows", 10.0, 0.0))
    (made,) = around([brows], [[]])
    np.testing.assert_allclose(made.shapes["fat"], np.tile(2.0 * SHIFT, (brows.mesh.n_vertices, 1)))


def test_weights_are_limited_in_blocks_of_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    short = weighted(triangles_of(sheet("shirt", 5.0, 0.9)), 1)
    own = [Part(name, sheet(name, 10.0, 1.0)) for name in ("my shirt", "coat")]
    whole = around(own, [[short], []])
    monkeypatch.setattr("cagemap.character.own_parts._DENSE_ROWS", 7)
    for one, other in zip(around(own, [[short], []]), whole, strict=True):
        np.testing.assert_array_equal(one.weights.toarray(), other.weights.toarray())


def test_a_counterpart_with_the_same_faces_gives_each_vertex_its_own_values() -> None:
    """Of two eyes with the same faces, that at the same place."""
    places = np.array([[2.0, 5.0, 0.5], [8.0, 5.0, 0.5]])
    own = [Part(f"eye {side}", ball(f"eye {side}", place, 1.0)) for side, place in zip("LR", places, strict=True)]
    tables = np.random.default_rng(0).dirichlet(np.ones(3), (2, own[0].mesh.n_vertices))
    mates = [
        Part(f"Eye {side}", ball(f"Eye {side}", place + 0.3, 1.2), sparse.csr_array(table))
        for side, place, table in zip("LR", places, tables, strict=True)
    ]
    for made, table in zip(around(own, [mates, mates]), tables, strict=True):
        np.testing.assert_allclose(made.weights.toarray(), table, atol=1e-12)
    (other,) = around(own[1:], [mates[:1]])  # without a counterpart there
    assert not np.allclose(other.weights.toarray(), tables[0])
