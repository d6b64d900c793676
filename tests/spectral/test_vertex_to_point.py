"""From a matched vertex to a point of the triangles around it (paper, section 5.4)."""

from __future__ import annotations

import numpy as np
from examples import shapes

from cagemap.spectral.vertex_to_point import vertex_to_point, vertex_triangles
from cagemap.subdivision import refine, triangles

from search_reference import closest_on_triangle, vertex_to_point_reference

RNG = np.random.default_rng(271)


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
