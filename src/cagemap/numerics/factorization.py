"""Sparse factorisations behind one small interface, so that the library can be replaced.

rslab (LDL^T, exact inertia) where it is installed, SciPy's SuperLU elsewhere: held to diagonal pivots it is an LDL^T
too, and its diagonal tells the inertia. Everything else in cagemap that solves a large sparse system calls `factor` or
`factor_general` and `Factorization.solve` and nothing more.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from cagemap.errors import ParameterError, SolverError
from cagemap.numerics.threads import core_count

rslab: Any
try:
    import rslab
except ImportError:  # no wheel for this platform
    rslab = None

_log = logging.getLogger(__name__)

Precision = type[np.float64 | np.float32]
SparseMatrix = sparse.csr_array | sparse.csc_array

# SuperLU's minimum degree ordering gives the least fill on small meshes and takes minutes on large ones.
_SUPERLU_MINIMUM_DEGREE_ROWS = 30_000
# Backward error of a solve above which diagonal pivots have let entries grow, and their signs prove nothing.
_STABLE = 1e-10
# Most threads that rslab gives one matrix by default.
_RSLAB_THREADS = 4


@dataclass(frozen=True, eq=False)
class Factorization:
    """A factored matrix A.

    Attributes
    ----------
    shape : (int, int)
    negative_eigenvalues : int or None
        Number of negative eigenvalues of A (Sylvester's law of inertia); None where the library cannot tell: where
        SuperLU left the diagonal, lost digits or works in single precision.
    library : str
        "rslab" or "superlu".
    dtype : numpy dtype
        Precision of the factors, float64 or float32.
    """

    shape: tuple[int, int]
    negative_eigenvalues: int | None
    library: str
    _solve: Callable[[NDArray[Any]], NDArray[Any]] = field(repr=False)
    _symbolic: Any = field(default=None, repr=False)
    dtype: Precision = np.float64

    def solve(self, right_sides: NDArray[Any]) -> NDArray[Any]:
        """Solve A X = B.

        Parameters
        ----------
        right_sides : (n,) or (n, q) array

        Returns
        -------
        array of the same shape, in the precision of the factors

        Raises
        ------
        ParameterError
            If the number of rows is not n.
        """
        values = np.ascontiguousarray(right_sides, dtype=self.dtype)
        if values.ndim not in (1, 2) or values.shape[0] != self.shape[0]:
            raise ParameterError(
                f"expected right sides with {self.shape[0]} rows, got an array of shape {values.shape}; "
                "use the level that the matrix was built at"
            )
        solution = self._solve(values.reshape(len(values), -1))
        return np.ascontiguousarray(solution).reshape(values.shape)


def factor(
    matrix: SparseMatrix,
    *,
    like: Factorization | None = None,
    library: str = "auto",
    dtype: Precision = np.float64,
) -> Factorization:
    """Factor a symmetric, possibly indefinite sparse matrix.

    Parameters
    ----------
    matrix : (n, n) sparse array
        Symmetric; only its lower triangle is read (rslab). Any unit.
    like : Factorization, optional
        Of a matrix with the same pattern; its ordering is used again.
    library : {"auto", "rslab", "superlu"}
    dtype : numpy.float64 or numpy.float32
        Precision of the factors. Single takes half the memory and two thirds of the time; its inertia proves nothing.

    Raises
    ------
    ParameterError
        If the matrix is not square, or the library named is not installed.
    SolverError
        If the matrix is singular to working precision.
    """
    if _chosen(library, matrix) == "superlu":
        return _factor_superlu(matrix, dtype)
    return _factor_rslab(matrix, like, dtype)


def factor_general(matrix: SparseMatrix, *, library: str = "auto") -> Factorization:
    """Factor a sparse matrix whose pattern is symmetric and whose values need not be, in double precision.

    Parameters
    ----------
    matrix : (n, n) sparse array
        Whose diagonal may serve as pivots, such as a diagonally dominant one. Any unit.
    library : {"auto", "rslab", "superlu"}

    Returns
    -------
    Factorization
        Without a number of negative eigenvalues.

    Raises
    ------
    ParameterError
        If the matrix is not square, or the library named is not installed.
    SolverError
        If the matrix is singular to working precision.
    """
    if _chosen(library, matrix) == "superlu":
        return replace(_factor_superlu(matrix, np.float64), negative_eigenvalues=None)
    entries = sparse.csc_array(matrix, dtype=np.float64)
    entries.sort_indices()
    try:
        # Minimum degree as in `_ordered`.
        factors = rslab.analyze(entries, "lu", ordering="amd", threads=_rslab_threads()).factor(entries.data)
    except (RuntimeError, ValueError) as error:
        raise SolverError(_singular_message(matrix, error)) from error
    return Factorization(matrix.shape, None, "rslab", factors.solve_many)


def _chosen(library: str, matrix: SparseMatrix) -> str:
    """Name of the library to factor a matrix with, both checked."""
    rows, columns = matrix.shape
    if rows != columns:
        raise ParameterError(f"expected a square matrix, got shape {matrix.shape}")
    if library == "auto":
        if rslab is not None:
            return "rslab"
        with _SAYING:
            _say_that_rslab_is_missing()
        return "superlu"
    if library not in ("rslab", "superlu") or (library == "rslab" and rslab is None):
        raise ParameterError(f'expected library "auto", "superlu" or an installed "rslab", got {library!r}')
    return library


_SAYING = Lock()  # both surfaces of a pair come here at the same time


@cache  # once for each process
def _say_that_rslab_is_missing() -> None:
    _log.warning(
        "rslab is not installed: SciPy's SuperLU factors matrices instead, more slowly the larger the surface; "
        "`pip install rslab` where it has a wheel for this platform"
    )


def _lower_triangle(matrix: SparseMatrix) -> sparse.csc_array:
    lower = sparse.csc_array(sparse.tril(matrix, format="csc"))
    lower.sort_indices()
    return lower


def _ordered(lower: sparse.csc_array) -> Any:
    # Approximate minimum degree: on meshes it beats nested dissection once analysis time is counted.
    return rslab.analyze(lower, "ldlt", ordering="amd", threads=_rslab_threads())


def _rslab_threads() -> tuple[str, int]:
    """What rslab chooses for a matrix, within its own cap and ours; factors do not depend on it."""
    return "auto", min(_RSLAB_THREADS, core_count())


def _factor_rslab(matrix: SparseMatrix, like: Factorization | None, dtype: Precision) -> Factorization:
    lower = _lower_triangle(matrix)
    try:
        symbolic = _ordered(lower) if like is None else like._symbolic
        factors = symbolic.factor(lower.data.astype(dtype, copy=False))
    except (RuntimeError, ValueError) as error:
        raise SolverError(_singular_message(matrix, error)) from error
    negative = int(factors.inertia[1])
    return Factorization(matrix.shape, negative, "rslab", factors.solve_many, symbolic, dtype)


def _factor_superlu(matrix: SparseMatrix, dtype: Precision) -> Factorization:
    small = matrix.shape[0] <= _SUPERLU_MINIMUM_DEGREE_ROWS
    try:
        factors = sparse_linalg.splu(
            sparse.csc_array(matrix, dtype=dtype),
            permc_spec="MMD_AT_PLUS_A" if small else "COLAMD",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": small},
        )
    except RuntimeError as error:
        raise SolverError(_singular_message(matrix, error)) from error
    # With diagonal pivots only, P A P^T = L D L^T with D the diagonal of U, and Sylvester's law counts its signs.
    told = np.array_equal(factors.perm_r, factors.perm_c) and _backward_error(matrix, factors.solve, dtype) < _STABLE
    negative = int(np.count_nonzero(factors.U.diagonal() < 0)) if told else None
    return Factorization(matrix.shape, negative, "superlu", factors.solve, dtype=dtype)


def _backward_error(matrix: SparseMatrix, solve: Callable[[NDArray[Any]], NDArray[Any]], dtype: Precision) -> float:
    """||A x - b|| / (||A|| ||x|| + ||b||) of a solve: the relative change of A that its factors are exact for."""
    right_side = np.cos(np.arange(matrix.shape[0]))  # any vector that is no eigenvector
    solution = np.asarray(solve(right_side.astype(dtype)), dtype=np.float64)
    size = sparse_linalg.norm(matrix, np.inf) * np.abs(solution).max() + np.abs(right_side).max()
    return float(np.abs(matrix @ solution - right_side).max() / size)


def _singular_message(matrix: SparseMatrix, error: Exception) -> str:
    return (
        f"expected a non-singular matrix, got one of {matrix.shape[0]} rows that the factorisation refused ({error}); "
        "shift it away from its eigenvalues, or fix a vertex"
    )
