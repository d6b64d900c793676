"""The next landmark: where answers differ, where the map is doubtful, and far from the landmarks there are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.cli import main
from cagemap.errors import ParameterError
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.result.folder import write_result
from cagemap.maps.pair import nearest_free_vertices
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import Curve, CurvePair
from cagemap.mesh.landmarks import Landmarks
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.suggest import SuggestRequest
from cagemap.tasks.suggest import run_suggest, suggested_landmarks, suggested_vertices

from example_result import identity_result


def line(count: int = 11) -> np.ndarray:
    return np.column_stack([np.linspace(0, 1, count), np.zeros((count, 2))])


def test_where_answers_differ_comes_first_and_then_what_is_far() -> None:
    places, trust = line(), np.ones(11)
    others = places[None].copy()
    others[0, 7] += (0, 0.9, 0)
    found = suggested_vertices(places, places, others, trust, np.array([0]), 2)
    assert found[0] == 7
    assert found[1] in (3, 4)  # then the middle of what is left, where no landmark is near
    assert suggested_vertices(places, places, others[:0], trust, np.array([0]), 1).tolist() == [10]
    counted = (places[:, 0] < 0.75).astype(float)  # the source lacks the end
    assert suggested_vertices(places, places, others[:0], trust, np.array([0]), 1, counted).tolist() == [7]


def test_doubt_counts_and_known_landmarks_do_not_come_again() -> None:
    places, trust = line(), np.ones(11)
    trust[6] = 0.0
    found = suggested_vertices(places, places, np.zeros((0, 11, 3)), trust, np.array([0, 10]), 9)
    assert found[0] == 6
    assert sorted(found) == list(range(1, 10))
    with pytest.raises(ParameterError, match="1 to 9 further"):
        suggested_vertices(places, places, np.zeros((0, 11, 3)), trust, np.array([0, 10]), 10)


def test_partners_are_near_and_different() -> None:
    places = line()
    assert nearest_free_vertices(places, places[[4, 4, 9]], np.array([4])).tolist() in ([5, 3, 9], [3, 5, 9])


def test_the_command_writes_a_landmark_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    result = identity_result(2)
    write_result("R", result)
    monkeypatch.setattr("sys.argv", ["cagemap", "suggest", "R", "--count", "2", "-o", "more.json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    new = suggested_landmarks(result, 2).target[-1]  # the map is the identity
    target, source = (side.control.file_vertex(new) for side in (result.target, result.source))
    assert f"suggested 2: target vertex {target}, now on source vertex {source}" in capsys.readouterr().out
    found = read_landmarks(tmp_path / "more.json", "large.obj", "small.obj")[0]
    assert found.names == (*result.landmarks.names, "suggested 1", "suggested 2")
    assert len(set(found.target.tolist())) == len(found)
    np.testing.assert_array_equal(found.target, found.source)  # the map is the identity


def test_points_between_vertices_and_curves_are_kept() -> None:
    result = identity_result(2)
    control = result.target.control
    ring = control.face_indices[: int(control.face_sizes[0])]
    between = CagePoints(ring[None, :3], np.array([[0.5, 0.25, 0.25]]))
    curves = (CurvePair.of_vertices("rim", ring, ring, closed=True),)
    given = replace(Landmarks.of_points(("cheek",), between, between, "large.obj", "small.obj"), curves=curves)
    more = suggested_landmarks(replace(result, landmarks=given), 1)
    np.testing.assert_array_equal(more.target_points.weights[0], between.weights[0])
    np.testing.assert_array_equal(more.source_points.corners[0], between.corners[0])
    assert more.target[1] not in (-1, between.heaviest_corners[0])
    assert [pair.name for pair in more.curves] == ["rim"]


def test_curves_through_points_between_vertices_are_left_out_with_a_warning(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = identity_result(2)
    ring = result.target.control.face_indices[:4]
    between = CagePoints(ring[[[0, 1, 2], [1, 2, 3]]], np.array([[0.5, 0.25, 0.25], [0.0, 0.5, 0.5]]))
    curves = (CurvePair("lid", *2 * [Curve(between, False)]), CurvePair.of_vertices("rim", ring, ring, closed=True))
    write_result("R", replace(result, landmarks=replace(result.landmarks, curves=curves)))
    summary, warnings = run_suggest(SuggestRequest(Path("R"), Path("more.json"), count=1), Stages())
    assert "suggested 1" in summary
    (warning,) = warnings
    assert warning.startswith("curve 'lid'")
    assert [pair.name for pair in read_landmarks("more.json", "large.obj", "small.obj")[0].curves] == ["rim"]
