"""The mean of a fit and the inverse of the reverse fit, and the best parts of several coarse placements."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature
from tests.fixtures.vertex_pairs import points_at

from cagemap.deform import multi_start
from cagemap.deform.config import ElasticConfig, SearchConfig, StartConfig
from cagemap.deform.fit import fine_fit
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.deform.placement import Placement, best_parts
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.deform.refit import inverse_consistent, inverse_positions, smooth_shifts
from cagemap.maps.hypotheses.search import inverse_placement
from cagemap.maps.hypotheses.starts import AS_FILED
from cagemap.maps.masks import Masks
from cagemap.maps.pair import PointPairs
from cagemap.mesh.curves import Curve, CurvePair
from cagemap.mesh.parts import extract_faces
from cagemap.operators import build_operators
from cagemap.spectral import BasisConfig, Surface, hierarchical_basis
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface


@pytest.fixture(scope="module")
def prepared() -> PreparedPair:
    """A creature on itself, fitted at 1500 vertices."""
    refinement = refine(creature(), 2)
    operators = build_operators(refinement)
    surface = Surface.of(refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(count=4)))
    return PreparedPair.build(surface, surface, StartConfig(search_vertices=1000))


def slid(prepared: PreparedPair, by: float) -> np.ndarray:
    """Places on the source that all lie too far in front."""
    mesh = prepared.mesh
    moved = mesh.positions + by * np.array([0.0, 0.0, 1.0])
    return moved - np.einsum("nd,nd->n", moved - mesh.positions, mesh.vertex_normals)[:, None] * mesh.vertex_normals


def test_the_inverse_of_a_motion_is_the_motion_back(prepared: PreparedPair) -> None:
    mesh = prepared.mesh
    rotation = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    places, gaps = inverse_positions(mesh, mesh.positions, mesh, 0.02)
    np.testing.assert_allclose(places, mesh.positions, atol=1e-9)
    assert gaps.max() < 1e-9
    turned = type(mesh)(mesh.positions @ rotation.T, mesh.triangles)
    places, gaps = inverse_positions(mesh, turned.positions, turned, 0.02)
    np.testing.assert_allclose(places, mesh.positions, atol=1e-7)
    far, _ = inverse_positions(mesh, turned.positions + 1e-3, turned, 0.02)
    assert 1e-4 < np.linalg.norm(far - mesh.positions, axis=1).mean() < 2e-3


@pytest.mark.slow
def test_half_of_a_slide_is_taken_back(prepared: PreparedPair) -> None:
    """The way back from a slid fit of a shape onto itself ends where it should: half of the slide is left."""
    landmarks = np.arange(0, prepared.target.refinement.levels[0].n_vertices, 4)
    on = prepared.source.finest_triangles
    pairs = points_at(on, on, landmarks, landmarks)
    problem = Problem(prepared, pairs)
    start = slid(prepared, 0.01)
    start[landmarks] = prepared.mesh.positions[landmarks]
    before = np.linalg.norm(start - prepared.mesh.positions, axis=1).mean()
    after = np.linalg.norm(inverse_consistent(problem, start) - prepared.mesh.positions, axis=1).mean()
    assert 0.4 * before < after < 0.65 * before
    still = inverse_consistent(problem, prepared.mesh.positions)
    assert np.linalg.norm(still - prepared.mesh.positions, axis=1).max() < 2e-3


def test_what_is_not_trusted_follows_its_surroundings(prepared: PreparedPair) -> None:
    n, rng = prepared.mesh.n, np.random.default_rng(5)
    same = np.tile([1.0, -2.0, 3.0], (n, 1))
    np.testing.assert_allclose(smooth_shifts(prepared.energy.graph, same, rng.uniform(size=n), 0.02), same, atol=1e-6)
    wild, trust = same.copy(), np.ones(n)
    wild[7], trust[7] = 100.0, 0.0
    np.testing.assert_allclose(smooth_shifts(prepared.energy.graph, wild, trust, 0.02)[7], same[7], atol=1e-2)
    assert np.abs(smooth_shifts(prepared.energy.graph, wild, np.ones(n), 0.02)[7] - same[7]).max() > 1.0


def test_a_reversed_pair_has_its_sides_exchanged(prepared: PreparedPair) -> None:
    other = refine(creature(), 2)
    operators = build_operators(other)
    basis = hierarchical_basis(other, operators, BasisConfig(count=4))
    source = Surface.of(other, operators, basis)
    masks = Masks(np.linspace(0, 1, other.finest.n_vertices), None)
    pair = PreparedPair.build(prepared.target, source, StartConfig(search_vertices=1000), masks=masks)
    back = pair.reverse_pair
    assert (back.target, back.source) == (pair.source, pair.target)
    assert back.levels == pair.levels[::-1]
    assert back.mesh.n == back.energy.graph.n == source.triangles(back.levels[0]).n
    assert back.source_surface.n >= back.mesh.n
    assert back.masks.target is None
    np.testing.assert_array_equal(back.masks.source, masks.target)
    np.testing.assert_array_equal(back.level_masks.source, masks.target[: back.source_surface.n])
    vertices = np.arange(4)
    on = pair.source.finest_triangles
    line = Curve(points_at(on, on, vertices, vertices).target, False)
    closed = Curve(line.points, True)
    pairs = points_at(on, on, vertices, vertices + 9)
    turned = PointPairs(pairs.target, pairs.source, (CurvePair("rim", line, closed),)).reversed()
    np.testing.assert_array_equal(turned.target.positions, pairs.source.positions)
    assert turned.curves[0].target.closed
    assert not turned.curves[0].source.closed


@pytest.fixture(scope="module")
def on_part(prepared: PreparedPair) -> Problem:
    """The creature on three quarters of its faces."""
    whole = creature()
    middles = np.array([whole.positions[whole.face(face)].mean(axis=0) for face in range(whole.n_faces)])
    part = extract_faces(whole, np.flatnonzero(middles[:, 2] < np.quantile(middles[:, 2], 0.75)))
    refinement = refine(part, 2)
    operators = build_operators(refinement)
    source = Surface.of(refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(count=4)))
    pair = PreparedPair.build(prepared.target, source, StartConfig(search_vertices=1000))
    corners = np.arange(0, part.n_vertices, 4)
    landmarks = points_at(
        prepared.source.finest_triangles, pair.source.finest_triangles, part.file_vertices[corners], corners
    )
    return Problem(pair, landmarks)


def at_home(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Places of the whole where it was cut, and their distances from the part."""
    mesh, source = problem.prepared.mesh, problem.prepared.source_surface
    places = mesh.positions * source.scale / mesh.scale
    return places, closest_points(source.tree, places)[2]


