"""Curves: read, checked, put on refined surfaces, followed by the fit, stored and shown."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.deform.config import StartConfig
from cagemap.deform.data import CurveConstraint
from cagemap.deform.fit import coarse_fit
from cagemap.deform.multi_start import curve_vertices
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.errors import FormatError
from cagemap.files.result.folder import read_result, write_result
from cagemap.maps.pair import Pair, curve_pairs, point_pairs, refined_edges
from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop
from cagemap.mesh.cage_points import CagePoints, NamedPoints
from cagemap.mesh.curves import CurvePair
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name
from cagemap.mesh.topology import mesh_topology
from cagemap.paper.constraints import curve_rows
from cagemap.pipeline import MatchResult, match, update_match
from cagemap.spectral.surface import prepare_surfaces
from cagemap.subdivision import refine
from cagemap.surface.polylines import Polyline

from curved_bar import RINGS, bar, ends_of, ring, rings_of, slid
from example_result import change_result


@pytest.fixture(scope="module")
def surfaces() -> tuple:
    mesh = bar()
    return prepare_surfaces(mesh, slid(mesh), (2, 2))


@pytest.fixture(scope="module")
def without(surfaces: tuple) -> MatchResult:
    return match(*surfaces, ends_of(surfaces[0].control))


@pytest.fixture(scope="module")
def with_curves(surfaces: tuple) -> MatchResult:
    mesh = surfaces[0].control
    return match(*surfaces, replace(ends_of(mesh), curves=rings_of(mesh)))


def errors(found: MatchResult) -> tuple[np.ndarray, np.ndarray]:
    """Distances between where vertices go and where they belong, and how far each is from the nearest ring."""
    target = found.target.triangles(found.target.finest_level)
    true = found.source.triangles(found.source.finest_level).positions
    rings = curve_pairs(found.target, found.source, rings_of(found.target.control))
    feet = [pair.target.line.nearest(target.positions)[0] for pair in rings]
    near = np.min([np.linalg.norm(places - target.positions, axis=1) for places in feet], axis=0)
    return np.linalg.norm(found.point_map.images.positions - true, axis=1), near


def test_a_map_is_right_where_curves_say_what_shape_cannot(without: MatchResult, with_curves: MatchResult) -> None:
    """The bar has no features: only curves know of the slide. Nothing gets worse far from them."""
    plain, near = errors(without)
    better, _ = errors(with_curves)
    close = near < 0.03
    assert plain[close].mean() > 0.05
    assert better[close].mean() < 0.15 * plain[close].mean()
    assert better[~close].mean() < plain[~close].mean()
    assert with_curves.quality.flipped_area <= without.quality.flipped_area + 1e-3


def test_the_distance_between_curves_is_stated(without: MatchResult, with_curves: MatchResult) -> None:
    assert without.curve_misses == ()
    assert [miss.name for miss in with_curves.curve_misses] == [f"ring {height}" for height in RINGS]
    assert max(miss.worst for miss in with_curves.curve_misses) < 0.01


@pytest.mark.slow
def test_where_a_loop_begins_and_which_way_it_runs_is_free(surfaces: tuple, with_curves: MatchResult) -> None:
    """The same points in another order ask for the same: only sums are taken in another order."""
    mesh, curves = surfaces[0].control, with_curves.landmarks.curves
    turned = [
        CurvePair.of_vertices(pair.name, np.roll(ring(mesh, height), 1)[::-1], ring(mesh, height), closed=True)
        for pair, height in zip(curves, RINGS, strict=True)
    ]
    again = match(*surfaces, replace(ends_of(mesh), curves=tuple(turned)))
    apart = np.linalg.norm(again.point_map.images.positions - with_curves.point_map.images.positions, axis=1)
    assert apart.max() < 1e-3
    assert apart.mean() < 1e-5


def test_curves_added_later_move_the_map(without: MatchResult) -> None:
    """The preview goes most of the way: closest points are found once, at the map before."""
    mesh = without.target.control
    preview = update_match(without, replace(without.landmarks, curves=rings_of(mesh)))
    before, near = errors(without)
    after, _ = errors(preview)
    assert after[near < 0.03].mean() < 0.4 * before[near < 0.03].mean()
    assert len(preview.curve_misses) == len(RINGS)


def test_a_result_keeps_its_curves(with_curves: MatchResult, tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", with_curves)
    stored = read_result(tmp_path / "RESULT")
    for read, written in zip(stored.landmarks.curves, with_curves.landmarks.curves, strict=True):
        assert read.name == written.name
        for kept, given_ in ((read.target, written.target), (read.source, written.source)):
            np.testing.assert_array_equal(kept.points.corners, given_.points.corners)
            assert kept.closed == given_.closed
    assert stored.manifest["curves"][0]["mean"] == pytest.approx(with_curves.curve_misses[0].mean)
    assert stored.curve_misses[0].mean == pytest.approx(with_curves.curve_misses[0].mean, abs=1e-9)


def test_a_damaged_curve_in_a_result_is_refused(with_curves: MatchResult, tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", with_curves)
    change_result(tmp_path / "RESULT", target_curve_corners=lambda array: array + 1000)
    with pytest.raises(FormatError, match="target_curve_corners"):
        read_result(tmp_path / "RESULT")


@pytest.mark.slow
def test_a_report_shows_curves(with_curves: MatchResult) -> None:
    pytest.importorskip("embreex")
    from cagemap.report import build_page, draw_gallery

    result = with_curves
    bare = replace(result, landmarks=replace(result.landmarks, curves=()))
    plain = draw_gallery(bare, size=(120, 90))
    drawn = draw_gallery(result, size=(120, 90))
    page = build_page(result, drawn)
    assert "ring 3" in page
    assert np.any(plain.maps[0].target != drawn.maps[0].target)


@pytest.mark.slow
def test_without_landmarks_curves_are_followed_by_every_coarse_fit(surfaces: tuple) -> None:
    rings = replace(Landmarks.none(), curves=rings_of(surfaces[0].control))
    problem = Problem.of_landmarks(PreparedPair.build(*surfaces), rings)
    for clusters in (problem.small_clusters, problem.coarse_clusters):
        start = clusters.energy.graph.positions
        assert len(clusters.constraints.curves) == len(RINGS)

        def miss(positions: np.ndarray, clusters: Clusters) -> float:
            """Largest mean distance of a ring's points from the other ring."""
            at = [(curve.anchors.of(positions), curve.source) for curve in clusters.constraints.curves]
            return max(np.linalg.norm(line.nearest(points)[0] - points, axis=1).mean() for points, line in at)

        assert miss(coarse_fit(problem, start, clusters).positions, clusters) < 0.15 * miss(start, clusters)


