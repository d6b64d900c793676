"""A result that is read back does what the one that was written does: it is baked, reported and updated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cagemap
from cagemap import BasisConfig, Landmarks, MatchResult
from cagemap.deform.placement import Placement
from cagemap.errors import ParameterError
from cagemap.maps.hypotheses.confidence import Confidence
from cagemap.mesh.cage_points import CagePoints
from cagemap.pipeline import other_answer

from example_once import example_pair
from quick_match import QUICK
from refusals import refuses

CONFIG = BasisConfig(count=40)


@pytest.fixture(scope="module")
def landmarks() -> Landmarks:
    return example_pair(64).landmarks


@pytest.fixture(scope="module")
def matched(landmarks: Landmarks) -> MatchResult:
    """The built-in pair, with one landmark that is left out."""
    pair = example_pair(64)
    wrong = landmarks.names.index("hoof_hind_L")
    source = landmarks.source.copy()
    away = np.linalg.norm(pair.source.positions - pair.source.positions[source[wrong]], axis=1)
    away[source] = 0.0
    source[wrong] = np.argmax(away)
    surfaces = cagemap.prepare_surfaces(pair.target, pair.source, (1, 1), CONFIG)
    return cagemap.match(*surfaces, replace(landmarks, source=source), QUICK)


@pytest.fixture(scope="module")
def read(matched: MatchResult, tmp_path_factory: pytest.TempPathFactory) -> MatchResult:
    folder = tmp_path_factory.mktemp("r") / "RESULT"
    cagemap.write_result(folder, matched)
    return cagemap.read_result(folder)


def test_bakes_are_those_of_the_match(matched: MatchResult, read: MatchResult) -> None:
    texture = example_pair(64).texture
    np.testing.assert_array_equal(cagemap.bake(read, texture, size=48), cagemap.bake(matched, texture, size=48))


@pytest.mark.slow
def test_both_are_reported(matched: MatchResult, read: MatchResult, tmp_path: Path, small_pages: None) -> None:
    cagemap.write_report(tmp_path / "read.html", read)
    cagemap.write_report(tmp_path / "fresh.html", matched)
    assert "left out" in (tmp_path / "fresh.html").read_text()
    assert "left out" in (tmp_path / "read.html").read_text()


def test_what_is_read_is_the_match_that_was_stored(matched: MatchResult, read: MatchResult) -> None:
    assert read.suspects == matched.suspects
    assert len(read.suspects) == 1
    assert read.trusted.names == matched.trusted.names
    np.testing.assert_array_equal(read.point_map.barycentric, matched.point_map.barycentric)
    np.testing.assert_array_equal(read.functional_map, matched.functional_map)
    np.testing.assert_array_equal(read.trust, matched.trust)
    assert read.quality.summary() == matched.quality.summary()
    assert not read.target.is_prepared


def test_a_functional_map_that_is_not_stored_is_made(matched: MatchResult, read: MatchResult) -> None:
    bare = replace(read, known_spectral=None)
    # Eigenvectors are found again from the same start, to rounding.
    np.testing.assert_allclose(bare.functional_map, matched.functional_map, atol=1e-9)


@pytest.mark.slow
def test_an_update_of_what_was_read_is_that_of_the_match(matched, read, landmarks):
    updated = cagemap.update_match(matched, landmarks, QUICK)
    assert updated.suspects == ()
    again = cagemap.update_match(read, landmarks, QUICK)
    assert again.suspects == ()
    np.testing.assert_allclose(again.point_map.images.positions, updated.point_map.images.positions, atol=1e-9)


def test_without_landmarks_other_answers_are_read(matched: MatchResult, tmp_path: Path) -> None:
    count = matched.target.control.n_vertices
    places = matched.point_map.images.positions
    answers = tuple(Placement(places + i, 2e-3 + i, name=name) for i, name in enumerate(("as it lies", "turned")))
    confidence = Confidence.of(answers, np.arange(count))
    cagemap.write_result(tmp_path / "R", replace(matched, confidence=confidence))
    read = cagemap.read_result(tmp_path / "R")
    assert read.confidence.message == confidence.message
    np.testing.assert_allclose(read.confidence.answers[1].positions, places[:count] + 1)
    refuses(ParameterError, "match again", other_answer, read, 1)


@pytest.mark.slow
def test_landmarks_between_vertices_stay_where_they_are(matched: MatchResult, tmp_path: Path) -> None:
    """Moved a third of the way along an edge of a face."""
    landmarks, control = matched.landmarks, matched.target.control
    points = landmarks.target_points
    weights, corners = points.weights.copy(), points.corners.copy()
    at = int(np.flatnonzero(control.face_indices == landmarks.target[0])[0])
    corners[0] = [landmarks.target[0], control.face_indices[control.next_corners[at]], landmarks.target[0]]
    weights[0] = [2 / 3, 1 / 3, 0]
    moved = CagePoints(corners, weights)
    between = replace(landmarks, target=moved.vertices, target_points=moved)
    assert between.target[0] == -1
    updated = cagemap.update_match(matched, between)
    cagemap.write_result(tmp_path / "R", updated)
    again = cagemap.read_result(tmp_path / "R")
    assert again.landmarks.target[0] == -1
    np.testing.assert_allclose(again.landmarks.target_points.weights, weights)
    for name, value in updated.quality.summary().items():
        if isinstance(value, float):
            assert again.quality.summary()[name] == pytest.approx(value, abs=1e-12), name
