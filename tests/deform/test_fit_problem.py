"""What one fit is given: held clusters first, each with its place, both ways and with others besides."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.deform.config import ElasticConfig, GraphConfig, LandmarkConfig, Stage
from cagemap.deform.problem import Problem
from cagemap.maps.pair import Pair
from cagemap.pipeline import MatchConfig, prepare_pair, prepare_surface

TARGET, SOURCE = np.array([40, 3, 17]), np.array([41, 5, 16])


@pytest.fixture(scope="module")
def problem() -> Problem:
    body = prepare_surface(creature(), 2)
    return Problem(prepare_pair(body, body), Pair.of_vertices(body, body, TARGET, SOURCE).landmarks)


def test_held_vertices_come_first_each_with_its_place(problem: Problem) -> None:
    places = problem.prepared.source.finest_triangles.positions
    clusters = problem.clusters_with((np.array([60, 9]), np.array([61, 8])))
    np.testing.assert_array_equal(clusters.vertices[:5], [*TARGET, 60, 9])
    np.testing.assert_array_equal(clusters.constraints.anchors.corners[:, 0], np.arange(5))
    np.testing.assert_array_equal(clusters.constraints.places, places[[*SOURCE, 61, 8]])
    np.testing.assert_array_equal(problem.coarse_clusters.vertices[:3], TARGET)
    np.testing.assert_array_equal(problem.constraints.anchors.corners[:, 0], TARGET)
    np.testing.assert_array_equal(problem.constraints.places, places[SOURCE])


def test_problems_made_of_one_keep_what_they_do_not_change(problem: Problem) -> None:
    few = problem.without([1])
    assert few.prepared is problem.prepared
    np.testing.assert_array_equal(few.landmark_vertices, (TARGET[[0, 2]], SOURCE[[0, 2]]))
    back = problem.reverse_problem
    assert back.prepared is problem.prepared.reverse_pair
    np.testing.assert_array_equal(back.landmark_vertices, (SOURCE, TARGET))
    stage = Stage(3, (1.0, 1e-2), 1e-2)
    small = problem.clusters_with(stage=stage, count=100)
    assert small.stage is stage
    assert 90 < small.energy.graph.n < 110 < problem.coarse_clusters.energy.graph.n
    assert problem.clusters_with(stage=stage).energy.graph.n == problem.coarse_clusters.energy.graph.n


def test_maps_of_clusters_are_factored_at_first_use(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """An update of a map has no use for them."""
    monkeypatch.setattr("cagemap.deform.energy.factor", lambda *_: pytest.fail("factored"))
    clusters = problem.clusters_with(count=100).with_stage(Stage(3, (1.0, 1e-2), 1e-2))
    with pytest.raises(pytest.fail.Exception, match="factored"):
        clusters.energy.maps(clusters.energy.graph.positions)


def test_distances_of_landmarks_are_measured_on_the_configured_graph(problem: Problem) -> None:
    body = problem.prepared.target
    # Tiny pieces of cells are not joined, so there are more clusters than asked for.
    config = ElasticConfig(landmarks=LandmarkConfig(distance_vertices=100), graph=GraphConfig(joining_rounds=0))
    own = Problem(prepare_pair(body, body, MatchConfig(elastic=config)), problem.landmarks)
    for distances in own.landmark_distances:
        assert distances.shape[0] == len(TARGET)
        assert 115 < distances.shape[1] < 130
