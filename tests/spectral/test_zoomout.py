"""ZoomOut: functional maps of matches, and matches that they repair."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.spectral.zoomout import (
    ZoomOutSchedule,
    evenly_spaced_vertices,
    fit_functional_map,
    nearest_rows,
    nearest_samples,
    zoomout,
)

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
        with pytest.raises(ParameterError, match="a factor above 1"):
            ZoomOutSchedule(**wrong)


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
