"""Nearest neighbours in the embedding, candidates from parents, and points in triangles (paper, section 5.4)."""

from __future__ import annotations

import numpy as np
from examples import shapes
from scipy import sparse

from cagemap.functional_map import Constraints, SpectralData, solve_functional_map
from cagemap.maps.spectral.hierarchical import Growth, HierarchyConfig, grown_map, search_samples
from cagemap.maps.spectral.samples import Samples, fit_functional_map, sizes_between, spread
from cagemap.maps.spectral.search import (
    nearest_candidates,
    nearest_rows,
    strongest_parents,
)
from cagemap.maps.spectral.vertex_to_point import (
    vertex_to_point,
    vertex_triangles,
)
from cagemap.refinement import refine, triangles
from search_reference import closest_on_triangle, nearest_candidates_reference, vertex_to_point_reference

RNG = np.random.default_rng(271)


def test_nearest_rows_is_the_exhaustive_search():
    points, queries = RNG.standard_normal((300, 7)), RNG.standard_normal((5000, 7))
    found = nearest_rows(queries.astype(np.float32), points.astype(np.float32))
    distances = ((queries[:, None, :] - points[None, :, :]) ** 2).sum(axis=2)
    # float32 may exchange two points at almost the same distance: compare distances, not indices.
    np.testing.assert_allclose(distances[np.arange(5000), found], distances.min(axis=1), atol=1e-5)


def test_nearest_candidates_agrees_with_its_slow_twin():
    target, source = refine(shapes.creature(), 2), refine(shapes.torus(9, 6), 2)
    parents = strongest_parents(target.matrices[1])
    children = sparse.csc_array(source.matrices[1])
    match = RNG.integers(0, source.levels[1].n_vertices, target.levels[1].n_vertices)
    rows = [RNG.standard_normal((r.levels[2].n_vertices, 6)).astype(np.float32) for r in (target, source)]
    expected = nearest_candidates_reference(*rows, parents, children, match)
    np.testing.assert_array_equal(nearest_candidates(*rows, parents, children, match), expected)


def test_identity_survives_the_descent():
    """A surface matched to itself: every vertex finds itself among its parents' children."""
    refinement = refine(shapes.creature(), 3)
    match = np.arange(refinement.control.n_vertices)
    for level, subdivision in enumerate(refinement.matrices):
        rows = refinement.levels[level + 1].positions.astype(np.float32)
        match = nearest_candidates(rows, rows, strongest_parents(subdivision), sparse.csc_array(subdivision), match)
        np.testing.assert_array_equal(match, np.arange(len(rows)))


def test_parents_are_the_strongest_entries():
    """A face point has all corners as parents, an edge point its two ends, a vertex itself."""
    subdivision = refine(shapes.creature(), 2).matrices[1]
    parents = strongest_parents(subdivision)
    counts = np.diff(parents.indptr)
    n = subdivision.shape[1]
    np.testing.assert_array_equal(counts[:n], 1)
    np.testing.assert_array_equal(parents.indices[parents.indptr[:n]], np.arange(n))
    assert set(counts[n:]) == {2, 4}


def test_vertex_to_point_agrees_with_its_slow_twin():
    refinement = refine(shapes.torus(7, 5), 1)
    faces = triangles(refinement.finest.faces)
    n = refinement.finest.n_vertices
    around = vertex_triangles(faces, n)
    source = RNG.standard_normal((n, 5)).astype(np.float32)
    target = RNG.standard_normal((80, 5)).astype(np.float32)
    match = RNG.integers(0, n, 80)
    found = vertex_to_point(target, source, faces, around, match)
    expected = vertex_to_point_reference(target, source, faces, around, match)
    # The nearest point may lie on an edge that two triangles share: compare points. float32 rows.
    points, expected_points = (np.einsum("mk,mkd->md", w, source[faces[t]]) for t, w in (found, expected))
    np.testing.assert_allclose(points, expected_points, atol=1e-5)
    np.testing.assert_allclose(found[1].sum(axis=1), 1.0, atol=1e-12)
    assert found[1].min() >= 0.0


