"""The energy of the elastic fit: what it forgives, what it bounds, how it is minimised and answers to landmarks."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform import energy as energies
from cagemap.deform.config import GraphConfig, Stage
from cagemap.deform.energy import ElasticEnergy, Terms, VertexTerms, any_map, bounded_maps, minimise
from cagemap.deform.graph import cluster_graph, extrapolate, mesh_graph
from cagemap.deform.update import displacement_response
from cagemap.errors import SolverError
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows

from elastic_shapes import graph_of


def affine(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.eye(3) + 0.4 * rng.standard_normal((3, 3)), rng.standard_normal(3)


@pytest.mark.parametrize("clustered", [False, True])
def test_an_affine_deformation_costs_nothing(creature_at_3: tuple[Refinement, float], clustered: bool) -> None:
    graph, _ = graph_of(*creature_at_3, 2)
    if clustered:
        graph, _ = cluster_graph(graph, 200, np.array([3, 5]))
    matrix, shift = affine(np.random.default_rng(11))
    positions = graph.positions @ matrix.T + shift
    laplacian = graph.laplacian
    energy = ElasticEnergy(graph, 1e-2, bounded_maps)
    maps = energy.maps(positions)
    np.testing.assert_allclose(maps, np.broadcast_to(matrix, maps.shape), atol=1e-6)  # ridge of 1e-9
    # The positions are then a solution of the energy's position equations.
    np.testing.assert_allclose(laplacian @ positions, graph.divergence(maps), atol=1e-6 * abs(laplacian.data).max())


def test_both_right_sides_are_those_of_the_energy(creature_at_3: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*creature_at_3, 1)
    rng = np.random.default_rng(19)
    positions, maps = rng.standard_normal((graph.n, 3)), rng.standard_normal((graph.n, 3, 3))
    laplacian = graph.laplacian
    energy = ElasticEnergy(graph, 1e-2, bounded_maps)
    blocks, moments, divergence = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3))
    for i, j, weight, edge in zip(graph.heads, graph.tails, graph.weights, graph.edges, strict=True):
        blocks[i] += weight * np.outer(edge, edge)
        moments[i] += weight * np.outer(edge, positions[i] - positions[j])
        divergence[i] += weight * 0.5 * (maps[i] + maps[j]) @ edge
    np.testing.assert_allclose((graph.moments @ positions).reshape(-1, 3, 3), moments, atol=1e-12)
    np.testing.assert_allclose(graph.divergence(maps), divergence, atol=1e-12)
    # (G_i + epsilon L) A_i^T = c_i, up to the ridge.
    transposed = energy.maps(positions).transpose(0, 2, 1)
    left = blocks @ transposed + 1e-2 * (laplacian @ transposed.reshape(graph.n, 9)).reshape(-1, 3, 3)
    np.testing.assert_allclose(left, moments, atol=1e-6)


def test_maps_that_flatten_or_mirror_are_bounded_and_no_others() -> None:
    rng = np.random.default_rng(21)
    normals = normalize_rows(rng.standard_normal((400, 3)))
    maps = rng.standard_normal((400, 3, 3))
    found, bounded = bounded_maps(maps, normals)
    expected = []
    for i, (before, after, normal) in enumerate(zip(maps, found, normals, strict=True)):
        tangents = np.linalg.svd(normal[None])[2][1:]
        across, along = np.linalg.svd(before @ tangents.T)[1]
        if np.linalg.det(before) > 0 and along >= GraphConfig.flat * across:
            np.testing.assert_array_equal(after, before)
            continue
        expected.append(i)
        largest, _, least = np.linalg.svd(after)[1]
        assert np.linalg.det(after) > 0
        assert least > (1 - 1e-9) * GraphConfig.min_stretch * largest
        sizes = np.linalg.svd(before)[1]
        assert largest == pytest.approx(sizes[0])
        # No farther from the map before than that takes: only the two smaller stretches change.
        least = GraphConfig.min_stretch * sizes[0]
        assert np.linalg.norm(after - before) <= np.hypot(least, least + sizes[2])
    assert 100 < len(expected) < 300  # half are mirrored, and some flat
    np.testing.assert_array_equal(bounded, expected)


def test_a_part_that_is_thin_along_its_normal_is_not_bounded() -> None:
    flat = np.diag([1.0, 0.8, 0.001])[None]
    assert len(bounded_maps(flat, np.array([[0.0, 0.0, 1.0]]))[1]) == 0
    assert len(bounded_maps(flat, np.array([[1.0, 0.0, 0.0]]))[1]) == 1


def test_flat_maps_come_out_upright_whatever_the_factorisation_says() -> None:
    rng = np.random.default_rng(22)
    maps = rng.standard_normal((50, 3, 2)) @ rng.integers(-3, 4, (50, 2, 3))
    found, bounded = bounded_maps(maps, normalize_rows(rng.standard_normal((50, 3))))
    assert np.all(np.linalg.det(found[bounded]) > 0)
    # Rounding decides which of them have a positive determinant and pass as thin along the normal.
    assert len(bounded) > 10


def test_a_map_that_shrinks_everything_to_a_point_stays_finite() -> None:
    found, bounded = bounded_maps(np.zeros((1, 3, 3)), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(found, 0.0)
    assert len(bounded) == 1


def test_extrapolation_is_exact_for_affine_deformations(creature_at_3: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*creature_at_3, 2)
    coarse, _ = cluster_graph(graph, 150, np.array([7]))
    matrix, shift = affine(np.random.default_rng(12))
    maps = np.broadcast_to(matrix, (coarse.n, 3, 3))
    found = extrapolate(coarse, coarse.positions @ matrix.T + shift, maps, graph, GraphConfig())
    np.testing.assert_allclose(found, graph.positions @ matrix.T + shift, atol=1e-12)


def test_clusters_keep_area_landmarks_and_energy(creature_at_3: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*creature_at_3, 3)
    kept = np.array([20, 4, 11])
    coarse, vertices = cluster_graph(graph, 300, kept)
    assert 150 < coarse.n < 500
    np.testing.assert_array_equal(vertices[:3], kept)
    np.testing.assert_array_equal(coarse.positions, graph.positions[vertices])
    assert len(np.unique(vertices)) == coarse.n
    assert coarse.areas.sum() == pytest.approx(1)
    assert (coarse.weights > 0).all()
    for g in (graph, coarse):  # the Dirichlet energy of the coordinates is twice the area, which is 1
        assert (g.weights * (g.edges**2).sum(axis=1)).sum() / 2 == pytest.approx(2, rel=0.05)


def test_the_response_to_landmarks_is_linear_and_keeps_what_is_held(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
    graph, _ = graph_of(refinement, scale, 1)
    rng = np.random.default_rng(16)
    held = np.arange(0, refinement.levels[0].n_vertices, 15)
    offsets = np.zeros((len(held), 3))
    offsets[0] = 0.05 * np.cross(graph.normals[held[0]], rng.standard_normal(3))
    moved, maps = displacement_response(graph, graph.normals, held, offsets)
    twice, _ = displacement_response(graph, graph.normals, held, 2 * offsets)
    still, flat = displacement_response(graph, graph.normals, held, 0 * offsets)
    np.testing.assert_allclose(twice, 2 * moved, atol=1e-12)
    assert abs(still).max() == 0.0
    assert abs(flat).max() == 0.0
    size = np.linalg.norm(offsets[0])
    np.testing.assert_allclose(moved[held], offsets, atol=1e-3 * size)  # weight 1e2 against a stiffness of 2e-4
    lengths = np.linalg.norm(moved, axis=1)
    distance = np.linalg.norm(graph.positions - graph.positions[held[0]], axis=1)
    near = distance < np.quantile(distance, 0.05)
    assert lengths[near].mean() > 0.2 * size  # the surroundings come along
    normal_part = abs(np.einsum("nd,nd->n", moved, graph.normals))
    assert np.median(normal_part[near] / lengths[near]) < 0.5  # along the surface
    assert maps.shape == (graph.n, 3, 3)


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


def minimised(energy: ElasticEnergy, terms: Terms | VertexTerms, start: np.ndarray, *others: Any) -> np.ndarray:
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

    found = minimised(energy, pulled, graph.positions, stage)
    assert missed(found) < 1e-6 * missed(graph.positions)
    again = minimised(energy, Anew(energy, pulled), graph.positions, stage)
    np.testing.assert_allclose(again, found, atol=1e-6)  # factors of single precision; the residual is double


def test_constant_terms_are_factored_once_and_others_as_the_stage_says(energy, pulled, monkeypatch):
    made: list[object] = []
    _, real = energy.factors, energies.factor  # the maps are factored at first use, maybe by another test

    def counted(*given: object, **named: object) -> object:
        made.append(given)
        return real(*given, **named)

    monkeypatch.setattr(energies, "factor", counted)
    stage = Stage(9, (1e-3, 1e-3), 1e-2)
    minimised(energy, pulled, energy.graph.positions, stage)
    assert len(made) == 1
    minimised(energy, Anew(energy, pulled), energy.graph.positions, replace(stage, factored=4))
    assert len(made) == 1 + 3
    minimised(energy, pulled, energy.graph.positions, replace(stage, stiffness=(1e-2, 1e-3), ramp=1.0))
    assert len(made) == 4 + 9  # their matrix changes with the stiffness


def test_positions_are_adjusted_in_every_iteration(energy: ElasticEnergy, pulled: VertexTerms) -> None:
    seen: list[np.ndarray] = []

    def adjust(positions: np.ndarray) -> np.ndarray:
        seen.append(positions)
        return positions * np.array([1.0, 1.0, 0.0])

    found = minimised(energy, pulled, energy.graph.positions, Stage(4, (1e-3, 1e-3), 1e-2, momentum=0.5), adjust)
    assert len(seen) == 4
    assert abs(found[:, 2]).max() == 0.0


def test_a_start_that_nothing_of_the_source_faces_stays_where_it_is(
    energy: ElasticEnergy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Translations are free then; the factorisation refuses some of these matrices, here all of them."""
    graph, real = energy.graph, energies.factor
    shift = np.tile(np.eye(3), (graph.n, 1))

    def refusing(matrix: Any, **named: Any) -> object:
        if abs(matrix @ shift).max() < 1e-9 * abs(matrix).max():
            raise SolverError("expected a non-singular matrix")
        return real(matrix, **named)

    monkeypatch.setattr(energies, "factor", refusing)
    start = graph.positions + 0.5
    nothing = VertexTerms(energy, np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3)))
    found = minimised(energy, nothing, start, Stage(3, (1e-3, 1e-3), 1e-3))
    np.testing.assert_allclose(found, start, atol=1e-5)  # factors of single precision
