"""Checks that ask all triples of landmarks, against their plain definitions, and with hundreds of landmarks."""

from __future__ import annotations

import tracemalloc

import numpy as np

from cagemap.maps.landmarks.check import MIRRORED
from cagemap.maps.landmarks.distances import (
    LARGEST,
    LEAST_EXCHANGE_GAIN,
    SHORT,
    LandmarkDistances,
    exchanged_pairs,
    misplaced_pairs,
    typical_misfit,
)
from cagemap.maps.landmarks.sides import Marks, agreement_around, exchanged_sides, orientation_agreement


def distances_of(points: np.ndarray, others: np.ndarray) -> LandmarkDistances:
    """Straight-line distances from points to themselves and to others."""
    nodes = np.vstack([points, others])
    return LandmarkDistances(np.linalg.norm(points[:, None] - nodes[None], axis=2), np.arange(len(nodes)))


def plain_exchange(target: LandmarkDistances, source: LandmarkDistances) -> tuple[int, int] | None:
    """The pair with the largest gain, summed term by term."""
    p = len(target.to_nodes)
    wanted, found = np.log(target.between + SHORT), np.log(source.between + SHORT)
    off = ~np.eye(p, dtype=bool)
    shift = np.median((wanted - found)[off])

    def misfit(i: int, at: int, unasked: int) -> float:
        asked = [k for k in range(p) if k not in (i, unasked)]
        weights = 1.0 / (target.between[i, asked] + SHORT)
        return float(weights @ np.minimum(np.abs(wanted[i, asked] - shift - found[at, asked]), LARGEST) / weights.sum())

    best = max(
        (misfit(i, i, j) + misfit(j, j, i) - misfit(i, j, j) - misfit(j, i, i), i, j)
        for i in range(p) for j in range(i + 1, p)
    )  # fmt: skip
    enough = max(LEAST_EXCHANGE_GAIN, typical_misfit(target, source, np.arange(p)))
    return (best[1], best[2]) if best[0] >= enough else None


def test_exchanges_are_those_of_the_sum_over_triples() -> None:
    rng = np.random.default_rng(3)
    for exchanged in (None, (1, 5), (0, 8)):
        points = rng.random((9, 3))
        moved = points + 0.02 * rng.standard_normal(points.shape)
        if exchanged:
            moved[list(exchanged)] = moved[list(exchanged)[::-1]]
        others = rng.random((30, 3))
        target, source = distances_of(points, others), distances_of(moved, others)
        found = exchanged_pairs(target, source, np.arange(9))
        assert found == plain_exchange(target, source)
        assert found == exchanged


def test_orientation_is_that_of_all_triples() -> None:
    rng = np.random.default_rng(4)
    sides = [(rng.random((7, 3)), rng.standard_normal((7, 3))) for _ in range(2)]
    votes = []
    for positions, normals in sides:
        turns = np.zeros((7, 7, 7))
        for i, j, k in np.ndindex(7, 7, 7):
            if i not in (j, k):
                first, second = (positions[n] - positions[i] for n in (j, k))
                unit = np.cross(first / np.linalg.norm(first), second / np.linalg.norm(second))
                turns[i, j, k] = normals[i] @ unit
        votes.append(turns)
    product = votes[0] * votes[1]
    np.testing.assert_allclose(orientation_agreement(*sides), product.sum() / np.abs(product).sum(), rtol=1e-10)
    near = rng.random((7, 7))
    weighted = product * near[:, :, None] * near[:, None, :]
    around = np.concatenate([part for i in (2, 5) for part in (weighted[i], weighted[:, i])])
    found = agreement_around((2, 5), *sides, near)
    np.testing.assert_allclose(found, around.sum() / np.abs(around).sum(), rtol=1e-10)


def placed(positions: np.ndarray, normals: np.ndarray, noise: float, rng: np.random.Generator) -> Marks:
    """Landmarks as somebody puts them: a little off."""
    moved = positions + noise * rng.standard_normal(positions.shape)
    turned = normals + 5 * noise * rng.standard_normal(normals.shape)
    return moved, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def test_landmarks_on_the_midline_alone_are_not_mirrored() -> None:
    """Their turns are what their places are off by: in a third of these sets these once had the opposite sense."""
    rng = np.random.default_rng(6)
    for count in np.repeat([6, 8, 14], 20).tolist():
        angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
        round_it = np.column_stack([np.zeros(count), np.cos(angles), np.sin(angles)])
        target, source = (placed(round_it * [1, 0.2, 0.5], round_it, 0.003, rng) for _ in range(2))
        assert orientation_agreement(target, source) > MIRRORED
        assert (
            exchanged_sides((distances_of(target[0], target[0]), distances_of(source[0], source[0])), target, source)
            is None
        )


def test_neighbours_that_a_hand_put_the_other_way_round_are_not_exchanged() -> None:
    rng = np.random.default_rng(7)
    normals = rng.standard_normal((9, 3))
    normals[1] = normals[0] + [0.05, 0.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = 0.3 * normals  # the first two 0.04 apart
    order = np.array([1, 0, *range(2, 9)])
    target, source = (positions, normals), (positions[order], normals[order])
    assert (
        exchanged_sides((distances_of(positions, positions), distances_of(source[0], source[0])), target, source)
        is None
    )


def test_hundreds_of_landmarks_need_little_memory() -> None:
    points = np.random.default_rng(5).random((400, 3))
    distances = distances_of(points, points[:100])
    tracemalloc.start()
    assert len(misplaced_pairs(distances, distances)) == 0
    assert orientation_agreement((points, points), (points, points)) > 0.99
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 400**3 * 8 / 2  # less than half of one array of all triples
