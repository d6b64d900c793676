"""The best parts of several ends of a fit become one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic import ends
from cagemap.maps.elastic.constants import PARTS_APART
from cagemap.maps.elastic.ends import FineFit, best_parts
from cagemap.maps.elastic.fit import CoarseFit
from cagemap.maps.elastic.graph import ElasticGraph, mesh_graph
from cagemap.refinement import level_triangles, refine


@pytest.fixture(scope="module")
def graph() -> ElasticGraph:
    fine = refine(creature(), 2)
    mesh = TriangleSurface.from_faces(fine.finest.positions, level_triangles(fine, 2))
    return mesh_graph(mesh, mesh.triangles)


def moved(graph: ElasticGraph, where: np.ndarray) -> np.ndarray:
    return graph.positions + 3 * PARTS_APART * where[:, None] * np.array([0.0, 1.0, 0.0])


def end(positions: np.ndarray, costs: np.ndarray) -> FineFit:
    return FineFit(float(costs.sum()), positions, costs)


def test_each_part_is_taken_from_where_it_is_cheaper(graph: ElasticGraph) -> None:
    """One end is wrong in front, the other one behind and dearer: together they are right everywhere."""
    along = graph.positions[:, 2]
    front, behind = along > np.quantile(along, 0.9), along < np.quantile(along, 0.2)
    first = end(moved(graph, front), 1e-4 + 1e-3 * front)
    second = end(moved(graph, behind), 1e-4 + 1e-3 * behind)
    assert first.cost < second.cost
    mixed = best_parts(graph, [first, second])
    assert mixed is not None
    np.testing.assert_allclose(mixed, graph.positions, atol=1e-12)


def test_nothing_is_taken_that_is_dearer_small_or_near(graph: ElasticGraph) -> None:
    along = graph.positions[:, 2]
    front = along > np.quantile(along, 0.9)
    best = end(graph.positions, np.full(graph.n, 1e-4))
    dearer = end(moved(graph, front), 1e-4 + 1e-3 * front)
    assert best_parts(graph, [best, dearer]) is None
    cheaper = np.full(graph.n, 1e-4) - 5e-5 * front
    near = FineFit(1.0, graph.positions + 0.5 * PARTS_APART * front[:, None] / np.sqrt(3), cheaper)
    assert best_parts(graph, [best, near]) is None
    one = np.arange(graph.n) == np.argmax(along)
    assert graph.areas[one].sum() < 5e-4
    assert best_parts(graph, [best, FineFit(1.0, moved(graph, one), cheaper)]) is None


def test_stiff_ends_are_finished_too_and_the_best_parts_of_all_come_first(
    graph: ElasticGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stages that change nothing, and costs that are distances: a soft end wrong in front, a stiff one behind."""
    along = graph.positions[:, 2]
    soft = moved(graph, along > np.quantile(along, 0.9))
    stiff = moved(graph, along < np.quantile(along, 0.1))

    def judged(prepared: object, positions: np.ndarray) -> FineFit:
        return end(positions, graph.areas * ((positions - graph.positions) ** 2).sum(axis=1))

    monkeypatch.setattr(ends, "fine_fit", lambda problem, coarse: coarse.positions)
    monkeypatch.setattr(ends, "fine_stage", lambda problem, start: start)
    monkeypatch.setattr(ends, "judged", judged)
    problem: Any = SimpleNamespace(prepared=SimpleNamespace(rest=SimpleNamespace(graph=graph)))
    maps = np.zeros((graph.n, 3, 3))
    of_both = [CoarseFit(cost, positions, maps, graph) for cost, positions in ((1.0, soft), (9.0, stiff))]
    found = ends.finished_ends(problem, of_both[:1], stiff=of_both[1:])
    assert len(found) == 3
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    np.testing.assert_allclose(found[0].positions, graph.positions, atol=1e-12)
    assert len(ends.finished_ends(problem, of_both)) == 1  # hopeless by its coarse cost


def test_shares_of_the_energy_are_its_terms(graph: ElasticGraph) -> None:
    """Every edge once, a half of it at each end; a twin in a loop over some vertices."""
    rng = np.random.default_rng(1)
    positions, maps = rng.standard_normal((graph.n, 3)), rng.standard_normal((graph.n, 3, 3))
    shares = graph.energies(positions, maps, 0.1)
    for i in (0, 7, graph.n - 1):
        total = 0.0
        for e in np.flatnonzero(graph.heads == i):
            j = graph.tails[e]
            rest = graph.positions[i] - graph.positions[j]
            missed = positions[i] - positions[j] - 0.5 * (maps[i] + maps[j]) @ rest
            total += 0.5 * graph.weights[e] * (missed @ missed + 0.1 * ((maps[i] - maps[j]) ** 2).sum())
        assert shares[i] == pytest.approx(total, rel=1e-10)
