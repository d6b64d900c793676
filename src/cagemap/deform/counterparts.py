"""Weights of data terms: parts without a counterpart have none (cavities, skin between toes, fingers in a mitten).

Closest points pair such parts with something: the inside of a mouth with the chin, the sides of toes with the edges of
a foot without toes, which drags the whole foot along. Two signs tell them apart. A part of the target that no source
point is closest to receives none of the source's area. And the round trip from a point of the source without a
counterpart to the target and back ends elsewhere.
"""

from __future__ import annotations

import numpy as np

from cagemap.deform.config import DataConfig
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import Factorization


def received_weights(
    smoother: Factorization, received: FloatArray, config: DataConfig = DataConfig(), *, of_parts: bool = False
) -> FloatArray:
    """(n,) from 0 (nothing lies there) to 1, by how much of the source's area (n,) vertices receive, of their own.

    Smoothed by `ElasticGraph.smoother`: 1 where received areas are the vertices' own. Both surfaces have area 1, which
    says nothing where one is a part: there densities are compared with what a received piece of area has on average.
    """
    none, full = config.received
    density = smoother.solve(received)
    if of_parts:
        density = density * (received.sum() / max(float(received @ density), 1e-12))
    return np.clip((density - none) / (full - none), 0.0, 1.0)


def round_trip_weights(
    trips: FloatArray, heights: FloatArray, alpha: float, config: DataConfig = DataConfig()
) -> FloatArray:
    """(m,) weights from 1 down to 0 of source points, by how far from them a round trip to the target ends.

    `trusted` with a smaller scale for points inside the target: it cannot grow into them.
    """
    return trusted(trips, np.where(heights > 0, config.outside_trips * np.sqrt(alpha), config.inside_trip))


def trusted(trips: FloatArray, scale: FloatArray | float) -> FloatArray:
    """(m,) weights ``1 / (1 + d^2 / s^2)^2`` of trips d (m, 3) by their scales s (Geman and McClure 1985)."""
    return np.asarray(1.0 / (1.0 + np.einsum("md,md->m", trips, trips) / scale**2) ** 2)
