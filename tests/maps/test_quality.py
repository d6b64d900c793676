"""Quality figures and closest points, on surfaces where every answer is known."""

import re

import numpy as np
import pytest
from benchmarks.truth import compare_with_truth, round_trip, true_map
from examples.shapes import torus
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, cKDTree
from tests.fixtures.vertex_pairs import points_at

from cagemap.errors import ParameterError
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import (
    covered_share,
    flipped_triangles,
    judge,
    measure_quality,
    stretches,
    unshared_warnings,
    weighted_percentiles,
)
from cagemap.numerics.threads import thread_limit
from cagemap.pipeline import prepare_surface
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows, surface_area, triangle_normals, vertex_normals

from closest_reference import closest_points_slowly


def sphere(n: int, radii: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Fibonacci points on an ellipsoid and their convex hull, outward triangles."""
    i = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    unit = np.column_stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])
    triangles = ConvexHull(unit).simplices.astype(np.int64)
    inward = np.einsum("td,td->t", triangle_normals(unit, triangles), unit[triangles[:, 0]]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return unit * np.array(radii), triangles


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit square in the plane z = 0 of n x n vertices, normals up."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.column_stack([i, i + n, i + n + 1]), np.column_stack([i, i + n + 1, i + 1])])
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)]), triangles


def surface_from(arrays: tuple[np.ndarray, np.ndarray]) -> TriangleSurface:
    return TriangleSurface.from_faces(*arrays)


def test_no_points_have_no_closest_points() -> None:
    triangle, barycentric, distance = closest_points(build_tree(*grid(3)), np.zeros((0, 3)))
    assert triangle.shape == distance.shape == (0,)
    assert barycentric.shape == (0, 3)


def random_search(seed: int) -> tuple[np.random.Generator, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A generator, positions and triangles of a soup, and points with normals to search for."""
    rng = np.random.default_rng(seed)
    positions = rng.standard_normal((30, 3))
    triangles = np.array([rng.choice(30, 3, replace=False) for _ in range(50)])
    return rng, positions, triangles, rng.standard_normal((20, 3)), normalize_rows(rng.standard_normal((20, 3)))


@settings(max_examples=15)
@given(seed=st.integers(10, 10_000), weight=st.sampled_from([0.0, 0.3]), cosine=st.sampled_from([-2.0, 0.2]))
def test_closest_points_agree_with_trying_every_triangle(seed: int, weight: float, cosine: float) -> None:
    rng, positions, triangles, points, normals = random_search(seed)
    options = {"normal_weight": weight, "minimum_cosine": cosine}
    guess = rng.integers(-1, 50, 20)
    expected, barycentric, distance = closest_points_slowly(positions, triangles, points, normals, **options)
    for start in (None, guess):
        found, b, d = closest_points(build_tree(positions, triangles), points, normals, guess=start, **options)
        # Two triangles may share the closest vertex or edge: the point is unique, its triangle is not.
        np.testing.assert_allclose(d, distance, atol=1e-12)
        foot = np.einsum("mk,mkd->md", b, positions[triangles[found]])
        if weight == 0.0 and cosine < -1:
            reference = np.einsum("mk,mkd->md", barycentric, positions[triangles[expected]])
            np.testing.assert_allclose(foot, reference, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(foot - points, axis=1), d, atol=1e-12)


@pytest.mark.parametrize("shuffled", [False, True], ids=["runs of triangles as leaves", "triangles sorted"])
def test_both_orders_of_the_tree_find_the_same_points(shuffled: bool) -> None:
    positions, triangles = grid(20)
    positions[:, 2] = 0.2 * np.sin(6 * positions[:, 0])
    rng = np.random.default_rng(5)
    triangles = triangles.reshape(2, -1, 3).transpose(1, 0, 2).reshape(-1, 3)  # both halves of a square in turn
    if shuffled:
        triangles = triangles[rng.permutation(len(triangles))]
    tree = build_tree(positions, triangles)
    assert np.array_equal(np.sort(tree.order), np.arange(len(triangles)))
    np.testing.assert_array_equal(
        tree.normals_of(np.arange(len(triangles))), normalize_rows(triangle_normals(positions, triangles))
    )
    runs = tree.order[: len(triangles) // 8 * 8].reshape(-1, 8)
    assert (np.diff(runs, axis=1) == 1).all() != shuffled
    points, normals = rng.random((50, 3)), normalize_rows(rng.standard_normal((50, 3)))
    expected = closest_points_slowly(positions, triangles, points, normals, normal_weight=0.3)[2]
    distance = closest_points(tree, points, normals, normal_weight=0.3)[2]
    np.testing.assert_allclose(distance, expected, atol=1e-12)


@settings(max_examples=15)
@given(seed=st.integers(10, 10_000), weight=st.sampled_from([0.0, 0.3]), cosine=st.sampled_from([-2.0, 0.2]))
def test_a_limit_leaves_out_what_is_farther_and_nothing_else(seed: int, weight: float, cosine: float) -> None:
    rng, positions, triangles, points, normals = random_search(seed)
    options = {"normal_weight": weight, "minimum_cosine": cosine}
    tree = build_tree(positions, triangles)
    unlimited, _, distance = closest_points(tree, points, normals, **options)
    found_normals = normalize_rows(triangle_normals(positions, triangles))[unlimited]
    cost = distance**2 + weight**2 * ((normals - found_normals) ** 2).sum(axis=1)
    for guess in (None, rng.integers(-1, 50, 20)):
        limit = np.sqrt(cost) * np.where(np.arange(20) % 2, 0.99, 1.01)
        found, _, limited = closest_points(tree, points, normals, guess=guess, within=limit, **options)
        np.testing.assert_array_equal(found >= 0, np.arange(20) % 2 == 0)
        np.testing.assert_allclose(limited[::2], distance[::2], atol=1e-12)
        assert np.isinf(limited[1::2]).all()


def test_triangle_normals_are_cross_products() -> None:
    rng = np.random.default_rng(37)
    positions, triangles = rng.standard_normal((40, 3)), rng.integers(0, 40, (90, 3))
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    np.testing.assert_allclose(triangle_normals(positions, triangles), np.cross(b - a, c - a), atol=1e-14)


def test_closest_points_returns_nothing_where_no_normal_agrees() -> None:
    positions, triangles = grid(4)
    down = np.tile([0.0, 0.0, -1.0], (2, 1))
    triangle, _, distance = closest_points(build_tree(positions, triangles), positions[:2], down, minimum_cosine=0.0)
    assert (triangle == -1).all()
    assert np.isinf(distance).all()


def test_stretches_are_the_singular_values_of_an_affine_map() -> None:
    rng = np.random.default_rng(5)
    positions, triangles = grid(5)
    matrix = rng.standard_normal((2, 2))
    image = positions.copy()
    image[:, :2] = positions[:, :2] @ matrix.T
    expected = np.linalg.svd(matrix, compute_uv=False)
    largest, smallest = stretches(positions, image, triangles)
    np.testing.assert_allclose(largest, expected[0], rtol=1e-9)
    np.testing.assert_allclose(smallest, expected[1], rtol=1e-9)


def test_stretches_of_a_degenerate_triangle_are_one() -> None:
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    largest, smallest = stretches(positions, 3 * positions, np.array([[0, 1, 2]]))
    assert (largest[0], smallest[0]) == (1.0, 1.0)


def test_of_points_equally_close_the_same_one_is_found_whatever_the_threads() -> None:
    positions, triangles = grid(12)
    both = np.concatenate([positions, positions + np.array([0.0, 0.0, 1.0])])
    tree = build_tree(both, np.concatenate([triangles, triangles + len(positions)]))
    rng = np.random.default_rng(77)
    # Between the sheets a search keeps to the one where the query before it ended, which here may be the upper one.
    between = np.column_stack([rng.random((6000, 2)), rng.choice([0.5, 0.9], 6000)])
    found = []
    for threads in (1, 2, 5):
        with thread_limit(threads):
            found.append(closest_points(tree, between)[0])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_a_vertex_pulled_across_its_ring_flips_triangles_and_loses_trust() -> None:
    surface = surface_from(grid(9))
    middle, image = 4 * 9 + 4, surface.positions.copy()
    assert not flipped_triangles(SurfacePoints.nearest(surface, image), surface.triangles).any()
    image[middle, 0] += 1.5 / 8
    found = SurfacePoints.nearest(surface, image)
    flipped = flipped_triangles(found, surface.triangles)
    assert flipped.any()
    assert (surface.triangles[flipped] == middle).any(axis=1).all()
    assert measure_quality(PointMap(surface, found)).trust.argmin() == middle


@pytest.mark.parametrize("n", [200, 900])
def test_the_identity_has_perfect_figures(n: int) -> None:
    positions, triangles = sphere(n, (1.0, 0.6, 0.4))
    target, source = (TriangleSurface.from_faces(size * positions, triangles) for size in (5.0, 0.1))
    landmarks = points_at(target, source, np.array([3, 50]), np.array([3, 50]))
    figures = measure_quality(PointMap.from_vertices(target, source, np.arange(n)), landmarks)
    assert figures.flipped_area == 0
    assert figures.coverage == 1
    assert figures.dirichlet == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(figures.area_ratios, 1, atol=1e-6)
    np.testing.assert_allclose(figures.aspect_ratios, 1, atol=1e-4)
    np.testing.assert_allclose(figures.trust, 1)
    assert figures.trusted_area == pytest.approx(1)
    assert figures.warnings == ()
    assert figures.summary()["landmark_error_worst"] == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("n", [41, 245])
def test_coverage_is_the_share_of_area_reached_in_any_order_of_the_vertices(n: int) -> None:
    positions, triangles = grid(n)
    order = np.random.default_rng(n).permutation(n * n)
    for source in (
        surface_from((positions, triangles)),
        surface_from((positions[order], np.argsort(order)[triangles])),
    ):
        image = source.positions * np.array([5 / 6, 1.0, 1.0])
        # 50 000 samples in compact runs of triangles: fewer than 100 of them at the edge of the image.
        covered = covered_share(source.positions, image, source.triangles, source)
        assert covered == pytest.approx(5 / 6, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("radii", [(1.0, 1.0, 1.0), (1.0, 0.25, 0.25)])
def test_triangles_of_a_coarse_target_cover_the_curved_surface_under_them(radii: tuple[float, float, float]) -> None:
    source, target = surface_from(sphere(40_000, radii)), surface_from(sphere(200, radii))
    image = SurfacePoints.nearest(source, target.positions).positions
    assert covered_share(target.positions, image, target.triangles, source) > 0.999
    # A cap that no triangle maps to; the triangles at its edge reach half their size beyond it or less far.
    kept = image[target.triangles][:, :, 0].mean(axis=1) < 0.7 * image[:, 0].max()
    missing = source.areas[source.positions[source.triangles][:, :, 0].mean(axis=1) > 0.7 * image[:, 0].max()].sum()
    covered = covered_share(target.positions, image, target.triangles[kept], source)
    assert covered == pytest.approx(1 - missing, abs=0.01)


def test_triangles_that_are_stretched_over_a_limb_do_not_cover_it() -> None:
    source = surface_from(sphere(5000, (1.0, 0.2, 0.2)))
    limb = source.positions[:, 0] > 0.5 * source.positions[:, 0].max()
    ring = np.flatnonzero(~limb)
    near = ring[cKDTree(source.positions[ring]).query(source.positions)[1]]
    image = source.positions[near]
    missing = source.areas[limb[source.triangles].any(axis=1)].sum()
    assert missing > 0.2
    covered = covered_share(source.positions, image, source.triangles, source)
    assert covered == pytest.approx(1 - missing, abs=0.02)  # the first row of triangles beyond the ring is 0.02


def test_coverage_from_a_coarser_level_is_that_of_the_finest() -> None:
    refinement = refine(torus(), 4)
    surface = TriangleSurface.from_faces(refinement.finest.positions, refinement.finest.faces)
    inner = np.flatnonzero(surface.positions[:, 0] > 0)  # everything goes to this half
    mirrored = np.column_stack([np.abs(surface.positions[:, 0]), surface.positions[:, 1:]])
    nearest = inner[cKDTree(surface.positions[inner]).query(mirrored)[1]]
    the_map = PointMap.from_vertices(surface, surface, nearest)
    measured = [measure_quality(the_map, coarse_triangles=c) for c in (None, level_triangles(refinement, 3))]
    assert measured[0].coverage == pytest.approx(0.5, abs=0.02)
    assert measured[1].coverage == pytest.approx(measured[0].coverage, abs=0.005)
    assert measured[1].flipped_area == measured[0].flipped_area


def part_in_place(side: int) -> tuple[PointMap, Masks]:
    """A corner of a unit square, side / 40 wide, on its own place; and the shared area."""
    whole, part = surface_from(grid(41)), surface_from(grid(side + 1))
    cell = np.round(whole.positions[:, :2] * 40).astype(int)
    inside = (cell <= side).all(axis=1)
    found = PointMap.from_vertices(part, whole, np.flatnonzero(inside))
    on_source = np.where(inside, np.prod(np.where(cell == side, 0.5, 1.0), axis=1), 0.0)
    return found, WHOLE.within(Masks(np.ones(part.n), on_source))


@pytest.mark.parametrize("side", [4, 12, 30])
def test_a_part_on_its_own_place_is_not_stretched(side: int) -> None:
    """Parts of 1, 9 and 56 % of the source's area."""
    found, masks = part_in_place(side)
    figures = measure_quality(found, masks=masks)
    np.testing.assert_allclose(figures.trust, 1)
    np.testing.assert_allclose(figures.area_ratios, 1, rtol=0.02)
    assert figures.dirichlet == pytest.approx(1, rel=0.02)
    assert not any("stretches" in warning for warning in figures.warnings)
    # A mask of a user says nothing about sizes.
    masked = measure_quality(found, masks=Masks(masks.target, masks.source))
    assert masked.dirichlet == pytest.approx((side / 40) ** 2, rel=1e-6)


def test_where_a_part_is_stretched_it_is_told() -> None:
    found, masks = part_in_place(12)
    places = found.images.positions * np.array([0.3, 1.0, 1.0])
    figures = measure_quality(PointMap(found.target, SurfacePoints.nearest(found.source, places)), masks=masks)
    np.testing.assert_allclose(figures.trust, (2.0 * 0.3) ** 2, rtol=0.05)
    assert figures.warnings[-1].startswith("the map stretches strongly over 100 % of the target's shared area")
    assert "% of the source's shared area is not reached by the map" in figures.warnings[-2]


def test_a_warning_names_the_landmark_nearest_to_the_worst_place() -> None:
    found, _ = part_in_place(40)
    x = found.target.positions[:, 0]
    low, high = x.min(), x.max()
    middle = 0.5 * (low + high)
    squeezed = np.where(x > middle, middle + (x - middle) / 3, x)  # all beyond the middle
    places = np.column_stack([squeezed, found.target.positions[:, 1:]])
    ends = np.array([x.argmin(), x.argmax()])
    points = points_at(found.target, found.source, ends, ends)
    named = PointPairs(points.target, points.source, names=("left", "right"))
    squeezed_map = PointMap(found.target, SurfacePoints.nearest(found.source, places))
    (warning,) = (text for text in measure_quality(squeezed_map, named).warnings if "stretches" in text)
    assert warning.startswith("the map stretches strongly over 49 % of the target's area, worst at (")
    assert warning.endswith("of the target's file (nearest landmark: 'right')")


def test_shared_area_leaves_the_figures_of_two_wholes() -> None:
    positions, triangles = sphere(400, (1.0, 0.6, 0.4))
    surface = surface_from((positions, triangles))
    bent = surface.positions + 0.05 * np.sin(5 * surface.positions[:, [1, 2, 0]])
    found = PointMap(surface, SurfacePoints.nearest(surface, bent))
    every = np.ones(surface.n)
    one, other = (measure_quality(found, masks=masks) for masks in (WHOLE, WHOLE.within(Masks(every, every))))
    np.testing.assert_array_equal(one.trust, other.trust)
    assert one.summary() == other.summary()
    nearly = np.where(np.arange(surface.n) < 3, 0.0, 1.0)
    assert WHOLE.within(Masks(nearly, every)).length_ratio(surface, surface) == 1.0
    nothing = np.where(np.arange(surface.n) < 3, 1e-6, 0.0)
    assert WHOLE.within(Masks(every, nothing)).length_ratio(surface, surface) == 1.0


def test_a_mirrored_map_is_called_inside_out_and_missed_landmarks_are_named() -> None:
    surface = surface_from(sphere(400, (1.0, 0.7, 0.5)))
    mirrored = SurfacePoints.nearest(surface, surface.positions * np.array([-1.0, 1.0, 1.0]))
    point = SurfacePoints.from_vertices(surface, np.array([10]))
    figures = measure_quality(PointMap(surface, mirrored), PointPairs(point, point, names=("left ear",)))
    assert figures.flipped_area > 0.9
    assert "inside out" in figures.warnings[0]
    assert any("left ear" in warning for warning in figures.warnings)


def test_the_worst_place_is_told_in_the_units_of_the_file() -> None:
    ball, triangles = sphere(400)
    surface = TriangleSurface.from_faces(40.0 * ball + [100.0, 0.0, 0.0], triangles)
    squeezed = surface.positions * np.array([1.0, 1.0, 0.05])
    (message,) = measure_quality(PointMap(surface, SurfacePoints.nearest(surface, squeezed))).warnings[-1:]
    told = [float(word) for word in re.findall(r"worst at \((.*)\) of the target's file", message)[0].split(", ")]
    assert np.linalg.norm(np.array(told) - [100.0, 0.0, 0.0]) == pytest.approx(40.0, rel=0.01)


def test_trust_and_stretch_are_shares_of_area_however_uneven_the_mesh() -> None:
    # Most vertices crowd in a strip of 4 % of the area, which the map stretches; the wide rest stays as it is.
    x = np.concatenate([np.linspace(0, 0.04, 60), np.linspace(0.05, 1, 12)])
    y = np.linspace(0, 1, 12)
    flat = np.column_stack([np.repeat(x, 12), np.tile(y, len(x)), np.zeros(12 * len(x))])
    i = (np.arange(len(x) - 1)[:, None] * 12 + np.arange(11)).ravel()
    triangles = np.concatenate([np.column_stack([i, i + 12, i + 13]), np.column_stack([i, i + 13, i + 1])])
    target = TriangleSurface(flat, triangles)
    wanted = flat.copy()
    wanted[:, 0] = np.where(flat[:, 0] < 0.045, flat[:, 0] / 5.0, flat[:, 0])
    figures = measure_quality(PointMap(target, SurfacePoints.nearest(target, wanted)))
    assert figures.trust.mean() < 0.4  # by vertices, most is lost
    assert figures.trusted_area > 0.93
    assert not any("stretches" in warning for warning in figures.warnings)


def test_truth_figures_see_a_known_shift() -> None:
    surface = TriangleSurface(*grid(33))
    truth = true_map(surface, surface)
    assert truth.known.all()
    shifted = PointMap(surface, SurfacePoints.nearest(surface, surface.positions + np.array([0.01, 0.0, 0.0])))
    corner = points_at(surface, surface, np.array([0]), np.array([0]))
    figures = compare_with_truth(shifted, truth, corner)
    inside = surface.positions[:, 0] < 0.98
    np.testing.assert_allclose(figures.errors[inside], 0.01, atol=1e-12)
    assert figures.maximum == pytest.approx(0.01)
    assert figures.worst_landmark == pytest.approx(0.01)
    assert 0.9 < figures.dirichlet_ratio <= 1


def test_truth_keeps_apart_two_sheets_that_touch() -> None:
    positions, triangles = grid(9)
    both = np.concatenate([positions, positions + np.array([0, 0, 1e-3])])
    sheets = np.concatenate([triangles[:, ::-1], triangles + len(positions)])  # lower one faces down
    truth = true_map(TriangleSurface(both, sheets), TriangleSurface(both + np.array([0, 0, 8e-4]), sheets))
    assert truth.known.all()
    below = np.arange(len(both)) < len(positions)
    np.testing.assert_array_equal(truth.images.triangle >= len(triangles), ~below)


def test_round_trip_of_a_permutation_and_its_inverse_is_zero() -> None:
    rng = np.random.default_rng(8)
    surface = surface_from(sphere(300))
    permutation = rng.permutation(300)
    there, back = (PointMap.from_vertices(surface, surface, p) for p in (permutation, np.argsort(permutation)))
    np.testing.assert_allclose(round_trip(there, back), 0, atol=1e-12)


def test_vertex_normals_are_sums_over_adjacent_triangles() -> None:
    rng = np.random.default_rng(8)
    positions, triangles = rng.standard_normal((20, 3)), rng.integers(0, 20, (60, 3))
    expected = np.zeros((20, 3))
    for triangle in triangles:
        a, b, c = positions[triangle]
        expected[triangle[0]] += np.cross(b - a, c - a)
        expected[triangle[1]] += np.cross(b - a, c - a)
        expected[triangle[2]] += np.cross(b - a, c - a)
    np.testing.assert_allclose(vertex_normals(positions, triangles), normalize_rows(expected), atol=1e-13)


def test_surface_area_and_percentiles() -> None:
    positions, triangles = grid(6)
    assert surface_area(3 * positions, triangles) == pytest.approx(9)
    values = np.array([3.0, 1.0, 2.0])
    np.testing.assert_array_equal(weighted_percentiles(values, np.array([1.0, 98.0, 1.0]), (50, 99.5)), [1, 3])


def test_masks_of_another_length_are_refused_by_name() -> None:
    surface = prepare_surface(torus(), 1)
    finest = surface.finest_triangles
    found = PointMap.from_vertices(finest, finest, np.arange(finest.n))
    for masks in (Masks(np.ones(5)), Masks(source=np.ones(5)), Masks(np.zeros(finest.n))):
        with pytest.raises(ParameterError, match="mask: expected"):
            judge(surface, found, masks=masks)


def test_area_without_a_counterpart_is_told_of_the_side_that_has_it() -> None:
    assert unshared_warnings(1.0, 1.0) == ()
    (target,), (source,) = unshared_warnings(0.75, 1.0), unshared_warnings(1.0, 0.5)
    assert target.startswith("25.0 % of the target has no counterpart")
    assert source.startswith("50.0 % of the source has no counterpart")
