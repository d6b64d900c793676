"""Block Lanczos iteration on (W - sigma M)^{-1} M."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import Factorization, Precision
from cagemap.numerics.products import multiply
from cagemap.numerics.threads import ROWS, in_threads, parts
from cagemap.spectral.config import SOLVER

Block = NDArray[Any]  # (n, q), float64 or float32


def orthonormal_block(
    block: FloatArray, mass: sparse.csr_array, rng: np.random.Generator, against: Block, mass_against: Block
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """M-orthonormalise a block that is already M-orthogonal to ``against``, by Cholesky QR, twice where needed.

    Directions that are lost (the Krylov space became invariant) are replaced by random ones, with a zero row in R.
    Returns the new block (n, b), M times it, and R (b, b) with old block = new block @ R.
    """
    width = block.shape[1]
    total = np.eye(width)
    for _ in range(2):
        mass_block = multiply(mass, block)
        gram = block.T @ mass_block
        values, vectors = linalg.eigh(0.5 * (gram + gram.T))
        weak = values <= SOLVER.dependent * max(values[-1], np.finfo(float).tiny)
        roots = np.sqrt(np.where(weak, 1.0, values))
        total = (np.where(weak, 0.0, roots)[:, None] * vectors.T) @ total
        turn = vectors / roots
        block, mass_block = block @ turn, mass_block @ turn
        if weak.any():
            fresh = rng.standard_normal((len(block), int(weak.sum())))
            for _ in range(2):
                kept = block[:, ~weak]
                fresh -= against @ (mass_against.T @ fresh)
                fresh -= kept @ (multiply(mass, kept).T @ fresh)
                fresh /= np.sqrt(np.einsum("ij,ij->j", fresh, multiply(mass, fresh)))
            block[:, weak] = fresh
            mass_block = multiply(mass, block)
        elif values[0] > SOLVER.well_conditioned * values[-1]:
            break
    return block, mass_block, total


def shift_invert_lanczos(
    shifted: Factorization,
    mass: sparse.csr_array,
    shift: float,
    below: int,
    above: int,
    *,
    block_size: int = 16,
    accuracy: float = 1e-9,
    loose: tuple[int, int] = (0, 0),
    dtype: Precision = np.float64,
) -> tuple[FloatArray, Block]:
    """Eigenvalues (below + above,), ascending, on both sides of a shift, and their M-orthonormal eigenvectors.

    Parameters
    ----------
    shifted : Factorization
        Of W - shift M.
    mass : (n, n) CSR array
    shift : float
    below, above : int
        How many of the nearest eigenvalues below and above the shift are wanted.
    block_size : int
        Highest multiplicity of an eigenvalue that is found for certain.
    accuracy : float
        Residual of a pair of the inverted operator relative to its eigenvalue 1 / (lambda - shift).
    loose : (int, int)
        How many of the outermost pairs below and above need no more than a residual of `SolverConfig.loose`.
    dtype : numpy.float64 or numpy.float32
        How the Krylov space is stored and what is orthogonalised in; solves are always in double.

    Raises
    ------
    SolverError
        If the Krylov space is exhausted without converging.

    Notes
    -----
    Full reorthogonalisation: O(n m^2) flops in matrix products for a Krylov space of m columns, m about 1.6 times the
    number of wanted pairs. Narrow blocks need fewer columns, wide ones find higher multiplicities.
    """
    n = mass.shape[0]
    rng = np.random.default_rng(SOLVER.seed)
    wanted = below + above
    block = rng.standard_normal((n, min(block_size, n)))
    width = block.shape[1]
    capacity = min(n, 4 * wanted + 12 * width) // width * width
    basis = np.empty((n, capacity + width), dtype, order="F")
    mass_basis = np.empty((n, capacity + width), dtype, order="F")
    projected = np.zeros((capacity, capacity))
    block, mass_block, _ = orthonormal_block(block, mass, rng, basis[:, :0], mass_basis[:, :0])
    basis[:, :width], mass_basis[:, :width] = block, mass_block
    size = width
    next_check = int(1.7 * wanted)
    # Ascending 1 / (lambda - shift): outermost below and outermost above stand side by side.
    allowed = np.full(wanted, accuracy)
    allowed[below - min(loose[0], below) : below + min(loose[1], above)] = max(SOLVER.loose, accuracy)
    while True:
        used, mass_used = basis[:, :size], mass_basis[:, :size]
        image: Block = np.asarray(shifted.solve(mass_block), dtype=dtype)
        # The recurrence couples a block to itself and the one before; what rounding leaves along older ones goes last.
        recent = slice(max(0, size - 2 * width), size)
        coefficients = np.zeros((size, width), dtype)
        coefficients[recent] = _products(mass_used[:, recent], image)
        _subtract(image, used[:, recent], coefficients[recent])
        correction = _products(mass_used, image)
        _subtract(image, used, correction)
        coefficients += correction
        projected[:size, size - width : size] = coefficients
        block, mass_block, factor = orthonormal_block(image.astype(np.float64, copy=False), mass, rng, used, mass_used)
        full = size + width > capacity
        if size >= min(next_check, capacity) and size >= wanted:
            square = projected[:size, :size]
            inverse_values, rotation = linalg.eigh(np.triu(square) + np.triu(square, 1).T, driver="evd")
            chosen = np.r_[0:below, size - above : size]
            errors = np.linalg.norm(factor @ rotation[size - width :, chosen], axis=0)
            sides = np.all(inverse_values[:below] < 0) and np.all(inverse_values[size - above :] > 0)
            if sides and np.all(errors <= allowed * np.abs(inverse_values[chosen])):
                values = shift + 1.0 / inverse_values[chosen]
                order = np.argsort(values)
                return values[order], _combined(used, rotation[:, chosen[order]].astype(dtype))
            next_check = size + max(width, size // 20)
        if full:
            raise SolverError(
                f"expected {wanted} eigenpairs within a Krylov space of {capacity} columns, got fewer to accuracy "
                f"{accuracy:g}; ask for fewer pairs or a lower accuracy"
            )
        basis[:, size : size + width], mass_basis[:, size : size + width] = block, mass_block
        size += width


def _products(basis: Block, block: Block) -> Block:
    """(m, b) Q^T X of blocks with the same rows, some rows in each thread; one sum, whatever the threads."""
    shares = in_threads(lambda part: basis[part].T @ block[part], parts(len(block), ROWS))
    return np.asarray(sum(shares[1:], shares[0]))


def _subtract(block: Block, basis: Block, coefficients: Block) -> None:
    """X - Q C in place, some rows in each thread."""

    def subtract(part: slice) -> None:
        block[part] -= basis[part] @ coefficients

    in_threads(subtract, parts(len(block), ROWS))


def _combined(basis: Block, coefficients: Block) -> Block:
    """(n, b) Q C, some rows in each thread."""
    return np.vstack(in_threads(lambda part: basis[part] @ coefficients, parts(len(basis), ROWS)))