# ---- the term of the fit


def test_points_that_lie_on_the_other_curve_do_not_pull() -> None:
    """Wherever along it they lie: sliding is free."""
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = Polyline(np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]), closed=True)
    rows = np.sort(np.random.default_rng(3).choice(400, 120, replace=False))
    on = circle.positions[rows]
    curve = CurveConstraint(CagePoints.of_vertices(np.arange(120)), Polyline(on, closed=True), circle)
    blocks, forces = curve.terms(on)
    # Chords of the target lie inside the circle, by squares of their lengths.
    assert np.abs(forces).max() < 2e-3 * np.abs(blocks).max()
    tangents = np.column_stack([-on[:, 1], on[:, 0], 0 * on[:, 0]])
    along = np.einsum("ma,mab,mb->m", tangents, blocks, tangents)
    assert np.all(along < 0.02 * np.trace(blocks, axis1=1, axis2=2))


def test_ends_of_open_curves_pull_at_each_other() -> None:
    line = Polyline(np.column_stack([np.linspace(0, 1, 21), np.zeros(21), np.zeros(21)]), closed=False)
    short = line.positions[4:17:4]
    curve = CurveConstraint(CagePoints.of_vertices(np.arange(4)), Polyline(short, closed=False), line)
    _, forces = curve.terms(short)
    assert forces[0, 0] < -1e-3
    assert forces[-1, 0] > 1e-3
    np.testing.assert_allclose(forces[1:-1], 0.0, atol=1e-12)


