"""Curves: read, checked, put on refined surfaces, followed by the fit, stored and shown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, voxels
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.deform.config import StartConfig
from cagemap.deform.constraints import Anchors, CurveConstraint
from cagemap.deform.multi_start import curve_vertices
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.errors import FormatError, InvalidLandmarksError
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import ARRAYS, read_result, write_result
from cagemap.maps.pair import Pair, point_pairs
from cagemap.maps.places import curve_pairs, edge_vertices, refined_edges
from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop, Plain
from cagemap.mesh.curves import CageCurves, Curves, chain_of_edges, curve_faults
from cagemap.mesh.landmarks import Landmarks, NamedPoints, check_landmarks, paired
from cagemap.mesh.parts import join_meshes
from cagemap.mesh.topology import mesh_topology
from cagemap.paper.constraints import curve_rows
from cagemap.pipeline import MatchResult, match, update_match
from cagemap.spectral.surface import prepare_surfaces
from cagemap.subdivision import refine
from cagemap.surface.polylines import Polyline
from cagemap.tasks.match_parts import PartInputs, ready_inputs

LENGTH = 6
# Heights that the rings of the source's bar stand at instead of 0 to 6: a slide along a bar that looks the same.
SLID = np.array([0.0, 0.7, 1.4, 2.3, 3.6, 4.9, 6.0])
RINGS = (2, 3, 4)


def bar() -> ControlMesh:
    """A bar of cubes along z, featureless between its ends."""
    mesh = voxels(np.column_stack([np.zeros((LENGTH, 2), dtype=np.int64), np.arange(LENGTH)]))
    return replace(mesh, positions=mesh.positions + 0.5, name="bar.obj")


def ring(mesh: ControlMesh, height: float) -> np.ndarray:
    """Vertices around a bar at a height, in order."""
    here = np.flatnonzero(np.isclose(mesh.positions[:, 2], height))
    centre = mesh.positions[here].mean(axis=0)
    return here[np.argsort(np.arctan2(*(mesh.positions[here] - centre).T[:2]))]


def slid(mesh: ControlMesh) -> ControlMesh:
    """The bar with its rings slid along it: the same shape, other places."""
    positions = mesh.positions.copy()
    positions[:, 2] = np.interp(positions[:, 2], np.arange(LENGTH + 1), SLID)
    return replace(mesh, positions=positions, name="slid.obj")


def rings_of(mesh: ControlMesh) -> Curves:
    """The rings in the middle of a bar, the same control vertices on both sides."""
    chains = [ring(mesh, height) for height in RINGS]
    lines = CageCurves.of_vertices(chains, [True] * len(chains))
    return Curves(tuple(f"ring {height}" for height in RINGS), lines, lines)


def ends_of(mesh: ControlMesh) -> Landmarks:
    """The eight corners of a bar as landmarks."""
    corners = np.concatenate([ring(mesh, 0), ring(mesh, LENGTH)])
    return Landmarks(tuple(map(str, corners)), corners, corners, "bar.obj", "slid.obj")


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
    target = found.target.triangles(found.target.finest)
    true = found.source.triangles(found.source.finest).positions
    rings = curve_pairs(found.target, found.source, rings_of(found.target.control))
    feet = [pair.target.line.nearest(target.positions).places for pair in rings]
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


def test_where_a_loop_begins_and_which_way_it_runs_is_free(surfaces: tuple, with_curves: MatchResult) -> None:
    """The same points in another order ask for the same: only sums are taken in another order."""
    mesh, curves = surfaces[0].control, with_curves.landmarks.curves
    chains = [np.roll(ring(mesh, height), 1)[::-1] for height in RINGS]
    turned = Curves(curves.names, CageCurves.of_vertices(chains, [True] * 3), curves.source)
    again = match(*surfaces, replace(ends_of(mesh), curves=turned))
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
    curves = with_curves.landmarks.curves
    assert stored.curves.names == curves.names
    for side in ("target", "source"):
        kept, given_ = getattr(stored.curves, side), getattr(curves, side)
        np.testing.assert_array_equal(kept.points.corners, given_.points.corners)
        np.testing.assert_array_equal(kept.starts, given_.starts)
        np.testing.assert_array_equal(kept.closed, given_.closed)
    assert stored.manifest["curves"][0]["mean"] == pytest.approx(with_curves.curve_misses[0].mean)
    assert stored.curve_misses[0].mean == pytest.approx(with_curves.curve_misses[0].mean, abs=1e-9)


def test_a_damaged_curve_in_a_result_is_refused(with_curves: MatchResult, tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", with_curves)
    arrays = dict(np.load(tmp_path / "RESULT" / ARRAYS))
    np.savez(tmp_path / "RESULT" / ARRAYS, **arrays | {"target_curve_corners": arrays["target_curve_corners"] + 1000})
    with pytest.raises(FormatError, match="target_curve_corners"):
        read_result(tmp_path / "RESULT")


def test_a_report_shows_curves(with_curves: MatchResult) -> None:
    pytest.importorskip("embreex")
    from cagemap.report import build_page, draw_gallery

    result = with_curves
    bare = replace(result, landmarks=replace(result.landmarks, curves=Curves.none()))
    plain = draw_gallery(bare, size=(120, 90))
    drawn = draw_gallery(result, size=(120, 90))
    page = build_page(result, drawn)
    assert "ring 3" in page
    assert np.any(plain.maps[0].target != drawn.maps[0].target)


@pytest.mark.slow
def test_without_landmarks_a_curve_is_followed_too(surfaces: tuple) -> None:
    found = match(*surfaces, replace(Landmarks.none(), curves=rings_of(surfaces[0].control)))
    assert max(miss.mean for miss in found.curve_misses) < 0.02


# ---- the term of the fit


def test_points_that_lie_on_the_other_curve_do_not_pull() -> None:
    """Wherever along it they lie: sliding is free."""
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = Polyline(np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]), closed=True)
    rows = np.sort(np.random.default_rng(3).choice(400, 120, replace=False))
    on = circle.positions[rows]
    curve = CurveConstraint(Anchors.of_vertices(np.arange(120)), Polyline(on, closed=True), circle)
    blocks, forces = curve.terms(on)
    # Chords of the target lie inside the circle, by squares of their lengths.
    assert np.abs(forces).max() < 2e-3 * np.abs(blocks).max()
    tangents = np.column_stack([-on[:, 1], on[:, 0], 0 * on[:, 0]])
    along = np.einsum("ma,mab,mb->m", tangents, blocks, tangents)
    assert np.all(along < 0.02 * np.trace(blocks, axis1=1, axis2=2))


def test_ends_of_open_curves_pull_at_each_other() -> None:
    line = Polyline(np.column_stack([np.linspace(0, 1, 21), np.zeros(21), np.zeros(21)]), closed=False)
    short = line.positions[4:17:4]
    curve = CurveConstraint(Anchors.of_vertices(np.arange(4)), Polyline(short, closed=False), line)
    _, forces = curve.terms(short)
    assert forces[0, 0] < -1e-3
    assert forces[-1, 0] > 1e-3
    np.testing.assert_allclose(forces[1:-1], 0.0, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(4, 30), st.booleans(), st.integers(0, 2**32 - 1))
def test_nearest_points_of_a_polyline_are_nearest(count: int, closed: bool, seed: int) -> None:
    """Against dense points of it."""
    random = np.random.default_rng(seed)
    angles = np.linspace(0, 2 * np.pi if closed else 4.0, count, endpoint=not closed)
    line = Polyline(np.column_stack([np.cos(angles), np.sin(angles), 0.2 * np.sin(2 * angles)]), closed)
    points = line.positions[random.integers(count, size=20)] + 0.05 * random.normal(size=(20, 3))
    feet = line.nearest(points)
    dense = np.vstack([line.finer(500), line.positions[-1:]])
    expected = np.linalg.norm(points[:, None] - dense[None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(feet.places - points, axis=1), expected, atol=4e-3)
    first, second = (line.positions[feet.ends[:, side]] for side in (0, 1))
    mixed = first + feet.share[:, None] * (second - first)
    np.testing.assert_allclose(mixed, feet.places, atol=1e-12)


def test_the_nearest_point_may_lie_on_a_piece_away_from_the_nearest_vertex() -> None:
    """Thin closed curves, such as eyelids: the nearest vertex is the other lid's."""
    lid = np.array([[0.0, 0, 0], [10, 0, 0], [10, 1, 0], [5, 1, 0]])
    feet = Polyline(lid, closed=False).nearest(np.array([[5, 0.4, 0.0]]))
    np.testing.assert_allclose(feet.places, [[5, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(feet.ends, [[0, 1]])
    np.testing.assert_allclose(feet.share, [0.5])
    np.testing.assert_allclose(feet.tangents, [[1, 0, 0]])


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 30), st.booleans(), st.integers(0, 2**32 - 1))
def test_nearest_points_are_the_best_of_all_pieces(count: int, closed: bool, seed: int) -> None:
    """Tangled lines, some of whose pieces have no length."""
    random = np.random.default_rng(seed)
    positions = random.normal(size=(count, 3))
    positions[1:][random.random(count - 1) < 0.2] = positions[0]
    points = random.normal(size=(20, 3))
    feet = Polyline(positions, closed).nearest(points)
    starts, stops = positions if closed else positions[:-1], np.roll(positions, -1, axis=0)[: count - (not closed)]
    along = stops - starts
    share = ((points[:, None] - starts) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    places = starts + np.clip(share, 0, 1)[:, :, None] * along
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(feet.places - points, axis=1), expected, atol=1e-12)


def test_a_line_without_length_has_one_nearest_point() -> None:
    for closed in (False, True):
        feet = Polyline(np.ones((2, 3)), closed).nearest(np.zeros((1, 3)))
        np.testing.assert_array_equal(feet.places, [[1, 1, 1]])
        np.testing.assert_array_equal(feet.tangents, [[0, 0, 0]])


def test_lengths_of_a_polyline_are_shared_out() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert Polyline(square, closed=True).length == pytest.approx(4.0)
    np.testing.assert_allclose(Polyline(square, closed=False).shares, [0.5, 1.0, 1.0, 0.5])
    assert len(Polyline(square, closed=False).spread(2)) == 2


# ---- curves on refined surfaces


@pytest.mark.parametrize(("mesh", "scheme"), [(cube(), CatmullClark()), (icosahedron(), Loop()), (cube(), Bilinear())])
def test_edge_vertices_are_the_rows_of_their_edges(mesh: ControlMesh, scheme: object) -> None:
    """In its row of S^l an edge's vertex has both ends at their largest weight."""
    refinement = refine(mesh, 3, scheme)  # type: ignore[arg-type]
    edges = mesh_topology(mesh).edge_vertices
    found = edge_vertices(refinement, 0, edges)
    rows = refinement.matrices[0].toarray()[found]
    assert len(np.unique(found)) == len(edges)
    np.testing.assert_array_equal(np.sort(np.argsort(-rows, axis=1, kind="stable")[:, :2], axis=1), edges)
    chains = refined_edges(refinement, edges, 3)
    assert chains.shape == (len(edges), 9)
    steps = np.linalg.norm(np.diff(refinement.levels[3].positions[chains], axis=1), axis=2)
    assert steps.max() < 0.5 * np.linalg.norm(mesh.positions[edges[:, 0]] - mesh.positions[edges[:, 1]], axis=1).max()
    assert edge_vertices(refinement, 0, np.array([[0, 0], [-1, 2]])).tolist() == [-1, -1]


def test_a_curve_through_places_lies_on_the_surface_near_them(surfaces: tuple) -> None:
    """Places on the cage's faces; the straight lines between them are put on the refined surface."""
    mesh = surfaces[0].control
    top = ring(mesh, 3.0)
    places = 0.5 * (mesh.positions[top] + mesh.positions[np.roll(top, -1)])
    points = NamedPoints((), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), "", (_through(places),))
    landmarks, notes = paired(points, points, mesh, mesh)
    check_landmarks(landmarks, mesh, mesh)
    assert notes == ()
    pair = curve_pairs(surfaces[0], surfaces[0], landmarks.curves)[0]
    vertices = curve_pairs(surfaces[0], surfaces[0], rings_of(mesh).only([1]))[0]
    assert len(pair.target.points) == 4 * 8
    away = vertices.target.line.nearest(pair.target.line.positions).places - pair.target.line.positions
    assert np.linalg.norm(away, axis=1).max() < 0.05


