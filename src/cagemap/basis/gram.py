"""Inner products of functions that live on different levels, by coarse-level products only (paper, Lemma 5)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.products import multiply
from cagemap.refinement import Refinement


def products_with_bands(
    bands: tuple[FloatArray, ...], refinement: Refinement, dual: FloatArray, level: int
) -> FloatArray:
    """Phi~^T y for y given as a functional on one level: y = M^level f, restricted down the levels.

    Parameters
    ----------
    bands : tuple of (n_l, k_l) arrays
        Band of every level from 0 up to at most ``level``.
    refinement : Refinement
    dual : (n_level, q) array
    level : int

    Returns
    -------
    (k, q) array, k the number of functions in the bands
    """
    bands = bands[: level + 1]
    if _few(bands, dual.shape[1]):
        return refined_bands(bands, refinement, level).T @ dual
    parts: list[FloatArray] = []
    for coarser in reversed(range(level + 1)):
        if coarser < len(bands):
            parts.append(bands[coarser].T @ dual)
        if coarser > 0:
            dual = refinement.matrices[coarser - 1].T @ dual
    return np.concatenate(parts[::-1]) if parts else np.zeros((0, dual.shape[1]))


def overlaps_with_bands(
    bands: tuple[FloatArray, ...], refinement: Refinement, mass: sparse.csr_array, vectors: NDArray[Any], level: int
) -> FloatArray:
    """(k, q) Phi~^T M X for functions X, (n_level, q), of the level of the mass matrix, in either precision."""
    if _few(bands, vectors.shape[1]):
        functions = multiply(mass, refined_bands(bands, refinement, level))
        return (functions.astype(vectors.dtype).T @ vectors).astype(np.float64)
    return products_with_bands(bands, refinement, multiply(mass, vectors), level)


def _few(bands: tuple[FloatArray, ...], columns: int) -> bool:
    """Whether the functions of the bands are refined sooner than so many columns are restricted."""
    return 4 * sum(band.shape[1] for band in bands) < columns


def refined_bands(
    bands: tuple[FloatArray, ...], refinement: Refinement, level: int, dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """(n_level, k~_level) Phi~^level, eq. 8: the bands up to a level, refined to it."""
    values: NDArray[Any] = np.zeros((refinement.levels[0].n_vertices, 0), dtype=dtype)
    for finer in range(level + 1):
        if finer > 0:
            values = multiply(refinement.matrices[finer - 1], values)
        if finer < len(bands):
            values = np.hstack([values, bands[finer].astype(dtype, copy=False)])
    return values


def extend_gram(
    gram: FloatArray, bands: tuple[FloatArray, ...], refinement: Refinement, dual: FloatArray, level: int
) -> FloatArray:
    """Gram matrix Phi~^T M Phi~ after an orthonormal band of one more level, eq. 9: [[G, E], [E^T, I]].

    ``dual`` is M^level times the band.
    """
    cross = products_with_bands(bands, refinement, dual, level)
    return np.block([[gram, cross], [cross.T, np.eye(dual.shape[1])]])
