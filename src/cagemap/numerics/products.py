"""Sparse matrix times block of columns, on all cores: the kernel under every eigenvalue iteration."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from cagemap.numerics.arrays import read_only
from cagemap.numerics.threads import core_count, in_threads

# A block of float64 (or of float32 where only a nearest neighbour is asked) gives one of the same type.
RealArray = TypeVar("RealArray", NDArray[np.float64], NDArray[np.float32], NDArray[Any])

# Below this much work starting threads costs more than it saves.
_PARALLEL_WORK = 2_000_000


@njit(cache=True, nogil=True, fastmath=True)
def _multiply_rows(indptr, indices, data, block, first, last, out):  # type: ignore[no-untyped-def]
    """Rows first..last of A X; X and the result in C order, so that the inner loop is contiguous."""
    columns = block.shape[1]
    for row in range(first, last):
        begin, end = indptr[row], indptr[row + 1]
        whole = begin + (end - begin) // 4 * 4
        for j in range(columns):
            out[row, j] = 0.0
        for entry in range(begin, whole, 4):  # four at a time: the result is read and written a quarter as often
            a, b, c, d = data[entry], data[entry + 1], data[entry + 2], data[entry + 3]
            p, q, r, s = indices[entry], indices[entry + 1], indices[entry + 2], indices[entry + 3]
            for j in range(columns):
                out[row, j] += a * block[p, j] + b * block[q, j] + c * block[r, j] + d * block[s, j]
        for entry in range(whole, end):
            a, p = data[entry], indices[entry]
            for j in range(columns):
                out[row, j] += a * block[p, j]


def multiply(matrix: sparse.csr_array, block: RealArray) -> RealArray:
    """A X for a CSR matrix and a dense block; the same as ``matrix @ block``, several times faster on wide blocks.

    Parameters
    ----------
    matrix : (n, m) CSR array of float64
    block : (m, q) array of float64 or float32

    Returns
    -------
    (n, q) C-ordered array of the block's type

    Notes
    -----
    Row ranges go to a few threads; the result does not depend on their number.
    """
    dtype = np.float32 if block.dtype == np.float32 else np.float64
    values = read_only(np.ascontiguousarray(block, dtype=dtype))
    pattern = read_only(matrix.indptr), read_only(matrix.indices)
    entries = read_only(matrix.data.astype(dtype, copy=False))
    out = np.empty((matrix.shape[0], values.shape[1]), dtype=dtype)

    def share(first: int, last: int) -> None:
        _multiply_rows(*pattern, entries, values, first, last, out)

    in_row_shares(matrix, values.shape[1], share)
    return out


def in_row_shares(matrix: sparse.csr_array, columns: int, work: Callable[[int, int], None]) -> None:
    """Run work(first, last) over ranges of rows in a few threads, where there is enough of it to repay them.

    Parameters
    ----------
    matrix : (n, m) CSR array
        The ranges have equal shares of its nonzeros.
    columns : int
        Of the block that it is multiplied with.
    work : callable
        Releases the GIL.
    """
    rows = matrix.shape[0]
    threads = 1 if matrix.nnz * columns < _PARALLEL_WORK else min(8, core_count())
    shares = np.linspace(0, matrix.nnz, threads + 1)
    bounds = [0, *np.searchsorted(matrix.indptr, shares[1:-1]).tolist(), rows]
    in_threads(lambda share: work(*share), list(pairwise(bounds)))
