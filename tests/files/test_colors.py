"""Vertex colours as files hold them become shares of full light."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.files.meshes.colors import as_shares


@pytest.mark.parametrize(
    ("largest", "full"),
    [
        (1.0, 1.0),
        (2.0, 255.0),  # whole numbers beyond 1
        (1.5, 1.0),  # light brighter than white
        (15.9, 1.0),
        (16.1, 255.0),  # means of bytes
    ],
)
def test_numbers_far_beyond_1_or_whole_are_bytes(largest: float, full: float) -> None:
    colors = np.array([[0.0, 1.0, largest], [np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(as_shares(colors), colors / full)


def test_the_file_says_what_is_full() -> None:
    np.testing.assert_allclose(as_shares(np.array([[0.0, 512.0, 1023.0]]), 1023.0), [[0.0, 512 / 1023, 1.0]])
