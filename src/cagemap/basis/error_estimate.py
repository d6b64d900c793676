"""What the eigenpairs of one level become at the next, without computing them there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.basis.products import multiply

FloatArray = NDArray[np.float64]


# Condition of the scaled stiffness matrix on what the coarser level cannot represent.
CONDITION = 20.0
_SEED = 2019


@dataclass(frozen=True, eq=False)
class Prediction:
    """Eigenpairs of the next level, predicted within reach of a correction of the present ones.

    Attributes
    ----------
    values : (m,) array
        Predicted eigenvalues of the next level, ascending; pair by pair not above those of the present level.
    rotation : (m, m) orthogonal array
        Predicted eigenvectors in the prolonged ones: entry (i, j) is how much of present pair i predicted pair j has.
    """

    values: FloatArray
    rotation: FloatArray

    def leak(self, split: int) -> float:
        """Directions lost if the pairs before ``split`` stay at their level: sin^2 of the angles, summed."""
        return float(np.sum(self.rotation[split:, :split] ** 2))


def predict_next_level(
    subdivision: sparse.csr_array,
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    values: FloatArray,
    vectors: FloatArray,
    *,
    steps: int = 4,
) -> Prediction:
    """Predict the eigenpairs of level l + 1 from those of level l.

    The residuals of the prolonged pairs, R = W^{l+1} S X - M^{l+1} S X Lambda, are orthogonal to the image of S (paper,
    eq. 2). What the pairs lack is therefore of high frequency, where W^{l+1} is well conditioned once scaled by its
    diagonal, and a few steps of Chebyshev iteration give Z near W^{-1} R. To second order the level l + 1 then acts on
    the prolonged pairs as Lambda - R^T Z. Its eigenvalues, not only its diagonal, are what counts: pairs closer to each
    other than their error mix, and one that the coarse level resolves badly drops below its neighbours.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
        S^l.
    stiffness, mass : (n_{l+1}, n_{l+1}) CSR arrays
        Of the next level.
    values : (m,) array
    vectors : (n_l, m) array
        Eigenpairs of level l, M-orthonormal.
    steps : int
        Chebyshev steps.

    Returns
    -------
    Prediction
    """
    prolonged = multiply(subdivision, vectors)
    residual = multiply(stiffness, prolonged) - multiply(mass, prolonged) * values
    correction = _smooth(stiffness, residual, steps)
    energy = residual.T @ correction
    gained = np.diag(energy)
    # On the correction the operator is W - lambda M rather than W: a Rayleigh quotient mu near lambda gains more.
    weight = np.einsum("ij,ij->j", correction, multiply(mass, correction))
    share = np.clip(values * weight / np.maximum(gained, np.finfo(float).tiny), 0.0, 0.5)
    scale = 1.0 / np.sqrt(1.0 - share)
    coupling = 0.5 * (energy + energy.T) * np.outer(scale, scale)
    predicted, rotation = linalg.eigh(np.diag(values) - coupling)
    return Prediction(predicted, rotation)


def _smooth(matrix: sparse.csr_array, right_sides: FloatArray, steps: int) -> FloatArray:
    """Z near W^{-1} R for R of high frequency: Chebyshev iteration on D^{-1} W, D the diagonal.

    One fixed polynomial for all columns keeps R^T Z symmetric and, but for a ripple, not above R^T W^{-1} R.
    """
    diagonal = matrix.diagonal()[:, None]
    highest = _highest_scaled_eigenvalue(matrix)
    lowest = highest / CONDITION
    centre, radius = 0.5 * (highest + lowest), 0.5 * (highest - lowest)
    step = right_sides / (diagonal * centre)
    solution = step.copy()
    factor = 1.0 / centre
    residual = right_sides
    for iteration in range(1, steps):
        residual = residual - multiply(matrix, step)
        momentum = 0.5 * (radius * factor) ** 2 if iteration == 1 else (0.5 * radius * factor) ** 2
        factor = 1.0 / (centre - momentum / factor)
        step = momentum * step + factor * (residual / diagonal)
        solution += step
    return solution


def _highest_scaled_eigenvalue(matrix: sparse.csr_array) -> float:
    """Largest eigenvalue of D^{-1} A, a few percent high, by power iteration."""
    inverse = 1.0 / matrix.diagonal()
    vector = np.random.default_rng(_SEED).standard_normal(matrix.shape[0])
    norm = 1.0
    for _ in range(15):
        image = inverse * (matrix @ vector)
        norm = float(np.linalg.norm(image) / np.linalg.norm(vector))
        vector = image / np.linalg.norm(image)
    return 1.1 * norm
