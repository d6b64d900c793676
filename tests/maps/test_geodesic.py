"""Distances along a surface, errors of maps measured by them, and sizes of regions around landmarks."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import icosahedron

import cagemap
from cagemap.errors import ParameterError
from cagemap.maps.geodesic import HeatDistances
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.maps.regions import local_size
from cagemap.maps.result import MatchResult
from cagemap.mesh.landmarks import Landmarks
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface


def test_distances_on_a_sphere_are_angles() -> None:
    refinement = refine(icosahedron(), 4)
    places = refinement.finest.positions / np.linalg.norm(refinement.finest.positions, axis=1, keepdims=True)
    sphere = TriangleSurface.from_faces(places, level_triangles(refinement, 4))
    radius = np.linalg.norm(sphere.positions[0])
    sources = SurfacePoints.from_vertices(sphere, np.array([0, 7, 500]))
    found = HeatDistances(sphere).from_points(sources)
    cosines = np.clip(sphere.positions @ sources.positions.T / radius**2, -1, 1)
    exact = radius * np.arccos(cosines)
    # The heat method rounds the cut locus off and is first order in the mesh width.
    assert np.abs(found - exact).mean() < 0.02 * exact.mean()


@pytest.fixture(scope="module")
def sphere_map() -> PointMap:
    """A sphere onto itself, every vertex mapped to a neighbour."""
    refinement = refine(icosahedron(), 3)
    places = refinement.finest.positions / np.linalg.norm(refinement.finest.positions, axis=1, keepdims=True)
    sphere = TriangleSurface.from_faces(places, level_triangles(refinement, 3))
    neighbour = np.arange(sphere.n)
    neighbour[sphere.triangles[:, 0]] = sphere.triangles[:, 1]
    return PointMap.from_vertices(sphere, sphere, neighbour)


def test_errors_are_distances_along_the_source(sphere_map: PointMap) -> None:
    """A map to antipodes misses by half a great circle, whatever the straight distance."""
    sphere = sphere_map.source
    opposite = SurfacePoints.nearest(sphere, -sphere.positions)
    radius = np.linalg.norm(sphere.positions[0])
    judged = np.arange(0, sphere.n, 60)
    errors = cagemap.geodesic_error(PointMap(sphere, opposite), np.arange(sphere.n), judged)
    np.testing.assert_allclose(errors, np.pi * radius, rtol=0.04)  # the cut locus is rounded off
    identity = PointMap.from_vertices(sphere, sphere, np.arange(sphere.n))
    assert len(cagemap.geodesic_error(identity, identity)) == 300
    np.testing.assert_allclose(cagemap.geodesic_error(identity, identity.images), 0.0, atol=1e-12)
    np.testing.assert_array_equal(sphere_map.nearest_vertices(), sphere_map.images.corners[
        np.arange(sphere.n), sphere_map.barycentric.argmax(axis=1)])  # fmt: skip
    np.testing.assert_allclose(sphere_map.to_sparse() @ sphere.positions, sphere_map.images.positions, atol=1e-14)


def test_truth_of_some_vertices_is_enough(sphere_map: PointMap) -> None:
    truth = sphere_map.nearest_vertices()[:12].copy()
    truth[::2] = -1
    np.testing.assert_allclose(cagemap.geodesic_error(sphere_map, truth), np.zeros(6), atol=1e-12)
    for vertices, wrong in (([1, 2], r"\[2\]"), ([1, 40], r"\[40\]"), ([-1], r"\[-1\]")):
        with pytest.raises(ParameterError, match=f"whose true image is known, 6 of 12, got {wrong}"):
            cagemap.geodesic_error(sphere_map, truth, vertices)
    for bad in (np.full(5, -1), np.full(5, -2), np.zeros((5, 2), int), np.zeros(10**4, int), "truth"):
        with pytest.raises(ParameterError, match="truth: expected"):
            cagemap.geodesic_error(sphere_map, bad)
    other = PointMap.from_vertices(*[TriangleSurface.from_faces(np.eye(3), np.array([[0, 1, 2]]))] * 2, np.arange(3))
    with pytest.raises(ParameterError, match="truth: expected points of TriangleSurface"):
        cagemap.geodesic_error(sphere_map, other)


def test_distances_of_another_library(sphere_map: PointMap) -> None:
    """Angles, which are exact on a sphere, from each true vertex."""
    places = sphere_map.source.positions
    radius = np.linalg.norm(places[0])
    asked: list[int] = []

    def angles(vertex: int) -> np.ndarray:
        asked.append(vertex)
        return radius * np.arccos(np.clip(places @ places[vertex] / radius**2, -1, 1))

    truth = np.arange(sphere_map.target.n)[::-1]
    found = cagemap.geodesic_error(sphere_map, truth, [3, 40], distances=angles)
    images = sphere_map.nearest_vertices()[[3, 40]]
    np.testing.assert_allclose(found, [angles(truth[3])[images[0]], angles(truth[40])[images[1]]])
    assert sorted(asked[:2]) == sorted(truth[[3, 40]].tolist())
    with pytest.raises(ParameterError, match=r"distances: expected \(\d+,\) from vertex"):
        cagemap.geodesic_error(sphere_map, truth, [3], distances=lambda vertex: angles(vertex)[:5])


def two_squares(width: float) -> tuple[np.ndarray, np.ndarray]:
    """A strip over x from -1 to width: the part beyond 0 is stretched by ``width`` along x alone."""
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0, 1, 11), indexing="ij")
    i = (np.arange(20)[:, None] * 11 + np.arange(10)).ravel()
    faces = np.concatenate([np.column_stack([i, i + 11, i + 12]), np.column_stack([i, i + 12, i + 1])])
    positions = np.column_stack([np.where(x > 0, width * x, x).ravel(), y.ravel(), np.zeros(x.size)])
    return positions, faces


def strip_result(width: float, names: tuple[str, ...] = ("left", "right")) -> MatchResult:
    """The map between strips of one connectivity that takes every vertex to itself, with a landmark in each part."""
    wide, narrow = (cagemap.plain_mesh(two_squares(factor)).mesh for factor in (width, 1.0))
    target, source = cagemap.prepare_surfaces(wide, narrow, levels=(0, 0))
    ends = np.array([5, 15 * 11 + 5])[: len(names)]  # at x = -1 and, of a width of 2, at x = 1
    numbers = np.arange(target.control.n_vertices)
    point_map = cagemap.PointMap.from_vertices(target.finest_triangles, source.finest_triangles, numbers)
    quality = measure_quality(point_map)
    return MatchResult(target, source, Landmarks(names, ends, ends), point_map, quality)


def test_each_region_has_the_size_and_shape_of_its_own_part() -> None:
    left, right = cagemap.region_figures(strip_result(2.0))
    # Areas 1 + 2 on the target and 1 + 1 on the source, which count as equal.
    assert (left.landmark, right.landmark) == ("left", "right")
    assert left.size == pytest.approx(np.sqrt(2 / 3))
    assert right.size == pytest.approx(np.sqrt(4 / 3))
    assert (left.aspect_ratio, right.aspect_ratio) == pytest.approx((1.0, 2.0))
    assert left.area + right.area == pytest.approx(1.0)
    assert left.folded == right.folded == 0.0
    # The border between them lies at x = 0, within an edge.
    assert left.area == pytest.approx(1 / 3, abs=0.1 / 3)


def test_masked_area_does_not_count() -> None:
    result = strip_result(2.0)
    masked = replace(result, masks=Masks((result.target.vertices[:, 0] < -0.15).astype(np.float64)))
    figures = cagemap.region_figures(masked)
    assert [region.landmark for region in figures] == ["left"]
    assert figures[0].area == pytest.approx(1.0)


def test_sizes_of_a_part_of_the_source_are_those_of_the_shared_area() -> None:
    """Half of the source and a third of the target have a counterpart."""
    result = strip_result(2.0)
    own = [(side.vertices[:, 0] < -0.15).astype(np.float64) for side in (result.target, result.source)]
    (left,) = cagemap.region_figures(replace(result, shared=Masks(*own)))
    assert left.size == pytest.approx(1.0, abs=0.02)
    assert left.area == pytest.approx(1.0)
    sizes = local_size(replace(result, shared=Masks(*own)))
    assert sizes[own[0] > 0] == pytest.approx(1.0, abs=0.02)


def test_sizes_at_vertices_follow_the_parts() -> None:
    result = strip_result(2.0)
    at = result.target.vertices[:, 0]
    sizes = local_size(result)
    assert sizes[at < -1e-9] == pytest.approx(np.sqrt(2 / 3))
    assert sizes[at > 1e-9] == pytest.approx(np.sqrt(4 / 3))


def test_without_landmarks_there_are_no_regions() -> None:
    with pytest.raises(ParameterError, match="with landmarks, which name the regions"):
        cagemap.region_figures(strip_result(2.0, ()))
