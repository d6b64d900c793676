"""Nearest neighbours in the embedding, and candidates from parents (paper, section 5.4)."""

from __future__ import annotations

import numpy as np
from examples import shapes
from scipy import sparse

from cagemap.spectral.nearest import nearest_both_ways, nearest_candidates, nearest_rows, strongest_parents
from cagemap.subdivision import refine

from search_reference import nearest_candidates_reference

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


def test_nearest_both_ways_is_two_searches():
    """More queries than one block has."""
    queries, points = (RNG.standard_normal((n, 6)).astype(np.float32) for n in (1100, 300))
    forward, backward = nearest_both_ways(queries, points)
    np.testing.assert_array_equal(forward, nearest_rows(queries, points))
    np.testing.assert_array_equal(backward, nearest_rows(points, queries))