# ---- curves on refined surfaces


@pytest.mark.parametrize(("mesh", "scheme"), [(cube(), CatmullClark()), (icosahedron(), Loop()), (cube(), Bilinear())])
def test_edge_vertices_are_the_rows_of_their_edges(mesh: ControlMesh, scheme: object) -> None:
    """In its row of S^l an edge's vertex has both ends at their largest weight."""
    refinement = refine(mesh, 3, scheme)
    edges = mesh_topology(mesh).edge_vertices
    found = refined_edges(refinement, edges, 1)[:, 1]
    rows = refinement.matrices[0].toarray()[found]
    assert len(np.unique(found)) == len(edges)
    np.testing.assert_array_equal(np.sort(np.argsort(-rows, axis=1, kind="stable")[:, :2], axis=1), edges)
    chains = refined_edges(refinement, edges, 3)
    assert chains.shape == (len(edges), 9)
    steps = np.linalg.norm(np.diff(refinement.levels[3].positions[chains], axis=1), axis=2)
    assert steps.max() < 0.5 * np.linalg.norm(mesh.positions[edges[:, 0]] - mesh.positions[edges[:, 1]], axis=1).max()
    np.testing.assert_array_equal(refined_edges(refinement, edges[:, ::-1], 3), chains[:, ::-1])
    np.testing.assert_array_equal(refined_edges(refinement, np.array([[0, 0], [-1, 2]]), 3), -1)


def test_a_curve_through_places_lies_on_the_surface_near_them(surfaces: tuple) -> None:
    """Places on the cage's faces; the straight lines between them are put on the refined surface."""
    mesh = surfaces[0].control
    top = ring(mesh, 3.0)
    places = 0.5 * (mesh.positions[top] + mesh.positions[np.roll(top, -1)])
    points = NamedPoints((), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), "", (_through(places),))
    landmarks, notes = pair_by_name(points, points, mesh, mesh)
    check_landmarks(landmarks, mesh, mesh)
    assert notes == ()
    pair = curve_pairs(surfaces[0], surfaces[0], landmarks.curves)[0]
    vertices = curve_pairs(surfaces[0], surfaces[0], rings_of(mesh)[1:2])[0]
    assert len(pair.target.points) == 4 * 8
    away = vertices.target.line.nearest(pair.target.line.positions)[0] - pair.target.line.positions
    assert np.linalg.norm(away, axis=1).max() < 0.05


def _through(places: np.ndarray):
    from cagemap.mesh.cage_points import NamedCurve

    return NamedCurve("belt", np.full(len(places), -1), places, closed=True)


def test_curves_give_the_start_coordinates_and_no_vertex_twice(surfaces: tuple) -> None:
    """Both rings, and the first once more, which has no vertices of its own left."""
    mesh = surfaces[0].control
    rings, landmarks = rings_of(mesh), ends_of(mesh)
    landmarks = replace(landmarks, curves=(*rings, replace(rings[0], name="again")))
    pair = Pair(*surfaces, point_pairs(*surfaces, landmarks))
    problem = Problem(PreparedPair.build(*surfaces), pair.landmarks)
    for side, near, surface, level in zip(
        curve_vertices(problem), problem.landmark_vertices, surfaces, problem.prepared.levels, strict=True
    ):
        assert len(side) == len(rings)
        listed = np.concatenate([near, *side])
        assert len(np.unique(listed)) == len(listed) <= surface.triangles(level).n
        for own in side:
            assert 3 <= len(own) <= StartConfig.curve_points


def test_constraints_of_a_curve_are_the_mean_of_its_points(surfaces: tuple) -> None:
    pair = curve_pairs(*surfaces, rings_of(surfaces[0].control))[0]
    surface, curve = surfaces[0], pair.target
    vertices = curve.points.corners[np.arange(len(curve.points)), curve.points.barycentric.argmax(axis=1)]
    expected = curve.line.point_shares @ surface.basis.rows(surface.finest_level, vertices)
    np.testing.assert_allclose(curve_rows(surface, [curve])[0], expected, atol=1e-10)
