"""Constraints of a functional map: descriptors and operators, in coefficients of the bases (paper, 5.1 - 5.3).

No n x n matrix is formed. A filter rho_t maps an eigenvalue to a weight. A landmark descriptor is
rho_t(Lambda~) Phi~(v, :)^T, already in coefficients. A signature is the diagonal of Phi~ rho_t(Lambda~) Phi~^T, a
function to be projected to the basis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.maps.pair import Pair
from cagemap.mesh.curves import Curve
from cagemap.numerics.arrays import FloatArray, IndexArray, finite_numbers
from cagemap.numerics.kinds import Config, kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.paper.symmetries import check_symmetry, symmetry_at, symmetry_operator
from cagemap.spectral.surface import Surface
from cagemap.surface.triangle_surface import SurfacePoints

HEAT_RANGE = 4.0 * np.log(10.0)  # [SOG09]: diffusion times are from HEAT_RANGE / lambda_k to HEAT_RANGE / lambda_1
WAVE_WIDTH = 7.0  # [ASC11]: width of a wave kernel filter, in steps between neighbouring energies
_MOST_FILTERS = 1000  # most filters of both kinds together; every landmark has one descriptor per filter
# Mean distance of neighbouring eigenvalues at unit area (Weyl's law). In this unit, eigenvalues are approximately their
# indices in the spectrum, so that one weight suits all k and all surfaces.
SPACING = 4.0 * np.pi


@dataclass(frozen=True, repr=False)
class ConstraintConfig(Config):
    """Numbers of descriptors, and weights of eq. 13 for descriptors of unit norm; alike on all levels."""

    heat: int = 10  #: number of heat kernel filters, for landmarks and signatures
    wave: int = 20  #: number of wave kernel filters, for landmarks and signatures
    signature_weight: float = 3.0  #: norm of a signature, relative to 1 of a landmark kernel; 0: no signatures
    laplacian: float = 0.001  #: alpha(Lambda~), for eigenvalues in units of their mean spacing (see `SPACING`)
    operators: float = 1.0  #: alpha(O) of every other operator
    decay: float = 3.0  #: weight of ||C||^2, against noise in rows of C that no descriptor determines; 0: eq. 13


@dataclass(frozen=True)
class Constraints:
    """Data of eq. 13: corresponding descriptors and operators of both surfaces."""

    target: SpectralData
    source: SpectralData

    def __post_init__(self) -> None:
        target, source = self.target, self.source
        if target.descriptors.shape[1] != source.descriptors.shape[1]:
            raise ParameterError(
                "expected as many target as source descriptors, got "
                f"{target.descriptors.shape[1]} and {source.descriptors.shape[1]}"
            )
        if len(target.operators) != len(source.operators):
            raise ParameterError(
                f"expected as many target as source operators, got {len(target.operators)} and {len(source.operators)}"
            )
        for side, data in (("target", target), ("source", source)):
            sizes = {(len(data.descriptors), data.count), *(matrix.shape for matrix in data.operators)}
            if sizes != {(data.count, data.count)}:
                raise ParameterError(
                    f"{side}: expected {data.count} rows of descriptors and operators, one for each basis function, "
                    f"got {sorted(sizes)}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(k1, k2), the shape of C12."""
        return self.target.count, self.source.count

    def leading(self, k1: int, k2: int) -> Constraints:
        """Constraints of the leading basis functions of both sides, as on a coarser level."""
        return Constraints(self.target.leading(k1), self.source.leading(k2))

    def with_descriptors(self, target: FloatArray, source: FloatArray, weight: float = 1.0) -> Constraints:
        """Add pairs of user-defined descriptors.

        Coefficients (k1, q), (k2, q) of corresponding functions; every column is scaled to norm ``weight``, which is 1
        for a landmark kernel.
        """
        sides = []
        for name, data, given in (("target", self.target, target), ("source", self.source, source)):
            columns = finite_numbers(given, f"{name} descriptors")
            if columns.ndim != 2 or len(columns) != data.count:
                raise ParameterError(
                    f"{name} descriptors: expected coefficients ({data.count}, q) of q functions, got {columns.shape}"
                )
            scaled = finite_numbers(weight, "weight") * normalise_columns(columns)
            sides.append(replace(data, descriptors=np.hstack([data.descriptors, scaled])))
        return Constraints(*sides)

    def with_operators(self, target: FloatArray, source: FloatArray) -> Constraints:
        """Add a pair of operators (k1, k1), (k2, k2) of norm about 1 that C shall commute with."""
        sides = ((self.target, target), (self.source, source))
        return Constraints(
            *(replace(data, operators=(*data.operators, finite_numbers(given, "operators"))) for data, given in sides)
        )


@dataclass(frozen=True, eq=False, repr=False)
class SpectralData:
    """Descriptors and operators of one surface; leading blocks belong to coarser levels (eq. 15)."""

    eigenvalues: FloatArray  #: (k,) Lambda~, in the order of the basis: bands of level 0, 1, ... Unit area.
    descriptors: FloatArray  #: (k, q) F~, weighted coefficients of the same q descriptors as on the other surface
    #: (k, k) each, in the same order on both surfaces: O~ but the Laplacian, such as self-symmetries (paper, 5.2)
    operators: tuple[FloatArray, ...] = ()

    def __repr__(self) -> str:
        sizes = f"{self.count} functions, {self.descriptors.shape[1]} descriptors, {len(self.operators)} operators"
        return f"SpectralData({sizes})"

    @property
    def count(self) -> int:
        """Number k of basis functions."""
        return len(self.eigenvalues)

    def leading(self, count: int) -> SpectralData:
        """The data of the first ``count`` basis functions."""
        operators = tuple(operator[:count, :count] for operator in self.operators)
        return SpectralData(self.eigenvalues[:count], self.descriptors[:count], operators)


