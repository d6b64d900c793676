"""The search from the source to the target, where the one from the target to the source may be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import torus

from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses import search as search_module
from cagemap.maps.hypotheses.search import search_both_ways
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import prepare_pair, prepare_surface


@pytest.mark.parametrize(
    ("forward", "backward", "searches", "takes_inverse"),
    [(1.0, 0.5, 2, True), (1.0, 2.0, 2, False), (1e-4, 1e-5, 1, False)],
    ids=["costs less", "costs more", "is cheap already"],
)
def test_the_inverse_of_a_cheaper_reverse_placement_is_taken(monkeypatch, forward, backward, searches, takes_inverse):
    surface = prepare_surface(torus(12, 8), 1)
    problem = Problem.of_landmarks(prepare_pair(surface, surface), Landmarks.none())
    truth = problem.prepared.mesh.positions
    wrong = Placement(truth @ np.diag([-1.0, 1.0, -1.0]), forward, name="turned")
    right = Placement(problem.reverse_problem.prepared.mesh.positions, backward)
    asked, finished = list[Problem](), list[Placement]()

    def finish(given: Problem, placed: Placement) -> Placement:
        assert given is problem
        finished.append(placed)
        return placed

    def search(given: Problem, *_: object, **__: object) -> list[Placement]:
        asked.append(given)
        return [replace(wrong)] if given is problem else [right]

    monkeypatch.setattr(search_module, "search_placements", search)
    monkeypatch.setattr(search_module, "finish_placement", finish)
    first, *others = search_both_ways(problem)
    assert len(asked) == searches
    assert finished == ([first] if searches > 1 else [])  # the last step is the slowest: once in all
    if takes_inverse:
        assert np.linalg.norm(first.map_positions - truth, axis=1).max() < 0.02
        assert [placed.name for placed in others] == ["turned"]
    else:
        assert [placed.name for placed in (first, *others)] == ["turned"]
