"""Limbs assigned to limbs: by what a pose does not change, and maps that start from there."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import creature, cube
from scipy.spatial.transform import Rotation

from cagemap.deform.config import SearchConfig
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.search import fit_small_graph
from cagemap.maps.hypotheses.starts import assigned_limbs, limb_measures, rank_assignments
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import prepare_pair, prepare_surface

from quick_match import SEARCHED

NONE = np.zeros(0, dtype=np.int64)


def star(lengths: list[int], girths: list[float], trunk: int = 4) -> tuple[ElasticGraph, np.ndarray]:
    """Chains of unit edges that leave a trunk, two at each of its vertices, and their tips; areas are girths."""
    edges = [(i, i + 1) for i in range(trunk - 1)]
    areas, tips = [1.0] * trunk, []
    for limb, (length, girth) in enumerate(zip(lengths, girths, strict=True)):
        before = limb // 2
        for _ in range(length):
            edges.append((before, len(areas)))
            before = len(areas)
            areas.append(girth)
        tips.append(before)
    once = np.array(edges)
    heads, tails = np.concatenate([once, once[:, ::-1]]).T
    depth = np.zeros(len(areas))
    for a, b in edges:
        depth[b] = depth[a] + 1.0
    positions = np.column_stack([depth, np.zeros((len(areas), 2))])  # edges have length 1
    weights = np.ones(len(heads))
    return ElasticGraph(positions, positions, np.array(areas) / sum(areas), heads, tails, weights), np.array(tips)


def test_lengths_of_limbs_do_not_count_and_girths_do() -> None:
    girths = [1.0, 3.0, 2.0, 2.5, 1.0, 1.0, 4.0, 0.5]
    target = limb_measures(*_with_tips(star([8, 8, 9, 7, 8, 8, 10, 6], girths)))
    source = limb_measures(*_with_tips(star([6, 6, 9, 9, 7, 7, 12, 14], girths)))
    np.testing.assert_allclose(source[0], target[0])
    few = [0, 1, 6, 7]  # two at either end of the trunk, told by their girths alone
    target, source = ((between[np.ix_(few, few)], own[few]) for between, own in (target, source))
    order = np.array([2, 0, 3, 1])
    shuffled = source[0][np.ix_(order, order)], source[1][order]
    (own, to), *others = rank_assignments(target, shuffled)
    np.testing.assert_array_equal(order[to], own)
    assert len(others) == SearchConfig.max_assignments - 1


def _with_tips(made: tuple[ElasticGraph, np.ndarray]) -> tuple[ElasticGraph, np.ndarray, np.ndarray]:
    return made[0], NONE, made[1]


def test_the_surface_with_more_limbs_keeps_some_for_itself() -> None:
    graph, tips = star([8, 8, 9, 7, 8, 12], [1.0, 1.0, 2.0, 2.5, 1.0, 3.0])
    more, fewer = limb_measures(graph, NONE, tips), limb_measures(graph, NONE, np.delete(tips, 3))
    for target, source in ((more, fewer), (fewer, more)):
        own, to = rank_assignments(target, source)[0]
        np.testing.assert_allclose(target[1][own], source[1][to])  # two limbs are alike
        assert len(set(own)) == len(set(to)) == 5


@pytest.mark.slow
def test_a_landmark_holds_its_limb_and_shapes_without_limbs_have_no_assignments() -> None:
    surface = prepare_surface(creature(), 2)
    prepared = prepare_pair(surface, surface)
    problem = Problem.of_landmarks(prepared, Landmarks.none())
    starts = assigned_limbs(problem)
    assert len(starts[0][1]) >= 4
    assert any(np.array_equal(*tips) for tips in starts)
    block = prepare_surface(cube(), 5)
    other = Problem.of_landmarks(prepare_pair(block, surface), Landmarks.none())
    assert not assigned_limbs(other)


def posed(control: ControlMesh) -> ControlMesh:
    """The creature with its fore legs forwards and hind legs backwards, turned and leaning."""
    x, y, z = (control.positions / np.ptp(control.positions)).T
    below = np.clip(0.3 - y / np.ptp(y) - y.min() / np.ptp(y), 0.0, None)
    moved = np.column_stack([x, y, z + below * np.sign(z - z.mean())])
    return control.with_positions(Rotation.from_euler("yx", [50, 20], degrees=True).apply(moved))


@pytest.mark.slow
def test_a_posed_creature_is_found_however_it_is_turned() -> None:
    """Limbs assigned to limbs are fitted at once: no turned start is tried."""
    prepared = prepare_pair(prepare_surface(creature(), 1), prepare_surface(posed(creature()), 1), SEARCHED)
    problem = Problem.of_landmarks(prepared, Landmarks.none())
    limb_fits, _ = fit_small_graph(problem, True, lambda placed: None)
    found = limb_fits[0][1].extrapolate_to(prepared.energy.graph, prepared.elastic.graph)
    there = prepared.source_surface.positions[prepared.vertices]
    assert np.linalg.norm(found - there, axis=1).mean() < 0.03
