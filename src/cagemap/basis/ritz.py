"""Rayleigh-Ritz on tall blocks, in place and some rows at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse

from cagemap.basis.constants import DEPENDENT_COLUMNS, NEW_SHARE
from cagemap.basis.smoothing import Block
from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import in_threads, parts

# Columns and rows multiplied at once: what fits a cache, and bounds the memory.
_COLUMNS = 64
_ROWS = 8192
# Sums of products over rows, each over every so many of these pieces.
_SHARES = 4


@dataclass(frozen=True, eq=False)
class Ritz:
    """Approximate eigenpairs X with W X and M X; X is M-orthonormal and X^T W X the diagonal matrix of values."""

    values: FloatArray
    vectors: Block
    stiffness_vectors: Block
    mass_vectors: Block

    def residuals(self, chosen: IndexArray) -> Block:
        """(n, k) W x - lambda M x of some pairs."""
        values = self.values[chosen].astype(self.vectors.dtype)
        return np.ascontiguousarray(self.stiffness_vectors[:, chosen] - self.mass_vectors[:, chosen] * values)


def ritz_rotation(block: Block, stiffness_block: Block, mass_block: Block) -> tuple[FloatArray, FloatArray]:
    """(q,) theta ascending and (q, q) c of X^T W X c = theta X^T M X c, from X, W X and M X."""
    stiffness_gram, mass_gram = gram(block, stiffness_block), gram(block, mass_block)
    sizes = np.sqrt(np.diag(mass_gram))
    # Columns near eigenvectors are nearly orthogonal; whether rounding lets a dependent one pass is chance.
    if linalg.eigvalsh(mass_gram / np.outer(sizes, sizes), subset_by_index=[0, 0])[0] < DEPENDENT_COLUMNS:
        raise SolverError(
            f"expected {block.shape[1]} independent columns in a Rayleigh-Ritz step, got dependent ones; "
            "the guess holds a vector twice"
        )
    values, rotation = linalg.eigh(stiffness_gram, mass_gram, driver="gvd")
    return values, rotation


def extended(pairs: Ritz, added: Block, stiffness: sparse.csr_array, mass: sparse.csr_array) -> Ritz:
    """Rayleigh-Ritz on the pairs and further directions; as many lowest pairs as before. Works in place."""
    for _ in range(2):  # directions that are nearly alike grow in the first turn, and what rounding has left in them
        subtract(added, pairs.vectors, gram(pairs.mass_vectors, added, symmetric=False))
        mass_added = multiply(mass, added)
        squares, axes = linalg.eigh(gram(added, mass_added))
        new = squares > NEW_SHARE**2 * max(squares[-1], np.finfo(float).tiny)
        turn = axes[:, new] / np.sqrt(squares[new])
        added, mass_added = rotated(added, turn), rotated(mass_added, turn)
    stiffness_added = multiply(stiffness, added)
    count = len(pairs.values)
    energy = np.zeros((count + added.shape[1], count + added.shape[1]))
    energy[:count, :count] = np.diag(pairs.values)
    energy[:count, count:] = gram(pairs.vectors, stiffness_added, symmetric=False)
    energy[count:, :count] = energy[:count, count:].T
    energy[count:, count:] = gram(added, stiffness_added)
    values, rotation = linalg.eigh(energy, driver="evd")
    blocks = ((pairs.vectors, added), (pairs.stiffness_vectors, stiffness_added), (pairs.mass_vectors, mass_added))
    turned = (rotated(old, rotation[:count, :count], extra, rotation[count:, :count]) for old, extra in blocks)
    return Ritz(values[:count], *turned)


def gram(left: Block, right: Block, *, symmetric: bool = True) -> FloatArray:
    """X^T Y in double precision, some rows at a time; of a symmetric one no more than half is computed."""
    columns = parts(left.shape[1], _COLUMNS) if symmetric else [slice(0, None)]

    def share(pieces: list[slice]) -> FloatArray:
        total = np.zeros((left.shape[1], right.shape[1]))
        for rows in pieces:
            for part in columns:
                total[part, part.start :] += left[rows, part].T @ right[rows, part.start :]
        return total

    pieces = parts(len(left), _ROWS)
    # As many sums whatever the number of cores, so that the result does not depend on it.
    total = np.sum(in_threads(share, [pieces[i::_SHARES] for i in range(_SHARES)]), axis=0)
    return np.triu(total) + np.triu(total, 1).T if symmetric else total


def rotated(block: Block, rotation: FloatArray, extra: Block | None = None, extra_rotation: Any = None) -> Block:
    """X Q, or X Q + Y P, some rows at a time; in the memory of X, which is lost, where Q is square."""
    turn = rotation.astype(block.dtype)
    extra_turn = None if extra is None else extra_rotation.astype(block.dtype)
    turned = block if rotation.shape[1] == block.shape[1] else np.empty((len(block), rotation.shape[1]), block.dtype)

    def turn_rows(rows: slice) -> None:
        product = block[rows] @ turn
        if extra is not None:
            product += extra[rows] @ extra_turn
        turned[rows] = product

    in_threads(turn_rows, parts(len(block), _ROWS))
    return turned


def subtract(block: Block, vectors: Block, coefficients: FloatArray) -> None:
    """Take X C from a block in place, some rows at a time; computed in the type of X."""
    factors = coefficients.astype(vectors.dtype)

    def subtract_rows(rows: slice) -> None:
        block[rows] -= vectors[rows] @ factors

    in_threads(subtract_rows, parts(len(block), _ROWS))


def rayleigh_quotients(stiffness: sparse.csr_array, mass: sparse.csr_array, vectors: Block) -> FloatArray:
    """(m,) ascending x^T W x / x^T M x in double precision."""
    quotients = np.empty(vectors.shape[1])
    for part in parts(vectors.shape[1], _COLUMNS):
        columns = vectors[:, part].astype(np.float64)
        energy, dual = multiply(stiffness, columns), multiply(mass, columns)
        quotients[part] = np.einsum("ij,ij->j", columns, energy) / np.einsum("ij,ij->j", columns, dual)
    return np.maximum.accumulate(quotients)


def squared_residuals(pairs: Ritz, weights: FloatArray) -> FloatArray:
    """(m,) squares of ||W x - lambda M x|| in the norm of the inverse of a diagonal matrix."""
    values, inverse = pairs.values.astype(pairs.vectors.dtype), (1.0 / weights).astype(pairs.vectors.dtype)
    squares = np.zeros(len(values))
    for rows in parts(len(weights), _ROWS):
        residual = pairs.stiffness_vectors[rows] - pairs.mass_vectors[rows] * values
        squares += inverse[rows] @ (residual * residual)
    return squares
