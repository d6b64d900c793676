"""Polylines: their nearest points, and how their length is shared out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.surface.polylines import Polyline


def test_the_nearest_point_may_lie_on_a_piece_away_from_the_nearest_vertex() -> None:
    """Thin closed curves, such as eyelids: the nearest vertex is the other lid's."""
    lid = np.array([[0.0, 0, 0], [10, 0, 0], [10, 1, 0], [5, 1, 0]])
    places, ends, share, tangents = Polyline(lid, closed=False).nearest(np.array([[5, 0.4, 0.0]]))
    np.testing.assert_allclose(places, [[5, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(ends, [[0, 1]])
    np.testing.assert_allclose(share, [0.5])
    np.testing.assert_allclose(tangents, [[1, 0, 0]])


@settings(max_examples=40)
@given(st.integers(2, 30), st.booleans(), st.integers(0, 2**32 - 1))
def test_nearest_points_are_the_best_of_all_pieces(count: int, closed: bool, seed: int) -> None:
    """Tangled lines, some of whose pieces have no length."""
    random = np.random.default_rng(seed)
    positions = random.normal(size=(count, 3))
    positions[1:][random.random(count - 1) < 0.2] = positions[0]
    points = random.normal(size=(20, 3))
    found, ends, share, _ = Polyline(positions, closed).nearest(points)
    first, second = (positions[ends[:, side]] for side in (0, 1))
    np.testing.assert_allclose(first + share[:, None] * (second - first), found, atol=1e-12)
    starts, stops = positions if closed else positions[:-1], np.roll(positions, -1, axis=0)[: count - (not closed)]
    along = stops - starts
    share = ((points[:, None] - starts) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    places = starts + np.clip(share, 0, 1)[:, :, None] * along
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), expected, atol=1e-12)


def test_a_line_without_length_has_one_nearest_point() -> None:
    for closed in (False, True):
        places, _, _, tangents = Polyline(np.ones((2, 3)), closed).nearest(np.zeros((1, 3)))
        np.testing.assert_array_equal(places, [[1, 1, 1]])
        np.testing.assert_array_equal(tangents, [[0, 0, 0]])


def test_lengths_of_a_polyline_are_shared_out() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert Polyline(square, closed=True).length == pytest.approx(4.0)
    np.testing.assert_allclose(Polyline(square, closed=False).point_lengths, [0.5, 1.0, 1.0, 0.5])
    assert len(Polyline(square, closed=False).spread(2)) == 2
