"""From fitted points to a map: interpolated, projected, and folded parts flattened so that it is one-to-one."""

import numpy as np
import pytest
from examples.shapes import creature
from scipy import sparse
from scipy.spatial import Delaunay
from tests.fixtures.vertex_pairs import pair_at

from cagemap.deform.config import ElasticConfig, ProjectionConfig
from cagemap.errors import SolverError
from cagemap.maps.projection import relax as folds
from cagemap.maps.projection.flatten import (
    Disc,
    combine_points,
    convex_weights,
    flat_disc,
    flatten_folded_parts,
    folded_parts,
    move_points,
)
from cagemap.maps.projection.project import control_points, project
from cagemap.maps.projection.relax import relax_folds
from cagemap.maps.quality import flipped_triangles
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows

from elastic_shapes import mesh_of, prepared_at, surface_of

SIDE = 81


def grid() -> tuple[np.ndarray, np.ndarray]:
    """The unit square in the plane z = 0, as (n, 3) positions and (t, 3) triangles that face up."""
    x, y = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE))
    a = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    triangles = np.concatenate(
        [np.column_stack([a, a + 1, a + SIDE + 1]), np.column_stack([a, a + SIDE + 1, a + SIDE])]
    )
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(SIDE * SIDE)]), triangles


def round_disc(rings: int = 6) -> tuple[Disc, np.ndarray]:
    """Points on circles, triangulated, and their (n, 2) places; counter-clockwise."""
    angles = [np.linspace(0, 2 * np.pi, 6 * k, endpoint=False) + 0.1 * k for k in range(1, rings + 1)]
    places = np.concatenate(
        [np.zeros((1, 2))] + [k * np.column_stack([np.cos(a), np.sin(a)]) for k, a in enumerate(angles, start=1)]
    )
    triangles = Delaunay(places).simplices.astype(np.int64)
    turned = signed_areas(places, triangles) < 0
    triangles[turned] = triangles[turned][:, ::-1]
    n = len(places)
    rim = np.arange(n - 6 * rings, n)
    return Disc(np.arange(n), np.arange(len(triangles)), triangles, rim), places


