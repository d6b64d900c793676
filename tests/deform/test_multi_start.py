"""Several coarse placements are refined, and the cheapest one wins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform import search
from cagemap.deform.config import ElasticConfig
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.deform.placement import Placement
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface


@pytest.fixture(scope="module")
def graph() -> ElasticGraph:
    fine = refine(creature(), 2)
    mesh = TriangleSurface.from_faces(fine.finest.positions, level_triangles(fine, 2))
    return mesh_graph(mesh, mesh.triangles)


def test_stiff_placements_are_refined_too_and_the_cheapest_comes_first(
    graph: ElasticGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage that changes nothing, and costs that are distances: what costs too much at once is not refined."""

    def with_cost(prepared: object, positions: np.ndarray) -> Placement:
        costs = graph.areas * ((positions - graph.positions) ** 2).sum(axis=1)
        return Placement(positions, float(costs.sum()), costs)

    monkeypatch.setattr(search, "fine_fit", lambda problem, coarse: coarse.positions)
    monkeypatch.setattr(search, "with_cost", with_cost)
    rest = SimpleNamespace(graph=graph)
    prepared = SimpleNamespace(rest=rest, elastic=ElasticConfig())
    problem: Any = SimpleNamespace(prepared=prepared, shape=SimpleNamespace(rest=rest))
    soft, near, stiff = (Placement(graph.positions + by, cost) for by, cost in ((0.3, 1.0), (0.3001, 1.1), (0.1, 9.0)))
    found = search.refine_best(problem, [soft, near], stiff=[stiff])
    assert [one.positions is two.positions for one, two in zip(found, (stiff, soft), strict=True)] == [True, True]
    assert found[0].cost < found[1].cost
    assert len(search.refine_best(problem, [soft, stiff])) == 1  # hopeless by its coarse cost


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
