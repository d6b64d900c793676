"""Maps without landmarks: one search over all starts, and the answer says how sure it is."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, grid, voxels
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cagemap.deform.fit import evaluate_clusters, evaluate_placement
from cagemap.deform.multi_start import StartFits
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.errors import InvalidLandmarksError
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.merged_parts import merge_results
from cagemap.maps.hypotheses import search
from cagemap.maps.hypotheses.confidence import LOOK, SURE, TWO, Confidence
from cagemap.maps.hypotheses.search import cost_floor
from cagemap.maps.hypotheses.starts import (
    AS_FILED,
    BY_FILE_AXES,
    part_starts,
    rigid_starts,
    rotation_name,
    rotation_penalty,
    unmoved_start,
    usual_rotations,
)
from cagemap.maps.masks import Masks
from cagemap.mesh import Bilinear, Plain
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import FileVertex
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import MatchConfig, match, prepare_pair, prepare_surface
from cagemap.surface.alignment import Z_UP, axis_rotations
from cagemap.surface.triangle_surface import TriangleSurface

from plain_meshes import ball
from quick_match import SEARCHED


def test_there_are_24_rotations_and_none_mirrors() -> None:
    rotations = axis_rotations()
    assert len({tuple(matrix.ravel()) for matrix in rotations}) == 24
    assert all(np.linalg.det(matrix) == pytest.approx(1.0) for matrix in rotations)
    assert rotation_name(rotations[0]) == AS_FILED
    assert len({rotation_name(matrix) for matrix in rotations}) == 24


ABOUT_X, ABOUT_Y, ABOUT_Z = (Rotation.from_rotvec(np.pi * axis).as_matrix().round() for axis in np.eye(3))


@pytest.mark.parametrize(
    ("up_axes", "penalties"),
    [
        # of no rotation, of those that bring +Z to +Y and +Y to +Z, of half turns about Y, Z and X, and of two together
        ((None, None), [1.0, 1.3, 1.3, 1.1, 1.3, 1.3, 1.3]),
        ((Z_UP, None), [1.0, 1.0, 1.3, 1.1, 1.3, 1.3, 1.1]),
        ((None, Z_UP), [1.0, 1.3, 1.0, 1.1, 1.3, 1.3, 1.1]),
        ((Z_UP, Z_UP), [1.0, 1.3, 1.3, 1.3, 1.1, 1.3, 1.3]),
    ],
)
def test_rotations_between_the_axes_that_the_files_state_have_no_penalty(up_axes, penalties):
    prepared = prepare_pair(*(prepare_surface(replace(creature(), upright=upright), 1) for upright in up_axes))
    rotations = (np.eye(3), Z_UP.T, Z_UP, ABOUT_Y, ABOUT_Z, ABOUT_X, ABOUT_Y @ Z_UP.T)
    assert [rotation_penalty(matrix, prepared) for matrix in rotations] == penalties
    names = [rotation_name(matrix, usual_rotations(prepared)) for matrix in rotations]
    assert [name == BY_FILE_AXES for name in names] == [False, *(cost == 1.0 for cost in penalties[1:])]


@pytest.mark.slow
def test_a_model_with_another_axis_up_is_aligned_by_its_file() -> None:
    tilted = replace(creature().with_positions(creature().positions * (1.3, 1.0, 0.8) @ Z_UP.T), upright=Z_UP)
    confidence = match(prepare_surface(tilted, 1), prepare_surface(creature(), 1), None, SEARCHED).confidence
    assert confidence.signs["turned"] == 0.0
    assert confidence.answers[0].name == BY_FILE_AXES
    assert BY_FILE_AXES in confidence.message


def test_boxes_agree_and_no_start_mirrors() -> None:
    rng = np.random.default_rng(2)
    points, others = rng.normal(size=(50, 3)) * (1, 2, 3), rng.normal(size=(80, 3)) * (3, 1, 1) + 5
    centred, areas = points - points.mean(axis=0), rng.random(50)
    starts = rigid_starts(points, areas, TriangleSurface(others, np.arange(78)[:, None] + np.arange(3)))
    for start in starts:
        linear = np.linalg.lstsq(centred, start.positions - start.positions.mean(axis=0), rcond=None)[0]
        assert np.linalg.det(linear) > 0, start.name
    assert len(starts) == 2 * 24 + 4  # boxes of one scale and of three, and principal frames
    stretched = starts[1].positions
    np.testing.assert_allclose(np.ptp(stretched, axis=0), np.ptp(others, axis=0))
    np.testing.assert_allclose(stretched.min(axis=0), others.min(axis=0), atol=1e-12)


@pytest.mark.parametrize("factor", [1.0, 2.0, 5.0])
def test_open_surfaces_of_related_units_also_start_where_the_files_place_them(factor: float) -> None:
    """Also in exactly one unit; closed surfaces and unrelated units have no such start."""
    closed = prepare_surface(cube(), 1)
    assert unmoved_start(prepare_pair(closed, closed), closed.finest_triangles.positions) == []
    mesh = grid()
    target, source = (prepare_surface(mesh.with_positions(k * mesh.positions), 1) for k in (1.0, factor))
    points = target.finest_triangles.positions
    starts = unmoved_start(prepare_pair(target, source), points)
    assert len(starts) == (0 if factor == 5.0 else 1)
    for start in starts:
        in_file = start.positions / source.finest_triangles.scale, points / target.finest_triangles.scale
        np.testing.assert_allclose(*in_file)


@pytest.mark.parametrize("turn", [np.eye(3), Rotation.from_euler("xyz", (20, 46, 130), degrees=True).as_matrix()])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_part_starts_near_its_place_on_the_whole_wherever_its_file_puts_it(turn: FloatArray, reverse: bool) -> None:
    """The head of a body with distinct axes, moved far away, and turned; in file units, so that its size is known."""
    whole = ball()
    whole = replace(whole, scheme=Plain()).with_positions(whole.positions * (1.0, 1.6, 3.0))
    kept = whole.positions[:, 2][whole.face_indices.reshape(-1, 3)].min(axis=1) > 0.5
    part = extract_faces(whole, np.flatnonzero(kept))
    moved = part.with_positions(part.positions @ turn.T + (5.0, 1.0, -4.0))
    sides = [prepare_surface(moved, 0), prepare_surface(whole, 0)]
    on_whole = part.positions * sides[1].finest_triangles.scale
    prepared = prepare_pair(*(sides[::-1] if reverse else sides))
    mesh = prepared.mesh
    starts = part_starts(prepared, mesh.positions, mesh.vertex_areas)
    wanted, chosen = on_whole, slice(None)
    if reverse:
        wanted = sides[0].finest_triangles.positions
        chosen = cKDTree(mesh.positions).query(on_whole)[1]
    assert min(np.linalg.norm(start.positions[chosen] - wanted, axis=1).mean() for start in starts) < 0.2
    sizes = (np.linalg.norm(positions.std(axis=0)) for positions in (starts[0].positions[chosen], wanted))
    assert next(sizes) == pytest.approx(next(sizes))


def test_principal_frames_do_not_depend_on_where_vertices_are_dense() -> None:
    """An ellipsoid of nearly equal axes on itself with many vertices at one side, rotated far from all axes."""
    mesh = TriangleSurface.from_faces(ball().positions * (1.0, 1.1, 1.2), ball().face_indices.reshape(-1, 3))
    places = mesh.positions
    turn = Rotation.from_euler("xyz", (20, 46, 30), degrees=True)
    # Vertices of no triangle lie on the surface too, and have no area.
    dense = np.repeat(places[places @ (0.6, 0.6, 0.5) > 0.2], 9, axis=0)
    source = TriangleSurface(turn.apply(np.concatenate([places, dense])), mesh.triangles)
    starts = rigid_starts(places, mesh.vertex_areas, source)[-4:]
    apart = min(np.linalg.norm(start.positions - turn.apply(np.array(places)), axis=1).max() for start in starts)
    assert apart < 1e-9


@pytest.mark.slow
def test_a_shape_that_is_its_own_double_has_two_answers_and_landmarks_choose() -> None:
    scene = join_meshes([creature(), cube()])
    cage = extract_faces(scene, np.arange(creature().n_faces, scene.n_faces))
    # Elsewhere: surfaces that lie on each other are known at once.
    longer = cage.with_positions(cage.positions * (1.0, 1.0, 1.0003) + 5.0)
    target, source = prepare_surface(cage, 2), prepare_surface(longer, 2)
    undecided = match(target, source, None, SEARCHED)
    assert undecided.confidence.verdict == TWO
    # The message counts as the file does, also in a result of several parts, which stand one after another.
    assert f"vertex {int(undecided.confidence.deciding or 0) + creature().n_vertices} " in undecided.confidence.message
    merged = merge_results([undecided, undecided], {}).confidence
    assert merged.message == f"the part of 6 faces: {undecided.confidence.message}"
    # Any corner may come to lie on any other, and an edge then on any of the three that leave it.
    other = cage.positions[0] * (-1, 1, 1)
    places = [int(np.argmin(np.linalg.norm(cage.positions - at, axis=1))) for at in (cage.positions[0], other)]
    pairs = Landmarks(("corner", "edge"), np.array(places), np.array(places[::-1]))
    result = match(target, source, pairs, SEARCHED)
    assert result.quality.landmark_errors.max() < 1e-9
    assert result.quality.flipped_area < 1e-3
    assert result.quality.dirichlet < 1.05


@pytest.mark.slow
def test_a_box_lies_on_itself_as_the_files_stand_although_its_sides_are_all_alike() -> None:
    """Turned upon itself it stretches affinely, which is free."""
    control = replace(voxels(list(product(range(2), repeat=3))), scheme=Bilinear())
    centred = control.positions - control.positions.mean(axis=0)
    box = prepare_surface(control.with_positions(centred * (1.4, 0.8, 1.0)), 1)
    # Elsewhere: surfaces that lie on each other are known at once.
    longer = prepare_surface(control.with_positions(centred * (1.4003, 0.8, 1.0) + 5.0), 1)
    result = match(box, longer)
    assert result.confidence.answers[0].name == AS_FILED
    away = result.point_map.images.positions - result.point_map.source.positions
    assert np.linalg.norm(away, axis=1).max() < 1e-3


def test_what_a_target_costs_on_itself_shrinks_with_what_masks_leave_of_either_side() -> None:
    surface = prepare_surface(creature(), 1)
    whole = cost_floor(prepare_pair(surface, surface))
    part = np.where(np.arange(len(surface.vertices)) % 4 == 0, 1.0, 0.0)
    prepared = prepare_pair(surface, surface, MatchConfig(masks=Masks(part)))
    areas = prepared.energy.graph.areas
    assert cost_floor(prepared) == pytest.approx(whole * areas[part[: len(areas)] > 0].sum())
    back = prepare_pair(surface, surface, MatchConfig(masks=Masks(None, part)))
    assert 0.1 * whole < cost_floor(back) < 0.5 * whole


def test_the_paper_s_method_asks_for_landmarks() -> None:
    target = prepare_surface(creature(), 1)
    with pytest.raises(InvalidLandmarksError, match="at least 3 pairs for the method hfm, got 0"):
        match(target, target, None, MatchConfig(method="hfm"))


def test_verdicts_follow_the_costs_of_all_answers() -> None:
    at = np.zeros((4, 3))
    best = Placement(at, 1e-4, name="a")
    other = Placement(at + np.outer([0.0, 2.0, 0.0, 9.0], [0, 1, 0]), 1.05e-4, name="b")
    two = Confidence.of((best, other), np.arange(3))
    assert (two.verdict, two.deciding) == (TWO, 1)  # the fourth vertex is not one of the control mesh
    assert "vertex 1 decides" in two.message
    assert "vertex 7 at (0, 2, 0) decides" in replace(two, file_vertex=FileVertex(7, (0.0, 2.0, 0.0))).message
    assert Confidence.of((best, replace(other, cost=1.2e-4)), np.arange(3)).verdict == LOOK
    shared = np.ones(3)
    shared[two.deciding] = 0.0
    assert Confidence.of((best, other), np.arange(3), weights=shared).deciding not in (None, two.deciding)
    assert Confidence.of((best, replace(other, cost=5e-4)), np.arange(3)).verdict == SURE
    alone = Confidence.of((best,), np.arange(3))
    assert (alone.verdict, alone.signs["runner_up"], alone.deciding) == (SURE, 0.0, None)
    assert Confidence.of((replace(best, cost=1.0),), np.arange(3)).verdict == LOOK
    turned = replace(best, cost=3e-4, penalty=1.1)
    assert Confidence.of((turned,), np.arange(3)).verdict == LOOK
    assert Confidence.of((replace(turned, penalty=1.0),), np.arange(3)).verdict == SURE


@pytest.fixture(scope="module")
def prepared() -> PreparedPair:
    surface = prepare_surface(creature(), 1)
    return prepare_pair(surface, surface)


def found(
    prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch, agree: bool, start: FloatArray | None = None
) -> tuple[list[Placement], list[bool]]:
    """Placements found where limbs lead to the truth and landmarks beside it; whether rotations were tried."""
    vertices, asked = np.array([0, 40, 80]), list[bool]()
    problem = Problem.of_landmarks(prepared, Landmarks(("a", "b", "c"), vertices, vertices))
    places = prepared.energy.graph.positions
    beside = evaluate_placement(prepared, places + np.array([0.05, 0.0, 0.0]))

    def fit_small_graph(problem: Problem, with_rotations: bool, show: object) -> tuple[list[object], list[object]]:
        asked.append(with_rotations)
        return [], []

    monkeypatch.setattr(search, "fit_from_two_starts", lambda *given: ([beside], [] if agree else [beside]))
    monkeypatch.setattr(search, "spectral_starts", lambda problem, clusters: lambda placed: [])
    monkeypatch.setattr(search, "refine_cheapest", lambda problem, coarse, fine=(): fine or coarse)
    monkeypatch.setattr(search, "fit_small_graph", fit_small_graph)
    monkeypatch.setattr(search, "fit_without_tips", lambda *given: [[evaluate_placement(prepared, places)]])
    monkeypatch.setattr(search, "refit_distinct_to_tips", lambda problem, ranked: ranked)
    monkeypatch.setattr(search, "finish_placement", lambda problem, placed: placed)
    return search.search_placements(problem, start=start), asked


def test_other_starts_compete_with_landmarks_whose_fits_disagree(prepared, monkeypatch):
    placements, asked = found(prepared, monkeypatch, agree=False)
    np.testing.assert_array_equal(placements[0].positions, prepared.energy.graph.positions)
    assert len(placements) == 2
    assert asked == [False]  # landmarks need no rotations


def test_landmarks_whose_fits_agree_and_starts_that_are_given_decide_alone(prepared, monkeypatch):
    assert found(prepared, monkeypatch, agree=True)[1] == []
    placements, asked = found(prepared, monkeypatch, agree=False, start=np.zeros((1, 3)))
    assert len(placements) == 1
    assert asked == []


def test_costs_below_the_floor_are_ties(prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    """A box fits itself turned as well, up to how samples fall: the alignment as the files stand is kept."""
    places, floor = prepared.energy.graph.positions, search.cost_floor(prepared)
    as_filed, turned = Placement(places, 0.9 * floor), Placement(places, 0.1 * floor, penalty=1.1)
    monkeypatch.setattr(search, "fit_small_graph", lambda *given: ([], []))
    monkeypatch.setattr(search, "fit_without_tips", lambda *given: [[turned], [as_filed]])
    monkeypatch.setattr(search, "refine_cheapest", lambda problem, coarse: coarse)
    monkeypatch.setattr(search, "refit_distinct_to_tips", lambda problem, ranked: ranked)
    monkeypatch.setattr(search, "finish_placement", lambda problem, placed: placed)
    assert search.search_placements(Problem.of_landmarks(prepared, Landmarks.none()))[0].cost == as_filed.cost


@pytest.mark.slow
def test_correct_landmarks_do_not_make_the_rest_worse(shared_data: Path) -> None:
    """Nose, four feet and tail: fits from landmarks alone leave the other places 2.9 off, all starts 1.7."""
    animals = shared_data / "animals"
    cow, horse = (prepare_surface(read_mesh(animals / f"{name}.obj"), 1) for name in ("cow", "horse"))
    named = read_landmarks(animals / "landmarks" / "horse__cow.json", "cow.obj", "horse.obj")[0]
    feet = ["nose_tip", "fore_hoof_left", "hind_hoof_right", "tail_tip", "fore_hoof_right", "hind_hoof_left"]
    of_feet = [named.names.index(name) for name in feet]
    given, rest = named.without(np.setdiff1d(np.arange(len(named)), of_feet)), named.without(of_feet)
    images = match(cow, horse, given).point_map.images.positions[rest.target]
    errors = np.linalg.norm(images - horse.finest_triangles.positions[rest.source], axis=1)
    assert 100 * errors.mean() < 2.2


def test_half_of_the_assignments_of_limbs_is_fitted(prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    """The half whose starts by ZoomOut cost least."""
    shifts, fitted = np.random.default_rng(3).permutation(10), list[int]()

    def zoomout_start(problem: Problem, clusters: Clusters) -> FloatArray:
        return clusters.energy.graph.positions + 0.02 * shifts[clusters.constrained_vertices[0]]

    def coarse_fit(problem: Problem, start: FloatArray, clusters: Clusters) -> Placement:
        fitted.extend(clusters.constrained_vertices[0].tolist())
        return evaluate_clusters(prepared, clusters, start)

    tips = [(np.array([vertex]), np.array([vertex])) for vertex in range(10)]
    monkeypatch.setattr(search, "assigned_limbs", lambda problem: tips)
    monkeypatch.setattr(search, "zoomout_start", zoomout_start)
    monkeypatch.setattr(search, "coarse_fit", coarse_fit)
    search.fit_small_graph(Problem.of_landmarks(prepared, Landmarks.none()), False, lambda placed: None)
    assert sorted(fitted) == sorted(np.argsort(shifts)[:5])


@pytest.mark.parametrize(("n_landmarks", "kept"), [(0, ["cheapest", "1.1"]), (2, ["cheapest", "1.1"]), (3, None)])
def test_assignments_of_limbs_that_cost_much_more_are_refined_with_landmarks_only(
    prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch, n_landmarks: int, kept: list[str] | None
) -> None:
    """Costs are those of the cheaper start times the penalty of the small fit."""
    positions, vertices = prepared.energy.graph.positions, np.arange(0, 40 * n_landmarks, 40)
    problem = Problem.of_landmarks(prepared, Landmarks(tuple("abc"[:n_landmarks]), vertices, vertices))
    costs = {"1.3": 1.3, "cheapest": 1.0, "penalty 1.2": 1.0, "1.1": 1.1}  # "tips" are names here
    refined = list[str]()

    class NamedClusters(str):
        def with_stage(self, stage: object) -> "NamedClusters":
            return self

    def fit_from_two_starts(
        problem: Problem, clusters: object, start: object = None, stiff_fits: StartFits | None = None
    ) -> tuple[list[Placement], list[Placement]]:
        beside = Placement(positions, 1.0)
        if stiff_fits is None:
            return [beside], [beside]
        refined.append(str(clusters))
        return [stiff_fits[0][1]], []

    def fit_both_starts(problem: Problem, clusters: str) -> StartFits:
        return [Placement(positions, 9.0), Placement(positions, costs[clusters])], positions

    small_fits = [(name, Placement(positions, 5.0, penalty=1.2 if "penalty" in name else 1.0)) for name in costs]
    monkeypatch.setattr(Problem, "clusters_with", lambda problem, tips="": NamedClusters(tips))
    monkeypatch.setattr(search, "fit_from_two_starts", fit_from_two_starts)
    monkeypatch.setattr(search, "fit_both_starts", fit_both_starts)
    monkeypatch.setattr(search, "fit_small_graph", lambda *given: (small_fits, []))
    monkeypatch.setattr(search, "fit_without_tips", lambda *given: [])
    monkeypatch.setattr(search, "spectral_starts", lambda problem, clusters: lambda placed: [])
    monkeypatch.setattr(search, "refine_cheapest", lambda problem, coarse, fine=(): fine or coarse)
    monkeypatch.setattr(search, "refit_distinct_to_tips", lambda problem, ranked: ranked)
    search.search_placements(problem, finish=False)
    assert refined == (list(costs) if kept is None else kept)