def _through(places: np.ndarray):
    from cagemap.mesh.cage_points import NamedCurve

    return NamedCurve("belt", np.full(len(places), -1), places, closed=True)


def test_curves_give_the_start_coordinates_and_no_vertex_twice(surfaces: tuple) -> None:
    """Both rings, and the first once more, which has no vertices of its own left."""
    mesh = surfaces[0].control
    rings, landmarks = rings_of(mesh), ends_of(mesh)
    again = Curves(("again",), rings.target.at([0]), rings.source.at([0]))
    landmarks = replace(landmarks, curves=rings.joined_with(again))
    pair = Pair(*surfaces, point_pairs(*surfaces, landmarks))
    problem = Problem(PreparedPair.build(*surfaces), pair)
    for side, near, surface, level in zip(
        curve_vertices(problem), problem.landmark_vertices, surfaces, problem.prepared.levels, strict=True
    ):
        assert len(side) == len(rings)
        listed = np.concatenate([near, *side])
        assert len(np.unique(listed)) == len(listed) <= surface.triangles(level).n
        for own in side:
            assert 3 <= len(own) <= StartConfig.curve_points


def test_descriptors_of_a_curve_are_the_mean_of_its_points(surfaces: tuple) -> None:
    pair = curve_pairs(*surfaces, rings_of(surfaces[0].control))[0]
    surface, curve = surfaces[0], pair.target
    vertices = curve.points.corners[np.arange(len(curve.points)), curve.points.barycentric.argmax(axis=1)]
    expected = curve.shares @ surface.basis.rows(surface.finest, vertices)
    np.testing.assert_allclose(curve_rows(surface, [curve])[0], expected, atol=1e-10)


