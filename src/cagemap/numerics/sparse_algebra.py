"""Sparse factorisations and products.

Factors are those of rslab (LDL^T, exact inertia) if installed, else of SciPy's SuperLU. SuperLU with diagonal pivots is
an LDL^T factorisation too: the signs of its diagonal give the inertia.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from cagemap.errors import ParameterError, SolverError
from cagemap.numerics.arrays import read_only
from cagemap.numerics.threads import core_count, in_threads

rslab: Any
try:
    import rslab
except ImportError:  # no wheel for this platform
    rslab = None

_log = logging.getLogger(__name__)

Precision = type[np.float64 | np.float32]
SparseMatrix = sparse.csr_array | sparse.csc_array

_MAX_MINIMUM_DEGREE_ROWS = 30_000  # rows up to which SuperLU orders by minimum degree, slow on large meshes
_MAX_BACKWARD_ERROR = 1e-10  # relative; above it the signs of diagonal pivots do not give the inertia
_MAX_RSLAB_THREADS = 4
_WARNING_LOCK = Lock()  # threads factor both surfaces of a pair at the same time

# The result has the block's type; float32 is enough for nearest neighbours.
RealArray = TypeVar("RealArray", NDArray[np.float64], NDArray[np.float32], NDArray[Any])
_MIN_PARALLEL_WORK = 2_000_000  # multiplications below which threads cost more than they save
_MAX_THREADS = 8


@dataclass(frozen=True, eq=False)
class Factorization:
    """A factored symmetric matrix A, or a general one without inertia."""

    shape: tuple[int, int]
    negative_eigenvalues: int | None  #: of A (Sylvester's law of inertia); None: general, or SuperLU without its signs
    _solve: Callable[[NDArray[Any]], NDArray[Any]] = field(repr=False)
    _symbolic: Any = field(default=None, repr=False)  # of rslab
    _lower: NDArray[np.bool_] | None = field(default=None, repr=False)  # mask of A's entries on or below the diagonal
    dtype: Precision = np.float64  #: precision of the factors, float64 or float32

    def solve(self, right_sides: NDArray[Any]) -> NDArray[Any]:
        """Solve A X = B for B (n,) or (n, q), in the factors' precision; ParameterError for other shapes."""
        values = np.ascontiguousarray(right_sides, dtype=self.dtype)
        if values.ndim not in (1, 2) or values.shape[0] != self.shape[0]:
            raise ParameterError(
                f"expected right sides with {self.shape[0]} rows, got an array of shape {values.shape}; "
                "use the level that the matrix was built at"
            )
        solution = self._solve(values.reshape(len(values), -1))
        return np.ascontiguousarray(solution).reshape(values.shape)


def factor(matrix: SparseMatrix, *, like: Factorization | None = None, dtype: Precision = np.float64) -> Factorization:
    """Factor a symmetric, possibly indefinite sparse matrix (n, n); rslab reads its lower triangle only.

    The ordering of ``like``, the factors of a matrix with the same pattern, is reused. Single precision takes half the
    memory and two thirds of the time, but its inertia is not reliable. ParameterError if the matrix is not square,
    SolverError if it is singular to working precision.
    """
    if not _rslab_factors(matrix):
        return _factor_superlu(matrix, dtype)
    entries = _canonical(matrix)
    with _singular_refused(matrix):
        symbolic, lower = _analyzed_lower(entries) if like is None else (like._symbolic, like._lower)
        factors = symbolic.factor(entries.data[lower].astype(dtype, copy=False))
    return Factorization(matrix.shape, int(factors.inertia[1]), factors.solve_many, symbolic, lower, dtype)


def factor_general(matrix: SparseMatrix) -> Factorization:
    """Factor a diagonally dominant matrix (n, n) of symmetric pattern, without inertia; errors as of `factor`."""
    if not _rslab_factors(matrix):
        return replace(_factor_superlu(matrix, np.float64), negative_eigenvalues=None)
    entries = _canonical(matrix)
    with _singular_refused(matrix):
        factors = _analyzed(entries, "lu").factor(entries.data)
    return Factorization(matrix.shape, None, factors.solve_many)


