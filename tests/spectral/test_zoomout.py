"""ZoomOut: functional maps of matches, matches that they repair, and landmark coordinates that begin it."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.operators import build_operators
from cagemap.spectral.zoomout import (
    ZoomOutSchedule,
    evenly_spaced_vertices,
    fit_functional_map,
    interpolants,
    landmark_coordinates,
    nearest_rows,
    nearest_samples,
    zoomout,
)
from cagemap.subdivision import Refinement

from elastic_shapes import fitted_map, unit_refinement
from refusals import refuses

RNG = np.random.default_rng(271)


def test_functional_map_of_a_point_map():
    """C = Phi1^+ P12 Phi2: the identity for the identity, and composition with a permutation."""
    rows = RNG.standard_normal((200, 9))
    areas = RNG.random(200) + 0.1
    np.testing.assert_allclose(fit_functional_map(rows, areas, rows), np.eye(9), atol=1e-7)
    mixing = RNG.standard_normal((9, 9))
    np.testing.assert_allclose(fit_functional_map(rows, areas, rows @ mixing), mixing, atol=1e-6)


def test_zoomout_reaches_the_end_in_small_steps():
    assert ZoomOutSchedule(20, 20).sizes(300) == [20]
    sizes = ZoomOutSchedule(20, 300, 1.25).sizes(300)
    assert sizes[0] == 20
    assert sizes[-1] == 300
    ratios = np.array(sizes[1:]) / np.array(sizes[:-1])
    assert ratios.max() < 1.3
    assert ratios.min() > 1.0
    assert ZoomOutSchedule(30, 100).sizes(20) == [20]
    for wrong in ({"first": 0}, {"first": 200}, {"factor": 1.0}):
        refuses(ParameterError, "a factor above 1", ZoomOutSchedule, **wrong)


def test_samples_spread_over_the_numbering():
    chosen = evenly_spaced_vertices(10_000, 3000)
    assert len(chosen) == 3000
    assert chosen[0] == 0
    assert chosen[-1] == 9999
    assert np.diff(chosen).max() <= 4
    np.testing.assert_array_equal(evenly_spaced_vertices(50, 3000), np.arange(50))


def cosines(points, count=6):
    """(n, count^2) eigenfunctions of the unit square, lowest first."""
    frequencies = sorted(((i, j) for i in range(count) for j in range(count)), key=lambda f: f[0] ** 2 + f[1] ** 2)
    return np.stack(
        [np.cos(np.pi * i * points[:, 0]) * np.cos(np.pi * j * points[:, 1]) for i, j in frequencies], axis=1
    )


def test_zoomout_repairs_a_rough_match():
    """The same surface on both sides, every sample matched to one up to a fifth of the side away: the identity."""
    points = RNG.random((400, 2))
    rows, areas = cosines(points), np.full(400, 1 / 400)
    moved = points + RNG.uniform(-0.2, 0.2, points.shape)
    rough = np.argmin(np.linalg.norm(moved[:, None] - points[None], axis=2), axis=1)
    before = np.linalg.norm(points[rough] - points, axis=1).mean()
    match = zoomout(rows, areas, rows, rough, ZoomOutSchedule(6, 36))
    after = np.linalg.norm(points[match] - points, axis=1).mean()
    assert after < 0.1 * before


def test_a_side_with_fewer_functions_keeps_them_all(monkeypatch):
    sizes = []

    def fitted(rows, areas, values):
        sizes.append((rows.shape[1], values.shape[1]))
        return fit_functional_map(rows, areas, values)

    monkeypatch.setattr("cagemap.spectral.zoomout.fit_functional_map", fitted)
    rows, areas = cosines(RNG.random((60, 2)), 4), np.full(60, 1 / 60)
    few = rows[:, :7]
    schedule = ZoomOutSchedule(6, 16, 1.9)
    for sides in ((rows, few), (few, rows)):
        zoomout(sides[0], areas, sides[1], np.arange(60), schedule)
    assert sizes == [(6, 6), (11, 7), (16, 7), (6, 6), (7, 11), (7, 16)]


def test_coordinates_beside_the_functions_tell_mirror_images_apart():
    """Every sample has a twin on the other half with the same functions; one coordinate says which half."""
    points, half = RNG.random((150, 2)), np.repeat([[0.0], [1.0]], 150, axis=0)
    alike, shared = np.vstack([cosines(points)] * 2), (0.1 * half, 0.1 * half)
    np.testing.assert_array_equal(nearest_samples(alike, alike, np.eye(36), shared), np.arange(300))


def test_nearest_rows_is_the_exhaustive_search():
    rng = np.random.default_rng(271)
    points, queries = rng.standard_normal((300, 7)), rng.standard_normal((5000, 7))
    found = nearest_rows(queries.astype(np.float32), points.astype(np.float32))
    distances = ((queries[:, None, :] - points[None, :, :]) ** 2).sum(axis=2)
    # float32 may exchange two points at almost the same distance: compare distances, not indices.
    np.testing.assert_allclose(distances[np.arange(5000), found], distances.min(axis=1), atol=1e-5)


@pytest.mark.slow
def test_landmark_coordinates_alone_lead_to_the_map_of_a_bent_twin(creature_at_3: tuple[Refinement, float]) -> None:
    target, _ = creature_at_3
    cage = target.control
    # Swell and bend the shape smoothly: every vertex keeps its meaning, so the true map is the identity.
    x, y, z = (cage.positions / np.ptp(cage.positions)).T
    bent = np.column_stack([x * (1 + 0.5 * z), y + 0.2 * z**2, z * (1 + 0.3 * x)])
    source, source_scale = unit_refinement(cage.with_positions(bent), 3)
    landmarks = np.arange(0, cage.n_vertices, 8)
    coordinates = []
    for refinement in (target, source):
        operators = build_operators(refinement)
        coordinates.append(landmark_coordinates(operators.stiffness[2], operators.mass[2], landmarks))
    match = cKDTree(coordinates[1]).query(coordinates[0])[1]
    np.testing.assert_array_equal(match[landmarks], landmarks)
    found = fitted_map(target, source, 2, match, landmarks)
    truth = source_scale * source.finest.positions
    error = np.linalg.norm(found.images.positions - truth, axis=1)
    assert error[landmarks].max() < 1e-12
    started = np.linalg.norm(truth[match] - truth[: len(match)], axis=1)
    assert error.mean() < 0.3 * started.mean()
    assert error.mean() < 0.008


def test_interpolants_have_unit_values_and_are_harmonic(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, _ = creature_at_3
    operators = build_operators(refinement)
    stiffness, mass = operators.stiffness[2], operators.mass[2]
    landmarks = np.array([0, 9, 30, 17])
    harmonic, biharmonic = interpolants(stiffness, mass, landmarks, np.eye(4))
    areas = np.asarray(mass.sum(axis=1)).ravel()
    free = np.setdiff1d(np.arange(stiffness.shape[0]), landmarks)
    for values in (harmonic, biharmonic):
        np.testing.assert_allclose(values[landmarks], np.eye(4), atol=1e-8)
        np.testing.assert_allclose(values.sum(axis=1), 1, atol=1e-8)  # constants are reproduced
    scale = abs(stiffness.data).max()
    assert abs(stiffness @ harmonic)[free].max() < 1e-9 * scale
    laplacian = (stiffness @ biharmonic) / areas[:, None]
    assert abs(stiffness @ laplacian)[free].max() < 1e-7 * scale * abs(laplacian).max()
    assert harmonic.min() > -0.05  # the maximum principle, up to the few negative cotangents
    assert landmark_coordinates(stiffness, mass, landmarks).shape == (stiffness.shape[0], 8)


def test_a_curve_has_one_coordinate_that_is_1_along_it(creature_at_3: tuple[Refinement, float]) -> None:
    """And 0 at landmarks and other curves; those are 0 along it. With its vertices in another order it is the same."""
    operators = build_operators(creature_at_3[0])
    stiffness, mass = operators.stiffness[2], operators.mass[2]
    landmarks, curves = np.array([0, 9]), [np.array([30, 17, 100, 45]), np.array([60, 61, 70])]
    found = landmark_coordinates(stiffness, mass, landmarks, curves)
    assert found.shape == (stiffness.shape[0], 8)
    fixed = np.concatenate([landmarks, *curves])
    expected = np.repeat(np.eye(4), [1, 1, 4, 3], axis=0)
    np.testing.assert_allclose(found[fixed], np.hstack([3.0 * expected, expected]), atol=1e-8)
    turned = landmark_coordinates(stiffness, mass, landmarks, [curves[0][::-1], curves[1]])
    np.testing.assert_allclose(turned, found, atol=1e-8)
