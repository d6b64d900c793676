"""The linear systems of the elastic fit: of its positions and, with the same pattern, of its differentials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from cagemap.maps.elastic.constants import GRADIENTS, SOLVED
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization, factor


@dataclass(frozen=True, eq=False)
class BlockSystem:
    """(3 n, 3 n) matrices alpha L + block diagonal, with the pattern kept from one to the next."""

    matrix: sparse.csc_array
    elastic: FloatArray
    blocks: IndexArray

    @classmethod
    def build(cls, laplacian: sparse.csr_array) -> BlockSystem:
        """Lay out the pattern for an (n, n) Laplacian."""
        n = laplacian.shape[0]
        ones = sparse.bsr_array((np.ones((n, 3, 3)), np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)).tocsc()
        elastic = sparse.csc_array(sparse.kron(laplacian, sparse.eye_array(3)))
        pattern = sparse.csc_array(abs(elastic) + ones)
        pattern.sort_indices()
        # Where the entries of both parts stand in the common pattern: number them, and read the numbers back.
        numbered = sparse.csc_array((np.arange(1.0, pattern.nnz + 1), pattern.indices, pattern.indptr), pattern.shape)
        values = np.zeros(pattern.nnz)
        elastic.sort_indices()
        columns = np.repeat(np.arange(3 * n), np.diff(elastic.indptr))
        at = np.asarray(numbered[elastic.indices, columns]).ravel().astype(np.int64) - 1
        values[at] = elastic.data
        rows = (3 * np.arange(n)[:, None, None] + np.arange(3)[None, :, None] + np.zeros((1, 1, 3), int)).ravel()
        cols = (3 * np.arange(n)[:, None, None] + np.arange(3)[None, None, :] + np.zeros((1, 3, 1), int)).ravel()
        blocks = np.asarray(numbered[rows, cols]).ravel().astype(np.int64) - 1
        return cls(pattern, values, blocks)

    def at(self, alpha: float, blocks: FloatArray) -> sparse.csc_array:
        """The matrix alpha L + blocks (n, 3, 3)."""
        values = alpha * self.elastic
        values[self.blocks] += blocks.ravel()
        return sparse.csc_array((values, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape)

    def step(self, matrix: sparse.csc_array, residual: FloatArray, near: Factorization) -> FloatArray:
        """About ``A^-1 r`` (3 n,) of a matrix A of this system, with factors of one near to it.

        A few conjugate gradients (Hestenes and Stiefel 1952) preconditioned by them, each a tenth of a factorisation;
        what they miss, the next iteration finds in its residual.
        """
        preconditioner = LinearOperator(matrix.shape, matvec=near.solve, dtype=np.float64)
        return np.asarray(cg(matrix, residual, rtol=SOLVED, maxiter=GRADIENTS, M=preconditioner)[0])

    def factor(self, alpha: float, blocks: FloatArray, like: Factorization | None = None) -> Factorization:
        """Factor alpha L + blocks (n, 3, 3), with the ordering of an earlier factorisation if there is one."""
        return factor(self.at(alpha, blocks), like=like)