def _rslab_factors(matrix: SparseMatrix) -> bool:
    """Whether rslab is installed; ParameterError if the matrix is not square."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ParameterError(f"expected a square matrix, got shape {matrix.shape}")
    if rslab is None:
        with _WARNING_LOCK:
            _warn_without_rslab()
    return rslab is not None


@cache  # log once per process
def _warn_without_rslab() -> None:
    _log.warning(
        "rslab is not installed: SciPy's SuperLU factors matrices instead, more slowly the larger the surface; "
        "`pip install rslab` where it has a wheel for this platform"
    )


def _canonical(matrix: SparseMatrix) -> sparse.csc_array:
    """The matrix by columns, with sorted indices, and entries that are stored twice added."""
    entries = sparse.csc_array(matrix, dtype=np.float64)
    if not entries.has_canonical_format:
        entries = entries.copy()  # it may share the given arrays
        entries.sum_duplicates()
    return entries


def _analyzed_lower(entries: sparse.csc_array) -> tuple[Any, NDArray[np.bool_]]:
    """Symbolic LDL^T factorisation of a matrix, and the mask of its stored entries on or below the diagonal."""
    columns = np.repeat(np.arange(entries.shape[1]), np.diff(entries.indptr))
    matrix = sparse.csc_array(sparse.tril(entries, format="csc"))
    return _analyzed(matrix, "ldlt"), entries.indices >= columns


def _analyzed(entries: sparse.csc_array, kind: str) -> Any:
    """Symbolic factorisation by rslab; independent of the number of threads."""
    # Approximate minimum degree: on meshes it beats nested dissection once analysis time is counted.
    threads = "auto", min(_MAX_RSLAB_THREADS, core_count())
    return rslab.analyze(entries, kind, ordering="amd", threads=threads)


def _factor_superlu(matrix: SparseMatrix, dtype: Precision) -> Factorization:
    small = matrix.shape[0] <= _MAX_MINIMUM_DEGREE_ROWS
    with _singular_refused(matrix):
        factors = sparse_linalg.splu(
            sparse.csc_array(matrix, dtype=dtype),
            permc_spec="MMD_AT_PLUS_A" if small else "COLAMD",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": small},
        )
    # With diagonal pivots, P A P^T = L D L^T with D the diagonal of U: its signs give the inertia (Sylvester).
    right_side = np.cos(np.arange(matrix.shape[0]))  # arbitrary, but no eigenvector
    solution = np.asarray(factors.solve(right_side.astype(dtype)), dtype=np.float64)
    size = sparse_linalg.norm(matrix, np.inf) * np.abs(solution).max() + np.abs(right_side).max()
    error = np.abs(matrix @ solution - right_side).max() / size
    stable = np.array_equal(factors.perm_r, factors.perm_c) and error < _MAX_BACKWARD_ERROR
    negative = int(np.count_nonzero(factors.U.diagonal() < 0)) if stable else None
    return Factorization(matrix.shape, negative, factors.solve, dtype=dtype)


@contextmanager
def _singular_refused(matrix: SparseMatrix) -> Iterator[None]:
    """Convert the libraries' errors to SolverError."""
    try:
        yield
    except (RuntimeError, ValueError) as error:
        raise SolverError(
            f"expected a non-singular matrix, got one of {matrix.shape[0]} rows that the factorisation refused "
            f"({error}); shift it away from its eigenvalues, or fix a vertex"
        ) from error


def multiply(matrix: sparse.csr_array, block: RealArray) -> RealArray:
    """Product A X in C order of CSR A and dense X (m, q), faster than ``@``, and the same for any threads."""
    dtype = np.float32 if block.dtype == np.float32 else np.float64
    values = read_only(np.ascontiguousarray(block, dtype=dtype))
    pattern = read_only(matrix.indptr), read_only(matrix.indices)
    entries = read_only(matrix.data.astype(dtype, copy=False))
    out = np.empty((matrix.shape[0], values.shape[1]), dtype=dtype)
    threads = 1 if matrix.nnz * values.shape[1] < _MIN_PARALLEL_WORK else min(_MAX_THREADS, core_count())
    shares: NDArray[np.float64] = np.linspace(0, matrix.nnz, threads + 1)  # row ranges of equal nonzeros
    bounds: list[int] = [0, *np.searchsorted(matrix.indptr, shares[1:-1]).tolist(), matrix.shape[0]]
    in_threads(lambda rows: _multiply_rows(*pattern, entries, values, *rows, out), list(pairwise(bounds)))
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _multiply_rows(indptr, indices, data, block, first, last, out):  # type: ignore[no-untyped-def]
    """Fill rows first..last - 1 of A X; C order makes the inner loop contiguous."""
    columns = block.shape[1]
    for row in range(first, last):
        begin, end = indptr[row], indptr[row + 1]
        whole = begin + (end - begin) // 4 * 4
        for j in range(columns):
            out[row, j] = 0.0
        for entry in range(begin, whole, 4):  # four at a time, to read and write the result less often
            a, b, c, d = data[entry], data[entry + 1], data[entry + 2], data[entry + 3]
            p, q, r, s = indices[entry], indices[entry + 1], indices[entry + 2], indices[entry + 3]
            for j in range(columns):
                out[row, j] += a * block[p, j] + b * block[q, j] + c * block[r, j] + d * block[s, j]
        for entry in range(whole, end):
            a, p = data[entry], indices[entry]
            for j in range(columns):
                out[row, j] += a * block[p, j]


def is_compiled() -> bool:
    """Whether Numba's cache, wherever it is, has the product: every map computes some."""
    folder = _multiply_rows.stats.cache_path
    return folder is not None and any(Path(folder).glob("*.nbi"))
