"""The target in the source's pose: as rigid as it can be near a fit, and fitted again from there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from examples.shapes import creature
from tests.fixtures.vertex_pairs import pair_at

from cagemap.deform import multi_start, refit
from cagemap.deform.config import RefitConfig, SearchConfig, StartConfig
from cagemap.deform.energy import ElasticEnergy, bounded_maps
from cagemap.deform.fit import coarse_fit, fine_fit
from cagemap.deform.graph import mesh_graph
from cagemap.deform.multi_start import fit_from_two_starts
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.deform.refit import (
    edge_stiffness,
    finish_placement,
    fit_from_shape,
    largest_limb_rotation,
    pose_difference,
    rigid_pose,
)
from cagemap.maps.hypotheses.starts import tip_vertices
from cagemap.maps.masks import WHOLE, Masks
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.operators import build_operators
from cagemap.spectral import BasisConfig, Surface, hierarchical_basis
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface

LIMB, LIMB_POSED, POSES_DIFFER = SearchConfig.limb_area, SearchConfig.max_limb_rotation, RefitConfig.min_pose_difference


@pytest.fixture(scope="module")
def energy() -> ElasticEnergy:
    """A creature of 380 vertices."""
    refinement = refine(creature(), 1)
    mesh = TriangleSurface.from_faces(refinement.finest.positions, level_triangles(refinement, 1))
    return ElasticEnergy(mesh_graph(mesh, mesh.triangles), 1e-4, bounded_maps)


def lengths(energy: ElasticEnergy, positions: np.ndarray) -> np.ndarray:
    """Of all edges."""
    return np.linalg.norm(positions[energy.graph.heads] - positions[energy.graph.tails], axis=1)


def test_a_motion_is_a_pose(energy: ElasticEnergy) -> None:
    rotation = nearest_rotations(np.random.default_rng(5).standard_normal((1, 3, 3)))[0]
    moved = energy.graph.positions @ rotation.T + np.array([3.0, -1.0, 2.0])
    assert pose_difference(energy, moved) < 1e-5  # of the whole body is no pose
    np.testing.assert_allclose(rigid_pose(energy.graph, moved), moved, atol=1e-6)


def test_a_bent_and_stretched_body_is_bent_and_hardly_stretched(energy: ElasticEnergy) -> None:
    at = energy.graph.positions
    along = at[:, 2] - at[:, 2].mean()
    stretched = at * np.array([1.0, 1.0, 1.4]) ** np.sign(along)[:, None]  # longer in front, shorter behind
    angle = 1.5 * np.clip(along, 0.0, None)
    bent = stretched.copy()
    bent[:, 0] = np.cos(angle) * stretched[:, 0] + np.sin(angle) * stretched[:, 1]
    bent[:, 1] = -np.sin(angle) * stretched[:, 0] + np.cos(angle) * stretched[:, 1]
    rolled = at.copy()
    rolled[:, 0] = np.cos(3.0 * angle) * at[:, 0] + np.sin(3.0 * angle) * at[:, 1]
    rolled[:, 1] = -np.sin(3.0 * angle) * at[:, 0] + np.cos(3.0 * angle) * at[:, 1]
    found = rigid_pose(energy.graph, bent)
    assert pose_difference(energy, stretched) < 0.1 < pose_difference(energy, bent) < POSES_DIFFER
    assert pose_difference(energy, rolled) > POSES_DIFFER
    own = lengths(energy, at)
    assert np.abs(np.log(lengths(energy, bent) / own)).mean() > 0.1
    assert np.abs(np.log(lengths(energy, found) / own)).mean() < 0.07
    assert np.linalg.norm(found - bent, axis=1).mean() < 0.1 < np.linalg.norm(found - at, axis=1).mean()


def test_one_limb_is_posed_where_the_body_stands_as_it_did(energy: ElasticEnergy) -> None:
    at, areas = energy.graph.positions, energy.graph.areas
    behind = np.argsort(at[:, 2])
    share = np.cumsum(areas[behind]) / areas.sum()
    bent = at.copy()
    limb = behind[share < 4 * LIMB]
    hinge = at[limb][:, 2].max()
    height, depth = at[limb, 1], at[limb, 2] - hinge
    bent[limb, 1] = np.cos(1.2) * height - np.sin(1.2) * depth
    bent[limb, 2] = hinge + np.sin(1.2) * height + np.cos(1.2) * depth
    assert largest_limb_rotation(energy, WHOLE, at, LIMB) < 1e-5
    assert pose_difference(energy, bent) < POSES_DIFFER
    assert largest_limb_rotation(energy, WHOLE, bent, LIMB) > LIMB_POSED
    # A masked arm that a landmark holds in another pose puts no joint of what is matched in doubt.
    around = behind[share < 8 * LIMB]
    masks = Masks(np.where(np.isin(np.arange(energy.graph.n), around), 0.0, 1.0))
    assert largest_limb_rotation(energy, masks, bent, LIMB) < LIMB_POSED


@pytest.mark.parametrize("angle", [0.9 * LIMB_POSED, 1.1 * LIMB_POSED])
def test_placements_that_agree_are_doubted_where_a_limb_is_posed(bent, monkeypatch, angle):
    problem = problem_of(bent)
    at_rest = Placement(problem.coarse_clusters.energy.graph.positions, 1.0)
    monkeypatch.setattr(multi_start, "refine_placements", lambda problem, coarse: list(coarse))
    starts, asked = list[FloatArray](), list[object]()

    def coarse_fit(problem: Problem, start: FloatArray, clusters: Clusters) -> Placement:
        starts.append(start)
        return at_rest

    def zoomout_start(*given: object) -> FloatArray:
        asked.append(given)
        return bent.source.finest_triangles.positions

    monkeypatch.setattr(multi_start, "coarse_fit", coarse_fit)
    monkeypatch.setattr(multi_start, "zoomout_start", zoomout_start)
    monkeypatch.setattr(multi_start, "largest_limb_rotation", lambda *given: angle)
    fine, soft = fit_from_two_starts(problem, problem.coarse_clusters)
    assert len(fine) == 1, "of coarse placements that agree, one is refined"
    assert (not soft) == (angle < LIMB_POSED)
    assert len(starts) == (4 if soft else 2)
    assert len(asked) == 1, "both stages start from one ZoomOut"


def test_edges_are_loose_where_a_body_turns_and_stiff_where_it_does_not(energy: ElasticEnergy) -> None:
    graph = energy.graph
    along = graph.positions[:, 2] - graph.positions[:, 2].mean()
    angle = np.clip(along / 0.1, 0.0, 1.0)
    cosine, sine, none, one = np.cos(angle), np.sin(angle), 0 * angle, 1 + 0 * angle
    turns = np.array([[cosine, -sine, none], [sine, cosine, none], [none, none, one]]).transpose(2, 0, 1)
    found = edge_stiffness(graph, turns)
    joint = (along > 0.03) & (along < 0.07)
    far = (along < -0.1) | (along > 0.2)
    assert found[joint[graph.heads]].max() < 0.4
    assert found[far[graph.heads]].min() > 0.8
    assert found.min() >= RefitConfig.min_stiffness
    np.testing.assert_allclose(edge_stiffness(graph, turns[:1] + 0 * turns), 1.0)
    np.testing.assert_allclose(found, edge_stiffness(graph, turns[3] @ turns), rtol=1e-6)
    # A vertex whose faces are points is seen to turn nowhere.
    positions = graph.positions.copy()
    positions[graph.heads[graph.tails == 0]] = positions[0]
    assert np.isfinite(edge_stiffness(replace(graph, positions=positions), turns)).all()


def bowed() -> ControlMesh:
    """The creature with its neck bent by 1.2 radians, as rigid as the joint lets it."""
    body = creature()
    at, joint = body.positions, np.array([0.0, 3.0, 3.0])
    angle = 1.2 * np.clip(at[:, 2] - joint[2], 0.0, 1.0)
    y, z = (at - joint)[:, 1:].T
    turned = np.column_stack([at[:, 0], np.cos(angle) * y - np.sin(angle) * z, np.sin(angle) * y + np.cos(angle) * z])
    return body.with_positions(turned + joint * [0.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def bent() -> PreparedPair:
    """A creature onto the bowed one; vertex i belongs on vertex i."""

    def surface(mesh: ControlMesh) -> Surface:
        refinement = refine(mesh, 1)
        operators = build_operators(refinement)
        return Surface.of(refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(count=4)))

    return PreparedPair.build(surface(creature()), surface(bowed()), StartConfig(search_vertices=300))


def problem_of(prepared: PreparedPair) -> Problem:
    """With every twelfth vertex a landmark."""
    vertices = np.arange(0, prepared.target.control.n_vertices, 12)
    return Problem(prepared, pair_at(prepared.target, prepared.source, vertices, vertices).landmarks)


@pytest.mark.slow
def test_a_bent_joint_is_no_strain_in_its_own_pose(bent: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, problem = bent.source.finest_triangles.positions, problem_of(bent)
    stages = []

    def fitted(problem: Problem, start: FloatArray, clusters: Clusters) -> Placement:
        stages.append(clusters.stage)
        return coarse_fit(problem, start, clusters)

    monkeypatch.setattr("cagemap.deform.refit.coarse_fit", fitted)
    assert pose_difference(bent.energy, truth) > POSES_DIFFER
    slid = fine_fit(problem, truth)
    found = fit_from_shape(problem, rigid_pose(bent.energy.graph, slid), slid)
    before, after = (np.linalg.norm(places - truth, axis=1).mean() for places in (slid, found))
    assert before > 0.004  # the minimum beside the truth
    assert after < 0.75 * before
    assert stages == [bent.elastic.stiff_coarse]  # the stage of bodies that stand alike


def test_the_fit_keeps_parts_of_the_placement_that_the_coarse_stage_loses(bent, monkeypatch):
    graph, placed, starts = bent.energy.graph, bent.source.finest_triangles.positions, []
    (distances,) = graph.distances(tip_vertices(graph, SearchConfig.limb_height)[:1])
    hand = (distances < 0.2)[:, None]
    coarse = placed + 0.1 * hand * np.random.default_rng(3).standard_normal(placed.shape)  # no fingers of its own
    monkeypatch.setattr(refit, "coarse_fit", lambda *given: SimpleNamespace(extrapolate_to=lambda *to: coarse))

    def fine(problem: Problem, start: FloatArray) -> FloatArray:
        starts.append(start)
        return start

    monkeypatch.setattr(refit, "fine_fit", fine)
    assert fit_from_shape(problem_of(bent), placed) is coarse  # of the next frame, whose hands have moved
    found = fit_from_shape(problem_of(bent), placed, placed)
    lost, kept = (np.linalg.norm(positions - placed, axis=1).max() for positions in (coarse, found))
    assert kept < 0.25 * lost
    assert len(starts) == 4
    assert found is starts[3]  # the parts that cost less, fitted once more


@pytest.mark.parametrize(("share", "taken"), [(0.95, False), (0.8, True)])
def test_parts_of_the_second_fit_count_if_they_cost_much_less(bent, monkeypatch, share, taken):
    placed = bent.source.finest_triangles.positions
    coarse = placed + np.array([0.1, 0.0, 0.0])
    monkeypatch.setattr(refit, "coarse_fit", lambda *given: SimpleNamespace(extrapolate_to=lambda *to: coarse))
    monkeypatch.setattr(refit, "smooth_shifts", lambda graph, shifts, *given: 0.0 * shifts)
    monkeypatch.setattr(refit, "fine_fit", lambda problem, start: start)
    costs = {True: np.full(len(placed), 1e-4), False: np.full(len(placed), share * 1e-4)}

    def evaluated(prepared: object, positions: FloatArray) -> Placement:
        return Placement(positions, 1.0, costs[positions is coarse])

    monkeypatch.setattr(refit, "evaluate_placement", evaluated)
    found = fit_from_shape(problem_of(bent), placed, placed)
    np.testing.assert_allclose(found, placed if taken else coarse)


@pytest.mark.parametrize("angle", [0.9 * POSES_DIFFER, 1.1 * POSES_DIFFER])
def test_only_poses_that_differ_are_fitted_in_the_other_pose(bent, monkeypatch, angle):
    problem = problem_of(bent)
    asked: list[tuple[PreparedPair, list[float]]] = []

    def fitted(given: Problem, shape: FloatArray, placed: FloatArray) -> FloatArray:
        asked.append((given.prepared, given.landmarks.target.positions[0].tolist()))
        np.testing.assert_array_equal(shape, placed + 1.0)
        return placed

    monkeypatch.setattr(refit, "pose_difference", lambda energy, positions: angle)
    monkeypatch.setattr(refit, "rigid_pose", lambda graph, positions, config: positions + 1.0)
    monkeypatch.setattr(refit, "fit_from_shape", fitted)
    monkeypatch.setattr(refit, "fine_fit", lambda problem, start: start)
    ended = Placement(bent.source.finest_triangles.positions, 1e-4)
    landmarks = problem.landmarks
    first = finish_placement(problem, ended)
    forth, back = (side.positions[0].tolist() for side in (landmarks.target, landmarks.source))
    assert asked == ([] if angle < POSES_DIFFER else [(bent, forth), (bent.reverse_pair, back)])
    assert first.positions is ended.positions
    assert first.map_positions is first.finished_positions


def test_nearest_rotations_are_rotations_and_nearest() -> None:
    rng = np.random.default_rng(7)
    maps = rng.standard_normal((40, 3, 3))  # half of them turn space over
    found = nearest_rotations(maps)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    others = nearest_rotations(found + 0.3 * rng.standard_normal((40, 3, 3)))
    assert (((maps - found) ** 2).sum(axis=(1, 2)) < ((maps - others) ** 2).sum(axis=(1, 2))).all()