# ---- files and checks


@settings(max_examples=50, deadline=None)
@given(st.integers(3, 12), st.booleans(), st.integers(0, 2**32 - 1))
def test_edges_in_any_order_make_the_chain(count: int, closed: bool, seed: int) -> None:
    random = np.random.default_rng(seed)
    chain = random.permutation(100)[:count]
    edges = np.column_stack([chain, np.roll(chain, -1)])[: count if closed else -1]
    flipped = np.where(random.random(len(edges))[:, None] < 0.5, edges, edges[:, ::-1])
    found, loop = chain_of_edges(random.permutation(flipped))
    assert loop == closed
    assert {frozenset(e) for e in np.column_stack([found, np.roll(found, -1)])[: count if closed else -1].tolist()} == {
        frozenset(e) for e in edges.tolist()
    }


@pytest.mark.parametrize(
    ("edges", "said"), [([[0, 1], [1, 2], [1, 3]], "branch at vertex 1"), ([[0, 1], [2, 3]], "pieces"),
                        ([[0, 1], [1, 2], [2, 0], [5, 6], [6, 7], [7, 5]], "pieces")]
)  # fmt: skip
def test_edges_of_more_than_one_chain_are_refused(edges: list, said: str) -> None:
    with pytest.raises(InvalidLandmarksError, match=said):
        chain_of_edges(np.array(edges))


