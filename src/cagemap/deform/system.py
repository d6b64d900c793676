"""Quadratic terms of single vertices, and the linear systems of positions and differentials that they lead to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from cagemap.deform.config import Stage
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization, factor


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """Sparsity of the (3 n, 3 n) matrices alpha L + block diagonal, the same for all of one graph."""

    matrix: sparse.csc_array
    elastic: FloatArray
    blocks: IndexArray

    @classmethod
    def build(cls, laplacian: sparse.csr_array) -> BlockPattern:
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

    def factor(self, alpha: float, blocks: FloatArray, like: Factorization | None = None) -> Factorization:
        """Factor alpha L + blocks (n, 3, 3), with the ordering of an earlier factorisation if there is one."""
        return factor(self.at(alpha, blocks), like=like)


@dataclass(frozen=True, eq=False)
class FactoredSystem:
    """A system of positions that is solved with its own factors."""

    factors: Factorization

    def solve(self, right: FloatArray, positions: FloatArray) -> FloatArray:
        """(n, 3) the solution for a right side (n, 3)."""
        return self.factors.solve(right.ravel()).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class CorrectedSystem:
    """A system of positions whose residual is solved with factors of lower precision, or of an earlier matrix.

    Single precision: what a step misses, the next iteration finds in its residual, which is in double.
    """

    matrix: sparse.csc_array
    factors: Factorization
    exact: bool
    stage: Stage

    def solve(self, right: FloatArray, positions: FloatArray) -> FloatArray:
        """(n, 3) positions corrected for a right side (n, 3)."""
        residual = right.ravel() - self.matrix @ positions.ravel()
        step = self.factors.solve(residual) if self.exact else self.gradients(residual)
        return positions + step.reshape(-1, 3)

    def gradients(self, residual: FloatArray) -> FloatArray:
        """About ``A^-1 r`` (3 n,) by a few conjugate gradients (Hestenes and Stiefel 1952).

        Each costs a tenth of a factorisation. Without a tolerance they divide by zero once the residual is zero. Where
        they leave too much of it, the matrix is factored anew.
        """
        stage, shape = self.stage, self.matrix.shape
        near = LinearOperator(shape, matvec=self.factors.solve, dtype=np.float64)
        step, missed = cg(self.matrix, residual, rtol=stage.tolerance, maxiter=stage.gradients, M=near)
        if missed and not np.linalg.norm(residual - self.matrix @ step) <= stage.max_unsolved * np.linalg.norm(
            residual
        ):
            step = factor(self.matrix, like=self.factors).solve(residual)
        return np.asarray(step)


@dataclass(frozen=True, eq=False)
class VertexTerms:
    """``sum_i x_i^T B_i x_i - 2 b_i^T x_i`` of one iteration, for `cagemap.deform.minimise`."""

    pattern: BlockPattern
    like: Factorization  # of a matrix of this pattern
    blocks: FloatArray  # (n, 3, 3): B_i
    right: FloatArray  # (n, 3): b_i
    distance: float = np.inf  # see `cagemap.deform.minimise.Quadratic`
    # Triangles of the closest points that were found, both ways, or None
    guesses: tuple[IndexArray | None, IndexArray | None] = (None, None)

    def system(self, alpha: float, stage: Stage, before: CorrectedSystem | None) -> CorrectedSystem:
        """Alpha L + B with new factors, or with those of a system before."""
        matrix = self.pattern.at(alpha, self.blocks)
        if before is not None:
            return CorrectedSystem(matrix, before.factors, False, stage)
        return CorrectedSystem(matrix, factor(matrix, like=self.like, dtype=np.float32), True, stage)


@dataclass(frozen=True, eq=False)
class ConstantTerms(VertexTerms):
    """The same terms in every iteration: one factorisation, in double precision."""

    def at(self, iterate: object) -> ConstantTerms:
        """Themselves."""
        return self

    def system(self, alpha: float, stage: Stage, before: object) -> FactoredSystem:  # type: ignore[override]
        """Alpha L + B with its own factors."""
        return FactoredSystem(self.pattern.factor(alpha, self.blocks, self.like))
