"""How far the eigenpairs of one level are from those of the surface, without computing finer ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from cagemap.basis.constants import (
    CHEAP_WORK,
    MUCH_WORK,
    PREDICTION_STEPS,
    SAFETY,
    SAMPLE_SAFETY,
    SAMPLES,
    SINGLE_TOLERANCE,
)
from cagemap.basis.smoothing import Block, Smoother, residuals, smoother
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.products import multiply


@dataclass(frozen=True, eq=False)
class ErrorEstimate:
    """Errors of the eigenpairs of one level against the finest, safety included.

    Attributes
    ----------
    errors : (m,) array
        Relative errors of the eigenvalues, index by index.
    leaks : (m + 1,) array
        For a cut before each pair, and after the last: how much of a direction is lost if the pairs below the cut stay
        at their level. Only their order matters.
    """

    errors: FloatArray
    leaks: FloatArray


def estimate_errors(
    subdivision: sparse.csr_array,
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    values: FloatArray,
    vectors: Block,
    tolerance: float,
) -> ErrorEstimate:
    """Errors of the eigenpairs of level l against the finest level, from the operators of level l + 1.

    All pairs are predicted together where that is cheap. On a large next level a sample of them comes first, and
    settles the matter if it is clear of the tolerance; on a very large one the sample has to do.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
        S^l.
    stiffness, mass : (n_{l+1}, n_{l+1}) CSR arrays
        Of the next level.
    values : (m,) array
    vectors : (n_l, m) array
        Eigenpairs of level l, M-orthonormal, ascending.
    tolerance : float
        Relative error that matters.
    """
    count = len(values)
    # The constant function has eigenvalue 0 at every level; a fraction of the last eigenvalue stands in for it.
    scale = np.maximum(values, 1e-3 * max(values[-1], 4.0 * np.pi / float(mass.sum())))
    work = stiffness.shape[0] * count
    # Single precision disturbs eigenvalues by less than 1e-7.
    vectors = vectors.astype(np.float32 if tolerance > SINGLE_TOLERANCE else np.float64, copy=False)
    chosen, smooth = slice(0, count), smoother(stiffness)
    errors, leaks = np.zeros(count), np.zeros(count + 1)
    if work > CHEAP_WORK and count > 2 * SAMPLES:
        sample = np.unique(np.linspace(0, count - 1, SAMPLES).astype(np.int64))
        coupling = _coupling(subdivision, smooth, mass, values[sample], vectors[:, sample])
        sampled = SAFETY * np.diag(coupling) / scale[sample]
        # Errors grow with the index: between two samples take the larger.
        segment = np.searchsorted(sample, np.arange(count), side="right") - 1
        errors = SAMPLE_SAFETY * np.maximum(sampled, np.append(sampled[1:], 0.0))[segment]
        gaps = np.diff(values, prepend=-scale[0], append=values[-1] + scale[0])
        leaks = np.append(errors * scale, errors[-1] * scale[-1]) / np.maximum(gaps, 1e-9 * scale[-1])
        if errors.max() <= 0.5 * tolerance or work > MUCH_WORK:
            return ErrorEstimate(errors, leaks)
        # From the first pair that is clearly too bad on nothing is kept.
        bad = sample[sampled > 2.0 * tolerance]
        chosen = slice(0, min(count, int(bad[0]) + 1 + count // 10) if len(bad) else count)
    predicted, rotation = predict_next_level(subdivision, smooth, mass, values[chosen], vectors[:, chosen])
    errors[chosen] = SAFETY * np.maximum(values[chosen] - predicted, 0.0) / scale[chosen]
    # Entry s sums the squares of rows from s on and columns before s.
    summed = np.zeros((chosen.stop + 1, chosen.stop + 1))
    summed[1:, 1:] = np.cumsum(np.cumsum(rotation**2, axis=0), axis=1)
    leaks[: chosen.stop + 1] = summed[-1] - np.diag(summed)
    return ErrorEstimate(errors, leaks)


def predict_next_level(
    subdivision: sparse.csr_array, smooth: Smoother, mass: sparse.csr_array, values: FloatArray, vectors: Block
) -> tuple[FloatArray, FloatArray]:
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
    smooth : Smoother
        Of the stiffness matrix of the next level.
    mass : (n_{l+1}, n_{l+1}) CSR array
        Of the next level.
    values : (m,) array
    vectors : (n_l, m) array
        Eigenpairs of level l, M-orthonormal.

    Returns
    -------
    predicted : (m,) array
        Eigenvalues of level l + 1, ascending.
    rotation : (m, m) orthogonal array
        Its eigenvectors in the prolonged ones: entry (i, j) is how much of pair i predicted pair j has.
    """
    coupling = _coupling(subdivision, smooth, mass, values, vectors)
    predicted, rotation = linalg.eigh(np.diag(values) - coupling)
    return predicted, rotation


def _coupling(
    subdivision: sparse.csr_array, smooth: Smoother, mass: sparse.csr_array, values: FloatArray, vectors: Block
) -> FloatArray:
    """(m, m) energy R^T Z that corrections within level l + 1 gain."""
    prolonged = multiply(subdivision, vectors)
    residual = residuals(smooth.matrix, mass, prolonged, values)
    correction = smooth(residual, PREDICTION_STEPS)
    energy = np.asarray(residual.T @ correction, dtype=np.float64)
    gained = np.diag(energy)
    # On the correction the operator is W - lambda M rather than W: a Rayleigh quotient mu near lambda gains more.
    weight = np.einsum("ij,ij->j", correction, multiply(mass, correction))
    share = np.clip(values * weight / np.maximum(gained, np.finfo(float).tiny), 0.0, 0.5)
    scale = 1.0 / np.sqrt(1.0 - share)
    return 0.5 * (energy + energy.T) * np.outer(scale, scale)