def test_every_fault_of_curves_is_named() -> None:
    mesh = bar()
    around = ring(mesh, 3.0)

    def faults(*chains: np.ndarray, closed: bool = True, source_closed: bool = True) -> str:
        names = tuple("ab"[: len(chains)])
        sides = [CageCurves.of_vertices(chains, [flag] * len(chains)) for flag in (closed, source_closed)]
        return " ".join(curve_faults(Curves(names, *sides), mesh, mesh))

    assert faults(around) == ""
    assert f"a ({around[0]} to {around[2]})" in faults(around[[0, 2, 3]])
    assert "a (999)" in faults(np.array([*around, 999]))
    assert "closed on one only: a" in faults(around, source_closed=False)
    assert f"a ({around[0]})" in faults(np.array([around[0], around[1], around[0], around[3]]))
    assert "fewer: a" in faults(around[:2])
    lines = CageCurves.of_vertices([around[[0, 2, 3]]], [True])
    broken = replace(Landmarks.none(), curves=Curves(("a",), lines, lines))
    with pytest.raises(InvalidLandmarksError, match="joined by edges"):
        check_landmarks(broken, mesh, mesh)


def test_files_of_pairs_hold_curves(tmp_path: Path) -> None:
    mesh = bar()
    rings = rings_of(mesh)
    backwards = CageCurves.of_vertices([ring(mesh, height)[::-1] for height in RINGS], [True] * len(RINGS))
    landmarks = replace(ends_of(mesh), curves=replace(rings, source=backwards))
    write_landmarks(tmp_path / "pairs.json", landmarks)
    read, _ = read_landmarks(tmp_path / "pairs.json", "bar.obj", "slid.obj")
    assert read.curves.names == landmarks.curves.names
    np.testing.assert_array_equal(read.curves.target.points.vertices, rings.target.points.vertices)
    np.testing.assert_array_equal(read.curves.source.points.vertices, backwards.points.vertices)
    assert read.curves.source.closed.all()
    turned = read.reversed().curves
    np.testing.assert_array_equal(turned.target.points.vertices, read.curves.source.points.vertices)


def test_curves_are_read_as_chains_edges_and_loops_that_come_back(tmp_path: Path) -> None:
    entry = {"name": "lips", "target": [3, 4, 9, 3], "source": [[9, 4], [3, 9], [4, 3]]}
    (tmp_path / "c.json").write_text(json.dumps({"target": "t.obj", "source": "s.obj", "curves": [entry]}))
    read, _ = read_landmarks(tmp_path / "c.json", "t.obj", "s.obj")
    assert len(read) == 0
    assert read.curves.target.closed.tolist() == read.curves.source.closed.tolist() == [True]
    assert read.curves.target.points.vertices.tolist() == [3, 4, 9]
    assert sorted(read.curves.source.points.vertices.tolist()) == [3, 4, 9]


