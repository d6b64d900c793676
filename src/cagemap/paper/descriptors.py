"""Spectral descriptors from eigenvalues and basis rows (paper, section 5.1), without n x n matrices.

A filter rho_t maps an eigenvalue to a weight. A landmark descriptor is rho_t(Lambda~) Phi~(v, :)^T, already in
coefficients. A signature is the diagonal of Phi~ rho_t(Lambda~) Phi~^T, a function to be projected to the basis.
`paper.functional_constraints` lists the descriptors that the method uses (`DescriptorConfig`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray

# [SOG09]: diffusion times are from HEAT_RANGE / lambda_k to HEAT_RANGE / lambda_1.
HEAT_RANGE = 4.0 * np.log(10.0)
# [ASC11]: width of a wave kernel filter, in steps between neighbouring energies.
WAVE_WIDTH = 7.0
# Most filters of both kinds together; every landmark has one descriptor per filter.
_MOST_FILTERS = 1000


@dataclass(frozen=True, eq=False)
class Filters:
    """Parameters of the filters rho_t, chosen once for both surfaces and all levels."""

    times: FloatArray  #: (h,) diffusion times of the heat kernels
    energies: FloatArray  #: (w,) energies of the wave kernels, log eigenvalues
    width: float  #: width of the wave kernels, in log eigenvalue

    def at(self, eigenvalues: FloatArray) -> FloatArray:
        """(k, h + w) rho_t of every eigenvalue; rows do not depend on larger eigenvalues."""
        return np.hstack([heat_filters(eigenvalues, self.times), wave_filters(eigenvalues, self.energies, self.width)])


def choose_filters(target_eigenvalues: FloatArray, source_eigenvalues: FloatArray, heat: int, wave: int) -> Filters:
    """Filters of both kinds for two surfaces of unit area, from their spectra's geometric mean.

    The eigenvalues (k1,), (k2,) may be in any order. ParameterError for too few eigenvalues or no filters.
    """
    if min(heat, wave) < 0 or not 0 < heat + wave <= _MOST_FILTERS:
        raise ParameterError(f"expected 1 to {_MOST_FILTERS} filters, got {heat} heat and {wave} wave kernels")
    spectra = [np.sort(eigenvalues) for eigenvalues in (target_eigenvalues, source_eigenvalues)]
    count = min(len(spectrum) for spectrum in spectra)
    shared = np.exp(np.mean([np.log(np.maximum(spectrum[:count], 1e-12)) for spectrum in spectra], axis=0))
    times = heat_times(shared, heat) if heat else np.zeros(0)
    energies, width = wave_energies(shared, wave) if wave else (np.zeros(0), 1.0)
    return Filters(times, energies, width)


def heat_times(eigenvalues: FloatArray, count: int) -> FloatArray:
    """(count,) diffusion times, ascending, log-spaced in [4 ln 10 / lambda_k, 4 ln 10 / lambda_1]; unit area."""
    positive = _positive(eigenvalues)
    return np.geomspace(HEAT_RANGE / positive.max(), HEAT_RANGE / positive.min(), count)


def heat_filters(eigenvalues: FloatArray, times: FloatArray) -> FloatArray:
    """(k, q) heat kernel filters rho_t(lambda) = exp(-lambda t), one column for each time."""
    return np.exp(-np.outer(eigenvalues, times))


def wave_energies(eigenvalues: FloatArray, count: int) -> tuple[FloatArray, float]:
    """(count,) energies of the wave kernel, ascending, and the filters' width, both in log eigenvalue [ASC11]."""
    positive = _positive(eigenvalues)
    low, high = np.log(positive.min()), np.log(positive.max())
    width = WAVE_WIDTH * (high - low) / count
    if high - 2.0 * width <= low + 2.0 * width:  # too few energies for the full inset on both sides
        width = (high - low) / 8.0
    return np.linspace(low + 2.0 * width, high - 2.0 * width, count), float(width)


def wave_filters(eigenvalues: FloatArray, energies: FloatArray, width: float) -> FloatArray:
    """(k, q) wave kernel filters exp(-(e - log lambda)^2 / (2 width^2)), 0 for the constant function."""
    logs = np.log(np.maximum(eigenvalues, np.finfo(float).tiny))
    filters = np.exp(-((energies[None, :] - logs[:, None]) ** 2) / (2.0 * width**2))
    filters[eigenvalues <= _zero(eigenvalues)] = 0.0
    return filters


def landmark_descriptors(rows: FloatArray, filters: FloatArray) -> FloatArray:
    """Coefficients (k, p q) of the landmark descriptors rho_t(Lambda~) Phi~(v, :)^T (paper, Definition 3).

    ``rows`` (p, k) are Phi~(v, :), ``filters`` (k, q) rho_t of every eigenvalue; column i q + j is landmark i's with
    filter j.
    """
    k = rows.shape[1]
    if filters.shape[0] != k:
        raise ParameterError(
            f"filters: expected {k} rows, one for each basis function, got {len(filters)}. Use its eigenvalues."
        )
    return (rows.T[:, :, None] * filters[:, None, :]).reshape(k, len(rows) * filters.shape[1])


def signatures(rows: FloatArray, filters: FloatArray) -> FloatArray:
    """(b, q) values of the signatures diag(Phi~ rho_t(Lambda~) Phi~^T) at vertices with basis rows (b, k)."""
    return (rows * rows) @ filters


def normalise_columns(columns: FloatArray) -> FloatArray:
    """Scale every descriptor (column of coefficients) to unit norm; zero columns stay zero."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0.0, norms, 1.0)


def _zero(eigenvalues: FloatArray) -> float:
    """Largest eigenvalue that counts as 0, that of the constant function."""
    return 1e-8 * float(np.max(eigenvalues, initial=0.0))


def _positive(eigenvalues: FloatArray) -> FloatArray:
    positive = eigenvalues[eigenvalues > _zero(eigenvalues)]
    if len(positive) < 2:
        raise ParameterError(f"descriptors need at least 2 eigenvalues above 0, got {len(positive)}: raise k")
    return positive
