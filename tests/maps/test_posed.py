"""Bodies in strong poses; slow, on the shared meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.posed import Bodies, row
from benchmarks.truth import compare_with_truth

from cagemap.deform import refit
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.maps.hypotheses import search
from cagemap.maps.hypotheses.confidence import TWO
from cagemap.maps.projection.project import map_of_places
from cagemap.pipeline import match, other_answer

from quick_match import SEARCHED


@pytest.mark.slow
def test_limbs_keep_their_turn_about_their_axis_in_strong_poses(shared_data: Path) -> None:
    # Differentials smoothed over a limb's length turned the arms whatever the start was: 3.05.
    target, source = ("male1591", "female_old_heavy", ""), ("female1605", "male_young", "stride")
    figures = row(Bodies(5000), target, source, 14)
    assert figures["left_out"] == []
    assert figures["mean"] < 1.0
    assert figures["flipped"] < 0.5


@pytest.mark.slow
def test_mirrored_landmarks_are_met_and_the_other_answer_is_offered(shared_data: Path) -> None:
    source, target = ("female1605", "male_young", ""), ("male1591", "female_old_heavy", "")
    bodies = Bodies(3000)
    path = shared_data / "humans" / "landmarks" / "female1605__male1591.json"
    landmarks = read_landmarks(path, "male1591_neutral.obj", "female1605_neutral.obj")[0]
    swap = {"left": "right", "right": "left"}
    other = [
        landmarks.names.index("_".join(swap.get(word, word) for word in name.split("_"))) for name in landmarks.names
    ]
    mirrored = landmarks.exchanged(list(enumerate(other)))
    surfaces = bodies.surface(target), bodies.surface(source)
    found = match(*surfaces, mirrored, SEARCHED)
    assert found.quality.landmark_errors.max() < 1e-9
    assert found.confidence.verdict == TWO
    assert "`answer=1`" in found.confidence.message
    chosen = other_answer(found, 1, SEARCHED)
    assert len(chosen.landmarks) >= 20
    assert chosen.confidence is None
    assert 100 * compare_with_truth(chosen.point_map, bodies.truth(target, source)).mean < 1.0


@pytest.mark.slow
def test_shins_of_a_crouching_body_stay_where_they_belong(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # With neither stage shins slide towards bent knees: 1.15. Posed, but not seen from both sides: 0.79; both: 0.74.
    bodies = Bodies(5000)
    pair = ("male1591", "female_old_heavy", "crouch"), ("female1605", "male_young", "")
    finished: list[tuple[Problem, Placement]] = []

    def finish(problem: Problem, placed: Placement) -> Placement:
        finished.append((problem, placed))
        return refit.finish_placement(problem, placed)

    monkeypatch.setattr(search, "finish_placement", finish)
    figures = row(bodies, *pair, 14)
    assert figures["left_out"] == []
    assert figures["mean"] < 0.85
    problem, placed = finished[-1]
    fit = refit.fit_in_pose  # the reverse fit, once, is a part of the other stage

    def leave(problem: Problem, positions: np.ndarray, times: int | None = None) -> np.ndarray:
        return positions if times is None else fit(problem, positions, times)

    for stage, worse in (("inverse_consistent", 1.02), ("fit_in_pose", 1.1)):
        with monkeypatch.context() as without:
            without.setattr(refit, stage, leave)
            point_map = map_of_places(problem, refit.finish_placement(problem, placed).map_positions)
        assert 100 * compare_with_truth(point_map, bodies.truth(*pair)).mean > worse * figures["mean"], stage
