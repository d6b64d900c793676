"""Searches of fine levels: candidates from parents, and points of triangles (paper, section 5.4)."""

import numpy as np
import pytest
from examples import shapes
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.paper.embeddings import nearest_candidates, strongest_parents, vertex_to_point
from cagemap.subdivision import refine, triangles

from closest_reference import closest_on_triangle
from refusals import refuses
from search_reference import nearest_candidates_reference, vertex_to_point_reference

RNG = np.random.default_rng(271)


def rows_of(values):
    return lambda vertices: values[vertices].astype(np.float32)


def in_blocks(count, size=37):
    """More than one block, in another order than the numbering."""
    order = RNG.permutation(count)
    return [order[start : start + size] for start in range(0, count, size)]


def test_nearest_candidates_agrees_with_its_slow_twin():
    target, source = refine(shapes.creature(), 2), refine(shapes.torus(9, 6), 2)
    parents = strongest_parents(target.matrices[1])
    match = RNG.integers(0, source.levels[1].n_vertices, target.levels[1].n_vertices)
    rows = [RNG.standard_normal((r.levels[2].n_vertices, 6)).astype(np.float32) for r in (target, source)]
    expected = nearest_candidates_reference(*rows, parents, sparse.csc_array(source.matrices[1]), match)
    given = rows_of(rows[0]), rows_of(rows[1]), in_blocks(len(rows[0]))
    np.testing.assert_array_equal(nearest_candidates(*given, parents, source.matrices[1], match), expected)


def test_identity_survives_the_descent():
    """A surface matched to itself: every vertex finds itself among its parents' children."""
    refinement = refine(shapes.creature(), 3)
    match = np.arange(refinement.control.n_vertices)
    for level, subdivision in enumerate(refinement.matrices):
        rows = rows_of(refinement.levels[level + 1].positions)
        in_order = in_blocks(subdivision.shape[0], 1000)
        match = nearest_candidates(rows, rows, in_order, strongest_parents(subdivision), subdivision, match)
        np.testing.assert_array_equal(match, np.arange(subdivision.shape[0]))


def test_parents_are_the_strongest_entries():
    """A face point has all corners as parents, an edge point its two ends, a vertex itself."""
    subdivision = refine(shapes.creature(), 2).matrices[1]
    parents = strongest_parents(subdivision)
    counts = np.diff(parents.indptr)
    n = subdivision.shape[1]
    np.testing.assert_array_equal(counts[:n], 1)
    np.testing.assert_array_equal(parents.indices[parents.indptr[:n]], np.arange(n))
    assert set(counts[n:]) == {2, 4}


def test_rows_that_are_not_finite_are_refused():
    refinement = refine(shapes.creature(), 1)
    good, bad = rows_of(refinement.finest.positions), rows_of(np.nan * refinement.finest.positions)
    parents, match = strongest_parents(refinement.matrices[0]), np.arange(refinement.control.n_vertices)
    order = in_blocks(refinement.finest.n_vertices)
    refuses(ParameterError, "not finite", nearest_candidates, good, bad, order, parents, refinement.matrices[0], match)
    with pytest.raises(ParameterError, match="not finite"):
        vertex_to_point(good, bad, order, triangles(refinement.finest.faces), np.arange(refinement.finest.n_vertices))


def test_vertex_to_point_agrees_with_its_slow_twin():
    refinement = refine(shapes.torus(7, 5), 1)
    faces = triangles(refinement.finest.faces)
    n = refinement.finest.n_vertices
    source = RNG.standard_normal((n, 5)).astype(np.float32)
    target = RNG.standard_normal((80, 5)).astype(np.float32)
    match = RNG.integers(0, n, 80)
    found = vertex_to_point(rows_of(target), rows_of(source), in_blocks(80), faces, match)
    expected = vertex_to_point_reference(target, source, faces, match)
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
    found = vertex_to_point(rows_of(points), rows_of(positions), in_blocks(len(points)), faces, faces[:, 0])
    images = np.einsum("mk,mkd->md", found[1], positions[faces[found[0]]])
    np.testing.assert_allclose(images, points, atol=1e-5)