@pytest.mark.parametrize(
    "entry",
    [{"name": "a"}, {"name": "a", "target": [1, 2], "source": ["x", 3]}, {"name": "a", "target": [True], "source": [1]},
     7, {"name": 3}, {"name": "a", "target": [[1, 2, 3]], "source": [1, 2]}, {"name": "a", "closed": "yes"}],
)  # fmt: skip
def test_entries_of_another_form_are_refused_by_number(entry: object, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps({"curves": [entry]}))
    with pytest.raises(FormatError, match="curve"):
        read_landmarks(tmp_path / "c.json", "t.obj", "s.obj")


def test_files_of_one_mesh_hold_curves_and_missing_ones_are_reported(tmp_path: Path) -> None:
    mesh = bar()
    belts = {"points": [], "curves": [{"name": "belt", "vertices": ring(mesh, 3.0).tolist(), "closed": True}]}
    (tmp_path / "a.json").write_text(json.dumps(belts))
    more = {**belts, "curves": [*belts["curves"], {"name": "hem", "vertices": ring(mesh, 2.0).tolist()}]}
    (tmp_path / "b.json").write_text(json.dumps(more))
    ours, theirs = (read_points(tmp_path / f"{name}.json") for name in "ab")
    landmarks, notes = paired(ours, theirs, mesh, mesh)
    assert landmarks.curves.names == ("belt",)
    assert notes == ("curves only on the source, which were not used: hem",)
    write_points(tmp_path / "c.json", theirs, mesh)
    again = read_points(tmp_path / "c.json")
    assert [curve.name for curve in again.curves] == ["belt", "hem"]
    assert [curve.closed for curve in again.curves] == [True, False]
    with pytest.raises(FormatError, match="MeshLab"):
        write_points(tmp_path / "c.pp", theirs, mesh)


def test_curves_of_3d_slicer_are_read(tmp_path: Path) -> None:
    points = [{"label": str(i), "position": [float(i), 0.0, 0.0]} for i in range(3)]
    markups = [
        {"type": "ClosedCurve", "name": "eye", "coordinateSystem": "LPS", "controlPoints": points},
        {"type": "Curve", "coordinateSystem": "RAS", "controlPoints": points},
        {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": points[:1]},
    ]
    (tmp_path / "face.mrk.json").write_text(json.dumps({"markups": markups}))
    read = read_points(tmp_path / "face.mrk.json")
    assert [(curve.name, curve.closed, len(curve.positions)) for curve in read.curves] == [
        ("eye", True, 3),
        ("face", False, 3),
    ]
    assert read.curves[1].positions[2, 0] == -2.0
    assert len(read.names) == 1


def test_the_command_takes_curves_and_says_how_they_are_met(tmp_path: Path) -> None:
    mesh = bar()
    write_mesh(tmp_path / "bar.obj", mesh)
    write_mesh(tmp_path / "slid.obj", slid(mesh))
    write_landmarks(tmp_path / "ends.json", ends_of(mesh))
    names = Landmarks.none()
    rings = replace(names, target_name="bar.obj", source_name="slid.obj", curves=rings_of(mesh))
    write_landmarks(tmp_path / "rings.json", rings)
    said = CliRunner().invoke(
        app,
        ["match", "-t", str(tmp_path / "bar.obj"), "-s", str(tmp_path / "slid.obj"), "-o", str(tmp_path / "RESULT"),
         "--landmarks", str(tmp_path / "ends.json"), "--curves", str(tmp_path / "rings.json"), "--level", "2"],
    )  # fmt: skip
    assert said.exit_code == 0, said.output
    assert "3 curves missed by 0.0" in said.output
    assert len(read_result(tmp_path / "RESULT").curves) == 3


def test_curves_on_pieces_that_are_set_aside_are_told() -> None:
    """As landmarks are: who drew a curve there wants to know that it says nothing."""
    away = cube().with_positions(0.1 * cube().positions + 20.0)
    scan = replace(join_meshes([creature(), away]), scheme=Plain())
    n = creature().n_vertices
    lines = CageCurves.of_vertices([scan.face(0)[:2], n + cube().face(0)[:2]], [False, False])
    landmarks = replace(Landmarks.none(), curves=Curves(("kept", "lost"), lines, lines))
    ready = ready_inputs(PartInputs(scan, scan, landmarks))
    assert ready.landmarks.curves.names == ("kept",)
    assert any("1 of 2 curves" in note for note in ready.notes)
