"""Bodies in strong poses; slow, on the shared meshes."""

from pathlib import Path

import pytest
from benchmarks.accuracy.posed import Bodies, Body, landmarks_of
from benchmarks.truth import TruthFigures, compare_with_truth

from cagemap.deform import refit
from cagemap.deform.problem import Problem
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.maps.hypotheses import search
from cagemap.maps.hypotheses.confidence import TWO
from cagemap.maps.projection.project import map_of_places
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import MatchConfig, match, other_answer, prepare_pair

from quick_match import SEARCHED

BODIES = Bodies(3000)


def problem_of(target: Body, source: Body, config: MatchConfig) -> Problem:
    """Of the two bodies, with 14 landmarks."""
    prepared = prepare_pair(BODIES.surface(target), BODIES.surface(source), config)
    return Problem.of_landmarks(prepared, landmarks_of(target[0], source[0], 14))


def figures(problem: Problem, positions: FloatArray, target: Body, source: Body) -> TruthFigures:
    return compare_with_truth(map_of_places(problem, positions), BODIES.truth(target, source))


@pytest.mark.slow
def test_limbs_keep_their_turn_about_their_axis_in_strong_poses(shared_data: Path) -> None:
    # From the two starts alone an arm is turned about its axis, and the error is 3.3.
    pair = ("male1591", "female_old_heavy", ""), ("female1605", "male_young", "stride")
    problem = problem_of(*pair, SEARCHED)
    found = figures(problem, search.search_placements(problem)[0].map_positions, *pair)
    assert 100 * found.mean < 1.5
    assert found.flipped_area < 0.005


@pytest.mark.slow
def test_mirrored_landmarks_are_met_and_the_other_answer_is_offered(shared_data: Path) -> None:
    source, target = ("female1605", "male_young", ""), ("male1591", "female_old_heavy", "")
    path = shared_data / "humans" / "landmarks" / "female1605__male1591.json"
    landmarks = read_landmarks(path, "male1591_neutral.obj", "female1605_neutral.obj")[0]
    swap = {"left": "right", "right": "left"}
    other = [
        landmarks.names.index("_".join(swap.get(word, word) for word in name.split("_"))) for name in landmarks.names
    ]
    mirrored = landmarks.exchanged(list(enumerate(other)))
    surfaces = BODIES.surface(target), BODIES.surface(source)
    found = match(*surfaces, mirrored, SEARCHED)
    assert found.quality.landmark_errors.max() < 1e-9
    assert found.confidence.verdict == TWO
    assert "`answer=1`" in found.confidence.message
    chosen = other_answer(found, 1, SEARCHED)
    assert len(chosen.landmarks) >= 20
    assert chosen.confidence is None
    assert 100 * compare_with_truth(chosen.point_map, BODIES.truth(target, source)).mean < 1.0


@pytest.mark.slow
def test_shins_of_a_crouching_body_stay_where_they_belong(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The two starts alone: 4.9, since shins slide towards bent knees. Refitted in the source's pose: 2.3.
    # Averaged with the inverse of the reverse fit as well: 1.9.
    pair = ("male1591", "female_old_heavy", "crouch"), ("female1605", "male_young", "")
    problem, posed = problem_of(*pair, SEARCHED), list[FloatArray]()
    inverse_consistent = refit.inverse_consistent

    def averaged(problem: Problem, positions: FloatArray) -> FloatArray:
        posed.append(positions)
        return inverse_consistent(problem, positions)

    monkeypatch.setattr(refit, "inverse_consistent", averaged)
    placed = search.fit_from_two_starts(problem, problem.coarse_clusters)[0][0]
    finished = refit.finish_placement(problem, placed).map_positions
    slid, half, whole = (100 * figures(problem, at, *pair).mean for at in (placed.positions, posed[0], finished))
    assert whole < 1.15 * 1.92
    assert half > 1.1 * whole
    assert slid > 1.5 * half
