"""What stands beside the basis functions in the searches of the hierarchical map, and matches both ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import shapes

from cagemap.basis import BasisConfig
from cagemap.maps.spectral import facing
from cagemap.maps.spectral.facing import LevelMesh, with_normals
from cagemap.maps.spectral.hierarchical import search_near_few, search_samples
from cagemap.maps.spectral.samples import Samples, fit_both_ways, fit_functional_map
from cagemap.maps.spectral.search import nearest_both_ways, nearest_rows
from cagemap.pipeline import prepare_surface

RNG = np.random.default_rng(1905)


@pytest.fixture(scope="module")
def creature():
    surface = prepare_surface(shapes.creature(), 1, BasisConfig(schedule=(30, 10)))
    rows = surface.basis.at(1)
    return LevelMesh(surface, 1), Samples(rows, surface.operators.areas(1), np.zeros((len(rows), 2)))


def test_the_identity_faces_the_same_way_and_a_mirror_image_the_other(creature):
    """Positions reflected through C: the same functions, but the normals of a surface that is inside out."""
    mesh, samples = creature
    both = (samples, samples), (mesh, mesh)
    target, source = with_normals(*both, np.eye(40), weight=0.5)
    np.testing.assert_allclose(target.coordinates, source.coordinates, atol=1e-12)
    np.testing.assert_array_equal(target.coordinates[:, :2], 0.0)
    np.testing.assert_allclose(np.linalg.norm(target.coordinates[:, 2:], axis=1), 0.5)
    target, source = with_normals(*both, -np.eye(40), weight=0.5)  # x -> -x turns every orientation
    np.testing.assert_allclose(target.coordinates, source.coordinates, atol=1e-12)
    rotated = mesh.coefficients(40) @ np.diag([1.0, 1.0, -1.0])
    mirror = rotated @ np.linalg.pinv(mesh.coefficients(40))
    target, source = with_normals(*both, mirror, weight=1.0)
    outside = np.sum(target.coordinates[:, 2:] * (source.coordinates[:, 2:] * [1.0, 1.0, -1.0]), axis=1)
    assert (outside < -0.99).all()


def test_nearest_both_ways_is_two_searches():
    queries, points = (RNG.standard_normal((n, 5)).astype(np.float32) for n in (1300, 400))
    forward, backward = nearest_both_ways(queries, points)
    np.testing.assert_array_equal(forward, nearest_rows(queries, points))
    np.testing.assert_array_equal(backward, nearest_rows(points, queries))


def test_a_part_that_no_target_sample_finds_still_counts(creature):
    """Both ways, C of a true match is the identity, where matches of the target alone miss a whole side."""
    _, samples = creature
    n = len(samples.areas)
    identity = np.arange(n)
    np.testing.assert_allclose(fit_both_ways(samples, samples, (identity, identity), (40, 40)), np.eye(40), atol=1e-6)
    left = samples.rows[:, 1] > 0
    collapsed = np.where(left, identity, identity[left][0])
    lame = fit_functional_map(samples, samples.rows[collapsed], 40)
    both = fit_both_ways(samples, samples, (collapsed, identity), (40, 40))
    assert np.linalg.norm(both - np.eye(40)) < 0.7 * np.linalg.norm(lame - np.eye(40))


def test_each_surface_counts_as_much_as_the_other(creature):
    """However many samples a side has: twice the areas on one side change nothing."""
    _, samples = creature
    n = len(samples.areas)
    matches = RNG.integers(0, n, n), RNG.integers(0, n, n)
    scaled = replace(samples, areas=2.0 * samples.areas)
    np.testing.assert_allclose(
        fit_both_ways(samples, samples, matches, (9, 7)), fit_both_ways(scaled, samples, matches, (9, 7)), atol=1e-12
    )


def test_few_searched_in_full_lead_all_others(creature, monkeypatch):
    """A third of the vertices find those near them; nearly all find what a search among all would, and no far place."""
    mesh, samples = creature
    monkeypatch.setattr(facing, "FEW", 200)
    mesh = LevelMesh(mesh.surface, 1)  # what follows from FEW is kept with a mesh
    assert mesh.near.shape == (len(samples.areas), 200)
    assert (np.diff(mesh.near.indptr) == facing.NEAR).all()
    np.testing.assert_array_equal(mesh.near[mesh.few].toarray().diagonal(), 1.0)  # each of the few is near itself
    functional_map = np.eye(40) + 0.02 * RNG.standard_normal((40, 40))
    found = search_near_few((samples, samples), functional_map, (mesh, mesh))
    wanted = search_samples(samples, samples, functional_map)
    assert np.mean(found == wanted) > 0.9
    places = mesh.surface.triangles(1).positions
    assert np.linalg.norm(places[found] - places[wanted], axis=1).max() < 0.3
