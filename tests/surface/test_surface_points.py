"""Triangulated surfaces, points on them, and polylines: what follows from the arrays, and what is refused."""

import numpy as np
import pytest
from examples.shapes import creature, torus
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.subdivision import refine
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import fan_triangles, surface_area, triangles

from refusals import refuses


@pytest.fixture(scope="module")
def surface() -> TriangleSurface:
    level = refine(creature(), 1).finest
    return TriangleSurface.from_faces(7.0 * level.positions, level.faces)


def some_points(surface: TriangleSurface, count: int, seed: int) -> SurfacePoints:
    rng = np.random.default_rng(seed)
    return SurfacePoints(surface, rng.integers(0, len(surface.triangles), count), rng.dirichlet((1, 1, 1), count))


def test_a_surface_has_unit_area_whatever_the_unit_of_its_file(surface: TriangleSurface) -> None:
    level = refine(creature(), 1).finest
    same = TriangleSurface.from_faces(level.positions, level.faces)
    np.testing.assert_allclose(surface.positions, same.positions, rtol=1e-12)
    assert same.scale == pytest.approx(7.0 * surface.scale)
    assert surface_area(same.positions, level.faces) == pytest.approx(1.0, abs=1e-12)
    # Quads that are not flat: their one split has a slightly other area than the mean of both.
    assert surface.areas.sum() == pytest.approx(1.0, abs=0.01)
    assert surface.vertex_areas.sum() == pytest.approx(1.0, abs=1e-12)
    assert surface.n == level.n_vertices


def test_area_of_flat_faces_is_the_same_for_quads_and_triangles() -> None:
    square = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], dtype=float)
    quad = np.array([[0, 1, 2, 3]])
    assert surface_area(square, quad) == surface_area(square, triangles(quad)) == 6.0


@settings(max_examples=30)
@given(st.lists(st.integers(0, 7), min_size=1, max_size=9))
def test_fans_cover_every_polygon_once(sizes: list[int]) -> None:
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    found, faces = fan_triangles(offsets, np.arange(offsets[-1]))
    np.testing.assert_array_equal(np.bincount(faces, minlength=len(sizes)), np.maximum(np.array(sizes) - 2, 0))
    for face, size in enumerate(sizes):
        expected = [[0, k, k + 1] for k in range(1, size - 1)]
        np.testing.assert_array_equal(found[faces == face] - offsets[face], np.reshape(expected, (-1, 3)))


def test_what_follows_from_a_surface_is_kept_and_cannot_be_written(surface: TriangleSurface) -> None:
    assert surface.tree is surface.tree
    for name in ("positions", "triangles", "areas", "normals", "vertex_normals", "neighbors", "vertex_triangles"):
        array = getattr(surface, name)
        assert getattr(surface, name) is array
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_values_are_equal_only_to_themselves(surface: TriangleSurface) -> None:
    points = some_points(surface, 3, 1)
    same = SurfacePoints(surface, points.triangle, points.barycentric)
    found = PointMap.from_vertices(surface, surface, np.arange(surface.n))
    assert points != same
    assert len({points, same, surface, found}) == 4


def test_points_interpolate_linear_functions_exactly(surface: TriangleSurface) -> None:
    points = some_points(surface, 500, 2)
    slope = np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(points.interpolate(surface.positions @ slope), points.positions @ slope, atol=1e-14)
    np.testing.assert_allclose(points.interpolate(np.full(surface.n, 2.5)), 2.5, rtol=1e-14)
    np.testing.assert_allclose(points.matrix() @ surface.positions, points.positions, atol=1e-14)
    values = np.random.default_rng(3).standard_normal((surface.n, 2, 4))
    flat = points.interpolate(values.reshape(surface.n, -1))
    np.testing.assert_array_equal(points.interpolate(values).reshape(len(points), -1), flat)


@pytest.mark.parametrize("make", [SurfacePoints.from_vertices, None])
def test_vertices_are_points(surface: TriangleSurface, make: object) -> None:
    if make is None:
        from scipy import sparse

        points = SurfacePoints.from_matrix(surface, sparse.eye_array(surface.n, format="csr"))
    else:
        points = SurfacePoints.from_vertices(surface, np.arange(surface.n))
    np.testing.assert_array_equal(points.positions, surface.positions)


def test_points_survive_their_matrix(surface: TriangleSurface) -> None:
    points = some_points(surface, 300, 4)
    again = SurfacePoints.from_matrix(surface, points.matrix())
    np.testing.assert_array_equal(again.triangle, points.triangle)
    np.testing.assert_array_equal(again.barycentric, points.barycentric)


def test_weights_of_one_vertex_given_twice_add_up(surface: TriangleSurface) -> None:
    from scipy import sparse

    twice = sparse.csr_array((np.array([0.25, 0.75]), np.array([5, 5]), np.array([0, 2])), shape=(1, surface.n))
    np.testing.assert_array_equal(SurfacePoints.from_matrix(surface, twice).positions, surface.positions[[5]])
    assert twice.nnz == 2  # the caller's matrix is as it was


