"""Images that were projected onto a part which only touches that of their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import unfold
from cagemap.numerics.arrays import IndexArray
from cagemap.surface.triangle_surface import TriangleSurface

NONE = np.zeros(0, dtype=np.int64)
SIDE = 13  # vertices along a lip
STRAY = 6 * SIDE + 6  # in the middle of the upper lip


@pytest.fixture(scope="module")
def lips() -> TriangleSurface:
    """Two square sheets, 0.001 apart, joined at the back: the upper faces down, the lower up."""
    x, z = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE), indexing="ij")
    upper, lower = (np.stack([x, np.full_like(x, y), z], axis=2).reshape(-1, 3) for y in (0.001, 0.0))
    at = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    sheet = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=2).reshape(-1, 4)
    back = np.stack([at[0, 1:], at[0, :-1], at[0, :-1] + SIDE**2, at[0, 1:] + SIDE**2], axis=1)
    faces = np.concatenate([sheet, sheet[:, ::-1] + SIDE**2, back])
    return TriangleSurface.from_faces(np.concatenate([upper, lower]), faces)


def _with_stray(lips: TriangleSurface) -> PointMap:
    vertices: IndexArray = np.arange(lips.n)
    vertices[STRAY] += SIDE**2
    return PointMap.from_vertices(lips, lips, vertices)


def test_a_stray_image_returns_to_the_lip_of_its_neighbours(lips: TriangleSurface) -> None:
    np.testing.assert_allclose(unfold(_with_stray(lips), NONE).images.positions, lips.positions, atol=1e-9)


def test_a_landmark_keeps_its_image_on_the_other_lip(lips: TriangleSurface) -> None:
    found = unfold(_with_stray(lips), np.array([STRAY])).images
    assert found.vertices[STRAY] == STRAY + SIDE**2
