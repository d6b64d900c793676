"""Parts of a surface that went through each other are moved apart; others stay."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagemap.character.self_collision import Collisions, move_apart, winding_numbers
from cagemap.surface.triangles import fan_triangles, surface_area

from plain_meshes import ball

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
FORWARD = TURN @ [0.0, 0.0, 1.0]


@pytest.fixture
def lips() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two balls, one above the other with a gap of 0.2, in a general orientation: positions and triangles."""
    mesh = ball(3)
    triangles = fan_triangles(mesh.face_offsets, mesh.face_indices)[0]
    height = np.ptp(mesh.positions[:, 1])
    upper = mesh.positions + np.array([0.0, height + 0.2, 0.0])
    is_upper = np.repeat([False, True], mesh.n_vertices)
    positions = np.concatenate([mesh.positions, upper]) @ TURN.T
    return positions, np.concatenate([triangles, triangles + mesh.n_vertices]), is_upper


def deepest(positions: np.ndarray, triangles: np.ndarray) -> float:
    found = Collisions.find(positions, triangles, np.arange(len(positions)), FORWARD)
    return float(np.linalg.norm(found.exits, axis=1).max(initial=0.0)) / np.sqrt(surface_area(positions, triangles))


def test_winding_numbers_count_the_parts_around_a_point(lips) -> None:
    positions, triangles, is_upper = lips
    middle = positions[~is_upper].mean(axis=0)
    points = np.stack([middle, positions[is_upper].mean(axis=0), middle + 10 * FORWARD, middle - 10 * FORWARD])
    np.testing.assert_array_equal(winding_numbers(positions, triangles, points, FORWARD), [1, 1, 0, 0])
    twice = np.concatenate([triangles, triangles])
    np.testing.assert_array_equal(winding_numbers(positions, twice, points, FORWARD), [2, 2, 0, 0])


def test_a_part_that_went_into_another_touches_it_afterwards(lips) -> None:
    positions, triangles, is_upper = lips
    down = -(TURN @ [0.0, 1.0, 0.0])
    moved = positions + 0.25 * is_upper[:, None] * down
    assert deepest(moved, triangles) > 5e-3
    apart = move_apart(positions, moved, triangles, FORWARD)
    assert deepest(apart, triangles) < 3e-4  # the tolerance of 2e-4 and the lift of 1e-4 of the points that are tested
    # Both give way, by half of the depth of 0.05 and what it spreads, and only where they touch.
    change = np.linalg.norm(apart - moved, axis=1)
    assert change[is_upper].max() < 0.05
    assert 0.0 < change[~is_upper].max() < 0.05
    assert (change > 0).mean() < 0.5


def test_what_does_not_collide_and_what_collides_at_rest_stays(lips) -> None:
    positions, triangles, is_upper = lips
    down = -(TURN @ [0.0, 1.0, 0.0])
    closer = positions + 0.15 * is_upper[:, None] * down
    np.testing.assert_array_equal(move_apart(positions, closer, triangles, FORWARD), closer)
    inside = positions + 0.25 * is_upper[:, None] * down
    shifted = inside + 0.01 * FORWARD
    np.testing.assert_array_equal(move_apart(inside, shifted, triangles, FORWARD), shifted)


def test_what_collides_at_rest_is_not_moved_apart_beside_a_new_collision(lips) -> None:
    """A third ball goes into the lower one, where another overlaps it at rest: pushed a little, not out of it."""
    positions, triangles, is_upper = lips
    lower, one, count = positions[~is_upper], triangles[: len(triangles) // 2], int((~is_upper).sum())
    right, up, _ = TURN.T * np.ptp(lower @ TURN[:, 1])
    rest = np.concatenate([lower, lower + 0.675 * right + 0.405 * up, lower + 1.05 * up])
    every = np.concatenate([one, one + count, one + 2 * count])
    moved = rest.copy()
    moved[2 * count :] -= 0.08 * up
    overlapping = Collisions.find(rest, every, np.arange(2 * count), FORWARD).vertices
    assert len(overlapping) > 40
    change = np.linalg.norm(move_apart(rest, moved, every, FORWARD) - moved, axis=1)
    assert change.max() > 0.0
    assert change[overlapping].max() < 0.06 * np.linalg.norm(up)  # 0.11 if they were moved apart
