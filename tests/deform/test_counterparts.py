"""Parts without a counterpart have no data term, and a projection that keeps to its side."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import creature
from scipy.spatial import cKDTree

from cagemap.deform.config import DataConfig, ElasticConfig, Stage
from cagemap.deform.data import PlacementConstraints, received_weights, round_trip_weights
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.maps.projection.project import facing_points
from cagemap.mesh.cage_points import CagePoints
from cagemap.subdivision import refine
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows, triangle_normals

from elastic_shapes import minimised


@pytest.fixture(scope="module")
def graph() -> tuple[ElasticGraph, np.ndarray, TriangleSurface]:
    """Graph, faces and mesh of a creature of 2434 vertices."""
    finest = refine(creature(), 2).finest
    mesh = TriangleSurface.from_faces(finest.positions, finest.faces)
    return mesh_graph(mesh, finest.faces), finest.faces, mesh


def test_what_receives_no_area_does_not_pull(graph: tuple[ElasticGraph, np.ndarray, TriangleSurface]) -> None:
    rest = graph[0]
    factors = rest.smoother(DataConfig.received_smoothing)
    np.testing.assert_allclose(received_weights(factors, rest.areas, of_parts=False), 1.0)
    np.testing.assert_allclose(received_weights(factors, np.zeros(rest.n), of_parts=False), 0.0)
    distance = np.linalg.norm(rest.positions - rest.positions[100], axis=1)
    weights = received_weights(factors, np.where(distance < 0.06, 0.0, rest.areas), of_parts=False)
    assert (weights[distance < 0.03] == 0).all()
    assert (weights[distance > 0.08] > 0.999).all()


def test_round_trips_count_more_inside_than_outside() -> None:
    lengths = np.linspace(0, 0.05, 11)
    trips = lengths[:, None] * normalize_rows(np.array([[1.0, 2.0, 2.0]]))
    inside = round_trip_weights(trips, np.full(11, -1e-3), 2e-4)
    outside = round_trip_weights(trips, np.full(11, 1e-3), 2e-4)
    assert inside[0] == outside[0] == 1.0
    assert (np.diff(inside) < 0).all()
    assert (np.diff(outside) < 0).all()
    assert (inside[1:] < outside[1:]).all()
    # The softer the energy, the less is forgiven.
    assert (round_trip_weights(trips, np.ones(11), 1e-5)[1:] < outside[1:]).all()


@pytest.mark.slow
def test_a_pocket_that_the_source_lacks_drags_nothing_along(graph):
    smooth, faces, mesh = graph
    # Push a finger into the flattest place: the pocket's walls face each other, nothing on the source is like them.
    near = cKDTree(smooth.positions).query_ball_point(smooth.positions, 0.1)
    middle = max(range(0, smooth.n, 31), key=lambda i: float((smooth.normals[near[i]] @ smooth.normals[i]).min()))
    reach = np.linalg.norm(smooth.positions - smooth.positions[middle], axis=1) / 0.06
    depth = 0.12 * np.clip(1.0 - reach**4, 0.0, None) * (smooth.normals @ smooth.normals[middle] > 0)
    pocket = TriangleSurface(smooth.positions - depth[:, None] * smooth.normals[middle], mesh.triangles)
    pocketed = mesh_graph(pocket, faces)
    landmarks = np.flatnonzero(reach > 3)[::25]

    def error(config: ElasticConfig) -> float:
        stage = Stage(8, (2e-4, 1e-5), 1e-4, momentum=0.8)
        found = minimised(
            pocketed,
            pocket,
            mesh,
            pocketed.positions,
            PlacementConstraints(CagePoints.of_vertices(landmarks), smooth.positions[landmarks]),
            stage,
            config,
        )
        around = reach > 2
        return float(np.linalg.norm(found - smooth.positions, axis=1)[around].mean())

    assert error(ElasticConfig()) < 0.5 * error(ElasticConfig(data=DataConfig(received=(0.0, 1e-12))))


def test_projection_keeps_to_its_side_and_its_place() -> None:
    # A sheet 0.004 thick: without normals a point just through it would land on the other side.
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    positions = np.vstack([np.column_stack([corners, np.full(4, height)]) for height in (0.0, 0.004)])
    triangles = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])  # the lower side faces down
    sheet = TriangleSurface(positions, triangles)
    rng = np.random.default_rng(51)
    points = np.column_stack([rng.uniform(0.2, 0.8, (50, 2)), rng.uniform(-0.004, 0.008, 50)])
    normals = normalize_rows(np.array([0.0, 0.0, 1.0]) + 0.3 * rng.standard_normal((50, 3)))
    assert (facing_points(sheet, points, normals, (0.002, 0.02)).triangle >= 2).all()
    assert (SurfacePoints.nearest(sheet, points, normals, normal_weight=0.002).triangle < 2).any()
    # Where the surface bends little, a normal that is off does not move the foot far.
    bend = np.column_stack([np.linspace(-1, 1, 41), 0.05 * np.linspace(-1, 1, 41) ** 2])
    strip = np.vstack([np.column_stack([bend[:, 0], np.full(41, y), bend[:, 1]]) for y in (-1.0, 1.0)])
    row = np.arange(40)
    quads = np.column_stack([row, row + 1, row + 42, row + 41])
    strip_triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    assert (triangle_normals(strip, strip_triangles)[:, 2] > 0).all()
    query = np.array([[0.0, 0.0, 0.001]])
    tilted = normalize_rows(np.array([[0.2, 0.0, 1.0]]))
    found = facing_points(TriangleSurface(strip, strip_triangles), query, tilted, (0.002, 0.02))
    assert abs(found.positions[0, 0]) < 1e-3