@kinds_checked
def gather_constraints(pair: Pair, config: ConstraintConfig = ConstraintConfig()) -> Constraints:
    """Descriptors F~ and operators O~ of both surfaces on their whole bases.

    Filters are chosen and columns scaled once, for all levels: descriptors F~^l of a coarser level are the leading
    rows, and weights of operators have the same meaning on all levels (eqs. 13-16). Of the config ``heat``, ``wave``
    and ``signature_weight`` are read.
    """
    filters = choose_filters(pair.target.basis.eigenvalues, pair.source.basis.eigenvalues, config.heat, config.wave)
    curves = [curve.target for curve in pair.landmarks.curves], [curve.source for curve in pair.landmarks.curves]
    sides = [
        (pair.target, pair.target_landmarks, curves[0], tuple(target for target, _ in pair.symmetries)),
        (pair.source, pair.source_landmarks, curves[1], tuple(source for _, source in pair.symmetries)),
    ]
    data = in_threads(lambda side: _spectral_data(*side, filters, config), sides)
    return Constraints(*data)


def _spectral_data(
    surface: Surface,
    landmarks: IndexArray,
    curves: Sequence[Curve[SurfacePoints]],
    symmetries: tuple[IndexArray, ...],
    filters: Filters,
    config: ConstraintConfig,
) -> SpectralData:
    basis = surface.basis
    at_eigenvalues, level = filters.at(basis.eigenvalues), basis.last_level
    rows = basis.rows(level, surface.hierarchy.on_level(level, landmarks))
    columns = [normalise_columns(landmark_descriptors(rows, at_eigenvalues))]
    if curves:
        columns.append(normalise_columns(landmark_descriptors(curve_rows(surface, curves), at_eigenvalues)))
    if config.signature_weight > 0.0:
        projected = basis.project(signature_functions(surface, filters, level), level)
        columns.append(config.signature_weight * normalise_columns(projected))
    projections = []
    for symmetry in symmetries:
        check_symmetry(symmetry, surface.control)
        projections.append(symmetry_operator(basis, symmetry_at(surface.hierarchy, symmetry, level)))
    return SpectralData(basis.eigenvalues, np.hstack(columns), tuple(projections))


def curve_rows(surface: Surface, curves: Sequence[Curve[SurfacePoints]]) -> FloatArray:
    """(q, k) length-weighted means of Phi~(v, :) along curves, whose kernels start from a whole curve at once."""
    corners, places = np.unique(np.vstack([curve.points.corners for curve in curves]), return_inverse=True)
    rows = surface.basis_rows(corners)
    weights = np.vstack([curve.line.point_shares[:, None] * curve.points.barycentric for curve in curves])
    curve_of = np.repeat(np.arange(len(curves)), [3 * len(curve.points) for curve in curves])
    gather = sparse.csr_array((weights.ravel(), (curve_of, places.ravel())), shape=(len(curves), len(corners)))
    return np.asarray(gather @ rows)


@kinds_checked
def signature_functions(surface: Surface, filters: Filters, level: int) -> FloatArray:
    """(n_level, q) signatures diag(Phi~ rho_t(Lambda~) Phi~^T) at the vertices of a level (Definition 3)."""
    at_eigenvalues = filters.at(surface.basis.eigenvalues[: surface.basis.size(level)])
    return np.concatenate([signatures(block, at_eigenvalues) for _, block in surface.basis.row_blocks(level)])


def landmark_descriptors(rows: FloatArray, filters: FloatArray) -> FloatArray:
    """Coefficients (k, p q) of the landmark descriptors rho_t(Lambda~) Phi~(v, :)^T (paper, Definition 3).

    ``rows`` (p, k) are Phi~(v, :), ``filters`` (k, q) rho_t of every eigenvalue; column i q + j is landmark i's with
    filter j.
    """
    k = rows.shape[1]
    if filters.shape[0] != k:
        raise ParameterError(f"filters: expected {k} rows, got {len(filters)}. Use the eigenvalues of the basis.")
    return (rows.T[:, :, None] * filters[:, None, :]).reshape(k, len(rows) * filters.shape[1])


def signatures(rows: FloatArray, filters: FloatArray) -> FloatArray:
    """(b, q) values of the signatures diag(Phi~ rho_t(Lambda~) Phi~^T) at vertices with basis rows (b, k)."""
    return (rows * rows) @ filters


def normalise_columns(columns: FloatArray) -> FloatArray:
    """Scale every descriptor (column of coefficients) to unit norm; zero columns stay zero."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0.0, norms, 1.0)


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
    """Filters for two surfaces by their spectra's geometric mean; ParameterError for too few eigenvalues, or none."""
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


def _positive(eigenvalues: FloatArray) -> FloatArray:
    positive = eigenvalues[eigenvalues > _zero(eigenvalues)]
    if len(positive) < 2:
        raise ParameterError(f"descriptors need at least 2 eigenvalues above 0, got {len(positive)}: raise k")
    return positive


def _zero(eigenvalues: FloatArray) -> float:
    """Largest eigenvalue that counts as 0, that of the constant function."""
    return 1e-8 * float(np.max(eigenvalues, initial=0.0))
