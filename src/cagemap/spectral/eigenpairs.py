"""Compute eigenpairs W x = lambda M x of one level: the lowest ones, or a band."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.errors import ParameterError, SolverError
from cagemap.numerics.arrays import FloatArray, read_only
from cagemap.numerics.kinds import Config
from cagemap.numerics.sparse_algebra import Factorization, Precision, factor, multiply
from cagemap.numerics.threads import ROW_BLOCK, in_threads, row_slices
from cagemap.operators import Operators

_log = logging.getLogger(__name__)

Block = NDArray[Any]  # (n, q), float64 or float32


@dataclass(frozen=True)
class SolverConfig(Config):
    """Numbers of the eigensolver."""

    dense_rows: int = 800  #: most rows for which a dense solve is faster than Lanczos
    largest_dense_rows: int = 5_000  #: most rows for a dense solve if more than a fifth of the spectrum is wanted
    rank: float = 1e-13  #: relative eigenvalue of a coarse mass matrix below which subdivision maps a direction to zero
    single_accuracy: float = 1e-5  #: from this accuracy on the Krylov space is in single precision, which changes less
    shifts: int = 3  #: number of shifts tried if a factorisation reports no inertia
    extra_pairs: int = 8  #: pairs computed on both sides of a band, to count eigenvalues below a gap among them
    loose: float = 1e-2  #: largest residual of the extra pairs
    well_conditioned: float = 1e-6  #: inverse squared condition of a block above which one Cholesky QR suffices
    dependent: float = 1e-14  #: inverse squared condition of a block below which a direction is lost
    overlap: int = 12  #: pairs computed below the start of a band, to determine which the refined bands span
    cluster: float = 1e-4  #: relative gap below which eigenvalues count as one repeated eigenvalue
    ill_conditioned: float = 100.0  #: condition of the Gram matrix above which functions are nearly dependent
    seed: int = 20190708  #: random seed of the first block


SOLVER = SolverConfig()


@dataclass(frozen=True, eq=False, repr=False)
class EigenPairs:
    """Consecutive eigenpairs of one level, W X = M X Lambda; both arrays are read-only."""

    values: FloatArray  #: (m,) ascending. Unit 1 / length^2 (unit area: none).
    vectors: NDArray[Any]  #: (n, m) M-orthonormal; in single precision if computed to a low accuracy

    def __repr__(self) -> str:
        return f"EigenPairs({len(self.values)} of {len(self.vectors)})"


def band_pairs(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    first: int,
    last: int,
    *,
    accuracy: float = 1e-9,
    like: Factorization | None = None,
) -> EigenPairs:
    """Eigenpairs first..last-1 of W (n, n) and M, complete for any multiplicity.

    Small problems are solved densely, others by block shift-invert Lanczos around a shift sigma inside the band. The
    inertia of W - sigma M gives the pairs' indices, that of W - tau M, with tau in gaps at both ends of the band,
    proves that none was missed. ``accuracy`` is relative to each eigenvalue of the inverted operator; the ordering of
    ``like``, factors of a matrix with the pattern of W - sigma M, is reused. ParameterError if
    the range is empty or not within the spectrum; SolverError if the iteration does not converge or misses eigenvalues.
    """
    n = stiffness.shape[0]
    if not 0 <= first < last <= n:
        raise ParameterError(
            f"expected a range of eigenpairs within 0 to {n}, the size of the level, got {first} to {last}; "
            "ask for fewer or refine once more"
        )
    if n <= SOLVER.dense_rows or (n <= SOLVER.largest_dense_rows and 5 * (last - first) > n):
        values, vectors = _dense_pairs(stiffness.toarray(), mass.toarray())
        if last > len(values):
            raise ParameterError(
                f"expected a range of eigenpairs within 0 to {len(values)}, as many as the level has independent "
                f"functions, got {first} to {last}; start at a finer level"
            )
        return EigenPairs(read_only(values[first:last]), read_only(np.ascontiguousarray(vectors[:, first:last])))
    # Factors in double precision: with slivers, single precision lost all digits (docs/lab/performance.md).
    low, high = max(0, first - SOLVER.extra_pairs), min(n, last + SOLVER.extra_pairs)
    shifted, sigma = _shift_inside(stiffness, mass, low, high, like)
    below = shifted.negative_eigenvalues
    if below is None:
        low, below = 0, 0  # the shift is then below the spectrum
    loose = first - low, high - last
    for block_size, dtype in ((16, np.float32 if accuracy >= SOLVER.single_accuracy else np.float64), (64, np.float64)):
        values, vectors = shift_invert_lanczos(
            shifted,
            mass,
            sigma,
            below - low,
            high - below,
            block_size=block_size,
            accuracy=accuracy,
            loose=loose,
            dtype=dtype,
        )
        if not any(in_threads(partial(missed_pairs, stiffness, mass, values, low, shifted), (first, last))):
            chosen = slice(first - low, last - low)
            return EigenPairs(read_only(values[chosen]), read_only(np.ascontiguousarray(vectors[:, chosen])))
    raise SolverError(
        f"expected eigenpairs {first} to {last - 1}, but the inertia of the shifted matrix counts others between them; "
        "an eigenvalue of multiplicity above 64 is likely: ask for a number of pairs that does not split it"
    )


def exact_basis(operators: Operators, level: int, count: int) -> EigenPairs:
    """Exact lowest eigenpairs of one level (paper, eq. 1); ParameterError if level or count is out of range."""
    if not 0 <= level <= operators.finest_level:
        raise ParameterError(f"expected a level from 0 to {operators.finest_level}, got {level}")
    return band_pairs(operators.stiffness[level], operators.mass[level], 0, count, accuracy=1e-10)


def count_below(stiffness: sparse.csr_array, mass: sparse.csr_array, value: float) -> int:
    """Number of eigenvalues below a value by Sylvester's law of inertia; SolverError if unknown."""
    for nudge in (0.0, 1e-9, -1e-9, 1e-7):  # the value may be an eigenvalue itself
        try:
            counted = factor(shifted_matrix(stiffness, mass, value * (1.0 + nudge))).negative_eigenvalues
        except SolverError:
            continue
        if counted is not None:
            return counted
    raise SolverError(
        f"eigenvalues below {value:g}: expected to count them, but the factorisation tells no inertia there. "
        "Install rslab."
    )