def test_points_of_the_surface_are_nearest_to_themselves(surface: TriangleSurface) -> None:
    points = some_points(surface, 400, 5)
    found = SurfacePoints.nearest(surface, points.positions)
    np.testing.assert_allclose(found.positions, points.positions, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("asked", [(), ("positions",), ("positions", "normals")])
def test_places_and_normals_are_those_of_the_points_that_took_others_place(surface, asked):
    points, others = some_points(surface, 9, 5), some_points(surface, 2, 6)
    known = [getattr(points, name) for name in asked]
    changed = points.replaced(np.array([8, 1]), others)
    anew = SurfacePoints(surface, changed.triangle, changed.barycentric)
    np.testing.assert_array_equal(changed.positions, anew.positions)
    np.testing.assert_array_equal(changed.normals, anew.normals)
    assert not changed.positions.flags.writeable
    assert [getattr(points, name) is before for name, before in zip(asked, known, strict=True)] == [True] * len(asked)


def test_some_points_and_points_in_place_of_others(surface: TriangleSurface) -> None:
    points, others = some_points(surface, 9, 6), some_points(surface, 2, 7)
    changed = points.replaced(np.array([8, 1]), others)
    np.testing.assert_array_equal(changed.at(np.array([8, 1])).positions, others.positions)
    kept = np.setdiff1d(np.arange(9), [8, 1])
    np.testing.assert_array_equal(changed.at(kept).positions, points.positions[kept])
    elsewhere = TriangleSurface(2.0 * surface.positions, surface.triangles)
    refuses(ParameterError, "another surface", points.replaced, np.arange(9), some_points(elsewhere, 9, 6))


@pytest.mark.parametrize(
    ("triangle", "barycentric", "match"),
    [
        ([0, -1], [[1, 0, 0], [1, 0, 0]], "expected triangles 0 to"),
        ([0, 10**9], [[1, 0, 0], [1, 0, 0]], "expected triangles 0 to"),
        ([0], [[np.nan, 0, 1]], "finite"),
        ([0], [[0.7, 0.7, 0]], "sum to 1"),
        ([0], [[1.5, -0.5, 0]], "not negative"),
        ([0, 1], [[1, 0, 0]], "barycentric"),
    ],
)
def test_what_is_no_point_is_refused(surface, triangle, barycentric, match):
    refuses(ParameterError, match, SurfacePoints, surface, np.array(triangle), np.array(barycentric, dtype=float))


def test_triangles_of_missing_vertices_are_refused() -> None:
    refuses(ParameterError, "vertices 0 to 2", TriangleSurface, np.eye(3), np.array([[0, 1, 3]]))
    refuses(ParameterError, "area", TriangleSurface.from_faces, np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_vertices_without_a_triangle_are_no_points() -> None:
    loose = TriangleSurface(np.random.default_rng(8).random((4, 3)), np.array([[0, 1, 2]]))
    for vertex in (3, 4, -1):
        refuses(ParameterError, "that have a triangle", SurfacePoints.from_vertices, loose, np.array([vertex]))


def test_a_map_pulls_values_of_its_own_source_back_and_no_others(surface: TriangleSurface) -> None:
    """(P12 g)(v) = g(T12(v)): the matrix says the same, and values of another surface are refused."""
    level = refine(torus(), 1).finest
    target = TriangleSurface.from_faces(level.positions, level.faces)
    points = some_points(surface, target.n, 9)
    found = PointMap(target, points)
    values = np.random.default_rng(10).standard_normal((surface.n, 2))
    np.testing.assert_allclose(found.to_sparse() @ values, found.pull_back(values), atol=1e-14)
    assert found.source is surface
    for count in (target.n, surface.n - 1, surface.n + 1):
        refuses(ParameterError, "other surface", found.pull_back, np.zeros(count))
    refuses(ParameterError, "exchanged", PointMap, surface, points)


def test_the_nearest_point_may_lie_on_a_piece_away_from_the_nearest_vertex() -> None:
    """Thin closed curves, such as eyelids: the nearest vertex is the other lid's."""
    lid = np.array([[0.0, 0, 0], [10, 0, 0], [10, 1, 0], [5, 1, 0]])
    places, ends, share, tangents = Polyline(lid, closed=False).nearest(np.array([[5, 0.4, 0.0]]))
    np.testing.assert_allclose(places, [[5, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(ends, [[0, 1]])
    np.testing.assert_allclose(share, [0.5])
    np.testing.assert_allclose(tangents, [[1, 0, 0]])


@settings(max_examples=40)
@given(st.integers(2, 30), st.booleans(), st.integers(0, 2**32 - 1))
def test_nearest_points_are_the_best_of_all_pieces(count: int, closed: bool, seed: int) -> None:
    """Tangled lines, some of whose pieces have no length."""
    random = np.random.default_rng(seed)
    positions = random.normal(size=(count, 3))
    positions[1:][random.random(count - 1) < 0.2] = positions[0]
    points = random.normal(size=(20, 3))
    found, ends, share, _ = Polyline(positions, closed).nearest(points)
    first, second = (positions[ends[:, side]] for side in (0, 1))
    np.testing.assert_allclose(first + share[:, None] * (second - first), found, atol=1e-12)
    starts, stops = positions if closed else positions[:-1], np.roll(positions, -1, axis=0)[: count - (not closed)]
    along = stops - starts
    share = ((points[:, None] - starts) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    places = starts + np.clip(share, 0, 1)[:, :, None] * along
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), expected, atol=1e-12)


def test_a_line_without_length_has_one_nearest_point() -> None:
    for closed in (False, True):
        places, _, _, tangents = Polyline(np.ones((2, 3)), closed).nearest(np.zeros((1, 3)))
        np.testing.assert_array_equal(places, [[1, 1, 1]])
        np.testing.assert_array_equal(tangents, [[0, 0, 0]])


def test_lengths_of_a_polyline_are_shared_out() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert Polyline(square, closed=True).length == pytest.approx(4.0)
    np.testing.assert_allclose(Polyline(square, closed=False).point_lengths, [0.5, 1.0, 1.0, 0.5])
    assert len(Polyline(square, closed=False).spread(2)) == 2
