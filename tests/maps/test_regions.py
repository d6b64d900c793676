"""Sizes of regions around landmarks, of a known map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cagemap
from cagemap.errors import ParameterError
from cagemap.maps.masks import Masks
from cagemap.maps.quality import measure_quality
from cagemap.maps.regions import local_size
from cagemap.maps.result import MatchResult
from cagemap.mesh.landmarks import Landmarks


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
