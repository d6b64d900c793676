"""One search over all starts: the cheapest placement wins, whatever started it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform.fit import evaluate_placement
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.maps.hypotheses import search
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import match, prepare_pair, prepare_surface


@pytest.fixture(scope="module")
def prepared() -> PreparedPair:
    surface = prepare_surface(creature(), 1)
    return prepare_pair(surface, surface)


def found(
    prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch, agree: bool, start: FloatArray | None = None
) -> tuple[list[Placement], list[bool]]:
    """Placements found where limbs lead to the truth and landmarks beside it; whether rotations were tried."""
    vertices, asked = np.array([0, 40, 80]), list[bool]()
    problem = Problem.of_landmarks(prepared, Landmarks(("a", "b", "c"), vertices, vertices))
    places = prepared.energy.graph.positions
    beside = evaluate_placement(prepared, places + np.array([0.05, 0.0, 0.0]))

    def fit_small_graph(problem: Problem, with_rotations: bool, show: object) -> tuple[list[object], list[object]]:
        asked.append(with_rotations)
        return [], []

    monkeypatch.setattr(search, "fit_from_two_starts", lambda *given: ([beside], [] if agree else [beside]))
    monkeypatch.setattr(search, "spectral_starts", lambda problem, clusters: lambda placed: [])
    monkeypatch.setattr(search, "refine_cheapest", lambda problem, coarse, fine: fine)
    monkeypatch.setattr(search, "fit_small_graph", fit_small_graph)
    monkeypatch.setattr(search, "fit_without_tips", lambda problem, small_fits: [evaluate_placement(prepared, places)])
    monkeypatch.setattr(search, "refit_distinct_to_tips", lambda problem, ranked: ranked)
    monkeypatch.setattr(search, "finish_placement", lambda problem, placed: placed)
    return search.search_placements(problem, start=start), asked


def test_other_starts_compete_with_landmarks_whose_fits_disagree(prepared, monkeypatch):
    placements, asked = found(prepared, monkeypatch, agree=False)
    np.testing.assert_array_equal(placements[0].positions, prepared.energy.graph.positions)
    assert len(placements) == 2
    assert asked == [False]  # landmarks need no rotations


def test_landmarks_whose_fits_agree_and_starts_that_are_given_decide_alone(prepared, monkeypatch):
    assert found(prepared, monkeypatch, agree=True)[1] == []
    placements, asked = found(prepared, monkeypatch, agree=False, start=np.zeros((1, 3)))
    assert len(placements) == 1
    assert asked == []


def test_costs_below_the_floor_are_ties(prepared: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    """A box fits itself turned as well, up to how samples fall: the alignment as the files stand is kept."""
    places, floor = prepared.energy.graph.positions, search.cost_floor(prepared)
    as_filed, turned = Placement(places, 0.9 * floor), Placement(places, 0.1 * floor, penalty=1.1)
    monkeypatch.setattr(search, "fit_small_graph", lambda *given: ([], []))
    monkeypatch.setattr(search, "fit_without_tips", lambda *given: [turned, as_filed])
    monkeypatch.setattr(search, "refit_distinct_to_tips", lambda problem, ranked: ranked)
    monkeypatch.setattr(search, "finish_placement", lambda problem, placed: placed)
    assert search.search_placements(Problem.of_landmarks(prepared, Landmarks.none()))[0] is as_filed


@pytest.mark.slow
def test_correct_landmarks_do_not_make_the_rest_worse(shared_data: Path) -> None:
    """Nose, four feet and tail: fits from landmarks alone leave the other places 2.9 off, all starts 1.7."""
    animals = shared_data / "animals"
    cow, horse = (prepare_surface(read_mesh(animals / f"{name}.obj"), 1) for name in ("cow", "horse"))
    named = read_landmarks(animals / "landmarks" / "horse__cow.json", "cow.obj", "horse.obj")[0]
    feet = ["nose_tip", "fore_hoof_left", "hind_hoof_right", "tail_tip", "fore_hoof_right", "hind_hoof_left"]
    of_feet = [named.names.index(name) for name in feet]
    given, rest = named.without(np.setdiff1d(np.arange(len(named)), of_feet)), named.without(of_feet)
    images = match(cow, horse, given).point_map.images.positions[rest.target]
    errors = np.linalg.norm(images - horse.finest_triangles.positions[rest.source], axis=1)
    assert 100 * errors.mean() < 2.2
