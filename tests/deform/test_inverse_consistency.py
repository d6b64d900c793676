"""A fit and what its inverse becomes: their mean leaves out half of what the energy prefers one way only."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform.config import StartConfig
from cagemap.deform.fit import fine_fit
from cagemap.deform.placement import Placement
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
from cagemap.subdivision import refine
from cagemap.surface.closest_points import closest_points


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
    pairs = PointPairs.of_vertices(on, on, landmarks, landmarks)
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
    line = Curve(PointPairs.of_vertices(on, on, vertices, vertices).target, False)
    closed = Curve(line.points, True)
    pairs = PointPairs.of_vertices(on, on, vertices, vertices + 9)
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
    landmarks = PointPairs.of_vertices(
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
