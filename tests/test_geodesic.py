"""Distances along a surface, for the benchmarks."""

from __future__ import annotations

import numpy as np
from benchmarks.geodesic import HeatDistances
from examples.shapes import icosahedron

from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.refinement import level_triangles, refine


def test_distances_on_a_sphere_are_angles() -> None:
    refinement = refine(icosahedron(), 4)
    places = refinement.finest.positions / np.linalg.norm(refinement.finest.positions, axis=1, keepdims=True)
    sphere = TriangleSurface.from_faces(places, level_triangles(refinement, 4))
    radius = np.linalg.norm(sphere.positions[0])
    sources = SurfacePoints.from_vertices(sphere, np.array([0, 7, 500]))
    found = HeatDistances(sphere).from_weights(sources.matrix().toarray().T)
    cosines = np.clip(sphere.positions @ sources.positions.T / radius**2, -1, 1)
    exact = radius * np.arccos(cosines)
    # The heat method rounds the cut locus off and is first order in the mesh width.
    assert np.abs(found - exact).mean() < 0.02 * exact.mean()