def test_closest_point_beats_a_fine_grid_of_points():
    grid = [(i / 40, j / 40) for i in range(41) for j in range(41 - i)]
    uv = np.array(grid)
    for _ in range(40):
        edges, point = RNG.standard_normal((2, 4)), 2.0 * RNG.standard_normal(4)
        weights = closest_on_triangle(edges @ edges.T, edges @ point)
        found = np.sum((weights[1:] @ edges - point) ** 2)
        best = np.min(np.sum((uv @ edges - point) ** 2, axis=1))
        assert found <= best + 1e-12


def test_points_on_the_surface_are_found_again():
    """A target that lies on the source's triangles maps to itself."""
    refinement = refine(shapes.creature(), 2)
    faces = triangles(refinement.finest.faces)
    positions = refinement.finest.positions
    weights = RNG.dirichlet([4, 2, 2], len(faces))
    points = np.einsum("tc,tcd->td", weights, positions[faces])
    found = vertex_to_point(
        points.astype(np.float32),
        positions.astype(np.float32),
        faces,
        vertex_triangles(faces, len(positions)),
        faces[:, 0],
    )
    images = np.einsum("mk,mkd->md", found[1], positions[faces[found[0]]])
    np.testing.assert_allclose(images, points, atol=1e-5)


def test_functional_map_of_a_point_map():
    """C = Phi1^+ P12 Phi2: the identity for the identity, and composition with a permutation."""
    rows = RNG.standard_normal((200, 9))
    samples = Samples(rows, RNG.random(200) + 0.1, np.zeros((200, 0)))
    np.testing.assert_allclose(fit_functional_map(samples, rows, 9), np.eye(9), atol=1e-7)
    mixing = RNG.standard_normal((9, 9))
    np.testing.assert_allclose(fit_functional_map(samples, rows @ mixing, 9), mixing, atol=1e-6)


def test_growth_reaches_the_end_in_small_steps():
    assert sizes_between(20, 20) == [20]
    sizes = sizes_between(20, 300)
    assert sizes[0] == 20
    assert sizes[-1] == 300
    ratios = np.array(sizes[1:]) / np.array(sizes[:-1])
    assert ratios.max() < 1.3
    assert ratios.min() > 1.0
    assert sizes_between(30, 20) == [20]


def test_samples_spread_over_the_numbering():
    chosen = spread(10_000, 3000)
    assert len(chosen) == 3000
    assert chosen[0] == 0
    assert chosen[-1] == 9999
    assert np.diff(chosen).max() <= 4
    np.testing.assert_array_equal(spread(50, 3000), np.arange(50))


def test_growing_map_repairs_a_rough_start():
    """The same embedding on both sides, descriptors of a few rough places: the match becomes the identity."""
    points = RNG.random((400, 2))
    frequencies = [(i, j) for i in range(6) for j in range(6)]
    frequencies.sort(key=lambda f: f[0] ** 2 + f[1] ** 2)
    rows = np.stack(
        [np.cos(np.pi * i * points[:, 0]) * np.cos(np.pi * j * points[:, 1]) for i, j in frequencies], axis=1
    )
    samples = Samples(rows, np.full(400, 1 / 400), np.zeros((400, 0)))
    spectrum = np.pi**2 * np.array([float(i**2 + j**2) for i, j in frequencies])
    decay = np.exp(-0.02 * spectrum)[:, None]
    shifted = points[None, :20] + 0.03 * RNG.standard_normal((2, 20, 2))
    sides = []
    for places in shifted:
        at = [np.cos(np.pi * i * places[:, 0]) * np.cos(np.pi * j * places[:, 1]) for i, j in frequencies]
        sides.append(SpectralData(spectrum, decay * np.array(at)))
    config = HierarchyConfig()
    constraints = Constraints(*sides)
    first = solve_functional_map(constraints.leading(6, 6), config.weights)
    before = np.linalg.norm(points[search_samples(samples, samples, first)] - points, axis=1).mean()
    functional_map, match = grown_map(constraints, samples, samples, config.weights, Growth(6))
    after = np.linalg.norm(points[match] - points, axis=1).mean()
    assert after < 0.2 * before
    assert functional_map.shape == (36, 36)
