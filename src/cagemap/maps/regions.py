"""Differences in size and shape between two surfaces, for the region around each landmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.maps.masks import distances_along_edges
from cagemap.maps.quality import flipped_triangles, stretches, weighted_percentiles
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.surface.triangles import corner_sums


@dataclass(frozen=True)
class RegionFigures:
    """Median stretch of a map over the region of the target around one landmark."""

    landmark: str  #: name of the landmark
    area: float  #: area of the region divided by the area of the unmasked target that has a counterpart
    #: square root of the median ratio of the areas of a target triangle and of its image. The surfaces are scaled so
    #: that their corresponding parts have equal area. 2 if the target's ear is twice as long and twice as wide.
    size: float
    aspect_ratio: float  #: median ratio of the singular values of the map's differential: 1 for a conformal map
    folded: float  #: share of the region whose image is folded over


@kinds_checked
def region_figures(result: MatchResult) -> tuple[RegionFigures, ...]:
    """Figures of the region around every trusted landmark, in the order of the landmarks.

    A target vertex belongs to the landmark nearest to it along edges. Masked area, area without a counterpart, and
    pieces of the mesh without a landmark, are left out. ParameterError if the result has no landmarks.
    """
    landmarks = result.trusted
    if not len(landmarks):
        raise ParameterError("region_figures: expected a result with landmarks, which name the regions; it has none")
    target, (largest, smallest) = result.point_map.target, _stretches(result)
    places = landmarks.target_points.heaviest_corners
    _, nearest = distances_along_edges(target, np.unique(places))
    masks = result.masks.within(result.shared)
    areas = target.areas * masks.joint(result.point_map)[target.triangles].mean(axis=1)
    folded = flipped_triangles(result.point_map.images, target.triangles)
    ratio, aspect = 1.0 / np.maximum(largest * smallest, 1e-12), largest / np.maximum(smallest, 1e-9)
    figures = []
    for name, place in zip(landmarks.names, places, strict=True):
        inside = np.flatnonzero((nearest[target.triangles[:, 0]] == place) & (areas > 0))
        if not len(inside):
            continue
        weight = areas[inside]
        figures.append(
            RegionFigures(
                name,
                float(weight.sum() / areas.sum()),
                float(np.sqrt(weighted_percentiles(ratio[inside], weight, [50.0])[0])),
                float(weighted_percentiles(aspect[inside], weight, [50.0])[0]),
                float(weight[folded[inside]].sum() / weight.sum()),
            )
        )
    return tuple(figures)


def local_size(result: MatchResult) -> FloatArray:
    """(n1,) length on the target per length on the source at target vertices; corresponding parts have equal area."""
    target, sigma = result.point_map.target, _stretches(result)
    # Sum the areas of a vertex's triangles, and of their images, before dividing.
    areas = np.column_stack([target.areas, target.areas * sigma[0] * sigma[1]])
    target_areas, image_areas = corner_sums(target.triangles, areas, target.n).T
    return np.sqrt(np.divide(target_areas, image_areas, out=np.ones(target.n), where=image_areas > 0))


def _stretches(result: MatchResult) -> tuple[FloatArray, FloatArray]:
    point_map = result.point_map
    ratio = result.masks.within(result.shared).length_ratio(point_map.target, point_map.source)
    return stretches(ratio * point_map.target.positions, point_map.images.positions, point_map.target.triangles)
