"""The simplified mesh that is deformed in place of a large one: the large mesh follows it, and ends where it did."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic import prepared as rooms
from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.config import ElasticConfig
from cagemap.maps.elastic.fit import fine_stage
from cagemap.maps.elastic.prepared import PreparedPair, RestShape, StandIn, level_graph
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.pair import Pair
from cagemap.mesh.shapes import creature
from cagemap.pipeline import prepare_pair, prepare_surface

LEVEL = 2
# Of the way from start to end: 0.36 on so small a shape, where a stand-in has 580 vertices.
MOST_APART = 0.5


@pytest.fixture(scope="module")
def pair() -> PreparedPair:
    """A shape and the same one bent a little, of a level that is large only where a test says so."""
    control = creature()
    x, y, z = control.positions.T
    bent = control.with_positions(np.column_stack([x + 0.05 * np.sin(2 * y), y, 1.1 * z]))
    return prepare_pair(*(prepare_surface(one, LEVEL) for one in (control, bent)))


def large(pair: PreparedPair, level: int = LEVEL) -> RestShape:
    return RestShape.build(level_graph(pair.target, level), pair.target.triangles(level), 1e-4)


@pytest.fixture
def small_limits(monkeypatch: pytest.MonkeyPatch, pair: PreparedPair) -> int:
    """The finest level counts as large, and has a stand-in of a third."""
    count = pair.target.triangles(LEVEL).n
    monkeypatch.setattr(rooms, "LARGEST_MESH", count // 2)
    monkeypatch.setattr(rooms, "STAND_IN", count // 3)
    return count


def test_small_meshes_have_none(pair: PreparedPair) -> None:
    assert large(pair).stand_in is None


def stand_in_of(shape: RestShape) -> StandIn:
    assert shape.stand_in is not None
    return shape.stand_in


def test_a_mesh_follows_affine_deformations_exactly(pair: PreparedPair, small_limits: int) -> None:
    shape = large(pair)
    stand_in = stand_in_of(shape)
    assert stand_in.rest.stand_in is None
    assert len(stand_in.vertices) < 0.4 * small_limits
    matrix, shift = np.array([[1.2, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.2, 1.1]]), np.array([1.0, -2.0, 0.5])
    moved = stand_in.rest.graph.positions @ matrix.T + shift
    wanted = shape.graph.positions @ matrix.T + shift
    # Differentials of affine maps are exact but for the ridge of 1e-9.
    np.testing.assert_allclose(stand_in.followed(moved, shape.graph), wanted, atol=1e-6)


def test_points_between_its_vertices_are_found_on_it(pair: PreparedPair, small_limits: int) -> None:
    stand_in = stand_in_of(large(pair))
    mesh, finest = stand_in.rest.mesh, pair.target.triangles(LEVEL)
    assert mesh is not None
    gone = np.setdiff1d(np.arange(finest.n), stand_in.vertices)[:5]
    there = stand_in.vertices[3:6]
    points = SurfacePoints.from_vertices(finest, np.concatenate([there, gone]))
    anchors = Anchors.on_mesh(mesh, points, stand_in.numbers)
    np.testing.assert_array_equal(anchors.corners[:3, 0], [3, 4, 5])
    np.testing.assert_array_equal(anchors.weights[:3, 0], 1.0)
    missed = np.linalg.norm(anchors.of(mesh.positions) - points.positions, axis=1)
    assert missed[:3].max() == 0.0
    assert 0.0 < missed[3:].max() < 0.02


def test_posed_shapes_have_posed_stand_ins(pair: PreparedPair, small_limits: int) -> None:
    shape = large(pair)
    posed = shape.graph.positions @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stand_in = stand_in_of(shape.at(posed, 1e-4))
    assert stand_in.rest.mesh is not None
    np.testing.assert_array_equal(stand_in.rest.graph.positions, posed[stand_in.vertices])
    # Landmarks are looked for on the mesh as it was given.
    np.testing.assert_array_equal(stand_in.rest.mesh.positions, shape.graph.positions[stand_in.vertices])


def test_a_fine_stage_ends_where_it_ends_without(pair: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two fifths of the vertices see the same shape; places and normals of the mesh that follows are those of it."""
    level, config = LEVEL, ElasticConfig()
    target, source = pair.target.triangles(level), pair.source.triangles(level)
    held = Pair.of_vertices(pair.target, pair.source, np.arange(0, 60, 6), np.arange(0, 60, 6))

    def ended() -> np.ndarray:
        shape = RestShape.build(level_graph(pair.target, level), target, config.fine.smoothing)
        fitted = PreparedPair(pair.target, pair.source, pair.start, config, (level, level), shape, source)
        return fine_stage(FitProblem(fitted, held), target.positions)

    whole = ended()
    monkeypatch.setattr(rooms, "LARGEST_MESH", target.n // 2)
    monkeypatch.setattr(rooms, "STAND_IN", 2 * target.n // 5)
    followed = ended()
    moved = np.linalg.norm(whole - target.positions, axis=1).mean()
    assert np.linalg.norm(followed - whole, axis=1).mean() < MOST_APART * moved
    facing = np.einsum("nd,nd->n", vertex_normals(followed, target.triangles), vertex_normals(whole, target.triangles))
    assert facing.mean() > 0.98