@pytest.mark.slow
def test_a_whole_body_is_averaged_where_a_part_of_it_is(on_part: Problem) -> None:
    """Area that the part lacks has no inverse; it moves little, and the rest comes nearer to the truth."""
    home, gaps = at_home(on_part)
    ended = fine_fit(on_part, home)
    moved = inverse_consistent(on_part, ended)
    before, after = (np.linalg.norm(places - home, axis=1)[gaps < 1e-3].mean() for places in (ended, moved))
    assert 0.0 < after < before < 3e-3
    beyond = np.linalg.norm(moved - ended, axis=1)[gaps > 0.03]
    assert len(beyond) > 0.3 * len(ended)
    assert beyond.max() < 0.02


@pytest.mark.slow
def test_a_part_on_a_whole_places_the_whole_on_the_part(on_part: Problem) -> None:
    home, gaps = at_home(on_part)
    back = on_part.prepared.reverse_pair
    reverse = Placement(back.mesh.positions * back.source_surface.scale / back.mesh.scale, 2.5, penalty=1.1)
    placed = inverse_placement(on_part, reverse)
    assert (placed.cost, placed.penalty, placed.name) == (2.5, 1.1, AS_FILED)
    assert np.linalg.norm(placed.positions - home, axis=1)[gaps < 1e-3].mean() < 5e-3


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
    half = Placement(moved(graph, front), 1.0, cheaper)
    assert best_parts(graph, [best, half], CONFIG, CONFIG.max_equal_cost) is not None
    assert best_parts(graph, [best, half], CONFIG, 2.0) is None


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
