"""Maps in every form that users have and in other bases, and maps from another answer of a match."""

from dataclasses import replace

import numpy as np
import pytest
from examples import shapes
from examples.shapes import creature

from cagemap import research
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import check_map, functional_map_from, image_positions
from cagemap.maps.hypotheses.confidence import SURE, TWO, Confidence, kept_confidence, prolong_answers
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import judge
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import other_answer, prepare_pair, prepare_surface, update_match
from cagemap.spectral import BasisConfig

from plain_meshes import animal, marks_at
from quick_match import QUICK
from refusals import refuses


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


@pytest.fixture(scope="module")
def pair():
    """The creature, and the same one wider: vertex i is vertex i."""
    mesh = shapes.creature()
    sides = [
        research.prepare(mesh.with_positions(mesh.positions * by), 1, BasisConfig(count=40))
        for by in (1, [1.2, 1, 0.9])
    ]
    chosen = np.arange(0, mesh.n_vertices, 9)
    return research.make_pair(*sides, np.column_stack([chosen, chosen]))


def forms(pair):
    """The true map as a point map, vertices of both levels, and a matrix."""
    n = len(pair.target.vertices)
    true = PointMap.from_vertices(pair.target.finest_triangles, pair.source.finest_triangles, np.arange(n))
    return true, np.arange(n), np.arange(pair.target.control.n_vertices), functional_map_from(pair, true)


def test_every_form_gives_the_same_places_and_matrix(pair):
    true, *others = forms(pair)
    vertices = np.arange(0, len(pair.target.vertices), 5)
    wanted = true.images.at(vertices).positions
    np.testing.assert_array_equal(image_positions(pair, true, vertices), wanted)
    for given, most in zip(others, (0.0, 0.05, 0.05), strict=True):
        away = np.linalg.norm(image_positions(pair, given, vertices) - wanted, axis=1)
        assert away.mean() <= most
        np.testing.assert_allclose(functional_map_from(pair, given)[:10, :10], others[2][:10, :10], atol=0.05)
    np.testing.assert_array_equal(
        image_positions(pair, others[1], np.arange(9)), true.images.at(np.arange(9)).positions
    )


def test_what_is_no_map_of_the_pair_is_refused(pair):
    n = len(pair.target.vertices)
    wrong = (3, np.zeros((0, 0)), np.eye(41), np.arange(n - 1), np.full(n, n), np.full(n, -1))
    for given in wrong:
        refuses(ParameterError, "map: expected a PointMap, a functional map of at most", check_map, pair, given)
    refuses(ParameterError, "finite numbers", check_map, pair, np.full((4, 4), np.nan))
    coarse = pair.target.triangles(0)
    with pytest.raises(ParameterError, match="may be exchanged"):
        check_map(pair, PointMap.from_vertices(coarse, coarse, np.arange(coarse.n)))


def test_bases_of_others_may_be_flipped_and_mixed(pair):
    """C there and back where the others' functions are a rotation of ours; pyFM's signs are another."""
    rng = np.random.default_rng(2)
    ours = [side.basis.at(1) for side in (pair.target, pair.source)]
    turns = [np.linalg.qr(rng.standard_normal((40, 40)))[0] for _ in ours]
    psi1, psi2 = (functions @ turn for functions, turn in zip(ours, turns, strict=True))
    matrix = forms(pair)[-1]
    theirs = research.to_bases(pair, matrix, psi1, psi2)
    np.testing.assert_allclose(theirs, turns[0].T @ matrix @ turns[1], atol=1e-5)
    np.testing.assert_allclose(research.from_bases(pair, theirs, psi1, psi2), matrix, atol=1e-5)
    assert research.from_bases(pair, np.eye(7, 5), psi1, psi2).shape == (7, 5)
    with pytest.raises(ParameterError, match=r"target functions: expected .* the vertices of level 1"):
        research.from_bases(pair, theirs, psi1[:-1], psi2)
    refuses(ParameterError, "source functions: expected", research.from_bases, pair, theirs, psi1, psi2[:, :39])


@pytest.mark.slow
def test_the_steps_follow_each_other_from_any_form(pair):
    true, vertices, coarse, matrix = forms(pair)
    prepared = prepare_pair(pair.target, pair.source, QUICK)
    for given in (vertices, coarse, matrix):
        found = research.elastic(pair, given, prepared)
        assert np.linalg.norm(found.images.positions - true.images.positions, axis=1).mean() < 0.02
    free = research.make_pair(pair.target, pair.source)
    found = research.unfold(free, research.project(free, research.elastic(free, matrix, prepared), prepared))
    assert np.linalg.norm(found.images.positions - true.images.positions, axis=1).mean() < 0.03
    assert research.judge(free, found).flipped_area < 0.02
    assert research.zoomout(free, found, research.ZoomOutSchedule(10, 30)).shape == (30, 30)
    again = research.project(pair, true.images.positions[prepared.vertices], prepared)
    np.testing.assert_allclose(again.images.positions, true.images.positions, atol=0.05)
    from_landmarks = research.elastic(pair, prepared=prepared)
    assert np.linalg.norm(from_landmarks.images.positions - true.images.positions, axis=1).mean() < 0.02
