"""Blend shapes: a coarse target follows what the source does over each of its triangles, not at a point of it."""

from __future__ import annotations

import numpy as np
from examples.shapes import torus

from cagemap.maps.point_map import PointMap
from cagemap.mesh.plain import plain_mesh
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes


def test_a_step_narrower_than_the_targets_triangles_is_carried_without_overshoot() -> None:
    """Vertices of the target are every fourth of the source: they move as these do."""
    around, across, share = 12, 8, 4
    coarse, fine = (refine(plain_mesh(torus(around * k, across * k)).mesh, 0) for k in (1, share))
    distance = np.linalg.norm(coarse.control.positions[:, None] - fine.control.positions, axis=2)
    same = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 1e-9
    surfaces = [TriangleSurface.from_faces(side.finest.positions, side.finest.faces) for side in (coarse, fine)]
    carrier = prepare_shapes(coarse, fine, PointMap.from_vertices(*surfaces, same))
    heights = fine.control.positions[:, 0]
    # A ninth of a coarse edge wide, at the centroids of triangles.
    step = np.clip((heights - np.quantile(heights, 0.55)) / 0.03, 0.0, 1.0)[:, None] * [0.0, 0.0, 0.3]
    np.testing.assert_allclose(carry_shape(carrier, step), step[same], rtol=0, atol=1e-6)
