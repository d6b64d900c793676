"""Functional maps of point maps."""

from __future__ import annotations

import numpy as np

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.spectral.samples import FIT_SAMPLES, Samples, evenly_spaced, fit_functional_map
from cagemap.spectral.surface import Surface


@kinds_checked
def functional_map_of(target: Surface, source: Surface, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2)."""
    chosen = evenly_spaced(len(point_map.images), FIT_SAMPLES)
    sampled = point_map.images.at(chosen)
    corners, places = np.unique(sampled.corners, return_inverse=True)
    at_vertices, at_corners = in_threads(
        lambda side: side[0].basis.rows(side[0].finest, side[1]), [(target, chosen), (source, corners)]
    )
    weights = sampled.barycentric
    pulled = np.asarray(sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3)))
    samples = Samples(at_vertices, target.finest_triangles.vertex_areas[chosen], np.zeros((len(chosen), 0)))
    return fit_functional_map(samples, pulled, target.basis.count)
