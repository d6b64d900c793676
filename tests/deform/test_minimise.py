"""Positions and differentials alternate: to a minimum, with as few factorisations as may be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform import energy as energies
from cagemap.deform.config import Stage
from cagemap.deform.energy import ElasticEnergy, VertexTerms, any_map
from cagemap.deform.graph import mesh_graph
from cagemap.deform.minimise import Terms, minimise
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface


@pytest.fixture(scope="module")
def energy() -> ElasticEnergy:
    refinement = refine(creature(), 1)
    mesh = TriangleSurface.from_faces(refinement.finest.positions, level_triangles(refinement, 1))
    return ElasticEnergy(mesh_graph(mesh, mesh.triangles), 1e-2, any_map)


@pytest.fixture(scope="module")
def pulled(energy: ElasticEnergy) -> VertexTerms:
    """Every vertex is drawn to where a bend takes it, some more than others."""
    graph = energy.graph
    wanted = graph.positions + 0.3 * np.sin(3.0 * graph.positions[:, [1, 2, 0]])
    weights = graph.areas * np.random.default_rng(1).uniform(0.1, 2.0, graph.n)
    return VertexTerms(energy, weights[:, None, None] * np.eye(3), weights[:, None] * wanted, constant=True)


def minimised(energy: ElasticEnergy, terms: Terms, start: np.ndarray, *others: Any) -> np.ndarray:
    return minimise(energy.graph, energy.differentials, terms, start, *others)


class Anew:
    """The same terms, made anew in every iteration."""

    def __init__(self, energy: ElasticEnergy, terms: VertexTerms) -> None:
        self.energy, self.terms = energy, terms

    def __call__(self, positions: np.ndarray, found: object, alpha: float, before: object) -> VertexTerms:
        return VertexTerms(self.energy, self.terms.blocks, self.terms.right)


@pytest.mark.slow
def test_a_minimum_is_stationary(energy: ElasticEnergy, pulled: VertexTerms) -> None:
    """The positions solve their equations with their own differentials, which the start does not."""
    graph, alpha = energy.graph, 1e-3
    stage = Stage(300, (alpha, alpha), 1e-2, momentum=0.6)

    def missed(positions: np.ndarray) -> float:
        right = pulled.right + alpha * graph.divergence(energy.maps(positions))
        left = alpha * graph.laplacian @ positions + np.einsum("nab,nb->na", pulled.blocks, positions)
        return float(np.linalg.norm(left - right))

    found = minimised(energy, lambda *_: pulled, graph.positions, stage)
    assert missed(found) < 1e-6 * missed(graph.positions)
    again = minimised(energy, Anew(energy, pulled), graph.positions, stage)
    np.testing.assert_allclose(again, found, atol=1e-6)  # factors of single precision; the residual is double


def test_constant_terms_are_factored_once_and_others_as_the_stage_says(
    energy: ElasticEnergy, pulled: VertexTerms, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    _, real = energy.factors, energies.factor  # the maps are factored at first use, maybe by another test

    def counted(*given: object, **named: object) -> object:
        made.append(given)
        return real(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(energies, "factor", counted)
    stage = Stage(9, (1e-3, 1e-3), 1e-2)
    minimised(energy, lambda *_: pulled, energy.graph.positions, stage)
    assert len(made) == 1
    minimised(energy, Anew(energy, pulled), energy.graph.positions, replace(stage, factored=4))
    assert len(made) == 1 + 3
    minimised(energy, lambda *_: pulled, energy.graph.positions, replace(stage, stiffness=(1e-2, 1e-3), ramp=1.0))
    assert len(made) == 4 + 9  # their matrix changes with the stiffness


def test_positions_are_adjusted_in_every_iteration(energy: ElasticEnergy, pulled: VertexTerms) -> None:
    seen: list[np.ndarray] = []

    def adjust(positions: np.ndarray) -> np.ndarray:
        seen.append(positions)
        return positions * np.array([1.0, 1.0, 0.0])

    found = minimised(
        energy, lambda *_: pulled, energy.graph.positions, Stage(4, (1e-3, 1e-3), 1e-2, momentum=0.5), adjust
    )
    assert len(seen) == 4
    assert abs(found[:, 2]).max() == 0.0
