"""The hierarchical basis as a value: bands per level, and what can be asked of it (paper, Definition 2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import linalg, sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only, real_numbers
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import parts
from cagemap.operators import Operators
from cagemap.subdivision import Refinement

# Rows that are made at a time of levels whose dense matrix would be too large.
ROWS = 65_536


@dataclass(frozen=True, eq=False, repr=False)
class HierarchicalBasis:
    """Eigenfunctions of several levels as one basis, Phi~^{l+1} = [S^l Phi~^l, band^{l+1}] (eqs. 7, 8).

    The dense matrix of the finest level is never stored: `at`, `rows` and `row_blocks` make what is asked of it.

    Attributes
    ----------
    refinement : Refinement
    operators : Operators
        Of the surface that the functions live on: of all its levels, or of the first ones.
    bands : tuple of (n_l, k_l) arrays
        New eigenvectors of every level from 0 to the last that has any, each M^l-orthonormal.
    eigenvalues : (k,) array
        Lambda~, band after band, each pair's at its own level. Unit area.
    residuals : (k,) array
        Relative residual of every pair at its own level, see `cagemap.spectral.residual_norms`.
    indices : (k,) int64 array
        Place of every pair in the whole spectrum of its own level, from 0.
    gram : (k, k) array
        Phi~^T M Phi~, the same at every level that has all the bands (Lemma 5).
    """

    refinement: Refinement
    operators: Operators
    bands: tuple[FloatArray, ...]
    eigenvalues: FloatArray
    residuals: FloatArray
    indices: IndexArray
    gram: FloatArray

    def __post_init__(self) -> None:
        """Check that the bands are functions of these levels; nobody changes them from here on."""
        sizes = [level.n_vertices for level in self.refinement.levels]
        found = [band.shape[0] for band in self.bands]
        known = [mass.shape[0] for mass in self.operators.mass]
        if found != sizes[: len(found)] or known != sizes[: len(known)] or len(found) > len(known):
            raise ParameterError(
                f"expected bands and operators of levels with {sizes} vertices, got bands with {found} rows; give the "
                "refinement and the operators that the basis was computed from"
            )
        object.__setattr__(self, "bands", tuple(read_only(band) for band in self.bands))
        for name in ("eigenvalues", "residuals", "indices", "gram"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

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

    @property
    def condition(self) -> float:
        """Condition number of the Gram matrix; near 1 where every band is orthogonal to the ones below it."""
        squares = linalg.eigvalsh(self.gram)
        return float(squares[-1] / max(squares[0], np.finfo(float).tiny))

    def size(self, level: int) -> int:
        """Number of functions k~_l of the basis at a level: those of the bands up to it."""
        return sum(self.schedule[: level + 1])

    def at(self, level: int, *, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Phi~^level as a dense matrix (eq. 8).

        Parameters
        ----------
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
        self._check_level(level)
        return refined_bands(self.bands, self.refinement, level, dtype)

    def rows(self, level: int, vertices: IndexArray) -> FloatArray:
        """Some rows of Phi~^level, without making the others.

        Parameters
        ----------
        level : int
        vertices : (q,) int64 array
            Vertices of that level.

        Returns
        -------
        (q, k~_level) array

        Raises
        ------
        ParameterError
            If the level or a vertex does not exist.

        Notes
        -----
        Each row combines the few coarse vertices that influence it: cost is linear in q, not in the size of the level.
        """
        self._check_level(level)
        vertices = np.asarray(vertices, dtype=np.int64)
        n = self.refinement.levels[level].n_vertices
        if len(vertices) and (vertices.min() < 0 or vertices.max() >= n):
            raise ParameterError(
                f"expected vertices from 0 to {n - 1} of level {level}, got {vertices.min()} to {vertices.max()}"
            )
        columns: list[FloatArray] = []
        chosen: sparse.csr_array | None = None  # None stands for the plain selection of vertices
        for coarser in reversed(range(level + 1)):
            if coarser <= self.last_level:
                band = self.bands[coarser]
                columns.append(band[vertices] if chosen is None else multiply(chosen, band))
            if coarser > 0:
                matrix = self.refinement.matrices[coarser - 1]
                chosen = sparse.csr_array(matrix[vertices] if chosen is None else chosen @ matrix)
        return np.hstack(columns[::-1])

    def row_blocks(self, level: int) -> Iterator[tuple[slice, FloatArray]]:
        """All rows of Phi~^level, some at a time, for levels whose dense matrix would be too large.

        Parameters
        ----------
        level : int

        Yields
        ------
        range : slice
            Of vertices.
        values : (rows, k~_level) array
        """
        self._check_level(level)
        base = min(level, self.last_level)
        dense = self.at(base)
        for part in parts(self.refinement.levels[level].n_vertices, ROWS):
            if level == base:
                values = dense[part]
            else:
                chosen = self.refinement.matrices[level - 1][part]
                for coarser in reversed(range(base, level - 1)):
                    chosen = chosen @ self.refinement.matrices[coarser]
                values = multiply(sparse.csr_array(chosen), dense)
            yield part, values

    def gram_at(self, level: int) -> FloatArray:
        """(k~_level, k~_level) Phi~^T M Phi~ at one level: a leading block of ``gram``, by Lemma 5."""
        self._check_level(level)
        size = self.size(level)
        return self.gram[:size, :size]

    def project(self, values: FloatArray, level: int, *, count: int | None = None) -> FloatArray:
        """Coefficients of functions: (Phi~^T M Phi~)^{-1} Phi~^T M f (paper, section 4.4).

        Parameters
        ----------
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
        self._check_level(level)
        size = self.count if count is None else count
        if not 1 <= size <= self.count:
            raise ParameterError(f"expected 1 to {self.count} basis functions, got {size}")
        n = self.refinement.levels[level].n_vertices
        functions = real_numbers(values, "functions")
        if functions.shape[0] != n:
            raise ParameterError(
                f"expected functions with {n} rows, one for each vertex of level {level}, got {functions.shape}"
            )
        if level > self.operators.finest:
            raise ParameterError(
                f"expected functions of a level up to {self.operators.finest}, the last with operators, got level "
                f"{level}; prepare the surface with a basis without `vertices`"
            )
        columns = functions.reshape(n, -1)
        needed = int(self.band_levels[:size].max())
        if level < needed:
            columns, level = self.refinement.prolong(columns, level, needed), needed
        dual = multiply(self.operators.mass[level], columns)
        moments = products_with_bands(self.bands[: needed + 1], self.refinement, dual, level)[:size]
        coefficients = linalg.cho_solve(linalg.cho_factor(self.gram[:size, :size]), moments)
        return coefficients.reshape(size, *functions.shape[1:])

    def _check_level(self, level: int) -> None:
        if not 0 <= level <= self.refinement.n_levels:
            raise ParameterError(
                f"expected a level from 0 to {self.refinement.n_levels}, got {level}; refine further to have it"
            )

    def __repr__(self) -> str:
        bands = ", ".join(f"{k} at level {level}" for level, k in enumerate(self.schedule))
        return f"HierarchicalBasis({self.count} functions: {bands})"


def products_with_bands(
    bands: tuple[FloatArray, ...], refinement: Refinement, dual: FloatArray, level: int
) -> FloatArray:
    """Phi~^T y for functionals y = M^level f of one level, restricted down the levels (paper, Lemma 5).

    Parameters
    ----------
    bands : tuple of (n_l, k_l) arrays
        Bands of levels 0, 1, ...; those finer than ``level`` are not used.
    refinement : Refinement
    dual : (n_level, q) array
    level : int

    Returns
    -------
    (k, q) array
    """
    products: list[FloatArray] = []
    for coarser in reversed(range(level + 1)):
        if coarser < len(bands):
            products.append(bands[coarser].T @ dual)
        if coarser > 0:
            dual = refinement.matrices[coarser - 1].T @ dual
    return np.concatenate(products[::-1]) if products else np.zeros((0, dual.shape[1]))


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
