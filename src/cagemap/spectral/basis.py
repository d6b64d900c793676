"""The hierarchical basis as a value: bands per level, and what can be asked of it (paper, Definition 2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only, real_numbers
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import ROWS, parts
from cagemap.operators import Operators
from cagemap.subdivision import Refinement


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

    def at(self, level: int) -> FloatArray:
        """Phi~^level (n_level, k~_level) as a dense matrix (eq. 8), without bands of finer levels.

        Raises
        ------
        ParameterError
            If there is no such level.
        """
        self._check_level(level)
        values = np.zeros((self.refinement.levels[0].n_vertices, 0))
        for finer in range(level + 1):
            if finer > 0:
                values = multiply(self.refinement.matrices[finer - 1], values)
            if finer <= self.last_level:
                values = np.hstack([values, self.bands[finer]])
        return values

    def rows(self, level: int, vertices: IndexArray) -> FloatArray:
        """Rows (q, k~_level) of Phi~^level at vertices (q,) of the level; cost is linear in q.

        Raises
        ------
        ParameterError
            If the level or a vertex does not exist.
        """
        self._check_level(level)
        bands = [(coarser, band) for coarser, band in enumerate(self.bands[: level + 1]) if band.shape[1]]
        rows = [multiply(self.refinement.rows(vertices, level, coarser), band) for coarser, band in bands]
        return np.hstack([np.zeros((len(vertices), 0)), *rows])

    def row_blocks(self, level: int) -> Iterator[tuple[slice, FloatArray]]:
        """Vertices and rows of Phi~^level, some at a time, for levels whose dense matrix would be too large."""
        self._check_level(level)
        for part in parts(self.refinement.levels[level].n_vertices, ROWS):
            yield part, self.rows(level, np.arange(part.start, part.stop))

    def project(self, values: FloatArray, level: int, *, count: int | None = None) -> FloatArray:
        """Coefficients (k,) or (k, q) of functions: (Phi~^T M Phi~)^{-1} Phi~^T M f (paper, section 4.4).

        Parameters
        ----------
        values : (n_level,) or (n_level, q) array
            Functions of a level; refined first where the basis has finer bands.
        level : int
        count : int, optional
            Use the leading functions of the basis only.

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
    """Phi~^T y (k, q) for functionals y = M^level f (n_level, q) of a level, restricted down the levels (Lemma 5).

    Bands are those of levels 0, 1, ...; the ones finer than ``level`` are not used.
    """
    products: list[FloatArray] = []
    for coarser in reversed(range(level + 1)):
        if coarser < len(bands):
            products.append(bands[coarser].T @ dual)
        if coarser > 0:
            dual = refinement.matrices[coarser - 1].T @ dual
    return np.concatenate(products[::-1]) if products else np.zeros((0, dual.shape[1]))
