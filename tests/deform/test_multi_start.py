"""Several coarse placements are refined, and the best parts of all become one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform import multi_start
from cagemap.deform.config import ElasticConfig, SearchConfig
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.deform.multi_start import best_parts
from cagemap.deform.placement import Placement
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface

CONFIG = SearchConfig()


@pytest.fixture(scope="module")
def graph() -> ElasticGraph:
    fine = refine(creature(), 2)
    mesh = TriangleSurface.from_faces(fine.finest.positions, level_triangles(fine, 2))
    return mesh_graph(mesh, mesh.triangles)


def moved(graph: ElasticGraph, where: np.ndarray) -> np.ndarray:
    return graph.positions + 3 * CONFIG.part_distance * where[:, None] * np.array([0.0, 1.0, 0.0])


def placed(positions: np.ndarray, costs: np.ndarray) -> Placement:
    return Placement(positions, float(costs.sum()), costs)


def test_each_part_is_taken_from_where_it_costs_less(graph: ElasticGraph) -> None:
    """One placement is wrong in front, the other one behind and dearer: together they are right everywhere."""
    along = graph.positions[:, 2]
    front, behind = along > np.quantile(along, 0.9), along < np.quantile(along, 0.2)
    first = placed(moved(graph, front), 1e-4 + 1e-3 * front)
    second = placed(moved(graph, behind), 1e-4 + 1e-3 * behind)
    assert first.cost < second.cost
    mixed = best_parts(graph, [first, second], CONFIG)
    np.testing.assert_allclose(mixed, graph.positions, atol=1e-12)


def test_nothing_is_taken_that_is_dearer_small_or_near(graph: ElasticGraph) -> None:
    along = graph.positions[:, 2]
    front = along > np.quantile(along, 0.9)
    best = placed(graph.positions, np.full(graph.n, 1e-4))
    dearer = placed(moved(graph, front), 1e-4 + 1e-3 * front)
    assert best_parts(graph, [best, dearer], CONFIG) is None
    cheaper = np.full(graph.n, 1e-4) - 5e-5 * front
    near = Placement(graph.positions + 0.5 * CONFIG.part_distance * front[:, None] / np.sqrt(3), 1.0, cheaper)
    assert best_parts(graph, [best, near], CONFIG) is None
    one = np.arange(graph.n) == np.argmax(along)
    assert graph.areas[one].sum() < CONFIG.part_area
    assert best_parts(graph, [best, Placement(moved(graph, one), 1.0, cheaper)], CONFIG) is None


def test_refined_placements_count_and_the_best_parts_of_all_come_first(graph, monkeypatch):
    """Stages that change nothing, and costs that are distances: one placement is wrong in front, another one behind."""
    along = graph.positions[:, 2]
    front = moved(graph, along > np.quantile(along, 0.9))
    behind = moved(graph, along < np.quantile(along, 0.1))

    def with_cost(prepared: object, positions: np.ndarray) -> Placement:
        return placed(positions, graph.areas * ((positions - graph.positions) ** 2).sum(axis=1))

    monkeypatch.setattr(multi_start, "fine_fit", lambda problem, start: getattr(start, "positions", start))
    monkeypatch.setattr(multi_start, "evaluate_placement", with_cost)
    prepared = SimpleNamespace(energy=SimpleNamespace(graph=graph), elastic=ElasticConfig())
    problem: Any = SimpleNamespace(prepared=prepared)
    coarse, hopeless = Placement(front, 1.0, graph=graph), Placement(behind, 9.0, graph=graph)
    found = multi_start.refine_cheapest(problem, [coarse], fine=[with_cost(prepared, behind)])
    assert len(found) == 3
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    np.testing.assert_allclose(found[0].positions, graph.positions, atol=1e-12)
    assert len(multi_start.refine_cheapest(problem, [coarse, hopeless])) == 1


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
