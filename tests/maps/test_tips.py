"""Tips of limbs: found by shape alone, paired where a fit puts them near each other, and met by a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature, cube

from cagemap.deform.config import SearchConfig
from cagemap.deform.data import SourceSamples, source_to_clusters
from cagemap.deform.fit import coarse_fit
from cagemap.deform.graph import cluster_graph, mesh_graph
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.deform.refit import finish_placement
from cagemap.maps.hypotheses.starts import (
    find_tips,
    mean_distances,
    pair_tips,
    prominences,
    refit_to_tips,
    tip_vertices,
)
from cagemap.maps.masks import Masks
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import join_meshes
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import MatchConfig, pair_of, prepare_pair, prepare_surface
from cagemap.spectral import Surface
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import TriangleSurface

CONFIG = SearchConfig()

# Cells of the creature: feet, tail, ears, nose.
ENDS = np.array([(x, 0, z) for x in (-1, 1) for z in (0, 5)] + [(0, 3, -2), (-1, 7, 5), (1, 7, 5), (0, 6, 7)])
TAIL, NOSE = 4, 7


@pytest.fixture(scope="module")
def surface() -> Surface:
    return prepare_surface(creature(), 1)


@pytest.fixture(scope="module")
def prepared(surface: Surface) -> PreparedPair:
    return prepare_pair(surface, surface)


def ends_of(surface: Surface, positions: np.ndarray) -> np.ndarray:
    """Number of the nearest end of places at unit area."""
    places = positions / surface.triangles(surface.finest_level).scale
    return np.asarray(np.linalg.norm(places[:, None] - ENDS, axis=2).argmin(axis=1))


def test_a_peak_stands_above_the_pass_to_a_higher_one() -> None:
    heights = np.array([0.0, 3.0, 1.0, 5.0, 2.0, 4.0, 0.5])
    ends = np.arange(6), np.arange(1, 7)
    peaks, above = prominences(heights, np.concatenate(ends), np.concatenate(ends[::-1]))
    assert dict(zip(peaks.tolist(), above.tolist(), strict=True)) == {1: 2.0, 3: 5.0, 5: 2.0}


def test_tips_are_where_limbs_end(surface: Surface, prepared: PreparedPair) -> None:
    places = prepared.energy.graph.positions[tip_vertices(prepared.energy.graph)]
    assert sorted(ends_of(surface, places)) == list(range(len(ENDS)))
    scale = surface.triangles(surface.finest_level).scale
    assert np.linalg.norm(places / scale - ENDS[ends_of(surface, places)], axis=1).max() < 1.0  # within the cell


def test_a_piece_of_its_own_has_finite_distances() -> None:
    far = cube().with_positions(cube().positions + 50.0)
    finest = refine(join_meshes([creature(), far]), 1).finest
    mesh = TriangleSurface.from_faces(finest.positions, finest.faces)
    heights = mean_distances(mesh_graph(mesh, mesh.triangles))
    assert np.isfinite(heights).all()
    assert heights[-1] < heights[:100].min()  # the cube knows itself only, and is small


@pytest.mark.filterwarnings("error")
def test_small_pieces_have_no_tips() -> None:
    """Eyes, scales and studs: the farthest vertex of a ball is any, and seventy pieces are more than all stations."""
    studs = [cube().with_positions(0.1 * cube().positions + [3.0 * i, 20.0, 0.0]) for i in range(70)]
    finest = refine(join_meshes([creature(), *studs]), 1).finest
    mesh = TriangleSurface.from_faces(finest.positions, finest.faces)
    tips = mesh.positions[tip_vertices(mesh_graph(mesh, mesh.triangles))] / mesh.scale
    assert len(tips) == len(ENDS)
    assert tips[:, 1].max() < 10.0  # of the creature


def test_what_is_masked_or_has_a_landmark_is_no_tip(surface: Surface) -> None:
    positions = surface.triangles(surface.finest_level).positions
    tail = np.linalg.norm(positions / surface.triangles(surface.finest_level).scale - ENDS[TAIL], axis=1) < 1.5
    prepared = prepare_pair(surface, surface, MatchConfig(masks=Masks(source=1.0 - tail)))
    cage = surface.triangles(surface.finest_level).positions[: surface.control.n_vertices]
    nose = int(np.linalg.norm(cage / surface.triangles(surface.finest_level).scale - ENDS[NOSE], axis=1).argmin())
    pair = pair_of(surface, surface, Landmarks(("nose",), np.array([nose]), np.array([nose])))
    found = find_tips(Problem(prepared, pair.landmarks))
    assert set(range(8)) - set(ends_of(surface, positions[found[0]])) == {NOSE}
    assert set(range(8)) - set(ends_of(surface, positions[found[1]])) == {NOSE, TAIL}


@pytest.mark.slow
def test_a_fit_is_led_to_tips_that_it_missed(surface, prepared, monkeypatch):
    held = []

    def fitted(problem: Problem, start: FloatArray, clusters: Clusters, samples: SourceSamples) -> Placement:
        held.append((clusters.energy.graph.positions[: len(clusters.constraints.places)], clusters.constraints.places))
        return coarse_fit(problem, start, clusters, samples)

    monkeypatch.setattr("cagemap.maps.hypotheses.starts.coarse_fit", fitted)
    problem = Problem.of_landmarks(prepared, Landmarks.none())
    found, rest = find_tips(problem), prepared.energy.graph.positions
    ends = prepared.graphs[1].positions[found[1]]
    there = Placement(rest, 1e-4)
    assert refit_to_tips(problem, found, there) is there  # nothing is missed
    tail = np.linalg.norm(rest - ends[ends_of(surface, ends) == TAIL], axis=1) < 0.12
    assert 3 * CONFIG.min_tip_miss < 0.15 < CONFIG.max_tip_distance
    bent = rest + tail[:, None] * np.array([0.15, 0.0, 0.0])
    pairs = pair_tips(bent[found[0]], ends, CONFIG)
    assert np.array_equal(ends_of(surface, rest[found[0][pairs[:, 0]]]), ends_of(surface, ends[pairs[:, 1]]))
    led = refit_to_tips(problem, found, Placement(bent, 1e-2))
    assert np.linalg.norm(led.positions - rest, axis=1)[found[0]].max() < CONFIG.min_tip_miss
    ((tips, places),) = held  # the same shape, so that every tip is held at its own place
    assert len(tips) == len(ENDS)
    assert np.linalg.norm(tips - places, axis=1).max() < CONFIG.min_tip_miss
    cheap = Placement(bent, 0.5 * led.cost / SearchConfig.max_equal_cost)
    assert refit_to_tips(problem, found, cheap) is cheap


def test_the_mean_with_the_inverse_is_left_where_it_costs_more(surface: Surface, prepared: PreparedPair) -> None:
    pair, rest = pair_of(surface, surface, Landmarks.none()), prepared.energy.graph.positions
    problem = Problem(prepared, pair.landmarks)
    bent = rest * (1.0 + 0.05 * np.sin(3.0 * rest[:, ::-1]))
    moved = finish_placement(problem, Placement(bent, 1.0)).map_positions
    assert 0.0 < np.abs(moved - bent).max() < 0.1
    assert finish_placement(problem, Placement(bent, 1.1e-4)).map_positions is bent  # it costs more
    masked = replace(prepared, masks=Masks(source=np.ones(surface.finest_triangles.n)))
    assert finish_placement(Problem(masked, pair.landmarks), Placement(bent, 1.0)).map_positions is bent


@pytest.mark.slow
def test_the_source_pulls_short_legs_to_where_long_ones_end() -> None:
    """Without it a short leg lies within a long one, and nothing that its own points ask for tells."""
    cage = creature()
    height = cage.positions[:, 1:2]
    long = cage.with_positions(cage.positions + [0.0, 2.0, 0.0] * np.minimum(height - 2.0, 0.0))
    prepared = prepare_pair(prepare_surface(cage, 1), prepare_surface(long, 1))
    problem = Problem.of_landmarks(prepared, Landmarks.none())
    sheet, clusters = prepared.source_surface, problem.clusters_with(stage=prepared.elastic.stiff_coarse)
    start = clusters.energy.graph.positions * prepared.source.finest_triangles.scale / prepared.mesh.scale
    start[:, 1] += sheet.positions[:, 1].max() - start[:, 1].max()
    feet, ground = start[:, 1] < start[:, 1].min() + 0.02, sheet.positions[:, 1].min()
    assert (start[feet, 1] > ground + 0.35).all()

    def above_ground(samples: SourceSamples | None) -> float:
        ended = coarse_fit(problem, start, clusters, samples)
        return float((ended.positions[feet, 1] - ground).mean())

    assert above_ground(None) > 0.2
    assert above_ground(prepared.source_samples) < 0.05


def test_source_points_neither_swell_a_round_shape_nor_pull_at_its_inside() -> None:
    """The tangent plane of a round shape lies outside of it wherever it does not touch."""
    finest = refine(cube(), 4).finest
    round_ = finest.positions / np.linalg.norm(finest.positions, axis=1, keepdims=True)
    ball = TriangleSurface.from_faces(round_, finest.faces)
    graph = cluster_graph(mesh_graph(ball, finest.faces), 100, np.zeros(0, dtype=np.int64))[0]
    outward = graph.positions / np.linalg.norm(graph.positions, axis=1, keepdims=True)
    around = SourceSamples.choose(ball, 4000)
    places = graph.positions, outward
    blocks, right = source_to_clusters(around, *places, normal_weight=0.03)
    weights = np.trace(blocks, axis1=1, axis2=2)
    forces = right - np.einsum("kab,kb->ka", blocks, graph.positions)
    radial = np.einsum("ka,ka->k", forces, outward)
    assert (radial < 1e-4 * weights).all()
    np.testing.assert_allclose(weights.sum(), 1.0, atol=0.05)
    inside = replace(around, planes=-around.planes)
    assert source_to_clusters(inside, *places, normal_weight=0.03)[0].max() == 0.0
