"""Landmark coordinates: harmonic and biharmonic interpolants of landmarks and curves.

Both surfaces have the same coordinates at corresponding landmarks, where nearest neighbours are therefore exact. Both
kinds are computed from Green's functions of the Laplacian, with one factorisation for all landmarks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg, sparse

from cagemap.errors import InvalidLandmarksError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.operators import lumped_areas

# Weight of harmonic coordinates relative to biharmonic and spectral ones (measured, docs/lab/spectral.md).
HARMONIC_WEIGHT = 3.0


def landmark_coordinates(
    stiffness: sparse.csr_array, mass: sparse.csr_array, landmarks: IndexArray, curves: Sequence[IndexArray] = ()
) -> FloatArray:
    """Weighted harmonic and biharmonic coordinates (n, 2 (p + c)) of every vertex, to extend spectral ones.

    Columns are 3 h_i of every landmark (p,) and curve (c arrays of vertices, none a landmark), then b_i. Both h_i and
    b_i are 1 on landmark i and 0 on the others. InvalidLandmarksError for fewer than two or repeated landmarks.
    """
    unique = np.unique(landmarks)
    if len(landmarks) < 2 or len(unique) != len(landmarks):
        raise InvalidLandmarksError(
            f"expected at least two different landmarks on a surface, got {len(landmarks)} of which {len(unique)} "
            "differ: add landmark pairs or remove the repeated ones"
        )
    sets = [*landmarks[:, None], *curves]
    units = np.repeat(np.eye(len(sets)), [len(vertices) for vertices in sets], axis=0)
    harmonic, biharmonic = interpolants(stiffness, mass, np.concatenate(sets), units)
    return np.hstack([HARMONIC_WEIGHT * harmonic, biharmonic])


def interpolants(
    stiffness: sparse.csr_array, mass: sparse.csr_array, vertices: IndexArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Harmonic and biharmonic interpolants (n, c) of values (q, c) at vertices (q,).

    They solve ``W h = 0`` and ``W D^{-1} W b = 0`` at all other vertices, with D the row sums of M. The solution is
    ``G[:, vertices] c + const`` with G = W^+, or W^+ D W^+ for b; c sums to zero and is chosen to fit the values.
    """
    n, q = stiffness.shape[0], len(vertices)
    areas = lumped_areas(mass)
    grounded = np.arange(n) != vertices[0]  # W is singular on constants only: fix the value at one vertex
    factors = factor(sparse.csc_array(stiffness[grounded][:, grounded]))

    def green(charges: FloatArray) -> FloatArray:
        """W^+ applied to charges that sum to zero, with mean 0."""
        potential = np.zeros((n, charges.shape[1]))
        potential[grounded] = factors.solve(np.ascontiguousarray(charges[grounded]))
        return potential - areas @ potential / areas.sum()

    charges = np.zeros((n, q))
    charges[vertices, np.arange(q)] = 1.0
    charges -= areas[:, None] / areas.sum()
    first = green(charges)
    second = green(areas[:, None] * first)
    return _interpolate(first, vertices, values), _interpolate(second, vertices, values)


def _interpolate(kernels: FloatArray, vertices: IndexArray, values: FloatArray) -> FloatArray:
    """Interpolate values by kernel columns and a constant, with coefficients that sum to zero."""
    q = len(vertices)
    system = np.ones((q + 1, q + 1))
    system[:q, :q], system[q, q] = kernels[vertices], 0.0
    coefficients = linalg.solve(system, np.vstack([values, np.zeros((1, values.shape[1]))]))
    return kernels @ coefficients[:q] + coefficients[q]
