"""Functional maps from level to level (paper, section 5.3.2, eqs. 14-16)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.functional_map.solve import Commutator, solve_functional_map
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True)
class SpectralData:
    """What one level's optimisation needs of one surface, in coefficients of its hierarchical basis.

    Attributes
    ----------
    eigenvalues : (k,) array
        Lambda~, in the order of the basis: bands of level 0, 1, ...
    descriptors : (k, q) array
        F~, the same q descriptors on both surfaces.
    symmetry : (k, k) array or None
        Tridiagonal self-symmetry operator O~ (paper, section 5.2).
    """

    eigenvalues: FloatArray
    descriptors: FloatArray
    symmetry: FloatArray | None = None

    def leading(self, count: int) -> SpectralData:
        """Keep the first basis functions only."""
        symmetry = None if self.symmetry is None else self.symmetry[:count, :count]
        return SpectralData(self.eigenvalues[:count], self.descriptors[:count], symmetry)


@dataclass(frozen=True)
class OperatorWeights:
    """alpha(O) of eq. 13, relative to the data term."""

    laplacian: float = 0.1
    symmetry: float = 0.1


def coarse_functional_map(target: SpectralData, source: SpectralData, weights: OperatorWeights) -> FloatArray:
    """Functional map of level 0, eq. 13; (k1, k2)."""
    return _solve(target, source, weights, slice(None), slice(None), target.descriptors)


def extend_functional_map(
    coarse: FloatArray, target: SpectralData, source: SpectralData, weights: OperatorWeights
) -> FloatArray:
    """Extend a functional map by the bands of the next level, eq. 14: C_h = [[C_l, C_lh], [C_hl, C_h]].

    C_l stays as it is. The low rows give C_lh alone (eq. 16); the high rows give C_hl and C_h together.

    Parameters
    ----------
    coarse : (k1_l, k2_l) array
        C_l, on the leading basis functions of both surfaces.
    target, source : SpectralData
        Of level l + 1: k1 >= k1_l and k2 >= k2_l basis functions (eq. 15 splits them).

    Returns
    -------
    (k1, k2) array
    """
    low1, low2 = coarse.shape
    k1, k2 = len(target.eigenvalues), len(source.eigenvalues)
    extended = np.zeros((k1, k2))
    extended[:low1, :low2] = coarse
    low_rows, high_rows, high_columns = slice(0, low1), slice(low1, k1), slice(low2, k2)
    if k2 > low2:
        explained = coarse @ source.descriptors[:low2]
        remainder = target.descriptors[low_rows] - explained
        extended[low_rows, high_columns] = _solve(target, source, weights, low_rows, high_columns, remainder)
    if k1 > low1:
        wanted = target.descriptors[high_rows]
        extended[high_rows] = _solve(target, source, weights, high_rows, slice(None), wanted)
    return extended


def _solve(
    target: SpectralData,
    source: SpectralData,
    weights: OperatorWeights,
    rows: slice,
    columns: slice,
    wanted: FloatArray,
) -> FloatArray:
    """One block of rows and columns, with that block of every operator."""
    commutators: tuple[Commutator, ...] = ()
    if target.symmetry is not None and source.symmetry is not None and weights.symmetry > 0.0:
        blocks = target.symmetry[rows, rows], source.symmetry[columns, columns]
        commutators = (Commutator(*blocks, weights.symmetry),)
    return solve_functional_map(
        source.descriptors[columns],
        wanted,
        target.eigenvalues[rows],
        source.eigenvalues[columns],
        weights.laplacian,
        commutators,
    )
