"""Functional maps from level to level (paper, section 5.3, eqs. 13-16)."""

from __future__ import annotations

import numpy as np

from cagemap.functional_map.constraints import Constraints, MapWeights, SpectralData
from cagemap.functional_map.solve import solve_functional_map
from cagemap.numerics.arrays import FloatArray


def extend_functional_map(
    coarse: FloatArray, constraints: Constraints, weights: MapWeights, *, match: FloatArray | None = None
) -> FloatArray:
    """Extend a functional map by the bands of the next level, eq. 14: C_h = [[C_l, C_lh], [C_hl, C_h]].

    C_l stays as it is. Tridiagonal operators are cut to their diagonal blocks (eq. 15), so the low rows give C_lh alone
    (eq. 16) and the high rows C_hl and C_h; denser ones keep their entries and couple all three (end of 5.3.2).

    Parameters
    ----------
    coarse : (k1_l, k2_l) array
        C_l, on the leading basis functions of both surfaces.
    constraints : Constraints
        Of level l + 1: k1 >= k1_l and k2 >= k2_l basis functions.
    weights : MapWeights
    match : (k1, k2) array, optional
        Functional map of the point map so far: the new blocks are then found by the descriptors and by the map.

    Returns
    -------
    (k1, k2) array
    """
    low1, low2 = coarse.shape
    split = Constraints(split_operators(constraints.target, low1), split_operators(constraints.source, low2))
    return solve_functional_map(split, weights, known=coarse, match=match)


def split_operators(data: SpectralData, low: int) -> SpectralData:
    """Cut tridiagonal operators between low and high functions (eq. 15); denser ones stay whole."""
    operators = tuple(_block_diagonal(o, low) if _is_tridiagonal(o) else o for o in data.operators)
    return SpectralData(data.eigenvalues, data.descriptors, operators)


def _is_tridiagonal(operator: FloatArray) -> bool:
    return not (np.any(np.triu(operator, 2)) or np.any(np.tril(operator, -2)))


def _block_diagonal(operator: FloatArray, low: int) -> FloatArray:
    blocks = np.zeros_like(operator)
    blocks[:low, :low], blocks[low:, low:] = operator[:low, :low], operator[low:, low:]
    return blocks