def signed_areas(places: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    first, second, third = (places[triangles[:, k]] for k in range(3))
    return np.linalg.det(np.stack([second - first, third - first], axis=-1)) / 2


def flat_grid() -> TriangleSurface:
    return TriangleSurface(*grid())


def collapsed(centre: tuple[float, float], radius: float) -> tuple[SurfacePoints, TriangleSurface]:
    """A square's map to itself that pushes a disc through itself: distances r from its centre go out, back and out."""
    surface = flat_grid()
    offset = surface.positions[:, :2] - centre
    r = np.linalg.norm(offset, axis=1) / radius
    squeezed = np.where(r < 1, np.interp(r, [0, 0.3, 0.6, 1], [0, 0.9, 0.5, 1]) / np.maximum(r, 1e-9), 1.0)
    wanted = np.column_stack([centre + squeezed[:, None] * offset, np.zeros(len(r))])
    return SurfacePoints.nearest(surface, wanted), surface


def test_a_disc_is_laid_flat_without_folds_whatever_it_is_made_of() -> None:
    disc, _ = round_disc()
    plane = flat_disc(disc)
    assert signed_areas(plane, disc.triangles).min() > 0
    np.testing.assert_allclose(np.linalg.norm(plane[disc.rim], axis=1), 1.0, rtol=1e-14)


def test_mean_value_combinations_leave_a_map_that_is_one_to_one_as_it_is() -> None:
    disc, places = round_disc()
    sheared = places @ np.array([[1.0, 0.4], [0.0, 0.7]]) + 0.02 * np.sin(3 * places)
    assert signed_areas(sheared, disc.triangles).min() > 0
    again = combine_points(convex_weights(sheared, disc), sheared, disc.inside)
    np.testing.assert_allclose(again, sheared, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_convex_combinations_unfold_whatever_lies_in_a_convex_rim(seed: int) -> None:
    disc, places = round_disc()
    folded = places.copy()
    inner = np.flatnonzero(np.linalg.norm(places, axis=1) < 3.5)
    folded[inner] += np.random.default_rng(seed).normal(scale=1.5, size=(len(inner), 2))
    assert (signed_areas(folded, disc.triangles) < 0).sum() > 10
    weights = convex_weights(folded, disc)
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1.0, rtol=1e-13)
    assert weights.data.min() > 0
    unfolded = combine_points(weights, folded, disc.inside)
    assert signed_areas(unfolded, disc.triangles).min() > 0
    np.testing.assert_array_equal(unfolded[disc.rim], places[disc.rim])


def test_slivers_and_coinciding_points_have_combinations_too() -> None:
    disc, places = round_disc()
    places[1], places[2] = places[0] + [1e-13, 0], places[0] + [0, 1e-200]  # beside each other, upright or not
    places[20] = places[19] + 0.5 * (places[21] - places[19])
    weights = convex_weights(places, disc)
    assert np.isfinite(weights.data).all()
    assert np.isfinite(combine_points(weights, places, disc.inside)).all()


def test_vertices_that_depend_on_each_other_alone_are_refused() -> None:
    disc, places = round_disc()
    itself = sparse.csr_array(sparse.eye_array(len(places), format="csr")[np.flatnonzero(disc.inside)])
    with pytest.raises(SolverError, match="non-singular"):
        combine_points(itself, places, disc.inside)


def test_a_disc_that_is_all_rim_stays_as_it_is() -> None:
    disc = Disc(np.arange(3), np.array([0]), np.array([[0, 1, 2]]), np.array([0, 1, 2]))
    plane = flat_disc(disc)
    np.testing.assert_array_equal(combine_points(convex_weights(plane, disc), plane, disc.inside), plane)


def test_landmarks_move_to_their_places_and_carry_the_disc_with_them() -> None:
    disc, places = round_disc()
    chosen, goals = np.array([0, 3]), np.array([[2.5, 1.0], [-2.0, -3.0]])
    moved = move_points(places, disc.rim, chosen, goals, 50)
    np.testing.assert_allclose(moved[chosen], goals, atol=1e-12)
    np.testing.assert_allclose(moved[disc.rim], places[disc.rim], atol=1e-12)
    # Points move with triangles of rim and landmarks, of which a triangle of the disc may straddle two.
    assert (signed_areas(moved, disc.triangles) > 0).mean() > 0.97


def test_landmarks_cannot_leave_the_disc() -> None:
    disc, places = round_disc()
    assert move_points(places, disc.rim, np.array([0]), np.array([[9.0, 0.0]]), 50) is None


@pytest.mark.parametrize("held", [[], [(0.5, 0.5)]])
def test_a_part_that_collapsed_is_laid_out_and_the_rest_stays(held: list[tuple[float, float]]) -> None:
    images, surface = collapsed((0.5, 0.5), 0.14)
    triangles = surface.triangles
    nearest = [np.argmin(np.linalg.norm(surface.positions[:, :2] - at, axis=1)) for at in held]
    landmarks = np.array(nearest, dtype=np.int64)
    flipped = flipped_triangles(images, triangles)
    assert surface.areas[flipped].sum() > 0.01
    found = flatten_folded_parts(images, flipped, surface, landmarks)
    assert not flipped_triangles(found, triangles).any()
    np.testing.assert_array_equal(found.positions[landmarks], images.positions[landmarks])
    moved = np.linalg.norm(found.positions - images.positions, axis=1) > 1e-9
    distance = np.linalg.norm(surface.positions[:, :2] - 0.5, axis=1)
    assert moved.any()
    assert distance[moved].max() < 0.21  # 1.5 times as far as the fold


def test_a_landmark_beside_its_natural_place_stays_and_does_not_fold_the_part_again() -> None:
    images, surface = collapsed((0.5, 0.5), 0.14)
    triangles = surface.triangles
    off = int(np.argmin(np.linalg.norm(surface.positions[:, :2] - [0.5653, 0.509], axis=1)))  # in the turned-over ring
    before = flipped_triangles(images, triangles)
    assert before[np.any(triangles == off, axis=1)].all()
    free = flatten_folded_parts(images, before, surface, np.zeros(0, dtype=np.int64))
    assert np.linalg.norm(free.positions[off] - images.positions[off]) > 0.0125  # a spacing
    found = flatten_folded_parts(images, before, surface, np.array([off]))
    np.testing.assert_array_equal(found.barycentric[off], images.barycentric[off])
    assert not flipped_triangles(found, triangles).any()


def test_parts_are_told_apart_and_small_ones_left_alone() -> None:
    surface = flat_grid()
    positions, triangles = surface.positions, surface.triangles
    middle = positions[triangles].mean(axis=1)[:, :2]
    flipped = np.zeros(len(triangles), dtype=bool)
    for centre, radius in (((0.25, 0.25), 0.04), ((0.7, 0.7), 0.06)):
        flipped |= np.linalg.norm(middle - centre, axis=1) < radius
    flipped[np.argmin(np.linalg.norm(middle - [0.9, 0.1], axis=1))] = True
    parts = folded_parts(surface, flipped)
    assert surface.areas[0] < ProjectionConfig().min_part
    assert len(parts) == 2
    np.testing.assert_allclose(positions[parts[0]].mean(axis=0), [0.7, 0.7, 0], atol=0.01)
    np.testing.assert_allclose(positions[parts[1]].mean(axis=0), [0.25, 0.25, 0], atol=0.01)
    assert folded_parts(surface, np.zeros(len(triangles), dtype=bool)) == []


def test_a_map_that_is_folded_all_over_is_left_alone() -> None:
    surface = flat_grid()
    positions, triangles = surface.positions, surface.triangles
    flipped = positions[triangles].mean(axis=1)[:, 0] < 1.5 * ProjectionConfig().max_folded
    assert folded_parts(surface, flipped) == []


def test_pieces_close_to_each_other_are_one_part() -> None:
    surface = flat_grid()
    positions, triangles = surface.positions, surface.triangles
    middle = positions[triangles].mean(axis=1)[:, :2]
    beside = np.abs(middle[:, 0] - 0.5)
    for gap, count in ((0.03, 1), (0.1, 2)):  # of a strip in two; edges are 0.0125 long
        flipped = (beside > gap / 2) & (beside < gap / 2 + 0.03) & (np.abs(middle[:, 1] - 0.5) < 0.1)
        assert len(folded_parts(surface, flipped)) == count


def test_a_part_that_would_stay_folded_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    images, surface = collapsed((0.5, 0.5), 0.14)
    flipped = flipped_triangles(images, surface.triangles)
    beside = SurfacePoints.nearest(surface, images.positions + np.array([1e-3, 0.0, 0.0]))
    still = np.arange(len(surface.triangles)), beside
    monkeypatch.setattr("cagemap.maps.projection.flatten._flatten_part", lambda *given: still)
    assert flatten_folded_parts(images, flipped, surface, np.zeros(0, dtype=np.int64)) is images


def test_the_border_of_a_surface_stays_where_it_is() -> None:
    images, surface = collapsed((0.0, 0.5), 0.14)
    flipped = flipped_triangles(images, surface.triangles)
    assert flipped.any()
    found = flatten_folded_parts(images, flipped, surface, np.zeros(0, dtype=np.int64))
    border = np.isin(surface.positions[:, :2], [0.0, 1.0]).any(axis=1)
    np.testing.assert_array_equal(found.positions[border], images.positions[border])


def test_a_limb_is_not_thrown_about_for_a_ring_of_folds_at_its_root() -> None:
    """Laid flat, a mast is a tiny place: what unfolds its root would slide all of it."""
    places, triangles = grid()
    r = np.linalg.norm(places[:, :2] - 0.5, axis=1)
    mast = TriangleSurface(places + np.outer(np.interp(r, [0.05, 0.1], [0.4, 0.0]), [0, 0, 1]), triangles)
    # Distances from its middle go back a little, around its root.
    pushed = r + 0.05 * np.exp(-(((r - 0.11) / 0.012) ** 2))
    wanted = np.column_stack([0.5 + (places[:, :2] - 0.5) * (pushed / np.maximum(r, 1e-9))[:, None], np.zeros(len(r))])
    flat = SurfacePoints.nearest(flat_grid(), wanted)
    images = SurfacePoints(mast, flat.triangle, flat.barycentric)
    flipped = flipped_triangles(images, triangles)
    folded = mast.areas[flipped].sum()
    assert ProjectionConfig().min_part < folded < ProjectionConfig().max_folded
    laid = flatten_folded_parts(images, flipped, mast, np.zeros(0, dtype=np.int64))
    far = np.linalg.norm(laid.positions - images.positions, axis=1) > 0.05
    assert mast.vertex_areas[far].sum() <= 5.0 * folded


def test_control_points_interpolate(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
    n = refinement.levels[1].n_vertices
    sampling = sparse.csr_array(refinement.product(3, 1)[:n])
    points = scale * refinement.finest.positions[:n]
    control = control_points(sampling, points)
    spacing = np.sqrt(1 / n)
    assert abs(sampling @ control - points).max() < 0.02 * spacing
    assert abs(sampling @ points - points).max() > 0.05 * spacing  # what not solving would leave


@pytest.mark.parametrize("rings", [0, 1, 3])
def test_rings_around_triangles_are_those_of_their_neighbours(rings):
    faces = level_triangles(refine(creature(), 1), 1)
    flipped = np.zeros(len(faces), dtype=bool)
    flipped[[3, 400]] = True
    expected = set(faces[flipped].ravel().tolist())
    for _ in range(rings):
        expected |= {vertex for face in faces.tolist() if expected & set(face) for vertex in face}
    assert set(np.flatnonzero(folds.flipped_rings(faces, flipped, rings, faces.max() + 1)).tolist()) == expected


def test_unfolding_repairs_folds_and_leaves_the_rest_alone(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    rng = np.random.default_rng(15)
    pulled = rng.choice(len(positions), 12, replace=False)
    held = np.setdiff1d(np.arange(0, len(positions), 50), pulled)
    wanted = positions.copy()
    spacing = np.sqrt(1 / len(positions))
    wanted[pulled] += 3 * spacing * normalize_rows(rng.standard_normal((12, 3)))
    images = SurfacePoints.nearest(surface, wanted)
    before = flipped_triangles(images, faces).sum()
    assert before > 10
    again, still = relax_folds(images, faces, held, normal_weight=0.02)
    assert flipped_triangles(again, faces).sum() == still.sum() <= before // 5
    moved = np.linalg.norm(again.positions - images.positions, axis=1)
    assert (moved[held] == 0).all()
    assert (moved > 0).mean() < 0.05


@pytest.mark.parametrize("seed", [3, 4])
def test_unfolding_knows_what_still_folds_however_far_folds_spread(creature_at_3, seed, monkeypatch):
    refinement, scale = creature_at_3
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    # A patch sent to another, upside down, cannot be unfolded; where every sweep is kept, folds spread to its border.
    centre, other = positions[np.random.default_rng(seed).choice(len(positions), 2, replace=False)]
    near = np.linalg.norm(positions - centre, axis=1) < 0.12
    wanted = np.where(near[:, None], other - (positions - centre), positions)
    images = SurfacePoints.nearest(surface, wanted)
    monkeypatch.setattr(folds, "_improved_patches", lambda near, inside, before, after: inside)
    again, still = relax_folds(
        images, faces, np.zeros(0, dtype=np.int64), normal_weight=0.02, config=ProjectionConfig(rings=(1, 2))
    )
    assert still.sum() > 100
    np.testing.assert_array_equal(still, flipped_triangles(again, faces))


@pytest.mark.slow
def test_projection_meets_landmarks_wherever_the_fit_left_them(creature_at_3: tuple[Refinement, float]) -> None:
    surface = surface_of(creature_at_3[0])
    prepared = prepared_at(surface, surface, surface.finest_level, ElasticConfig())
    pair = pair_at(surface, surface, landmarks := np.array([3, 40, 90]), landmarks)
    positions = prepared.source.finest_triangles.positions
    fitted = positions.copy()
    fitted[landmarks] = positions[np.array([500, 700, 900])]  # far off: the closest triangle does not hold the landmark
    found = project(prepared, fitted, pair.landmarks)
    np.testing.assert_allclose(found.images.positions[landmarks], positions[landmarks], atol=1e-12)
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-12)
