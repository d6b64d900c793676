"""Landmarks: files read and write exactly, exchanged meshes are refused, pairs must fit the two meshes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, torus
from hypothesis import given
from hypothesis import strategies as st
from test_obj import QUICK

from cagemap.errors import DirectionError, FormatError, InvalidLandmarksError
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh.cage_points import CagePoints, NamedPoints
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name

PAIRS = [{"name": name, "source": 2 * i, "target": i} for i, name in enumerate(("nose", "tail", "left hoof", "navel"))]


def write_file(folder: Path, source: str = "zebra.obj", target: str = "horse.obj", pairs: object = PAIRS) -> Path:
    file = folder / "pairs.json"
    file.write_text(json.dumps({"source": source, "target": target, "pairs": pairs}))
    return file


def landmarks(count: int = 4) -> Landmarks:
    return Landmarks(tuple(f"mark {i}" for i in range(count)), np.arange(count), np.arange(count) * 2, "cube", "torus")


def test_file_is_read_as_it_says(tmp_path: Path) -> None:
    marks, notes = read_landmarks(write_file(tmp_path), target="horse.obj", source="zebra.obj")
    assert marks.names == ("nose", "tail", "left hoof", "navel")
    assert marks.target.tolist() == [0, 1, 2, 3]
    assert marks.source.tolist() == [0, 2, 4, 6]
    assert marks.target.dtype == marks.source.dtype == np.int64
    assert (marks.target_name, marks.source_name) == ("horse.obj", "zebra.obj")
    assert len(marks) == 4
    assert notes == ()


def test_reversing_exchanges_the_two_sides() -> None:
    there = landmarks()
    back = there.reversed()
    assert back.target.tolist() == there.source.tolist()
    assert back.source.tolist() == there.target.tolist()
    assert (back.target_name, back.source_name) == ("torus", "cube")
    assert back.names == there.names


@pytest.mark.slow
@QUICK
@given(data=st.data())
def test_what_is_written_reads_back(tmp_path: Path, data: st.DataObject) -> None:
    text = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
    names = data.draw(st.lists(text, max_size=5))
    numbers = st.lists(st.integers(-(2**63) + 1, 2**63 - 1), min_size=len(names), max_size=len(names))
    target, source = (np.array(data.draw(numbers), dtype=np.int64) for _ in range(2))
    marks = Landmarks(tuple(names), target, source, data.draw(text), "b.obj")
    write_landmarks(tmp_path / "l.json", marks)
    again, _ = read_landmarks(tmp_path / "l.json", "c_1", "d_1")
    assert (again.names, again.target_name, again.source_name) == (marks.names, marks.target_name, "b.obj")
    np.testing.assert_array_equal(again.target, target)
    np.testing.assert_array_equal(again.source, source)


@QUICK
@given(shares=st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9), st.integers(0, 9)), max_size=5))
def test_points_between_vertices_read_back_exactly(tmp_path: Path, shares: list[tuple[int, int, int]]) -> None:
    weights = np.array(shares, dtype=np.float64).reshape(-1, 3)
    weights /= weights.sum(axis=1, keepdims=True)
    points = CagePoints(np.arange(3 * len(shares)).reshape(-1, 3), weights)
    vertices = CagePoints.of_vertices(np.arange(len(shares)))
    marks = Landmarks.of_points(tuple(f"m{i}" for i in range(len(shares))), points, vertices, "a.obj", "b.obj")
    write_landmarks(tmp_path / "p.json", marks)
    again, _ = read_landmarks(tmp_path / "p.json", "a.obj", "b.obj")
    np.testing.assert_array_equal(again.target, points.vertices)
    np.testing.assert_array_equal(again.source, np.arange(len(shares)))
    values = np.random.default_rng(0).normal(size=(3 * len(shares), 2))
    np.testing.assert_allclose(again.target_points.of(values), points.of(values), atol=1e-14)


@pytest.mark.parametrize(
    "end",
    [
        {"corners": [0, 1], "weights": [0.5, 0.5]},
        {"corners": [0, 1, 2], "weights": [0.5, 0.4, 0.3]},
        {"corners": [0, 1, 2], "weights": [1.5, -0.5, 0.0]},
        {"corners": [0, 1, True], "weights": [1, 0, 0]},
        {"corners": [0, 1, 2], "weights": [float("nan"), 0, 1]},
        {"corners": [0, 1, 2]},
    ],
)
def test_points_that_are_none_are_refused(tmp_path: Path, end: dict[str, object]) -> None:
    with pytest.raises(FormatError, match=r"'nose'.*'target'"):
        read_landmarks(write_file(tmp_path, pairs=[{"name": "nose", "source": 0, "target": end}]), "horse", "zebra")


@pytest.mark.parametrize(
    ("file", "here", "verdict"),  # (source, target) of the file and of the call
    [
        (("zebra.obj", "horse.obj"), ("zebra.obj", "horse.obj"), "accepted"),
        (("zebra.obj", "horse.obj"), ("some/where/Zebra.ply", "D:/meshes/horse.obj"), "accepted"),
        (("zebra.obj", "horse.obj"), ("horse.obj", "zebra.obj"), "refused"),
        (("zebra.obj", "horse.obj"), ("horse.ply", "zebra.ply"), "refused"),
        (("zebra.obj", "horse.obj"), ("cow.obj", "pig.obj"), "noted"),
        (("zebra.obj", "horse.obj"), ("zebra.obj", "horse2.obj"), "noted"),
        (("zebra.obj", "horse.obj"), ("zebra_run.obj", "horse_run.obj"), "noted"),
        # One column is of a mesh that stands on the other side.
        (("zebra.obj", "horse.obj"), ("cow.obj", "zebra.obj"), "refused"),
        (("zebra.obj", "horse.obj"), ("horse.obj", "cow.obj"), "refused"),
        # Poses and identities: the cage is named before the first '_'.
        (("base_neutral.obj", "soma_neutral.obj"), ("base_young.obj", "soma_old.obj"), "noted"),
        (("base_neutral.obj", "soma_neutral.obj"), ("soma_old.obj", "base_young.obj"), "refused"),
        (("base_neutral.obj", "soma_neutral.obj"), ("soma_neutral.obj", "base_young.obj"), "refused"),
        (("base_neutral.obj", "soma_neutral.obj"), ("male_old.obj", "base_young.obj"), "noted"),
        # Two poses of one cage: either column serves either mesh.
        (("hero_a.obj", "hero_b.obj"), ("hero_b.obj", "hero_c.obj"), "noted"),
        (("hero_a.obj", "hero_b.obj"), ("hero_c.obj", "hero_d.obj"), "noted"),
        (("hero_a.obj", "hero_b.obj"), ("hero_b.obj", "hero_a.obj"), "refused"),
        (("hero.obj", "hero.obj"), ("hero.obj", "hero.obj"), "accepted"),
        (("zebra.obj", ""), ("horse.obj", "zebra.obj"), "noted"),
    ],
)
def test_direction_by_name(tmp_path: Path, file: tuple[str, str], here: tuple[str, str], verdict: str) -> None:
    path = write_file(tmp_path, *file)
    if verdict == "refused":
        with pytest.raises(DirectionError, match=r"(?s)other way round.*Exchange.*target and source.*reversed\(\)"):
            read_landmarks(path, target=here[1], source=here[0])
        return
    marks, notes = read_landmarks(path, target=here[1], source=here[0])
    assert marks.source.tolist() == [0, 2, 4, 6]
    assert bool(notes) == (verdict == "noted")


def test_real_files_fit_their_meshes_in_one_direction_only(shared_data: Path) -> None:
    files = sorted(shared_data.rglob("landmarks/*.json"))
    assert files
    for file in files:
        stated = json.loads(file.read_text())
        target, source = file.parents[1] / stated["target"], file.parents[1] / stated["source"]
        marks, notes = read_landmarks(file, target, source)
        assert not notes
        with pytest.raises(DirectionError):
            read_landmarks(file, target=source, source=target)
        if target.stat().st_size < 200_000 and source.stat().st_size < 200_000:
            check_landmarks(marks, read_mesh(target), read_mesh(source))


BAD_FILES = {
    "empty": ("", "empty file"),
    "no JSON": ('{"pairs": [\n{"name": }]}', "line 2: expected JSON"),
    "deep": ("[" * 100_000, "JSON that cannot be"),
    "list": ("[1, 2]", "a list 'pairs'"),
    "no pairs": ('{"source": "a", "target": "b"}', "a list 'pairs'"),
    "pairs no list": ('{"pairs": 3}', "a list 'pairs'"),
    "mesh no name": ('{"source": 3, "pairs": []}', "file name of the source mesh, got 3"),
    "pair no object": ('{"pairs": [[1, 2]]}', r"pair 0 .*object"),
    "name no text": ('{"pairs": [{"name": 1, "source": 0, "target": 0}]}', "pair 0 .*name"),
    "no target": ('{"pairs": [{"name": "a", "source": 0}]}', "pair 0 .*'a'.*'target', got None"),
    "text": ('{"pairs": [{"name": "a", "source": "0", "target": 0}]}', "'source', got '0'"),
    "fraction": ('{"pairs": [{"name": "a", "source": 0.5, "target": 0}]}', "'source', got 0.5"),
    "truth": ('{"pairs": [{"name": "a", "source": 0, "target": true}]}', "'target', got True"),
    "huge": ('{"pairs": [{"name": "a", "source": 0, "target": 9223372036854775808}]}', "'target', got 92"),
    "very long number": (
        '{"pairs": [{"name": "a", "source": 0, "target": ' + "9" * 5000 + "}]}",
        "JSON that cannot be",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_with_the_pair(tmp_path: Path, case: str) -> None:
    text, message = BAD_FILES[case]
    (tmp_path / "pairs.json").write_text(text)
    with pytest.raises(FormatError, match=r"(?s)pairs\.json.*" + message):
        read_landmarks(tmp_path / "pairs.json", "a.obj", "b.obj")


def test_pairs_without_names_are_numbered(tmp_path: Path) -> None:
    file = write_file(tmp_path, pairs=[{"source": 1, "target": 2}])
    assert read_landmarks(file, "horse", "zebra")[0].names == ("pair 0",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": np.array([0, 1, 8, 3])}, r"target vertices from 0 to 7, those of cube, got mark 2 \(8\)"),
        (
            {"source": np.array([0, -1, 2, 40])},
            r"source vertices from 0 to 39, those of torus, got mark 1 \(-1\), mark 3",
        ),
        ({"target": np.array([0, 1, 1, 3])}, r"every target vertex in one pair only, got these again: mark 2 \(1\)"),
        ({"source": np.array([5, 1, 2, 5])}, r"every source vertex in one pair only, got these again: mark 3 \(5\)"),
        ({"names": ("a", "b", "a", "c")}, "every name once, got these again: a"),
        ({"target": np.array([0, 1, 2])}, "one target and one source vertex for each of 4"),
        (
            {"target": np.array([0, 1, 8, 3]), "target_name": "horse.obj", "source_name": "zebra.obj"},
            r"for target cube and source torus, which were made for horse\.obj and zebra\.obj:",
        ),
    ],
)
def test_landmarks_that_do_not_fit_are_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidLandmarksError, match=message):
        check_landmarks(replace(landmarks(), **change), cube(), torus())


def test_several_faults_at_once_and_no_number_of_pairs_is_one() -> None:
    for count in (0, 1, 2, 4):
        check_landmarks(landmarks(count), cube(), torus())
    both = replace(landmarks(), target=np.array([0, 0, 99, 3]), source=np.array([1, 1, 2, 3]))
    with pytest.raises(
        InvalidLandmarksError, match=r"(?s)from 0 to 7.*target vertex in one pair.*source vertex in one"
    ):
        check_landmarks(both, cube(), torus())


def test_a_name_twice_on_one_side_is_refused() -> None:
    twice = NamedPoints(("nose", "nose"), np.arange(2), np.full((2, 3), np.nan))
    with pytest.raises(InvalidLandmarksError, match=r"target points: .*once, got these again: nose.*Rename them"):
        pair_by_name(twice, twice, cube(), cube())
