"""The hierarchical basis as a value: bands per level, and what can be asked of it (paper, Definition 2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import linalg, sparse

from cagemap.basis.gram import products_with_bands, refined_bands
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import parts
from cagemap.operators import Operators
from cagemap.refinement import Refinement


@dataclass(frozen=True, eq=False, repr=False)
class HierarchicalBasis:
    """Eigenfunctions of several levels as one basis, Phi~^{l+1} = [S^l Phi~^l, band^{l+1}] (eqs. 7, 8).

    The dense matrix of the finest level is never stored: `evaluate` and `rows` make what is asked of it.

    Attributes
    ----------
    bands : tuple of (n_l, k_l) arrays
        New eigenvectors of every level from 0 to the last that has any, each M^l-orthonormal.
    eigenvalues : (k,) array
        Lambda~, band after band, each pair's at its own level. Unit area.
    residuals : (k,) array
        Relative residual of every pair at its own level, see `cagemap.basis.residual_norms`.
    indices : (k,) int64 array
        Place of every pair in the whole spectrum of its own level, from 0.
    gram : (k, k) array
        Phi~^T M Phi~, the same at every level that has all the bands (Lemma 5).
    errors : (k,) array
        Estimated relative eigenvalue error of every pair against the finest level.
    """

    bands: tuple[FloatArray, ...]
    eigenvalues: FloatArray
    residuals: FloatArray
    indices: IndexArray
    gram: FloatArray
    errors: FloatArray

    @property
    def schedule(self) -> tuple[int, ...]:
        """k_l, number of functions that each level adds."""
        return tuple(band.shape[1] for band in self.bands)

    @property
    def count(self) -> int:
        """Total number k of basis functions."""
        return len(self.eigenvalues)

    @property
    def band_levels(self) -> IndexArray:
        """(k,) level that each function was computed at."""
        return np.repeat(np.arange(len(self.bands)), self.schedule)

    @property
    def last_level(self) -> int:
        """The finest level that adds functions; from there on the whole basis can be evaluated."""
        return len(self.bands) - 1

    def size(self, level: int) -> int:
        """Number of functions k~_l of the basis at a level: those of the bands up to it."""
        return sum(self.schedule[: level + 1])

    def __repr__(self) -> str:
        bands = ", ".join(f"{k} at level {level}" for level, k in enumerate(self.schedule))
        return f"HierarchicalBasis({self.count} functions: {bands})"


def evaluate(
    basis: HierarchicalBasis, refinement: Refinement, level: int, *, dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """The basis at one level as a dense matrix: Phi~^level, eq. 8.

    Parameters
    ----------
    basis : HierarchicalBasis
    refinement : Refinement
    level : int
        Bands of finer levels are left out: they are no functions of this level.
    dtype : float64 or float32

    Returns
    -------
    (n_level, k~_level) array

    Raises
    ------
    ParameterError
        If there is no such level.
    """
    _check_level(refinement, level)
    return refined_bands(basis.bands, refinement, level, dtype)


def rows(
    basis: HierarchicalBasis,
    refinement: Refinement,
    level: int,
    vertices: IndexArray,
    *,
    dtype: DTypeLike = np.float64,
) -> NDArray[Any]:
    """Some rows of Phi~^level, without making the others.

    Parameters
    ----------
    basis : HierarchicalBasis
    refinement : Refinement
    level : int
    vertices : (q,) int64 array
        Vertices of that level.
    dtype : float64 or float32

    Returns
    -------
    (q, k~_level) array

    Notes
    -----
    Each row combines the few coarse vertices that influence it: cost is linear in q, not in the size of the level.
    """
    _check_level(refinement, level)
    vertices = np.asarray(vertices, dtype=np.int64)
    n = refinement.levels[level].n_vertices
    if len(vertices) and (vertices.min() < 0 or vertices.max() >= n):
        raise ParameterError(
            f"expected vertices from 0 to {n - 1} of level {level}, got {vertices.min()} to {vertices.max()}"
        )
    parts: list[FloatArray] = []
    chosen: sparse.csr_array | None = None  # None stands for the plain selection of vertices
    for coarser in reversed(range(level + 1)):
        if coarser <= basis.last_level:
            band = basis.bands[coarser]
            parts.append(band[vertices] if chosen is None else multiply(chosen, band))
        if coarser > 0:
            matrix = refinement.matrices[coarser - 1]
            chosen = sparse.csr_array(matrix[vertices] if chosen is None else chosen @ matrix)
    return np.hstack(parts[::-1]).astype(dtype, copy=False)


def row_blocks(
    basis: HierarchicalBasis,
    refinement: Refinement,
    level: int,
    *,
    block: int = 65_536,
    dtype: DTypeLike = np.float64,
) -> Iterator[tuple[slice, NDArray[Any]]]:
    """All rows of Phi~^level, some at a time, for levels whose dense matrix would be too large.

    Parameters
    ----------
    basis : HierarchicalBasis
    refinement : Refinement
    level : int
    block : int
        Rows at a time.
    dtype : float64 or float32

    Yields
    ------
    range : slice
        Of vertices.
    values : (rows, k~_level) array
    """
    _check_level(refinement, level)
    n = refinement.levels[level].n_vertices
    base = min(level, basis.last_level)
    dense = evaluate(basis, refinement, base, dtype=dtype)
    for part in parts(n, block):
        if level == base:
            values = dense[part]
        else:
            chosen = refinement.matrices[level - 1][part]
            for coarser in reversed(range(base, level - 1)):
                chosen = chosen @ refinement.matrices[coarser]
            values = multiply(sparse.csr_array(chosen), dense)
        yield part, values


def gram_matrix(basis: HierarchicalBasis, operators: Operators, refinement: Refinement, level: int) -> FloatArray:
    """Phi~^T M Phi~ of the basis at one level: a leading block of ``basis.gram``, as products do not change (Lemma 5).

    Parameters
    ----------
    basis : HierarchicalBasis
    operators : Operators
    refinement : Refinement
    level : int

    Returns
    -------
    (k~_level, k~_level) array
    """
    _check_level(refinement, level)
    size = basis.size(level)
    return basis.gram[:size, :size]


def project(
    basis: HierarchicalBasis,
    operators: Operators,
    refinement: Refinement,
    values: FloatArray,
    level: int,
    *,
    count: int | None = None,
) -> FloatArray:
    """Coefficients of functions: (Phi~^T M Phi~)^{-1} Phi~^T M f (paper, section 4.4).

    Parameters
    ----------
    basis : HierarchicalBasis
    operators : Operators
    refinement : Refinement
    values : (n_level,) or (n_level, q) array
        Functions at any level; refined first where the basis has finer bands.
    level : int
        The level of ``values``.
    count : int, optional
        Use the leading functions of the basis only.

    Returns
    -------
    (count,) or (count, q) array

    Raises
    ------
    ParameterError
        If the level does not exist or the number of rows is not that of the level.
    """
    _check_level(refinement, level)
    size = basis.count if count is None else count
    if not 1 <= size <= basis.count:
        raise ParameterError(f"expected 1 to {basis.count} basis functions, got {size}")
    n = refinement.levels[level].n_vertices
    functions = np.asarray(values, dtype=np.float64)
    if functions.shape[0] != n:
        raise ParameterError(
            f"expected functions with {n} rows, one for each vertex of level {level}, got {functions.shape}"
        )
    columns = functions.reshape(n, -1)
    needed = int(basis.band_levels[:size].max())
    if level < needed:
        columns, level = refinement.prolong(columns, level, needed), needed
    dual = multiply(operators.mass[level], columns)
    moments = products_with_bands(basis.bands[: needed + 1], refinement, dual, level)[:size]
    coefficients = linalg.cho_solve(linalg.cho_factor(basis.gram[:size, :size]), moments)
    return coefficients.reshape(size, *functions.shape[1:])


def _check_level(refinement: Refinement, level: int) -> None:
    if not 0 <= level <= refinement.n_levels:
        raise ParameterError(
            f"expected a level from 0 to {refinement.n_levels}, got {level}; refine further to have it"
        )
