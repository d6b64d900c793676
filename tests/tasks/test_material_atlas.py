"""Images of several materials on one image."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.tasks.material_atlas import _tile_image


@pytest.mark.parametrize(("low", "high", "times"), [(-1e-8, 1.0 + 1e-7, 1), (0.0, 1.5, 2), (-0.5, 1.2, 3)])
def test_an_image_is_repeated_as_often_as_uvs_leave_it_by_more_than_rounding(low, high, times):
    pixels = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    tiled, uvs = _tile_image(pixels, np.array([[low, 0.2], [high, 0.8]]))
    np.testing.assert_array_equal(tiled, np.tile(pixels, (1, times, 1)))
    np.testing.assert_allclose(uvs[:, 0], (np.array([low, high]) - np.floor(low + 1e-4)) / times)
    assert _tile_image(pixels, np.array([[0.0, 0.0], [5000.0, 1.0]])) is None
