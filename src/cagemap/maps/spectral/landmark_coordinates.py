"""Coordinates that landmarks give to every point of a surface: harmonic and biharmonic interpolants.

Both surfaces have the same coordinates at corresponding landmarks, so that a nearest neighbour in them is exact there.
Both kinds come from Green's functions of the Laplacian, one factorisation for all landmarks.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from cagemap.errors import InvalidLandmarksError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.operators import lumped_areas

# Weights of the coordinates beside the spectral ones, per sqrt(k) basis functions (measured, docs/accuracy.md).
HARMONIC_WEIGHT = 3.0
BIHARMONIC_WEIGHT = 1.0


def landmark_coordinates(stiffness: sparse.csr_array, mass: sparse.csr_array, landmarks: IndexArray) -> FloatArray:
    """Weighted harmonic and biharmonic coordinates of every vertex, ready to stand beside spectral ones.

    Parameters
    ----------
    stiffness, mass : (n, n) sparse arrays of one level
    landmarks : (p,) int64, vertices of that level, at least 2

    Returns
    -------
    (n, 2 p) float64
        Column i is 3 h_i, column p + i is b_i: both interpolants of the unit vector of landmark i.

    Raises
    ------
    InvalidLandmarksError
        If there are fewer than two landmarks or one repeats.
    """
    harmonic, biharmonic = interpolants(stiffness, mass, landmarks)
    return np.hstack([HARMONIC_WEIGHT * harmonic, BIHARMONIC_WEIGHT * biharmonic])


def interpolants(
    stiffness: sparse.csr_array, mass: sparse.csr_array, landmarks: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Harmonic and biharmonic interpolants of unit values at landmarks.

    ``h_i`` is 1 at landmark i, 0 at the others and ``W h_i = 0`` elsewhere; ``b_i`` likewise with
    ``W D^{-1} W b_i = 0``, D being the row sums of M. With G = W^+ (W^+ D W^+ for the second kind), the solution is
    ``G[:, L] c + const`` where c sums to zero and the values at the landmarks fit.

    Returns
    -------
    harmonic, biharmonic : (n, p) float64
    """
    unique = np.unique(landmarks)
    if len(landmarks) < 2 or len(unique) != len(landmarks):
        raise InvalidLandmarksError(
            f"expected at least two different landmarks on a surface, got {len(landmarks)} of which {len(unique)} "
            "differ: add landmark pairs or remove the repeated ones"
        )
    n, p = stiffness.shape[0], len(landmarks)
    areas = lumped_areas(mass)
    grounded = np.arange(n) != landmarks[0]  # W is singular by constants only: ground one vertex
    factors = factor(sparse.csc_array(stiffness[grounded][:, grounded]))

    def green(charges: FloatArray) -> FloatArray:
        """W^+ applied to charges that sum to zero, up to a constant."""
        potential = np.zeros((n, charges.shape[1]))
        potential[grounded] = factors.solve(np.ascontiguousarray(charges[grounded]))
        return potential - areas @ potential / areas.sum()

    charges = np.zeros((n, p))
    charges[landmarks, np.arange(p)] = 1.0
    charges -= areas[:, None] / areas.sum()
    first = green(charges)  # (n, p)
    second = green(areas[:, None] * first)
    return _interpolate(first, landmarks), _interpolate(second, landmarks)


def _interpolate(kernels: FloatArray, landmarks: IndexArray) -> FloatArray:
    """Combine kernel columns and a constant to unit values at the landmarks, the coefficients summing to zero."""
    p = len(landmarks)
    system = np.ones((p + 1, p + 1))
    system[:p, :p], system[p, p] = kernels[landmarks], 0.0
    coefficients = linalg.solve(system, np.eye(p + 1)[:, :p])
    return kernels @ coefficients[:p] + coefficients[p]
