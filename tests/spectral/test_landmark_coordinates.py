"""Landmark coordinates: harmonic, and enough to find the map of a bent twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cagemap.operators import build_operators
from cagemap.spectral.landmark_coordinates import interpolants, landmark_coordinates
from cagemap.subdivision import Refinement

from elastic_shapes import fitted_map, unit_refinement


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
