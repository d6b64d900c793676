"""A map from another answer of a match: of plain meshes, and with landmarks that were left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.confidence import SURE, TWO, Confidence, kept_confidence, prolong_answers
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import judge
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import other_answer, prepare_pair, prepare_surface, update_match

from plain_meshes import animal, marks_at
from quick_match import QUICK


def result_of_two_answers(mesh: ControlMesh, level: int, landmarks: Landmarks, check: LandmarkCheck) -> MatchResult:
    """A mesh mapped to itself, with two equal answers."""
    surface = prepare_surface(mesh, level)
    prepared = prepare_pair(surface, surface, QUICK)
    places = prepared.mesh.positions
    answers = Placement(places, 1e-4, name="first"), Placement(places, 1e-4, name="second")
    finest = surface.finest_triangles
    point_map = PointMap.from_vertices(finest, finest, np.arange(finest.n))
    return MatchResult(
        surface,
        surface,
        landmarks,
        point_map,
        judge(surface, point_map),
        landmark_check=check,
        confidence=prolong_answers(Confidence(TWO, answers), prepared),
        prepared=prepared,
    )


def test_another_answer_of_an_open_plain_mesh_whose_coarse_level_is_deformed() -> None:
    whole = animal(2)
    opened = replace(whole, face_offsets=whole.face_offsets[:-1], face_indices=whole.face_indices[:-3])
    before = result_of_two_answers(opened, 0, Landmarks.none(), LandmarkCheck())
    assert before.prepared.mesh.is_open
    assert before.prepared.mesh.n < opened.n_vertices
    found = other_answer(before, 1, QUICK)
    assert np.linalg.norm(found.image() - opened.positions, axis=1).mean() < 0.01 * np.ptp(opened.positions)
    np.testing.assert_allclose(found.shared_shares, 1.0, atol=0.01)


def two_answers(mesh: ControlMesh, level: int, *, first_is_right: bool = True) -> MatchResult:
    """`result_of_two_answers` of a mesh on itself; the right answer, and one mirrored at a vertex in the middle."""
    before = result_of_two_answers(mesh, level, Landmarks.none(), LandmarkCheck())
    right, wrong = before.confidence.answers
    shift = 2 * wrong.positions[np.abs(mesh.positions[:, 0]).argmin()] * [1.0, 0.0, 0.0]
    mirrored = replace(wrong, positions=wrong.positions * [-1.0, 1.0, 1.0] + shift)
    confidence = replace(before.confidence, answers=(right, mirrored) if first_is_right else (mirrored, right))
    return replace(before, confidence=confidence)


@pytest.mark.parametrize(("mesh", "level"), [(creature(), 1), (animal(1), 0)])
def test_an_update_keeps_the_confidence_until_an_answer_misses_a_landmark(mesh: ControlMesh, level: int) -> None:
    side = int(np.abs(mesh.positions[:, 0]).argmax())
    middle = int(np.abs(mesh.positions[:, 0]).argmin())
    given = two_answers(mesh, level).confidence
    mirrored_first = two_answers(mesh, level, first_is_right=False).confidence
    before = two_answers(mesh, level)

    def updated(confidence: Confidence | None, *vertices: int) -> Confidence | None:
        return kept_confidence(confidence, Problem.of_landmarks(before.prepared, marks_at(np.array(vertices))))

    assert updated(given, middle) is given
    assert updated(replace(given, deciding=middle), middle) is None
    assert updated(given, middle, side) is None
    assert updated(mirrored_first, side) is None
    short = tuple(replace(answer, positions=answer.positions[: mesh.n_vertices // 2]) for answer in given.answers)
    assert updated(replace(given, answers=short), mesh.n_vertices - 1) is None
    assert updated(replace(given, verdict=SURE, answers=given.answers[1:]), side) is None


def test_an_update_with_few_landmarks_has_a_confidence() -> None:
    mesh = creature()
    before = result_of_two_answers(mesh, 1, Landmarks.none(), LandmarkCheck())
    one = marks_at(np.array([59]))  # moved little by the bend below
    assert update_match(before, one, QUICK).confidence is not None
    bent = mesh.with_positions(mesh.positions * (1 + 0.1 * mesh.positions[:, [1]]))
    surface = prepare_surface(bent, 1)
    apart = replace(before, source=surface, prepared=prepare_pair(before.target, surface, QUICK))
    found = update_match(apart, one, QUICK)
    assert found.confidence.verdict == TWO
    enough = marks_at(np.arange(0, 35, 5))
    assert update_match(apart, enough, QUICK).confidence is None
    for earlier in (marks_at(np.array([9])), marks_at(np.array([59, 9]))):  # moved, removed
        assert update_match(replace(apart, landmarks=earlier), one, QUICK).confidence is None


def test_another_answer_does_not_meet_landmarks_that_were_left_out() -> None:
    mesh = creature()
    vertices = np.arange(0, 35, 5)
    wrong, far = 2, int(np.linalg.norm(mesh.positions - mesh.positions[vertices[2]], axis=1).argmax())
    given = np.where(np.arange(len(vertices)) == wrong, far, vertices)
    landmarks = Landmarks(tuple("abcdefg"), vertices, given)
    suspect = LandmarkSuspect("c", wrong, 1.0, mesh.file_vertex(int(vertices[wrong])), mesh.file_vertex(far), "sides")
    found = other_answer(result_of_two_answers(mesh, 1, landmarks, LandmarkCheck((suspect,))), 1, QUICK)
    missed = np.linalg.norm(found.image()[vertices] - mesh.positions[given], axis=1)
    own = np.linalg.norm(found.image()[vertices] - mesh.positions[vertices], axis=1)
    extent = np.ptp(mesh.positions)
    assert missed[wrong] > 0.5 * extent
    assert own[wrong] < 0.1 * extent
    assert found.landmark_check.left_out == [wrong]
    assert len(found.quality.landmark_errors) == len(landmarks) - 1