def residual_norms(
    values: FloatArray,
    stiffness_vectors: FloatArray,
    mass_vectors: FloatArray,
    areas: FloatArray,
    area: float | None = None,
) -> FloatArray:
    """(m,) relative residuals, ||W x - lambda M x||_{D^{-1}} / max(lambda, 4 pi / area), of M-orthonormal X (n, m).

    ``stiffness_vectors`` is W X, ``mass_vectors`` M X, ``areas`` the lumped mass matrix D = M 1 (n,), equal to M at the
    finest level. The lower bound 4 pi / area, for eigenvalues near 0, is the mean distance of eigenvalues (Weyl's law);
    ``area`` is by default the sum of ``areas``.
    """
    squares = sum(
        in_threads(
            lambda part: (1.0 / areas[part]) @ (stiffness_vectors[part] - mass_vectors[part] * values) ** 2,
            row_slices(len(areas), ROW_BLOCK),
        )
    )
    least = 4.0 * np.pi / (float(areas.sum()) if area is None else area)
    return np.asarray(np.sqrt(squares) / np.maximum(values, least))


def _dense_pairs(stiffness: FloatArray, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All eigenpairs of a small problem but those on which W and M vanish (on a cube +1 and -1 in turn)."""
    squares, axes = linalg.eigh(mass, driver="evd")
    seen = squares > SOLVER.rank * squares[-1]
    scaled = axes[:, seen] / np.sqrt(squares[seen])
    values, vectors = linalg.eigh(scaled.T @ stiffness @ scaled, driver="evd")
    return values, scaled @ vectors


def _shift_inside(
    stiffness: sparse.csr_array, mass: sparse.csr_array, low: int, high: int, like: Factorization | None
) -> tuple[Factorization, float]:
    """Factor W - shift M, with a shift inside low..high, or below the spectrum without inertia."""
    # Weyl's law for a surface: lambda_j is about 4 pi j / area.
    spacing = 4.0 * np.pi / float(mass.sum())
    middle = 0.6 * high if low == 0 else 0.5 * (low + high)
    shift = middle * spacing
    unknown = 0
    for _ in range(8):
        try:
            shifted = factor(shifted_matrix(stiffness, mass, shift), like=like)
        except SolverError:  # exactly on an eigenvalue
            shift *= 1.0 + 1e-4
            continue
        below = shifted.negative_eigenvalues
        if below is None:
            unknown += 1
            if unknown == SOLVER.shifts:
                return factor(shifted_matrix(stiffness, mass, -spacing)), -spacing
            shift *= 1.0 + 1e-3
            continue
        if abs(below - middle) <= 0.2 * (high - low):
            return shifted, shift
        shift *= middle / max(below, 1)
    raise SolverError(
        f"shift: expected one among eigenvalues {low} to {high} of the level, found none; the last try {shift:g}. "
        "Ask for fewer eigenpairs."
    )


def shifted_matrix(stiffness: sparse.csr_array, mass: sparse.csr_array, shift: float) -> sparse.csr_array:
    """The matrix W - shift M."""
    return sparse.csr_array(stiffness - shift * mass)


def missed_pairs(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    values: FloatArray,
    first_index: int,
    like: Factorization | None,
    end: int,
) -> int:
    """Number of eigenvalues missing below a gap near index ``end``, by inertia; 0 and a warning without one."""
    if end == 0:
        return 0
    position = end - first_index
    low, high = max(0, position - SOLVER.extra_pairs), min(len(values), position + SOLVER.extra_pairs)
    gap = low + int(np.argmax(np.diff(values[low:high])))
    for share in (0.5, 0.3, 0.7)[: SOLVER.shifts]:
        threshold = values[gap] + share * (values[gap + 1] - values[gap])
        counted = factor(shifted_matrix(stiffness, mass, threshold), like=like).negative_eigenvalues
        if counted is not None:
            return counted - (first_index + gap + 1)
    _log.warning(
        "eigenpairs up to %d of a level with %d vertices could not be proven complete: the factorisation tells no "
        "inertia near %g",
        end,
        stiffness.shape[0],
        threshold,
    )
    return 0


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
    """Ascending eigenvalues (below + above,) on both sides of a shift, and their M-orthonormal eigenvectors.

    Block Lanczos iteration on (W - sigma M)^{-1} M, given the factors of W - sigma M, with full reorthogonalisation:
    O(n m^2), m about 1.6 times the number of wanted pairs. ``block_size`` is the highest multiplicity that is certainly
    found. ``accuracy`` is the largest residual of a pair of the inverted operator relative to its eigenvalue 1 /
    (lambda - sigma), but `SolverConfig.loose` for the ``loose`` outermost pairs below and above. The Krylov space is in
    ``dtype``; solves are in double. SolverError if the Krylov space reaches its largest size without convergence.
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
    # In ascending order of 1 / (lambda - shift) the outermost pairs below and above are adjacent.
    allowed = np.full(wanted, accuracy)
    allowed[below - min(loose[0], below) : below + min(loose[1], above)] = max(SOLVER.loose, accuracy)
    while True:
        used, mass_used = basis[:, :size], mass_basis[:, :size]
        image: Block = np.asarray(shifted.solve(mass_block), dtype=dtype)
        # The recurrence couples a block to itself and the previous one; the rest removes rounding along older blocks.
        recent = slice(max(0, size - 2 * width), size)
        coefficients = np.zeros((size, width), dtype)
        coefficients[recent] = _remove(image, used[:, recent], mass_used[:, recent])
        coefficients += _remove(image, used, mass_used)
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
                return values[order], combined(used, rotation[:, chosen[order]].astype(dtype))
            next_check = size + max(width, size // 20)
        if full:
            raise SolverError(
                f"expected {wanted} eigenpairs within a Krylov space of {capacity} columns, got fewer to accuracy "
                f"{accuracy:g}; ask for fewer pairs or a lower accuracy"
            )
        basis[:, size : size + width], mass_basis[:, size : size + width] = block, mass_block
        size += width


def orthonormal_block(
    block: FloatArray, mass: sparse.csr_array, rng: np.random.Generator, against: Block, mass_against: Block
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """M-orthonormalise a block that is M-orthogonal to ``against``, in place, by Cholesky QR, repeated if needed.

    Lost directions (when the Krylov space became invariant) are replaced by random ones, with a zero row in R.
    Returns the new block (n, b), M times it, and R (b, b) with old block = new block @ R.
    """
    width = block.shape[1]
    total = np.eye(width)
    for _ in range(2):
        mass_block = multiply(mass, block)
        gram = inner_products(block, mass_block)
        values, vectors = linalg.eigh(0.5 * (gram + gram.T))
        weak = values <= SOLVER.dependent * max(values[-1], np.finfo(float).tiny)
        roots = np.sqrt(np.where(weak, 1.0, values))
        total = (np.where(weak, 0.0, roots)[:, None] * vectors.T) @ total
        turn = vectors / roots
        for part in (block, mass_block):
            combined(part, turn, out=part)
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


def _remove(block: Block, basis: Block, mass_basis: Block) -> Block:
    """Make X M-orthogonal to Q in place, in threads; returns the coefficients (M Q)^T X (m, b)."""
    coefficients = inner_products(mass_basis, block)

    def subtract(part: slice) -> None:
        block[part] -= basis[part] @ coefficients

    in_threads(subtract, row_slices(len(block), ROW_BLOCK))
    return coefficients


def inner_products(first: Block, second: Block, areas: FloatArray | None = None) -> Block:
    """(m, b) product P^T D Q of tall blocks, in threads; D = diag ``areas`` (n,), or 1."""

    def share(part: slice) -> Block:
        return first[part].T @ (second[part] if areas is None else areas[part, None] * second[part])

    shares = in_threads(share, row_slices(len(first), ROW_BLOCK))
    return np.asarray(sum(shares[1:], shares[0]))


def combined(basis: Block, coefficients: Block, out: Block | None = None) -> Block:
    """(n, b) product Q C of a tall Q, in threads; ``out`` may be Q."""
    out = np.empty((len(basis), coefficients.shape[1]), np.result_type(basis, coefficients)) if out is None else out

    def combine(part: slice) -> None:
        np.matmul(basis[part], coefficients, out=out[part])

    in_threads(combine, row_slices(len(basis), ROW_BLOCK))
    return out
