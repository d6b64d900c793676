"""What has no counterpart on the other surface does not pull: cavities, the skin between toes, fingers in a mitten.

Closest points pair such parts with something: the inside of a mouth is pulled to the chin until it turns inside out,
and the sides of toes to the edges of a foot without toes, which drags the whole foot along. Two signs tell them apart.
A part of the target that no source point is closest to receives none of the source's area; and from a point of the
source without a counterpart, the way to the target and back ends elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.maps.elastic.constants import FULL, INSIDE_TRIP, NONE, OUTSIDE_TRIPS, SMOOTHING_LENGTH
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import Factorization, factor


def received_factors(areas: FloatArray, laplacian: sparse.csr_array) -> Factorization:
    """Factors of ``M + l^2 L`` (n, n), M the vertices' areas (n,), which smooth what every vertex receives."""
    return factor(sparse.csc_array(sparse.diags_array(areas) + SMOOTHING_LENGTH**2 * laplacian))


def received_weights(factors: Factorization, received: FloatArray) -> FloatArray:
    """(n,) from 0 (nothing lies there) to 1, by how much of the source's area vertices receive, of their own.

    Solves ``(M + l^2 L) r = m`` for received areas m (n,): r = 1 where they are the vertices' own.
    """
    return np.clip((factors.solve(received) - NONE) / (FULL - NONE), 0.0, 1.0)


def round_trip_weights(trips: FloatArray, heights: FloatArray, alpha: float) -> FloatArray:
    """(m,) weights from 1 down to 0 of source points, by how far from home a round trip to the target ends.

    `trusted` with a smaller scale for points inside the target: it cannot grow into them.

    Parameters
    ----------
    trips : (m, 3) float64
        From a source point to the source's point nearest to the point's own nearest point on the target.
    heights : (m,) float64
        Of the source point over the target, along its normal; negative inside.
    alpha : float
        Stiffness of the energy.
    """
    return trusted(trips, np.where(heights > 0, OUTSIDE_TRIPS * np.sqrt(alpha), INSIDE_TRIP))


def trusted(trips: FloatArray, scale: FloatArray | float) -> FloatArray:
    """(m,) weights ``1 / (1 + d^2 / s^2)^2`` of trips d (m, 3) by their scales s (Geman and McClure 1985)."""
    return np.asarray(1.0 / (1.0 + np.einsum("md,md->m", trips, trips) / scale**2) ** 2)
