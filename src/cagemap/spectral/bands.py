"""Compute a basis: all functions at one level, or the paper's bands of several levels (sections 4.3 and 4.4)."""

from __future__ import annotations

import logging

import numpy as np
from scipy import linalg, sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.products import multiply
from cagemap.operators import Operators, lumped_areas
from cagemap.spectral.basis import HierarchicalBasis, products_with_bands
from cagemap.spectral.config import SOLVER, BasisConfig
from cagemap.spectral.eigenpairs import band_pairs, count_below, residual_norms
from cagemap.subdivision import Refinement

_log = logging.getLogger(__name__)


def hierarchical_basis(
    refinement: Refinement, operators: Operators, config: BasisConfig = BasisConfig()
) -> HierarchicalBasis:
    """Basis of a surface: ``config.count`` functions of one level, or ``config.schedule[l]`` of each level.

    Warns where functions of different levels nearly repeat each other (``condition``).

    Parameters
    ----------
    refinement : Refinement
    operators : Operators
        Of the same refinement.
    config : BasisConfig

    Raises
    ------
    ParameterError
        If more functions are asked for than a level has vertices.
    """
    counts = config.bands(refinement, operators.finest)
    if config.schedule is None:
        size = operators.mass[len(counts) - 1].shape[0]
        if config.count > size and config.count != BasisConfig.count:
            raise ParameterError(
                f"count: expected at most {size} basis functions, the vertices of the finest level, got {config.count};"
                " refine further or ask for fewer"
            )
        counts = (*counts[:-1], min(config.count, size))
    else:
        _check_schedule(operators, counts)
    while not counts[-1]:
        counts = counts[:-1]
    none = np.zeros(0)
    basis = HierarchicalBasis(refinement, operators, (), none, none, none.astype(np.int64), np.zeros((0, 0)))
    for level, count in enumerate(counts):
        basis = _with_band(basis, level, *_new_band(basis, level, count, config))
    if basis.condition > SOLVER.ill_conditioned:
        _log.warning(
            "%s: the Gram matrix has condition %.0f: functions of different levels nearly repeat each other, since "
            "coarse levels were asked for more than they resolve; take fewer there, or count instead of schedule",
            basis,
            basis.condition,
        )
    return basis


def _new_band(basis: HierarchicalBasis, level: int, count: int, config: BasisConfig) -> tuple[FloatArray, IndexArray]:
    """The eigenvectors (n_l, k_l) of a level that follow those of the basis so far (Definition 2), and their places."""
    stiffness, mass = basis.operators.stiffness[level], basis.operators.mass[level]
    if not count:
        return np.zeros((mass.shape[0], 0)), np.zeros(0, dtype=np.int64)
    if config.literal and basis.count:
        first = count_below(stiffness, mass, float(basis.eigenvalues.max()))
        if first + count > mass.shape[0]:
            raise ParameterError(
                f"schedule: expected at most {mass.shape[0] - first} functions at level {level}, which has so many "
                f"above the largest eigenvalue so far, got {count}; move counts to finer levels"
            )
        pairs = band_pairs(stiffness, mass, first, first + count, accuracy=config.accuracy)
        return _orthonormal(pairs.vectors, mass), first + np.arange(count)
    first = max(0, basis.count - SOLVER.overlap)
    pairs = band_pairs(stiffness, mass, first, basis.count + count, accuracy=config.accuracy)
    vectors = _orthonormal(pairs.vectors, mass)
    if not basis.count:
        return vectors, np.arange(count)
    overlap = products_with_bands(basis.bands, basis.refinement, multiply(mass, vectors), level)
    rotation, positions = new_directions(pairs.values, overlap, basis.gram, basis.count - first)
    return np.ascontiguousarray(vectors @ rotation), first + positions


def _with_band(basis: HierarchicalBasis, level: int, band: FloatArray, indices: IndexArray) -> HierarchicalBasis:
    """The basis with the band of one more level; its Gram matrix is [[G, E], [E^T, I]] (eqs. 8, 9)."""
    mass, stiffness = basis.operators.mass[level], basis.operators.stiffness[level]
    dual, energy = multiply(mass, band), multiply(stiffness, band)
    values = np.einsum("ij,ij->j", band, energy)
    residuals = residual_norms(values, energy, dual, lumped_areas(mass))
    cross = products_with_bands(basis.bands, basis.refinement, dual, level)
    return HierarchicalBasis(
        basis.refinement,
        basis.operators,
        (*basis.bands, band),
        np.concatenate([basis.eigenvalues, values]),
        np.concatenate([basis.residuals, residuals]),
        np.concatenate([basis.indices, indices]),
        np.block([[basis.gram, cross], [cross.T, np.eye(len(values))]]),
    )


def clusters(values: FloatArray) -> IndexArray:
    """(m,) number of the cluster of nearly equal eigenvalues that each of an ascending list belongs to."""
    steps = np.diff(values) > SOLVER.cluster * np.maximum(np.abs(values[1:]), 1e-3 * abs(values[-1]))
    return np.concatenate([[0], np.cumsum(steps)])


def new_directions(
    values: FloatArray, overlap: FloatArray, gram: FloatArray, present: int
) -> tuple[FloatArray, IndexArray]:
    """Rotate eigenvectors inside repeated eigenvalues; leave out those that the refined basis spans.

    A repeated eigenvalue may be cut by the end of a band: its eigenvectors are rotated so that each is in the refined
    span as far as possible or out of it. ``present`` directions are there already: those with the largest overlap.
    Given are the window's eigenvalues (m,), ascending, of M-orthonormal vectors, and inner products of the refined
    basis with the window (k, m) and with itself (k, k). Returned are the new directions in the window (m, m - present),
    and the place of each.
    """
    m = len(values)
    # In an orthonormal basis of the refined span a squared column norm is the share of a vector inside that span.
    inside = linalg.solve_triangular(linalg.cholesky(gram, lower=True), overlap, lower=True)
    rotation = np.eye(m)
    share = np.sum(inside**2, axis=0)
    labels = clusters(values)
    for label in np.flatnonzero(np.bincount(labels) > 1):
        members = np.flatnonzero(labels == label)
        squares, axes = linalg.eigh(inside[:, members].T @ inside[:, members])
        if squares[0] > 0.5 or squares[-1] < 0.5:  # not cut: its vectors stay as they are
            continue
        # Descending shares: the missing directions come last, next to the following pairs.
        share[members] = squares[::-1]
        rotation[np.ix_(members, members)] = axes[:, ::-1]
    positions = np.sort(np.argsort(-share, kind="stable")[present:])
    return rotation[:, positions], positions


def _orthonormal(vectors: FloatArray, mass: sparse.csr_array) -> FloatArray:
    """Eigenvectors that may come in single precision, M-orthonormal in double."""
    band = np.array(vectors, dtype=np.float64)
    factor = linalg.cholesky(band.T @ multiply(mass, band))
    return np.ascontiguousarray(linalg.solve_triangular(factor, band.T, trans="T").T)


def _check_schedule(operators: Operators, counts: tuple[int, ...]) -> None:
    sizes = [mass.shape[0] for mass in operators.mass]
    if len(counts) > len(sizes):
        raise ParameterError(
            f"schedule: expected at most {len(sizes)} counts, one for each level, got {len(counts)}: {counts}; refine "
            "further or shorten it"
        )
    for level, total in enumerate(np.cumsum(counts)):
        if total > sizes[level]:
            raise ParameterError(
                f"schedule: expected at most {sizes[level]} functions up to level {level}, which has so many vertices, "
                f"got {total} from {counts}; move counts to finer levels, or give count instead"
            )
