"""The target in the source's pose: as rigid as it can be near a fit, and fitted again from there."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic.constants import LOOSEST, POSES_DIFFER
from cagemap.maps.elastic.graph import mesh_graph
from cagemap.maps.elastic.pose import posed, stiffness, turn
from cagemap.maps.elastic.prepared import RestShape
from cagemap.mesh.shapes import creature
from cagemap.numerics.rotations import nearest_rotations
from cagemap.refinement import level_triangles, refine


@pytest.fixture(scope="module")
def rest() -> RestShape:
    """A creature of 380 vertices."""
    refinement = refine(creature(), 1)
    mesh = TriangleSurface.from_faces(refinement.finest.positions, level_triangles(refinement, 1))
    return RestShape.build(mesh_graph(mesh, mesh.triangles), mesh, 1e-4)


def lengths(rest: RestShape, positions: np.ndarray) -> np.ndarray:
    """Of all edges."""
    return np.linalg.norm(positions[rest.graph.heads] - positions[rest.graph.tails], axis=1)


def test_a_motion_is_a_pose(rest: RestShape) -> None:
    rotation = nearest_rotations(np.random.default_rng(5).standard_normal((1, 3, 3)))[0]
    moved = rest.graph.positions @ rotation.T + np.array([3.0, -1.0, 2.0])
    assert turn(rest, moved) < 1e-5  # of the whole body is no pose
    np.testing.assert_allclose(posed(rest, moved), moved, atol=1e-6)


def test_a_bent_and_stretched_body_is_bent_and_hardly_stretched(rest: RestShape) -> None:
    at = rest.graph.positions
    along = at[:, 2] - at[:, 2].mean()
    stretched = at * np.array([1.0, 1.0, 1.4]) ** np.sign(along)[:, None]  # longer in front, shorter behind
    angle = 1.5 * np.clip(along, 0.0, None)
    bent = stretched.copy()
    bent[:, 0] = np.cos(angle) * stretched[:, 0] + np.sin(angle) * stretched[:, 1]
    bent[:, 1] = -np.sin(angle) * stretched[:, 0] + np.cos(angle) * stretched[:, 1]
    rolled = at.copy()
    rolled[:, 0] = np.cos(3.0 * angle) * at[:, 0] + np.sin(3.0 * angle) * at[:, 1]
    rolled[:, 1] = -np.sin(3.0 * angle) * at[:, 0] + np.cos(3.0 * angle) * at[:, 1]
    found = posed(rest, bent)
    assert turn(rest, stretched) < 0.1 < turn(rest, bent) < POSES_DIFFER
    assert turn(rest, rolled) > POSES_DIFFER
    own = lengths(rest, at)
    assert np.abs(np.log(lengths(rest, bent) / own)).mean() > 0.1
    assert np.abs(np.log(lengths(rest, found) / own)).mean() < 0.07
    assert np.linalg.norm(found - bent, axis=1).mean() < 0.1 < np.linalg.norm(found - at, axis=1).mean()


def test_edges_are_loose_where_a_body_turns_and_stiff_where_it_does_not(rest: RestShape) -> None:
    graph = rest.graph
    along = graph.positions[:, 2] - graph.positions[:, 2].mean()
    angle = np.clip(along / 0.1, 0.0, 1.0)
    cosine, sine, none, one = np.cos(angle), np.sin(angle), 0 * angle, 1 + 0 * angle
    turns = np.array([[cosine, -sine, none], [sine, cosine, none], [none, none, one]]).transpose(2, 0, 1)
    found = stiffness(graph, turns)
    joint = (along > 0.03) & (along < 0.07)
    far = (along < -0.1) | (along > 0.2)
    assert found[joint[graph.heads]].max() < 0.4
    assert found[far[graph.heads]].min() > 0.8
    assert found.min() >= LOOSEST
    np.testing.assert_allclose(stiffness(graph, turns[:1] + 0 * turns), 1.0)
    np.testing.assert_allclose(found, stiffness(graph, turns[3] @ turns), rtol=1e-6)
