"""Curves in files, and what is wrong with them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import FormatError, InvalidLandmarksError
from cagemap.files.landmarks.curves import chain_of_edges
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result
from cagemap.mesh import Plain
from cagemap.mesh.curves import Curve, CurvePair, curve_faults
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name
from cagemap.mesh.parts import join_meshes
from cagemap.tasks.match_parts import PartInputs, ready_inputs

from command_line import Run
from curved_bar import bar, ends_of, ring, rings_of, slid
from refusals import refuses


@settings(max_examples=50)
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
    refuses(InvalidLandmarksError, said, chain_of_edges, np.array(edges))


def test_every_fault_of_curves_is_named() -> None:
    mesh = bar()
    around = ring(mesh, 3.0)

    def faults(*chains: np.ndarray, closed: bool = True, source_closed: bool = True) -> str:
        pairs = [
            CurvePair(name, Curve.of_vertices(chain, closed), Curve.of_vertices(chain, source_closed))
            for name, chain in zip("ab", chains, strict=False)
        ]
        return " ".join(curve_faults(tuple(pairs), mesh, mesh))

    assert faults(around) == ""
    assert f"a ({around[0]} to {around[2]})" in faults(around[[0, 2, 3]])
    assert "a (999)" in faults(np.array([*around, 999]))
    assert "closed on one only: a" in faults(around, source_closed=False)
    assert f"a ({around[0]})" in faults(np.array([around[0], around[1], around[0], around[3]]))
    assert "fewer: a" in faults(around[:2])
    pinched = mesh.with_positions(mesh.positions.copy())
    pinched.positions[around[:2]] = 1.0, 2.0, 3.0
    point = CurvePair.of_vertices("a", around[:2], around[1:3], closed=False)
    assert curve_faults((point,), mesh, mesh) == []
    (flat,) = curve_faults((point,), pinched, mesh)
    assert "curves of the target with a length, got all points at one place: a at (1, 2, 3)" in flat
    chain = around[[0, 2, 3]]
    broken = replace(Landmarks.none(), curves=(CurvePair.of_vertices("a", chain, chain, closed=True),))
    refuses(InvalidLandmarksError, "joined by edges", check_landmarks, broken, mesh, mesh)


def test_files_of_pairs_hold_curves(tmp_path: Path) -> None:
    mesh = bar()
    rings = tuple(
        replace(pair, source=Curve.of_vertices(pair.source.points.vertices[::-1], closed=True))
        for pair in rings_of(mesh)
    )
    landmarks = replace(ends_of(mesh), curves=rings)
    write_landmarks(tmp_path / "pairs.json", landmarks)
    read, _ = read_landmarks(tmp_path / "pairs.json", "bar.obj", "slid.obj")
    for pair, written, turned in zip(read.curves, rings, read.reversed().curves, strict=True):
        assert pair.name == written.name
        np.testing.assert_array_equal(pair.target.points.vertices, written.target.points.vertices)
        np.testing.assert_array_equal(pair.source.points.vertices, written.source.points.vertices)
        assert pair.source.closed
        np.testing.assert_array_equal(turned.target.points.vertices, pair.source.points.vertices)


def test_curves_are_read_as_chains_edges_and_loops_that_come_back(tmp_path: Path) -> None:
    entry = {"name": "lips", "target": [3, 4, 9, 3], "source": [[9, 4], [3, 9], [4, 3]]}
    (tmp_path / "c.json").write_text(json.dumps({"target": "t.obj", "source": "s.obj", "curves": [entry]}))
    read, _ = read_landmarks(tmp_path / "c.json", "t.obj", "s.obj")
    assert len(read) == 0
    (lips,) = read.curves
    assert lips.target.closed
    assert lips.source.closed
    assert lips.target.points.vertices.tolist() == [3, 4, 9]
    assert sorted(lips.source.points.vertices.tolist()) == [3, 4, 9]


@pytest.mark.parametrize(
    "entry",
    [{"name": "a"}, {"name": "a", "target": [1, 2], "source": ["x", 3]}, {"name": "a", "target": [True], "source": [1]},
     7, {"name": 3}, {"name": "a", "target": [[1, 2, 3]], "source": [1, 2]}, {"name": "a", "closed": "yes"}],
)  # fmt: skip
def test_entries_of_another_form_are_refused_by_number(entry: object, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps({"curves": [entry]}))
    refuses(FormatError, "curve", read_landmarks, tmp_path / "c.json", "t.obj", "s.obj")


def test_files_of_one_mesh_hold_curves_and_missing_ones_are_reported(tmp_path: Path) -> None:
    mesh = bar()
    belts = {"points": [], "curves": [{"name": "belt", "vertices": ring(mesh, 3.0).tolist(), "closed": True}]}
    (tmp_path / "a.json").write_text(json.dumps(belts))
    more = {**belts, "curves": [*belts["curves"], {"name": "hem", "vertices": ring(mesh, 2.0).tolist()}]}
    (tmp_path / "b.json").write_text(json.dumps(more))
    ours, theirs = (read_points(tmp_path / f"{name}.json") for name in "ab")
    landmarks, notes = pair_by_name(ours, theirs, mesh, mesh)
    assert [pair.name for pair in landmarks.curves] == ["belt"]
    assert notes == ("curves only on the source, which were not used: hem",)
    write_points(tmp_path / "c.json", theirs, mesh)
    again = read_points(tmp_path / "c.json")
    assert [curve.name for curve in again.curves] == ["belt", "hem"]
    assert [curve.closed for curve in again.curves] == [True, False]
    refuses(FormatError, "MeshLab", write_points, tmp_path / "c.pp", theirs, mesh)


@pytest.mark.parametrize("closed", [False, True])
def test_a_first_position_repeated_at_the_end_closes_a_curve(closed: bool, tmp_path: Path) -> None:
    positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    entry = {"name": "lips", "positions": [*positions, positions[0]], "closed": closed}
    (tmp_path / "a.json").write_text(json.dumps({"points": [], "curves": [entry]}))
    (curve,) = read_points(tmp_path / "a.json").curves
    assert curve.closed
    assert curve.positions.tolist() == positions
    assert curve.vertices.tolist() == [-1, -1, -1]


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


@pytest.mark.slow
def test_the_command_takes_curves_and_says_how_they_are_met(run: Run, tmp_path: Path, one_start: None) -> None:
    mesh = bar()
    write_mesh(tmp_path / "bar.obj", mesh)
    write_mesh(tmp_path / "slid.obj", slid(mesh))
    write_landmarks(tmp_path / "ends.json", ends_of(mesh))
    names = Landmarks.none()
    rings = replace(names, target_name="bar.obj", source_name="slid.obj", curves=rings_of(mesh))
    write_landmarks(tmp_path / "rings.json", rings)
    said = run.done("match -t bar.obj -s slid.obj -o RESULT --landmarks ends.json --curves rings.json --level 1 -k 20")
    assert "3 curves missed by 0.0" in said.out
    assert len(read_result(tmp_path / "RESULT").landmarks.curves) == 3


def test_curves_on_pieces_that_are_set_aside_are_told() -> None:
    away = cube().with_positions(0.1 * cube().positions + 20.0)
    scan = replace(join_meshes([creature(), away]), scheme=Plain())
    n = creature().n_vertices
    chains = {"kept": scan.face(0)[:2], "lost": n + cube().face(0)[:2]}
    curves = tuple(CurvePair.of_vertices(name, chain, chain, closed=False) for name, chain in chains.items())
    landmarks = replace(Landmarks.none(), curves=curves)
    ready = ready_inputs(PartInputs(scan, scan, landmarks))
    assert [pair.name for pair in ready.landmarks.curves] == ["kept"]
    assert any("1 of 2 curves" in note for note in ready.notes)
