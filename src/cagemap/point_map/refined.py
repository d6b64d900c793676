"""The default method: the spectral map with landmark coordinates finds the basin, the elastic fit finishes in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cagemap.basis import rows
from cagemap.mesh import FloatArray
from cagemap.point_map.elastic import ElasticConfig, elastic_map
from cagemap.point_map.hierarchical import (
    SAMPLE_VERTICES,
    HierarchyConfig,
    Pair,
    Progress,
    coarse_map,
    search_levels,
)
from cagemap.point_map.landmark_coordinates import landmark_coordinates
from cagemap.point_map.point_map import PointMap
from cagemap.point_map.upsample import spread
from cagemap.refinement import level_triangles


@dataclass(frozen=True)
class RefinedConfig:
    """Parameters of the two halves of the method."""

    hierarchy: HierarchyConfig = HierarchyConfig()
    elastic: ElasticConfig = ElasticConfig()


def refined_map(
    pair: Pair, config: RefinedConfig, progress: Progress = lambda stage: None
) -> tuple[FloatArray, PointMap]:
    """Functional map C12 and point map T12 of the finest levels.

    The functional map starts as the paper's (eqs. 13-16) and grows on the search levels beside harmonic and biharmonic
    landmark coordinates; the elastic fit deforms the target's search level onto the source and its subdivision is
    projected once; C12 is then read off the point map.

    Raises
    ------
    InvalidLandmarksError
        If there are fewer than two landmarks.
    """
    progress("functional map")
    levels = search_levels(pair, config.hierarchy)
    coordinates = (
        landmark_coordinates(
            pair.target.operators.stiffness[levels[0]], pair.target.operators.mass[levels[0]], pair.target_landmarks
        ),
        landmark_coordinates(
            pair.source.operators.stiffness[levels[1]], pair.source.operators.mass[levels[1]], pair.source_landmarks
        ),
    )
    coarse = coarse_map(pair, config.hierarchy, coordinates)
    progress("elastic fit")
    point_map = elastic_map(
        pair.target.refinement,
        pair.source.refinement,
        (pair.target.operators.scale, pair.source.operators.scale),
        levels,
        coarse.match,
        (pair.target_landmarks, pair.source_landmarks),
        config.elastic,
    )
    progress("functional map of the fit")
    return functional_map_of(pair, point_map), point_map


def functional_map_of(pair: Pair, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2)."""
    chosen = spread(len(point_map.triangle), SAMPLE_VERTICES)
    target_rows = rows(pair.target.basis, pair.target.refinement, pair.target.finest, chosen)
    source_triangles = level_triangles(pair.source.refinement, pair.source.finest)
    corners, places = np.unique(source_triangles[point_map.triangle[chosen]], return_inverse=True)
    at_corners = rows(pair.source.basis, pair.source.refinement, pair.source.finest, corners)
    weights = point_map.barycentric[chosen]
    pulled = sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3))
    weighted = target_rows * pair.target.operators.finest_areas[chosen, None]
    return np.asarray(linalg.solve(weighted.T @ target_rows, weighted.T @ pulled, assume_a="pos"))
