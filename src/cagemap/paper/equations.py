"""Functional maps from constraints: eq. 13 at level 0, eqs. 14-16 for bands of finer levels (5.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.sparse.linalg import LinearOperator, cg

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.paper.constraints import SPACING, ConstraintConfig, Constraints, SpectralData

Mask = NDArray[np.bool_]

CONVERGED = 1e-11  # residual of the iteration that couples rows, relative to the right side
MOST_ITERATIONS = 5000


def solve_functional_map(
    constraints: Constraints, config: ConstraintConfig, *, known: FloatArray | None = None
) -> FloatArray:
    """C12 (k1, k2) minimising ||C F2 - F1||^2 + sum_O alpha(O) ||C O2 - O1 C||^2 + decay ||C||^2 (eq. 13).

    A ``known`` leading block C_l (a, b) is kept (eq. 14); the three other blocks are solved for together. If operators
    have no entries between low and high functions, the system separates into eq. 16 and one for the high rows.
    Of the config ``laplacian``, ``operators`` and ``decay`` are read.

    ParameterError if the known block is larger than C.
    """
    target, source = constraints.target, constraints.source
    k1, k2 = constraints.shape
    low1, low2 = (0, 0) if known is None else known.shape
    if low1 > k1 or low2 > k2:
        raise ParameterError(f"expected a known block within {(k1, k2)} functions, got {(low1, low2)}")
    gram = source.descriptors @ source.descriptors.T
    right = target.descriptors @ source.descriptors.T
    diagonal = laplacian_penalties(target.eigenvalues, source.eigenvalues, config.laplacian)
    # Keeps the systems definite where neither descriptors nor operators determine C.
    diagonal += 1e-10 * np.trace(gram) / max(k2, 1) + np.finfo(float).tiny + config.decay
    pairs = [] if config.operators == 0.0 else list(zip(target.operators, source.operators, strict=True))

    def normal_equations(c: FloatArray) -> FloatArray:
        result = c @ gram + diagonal * c
        for o1, o2 in pairs:
            commutator = c @ o2 - o1 @ c
            result += config.operators * (commutator @ o2.T - o1.T @ commutator)
        return np.asarray(result)

    start = np.zeros((k1, k2))
    if known is not None:
        start[:low1, :low2] = known
        right = right - normal_equations(start)
    unknown = np.ones((k1, k2), dtype=bool)
    unknown[:low1, :low2] = False
    if pairs and start.size:
        start[unknown] = _solve_coupled(normal_equations, gram, diagonal, right, unknown)
        return start
    for i, free in enumerate(unknown):  # one positive definite system for each row of C
        if free.any():
            system = gram[np.ix_(free, free)] + np.diag(diagonal[i, free])
            start[i, free] = linalg.solve(system, right[i, free], assume_a="pos", check_finite=False)
    return start


def extend_functional_map(coarse: FloatArray, constraints: Constraints, config: ConstraintConfig) -> FloatArray:
    """Extend C_l (k1_l, k2_l) by the bands of the next level, eq. 14: [[C_l, C_lh], [C_hl, C_h]], (k1, k2).

    C_l is kept. Tridiagonal operators are cut to their diagonal blocks (eq. 15): low rows then determine C_lh alone
    (eq. 16), high rows C_hl and C_h. Denser operators keep their entries and couple all three (end of 5.3.2).
    The config is read as by `solve_functional_map`.
    """
    low1, low2 = coarse.shape
    split = Constraints(split_operators(constraints.target, low1), split_operators(constraints.source, low2))
    return solve_functional_map(split, config, known=coarse)


def split_operators(data: SpectralData, low: int) -> SpectralData:
    """Cut tridiagonal operators between low and high functions (eq. 15); denser ones are unchanged."""

    def cut(operator: FloatArray) -> FloatArray:
        if np.any(np.triu(operator, 2)) or np.any(np.tril(operator, -2)):
            return operator
        return np.asarray(linalg.block_diag(operator[:low, :low], operator[low:, low:]))

    return SpectralData(data.eigenvalues, data.descriptors, tuple(map(cut, data.operators)))


def laplacian_penalties(target_eigenvalues: FloatArray, source_eigenvalues: FloatArray, weight: float) -> FloatArray:
    """(k1, k2) weights of C_ij^2 in alpha ||C Lambda2 - Lambda1 C||^2."""
    differences = (source_eigenvalues[None, :] - target_eigenvalues[:, None]) / SPACING
    return np.asarray(weight * differences**2)


def _solve_coupled(
    normal_equations: Callable[[FloatArray], FloatArray],
    gram: FloatArray,
    diagonal: FloatArray,
    right: FloatArray,
    unknown: Mask,
) -> FloatArray:
    """Solve for unknown entries with operators that couple rows, by preconditioned conjugate gradients."""
    # Preconditioner of row i: (G + d_i)^{-1}, d_i the mean of its penalties; one eigendecomposition for all rows.
    values, vectors = linalg.eigh(gram)
    shifted = np.maximum(values, 0.0) + diagonal.mean(axis=1, keepdims=True)

    def whole(x: FloatArray) -> FloatArray:
        c = np.zeros_like(right)
        c[unknown] = x
        return c

    size = int(unknown.sum())
    solution, failed = cg(
        LinearOperator((size, size), matvec=lambda x: normal_equations(whole(x))[unknown], dtype=np.float64),
        right[unknown],
        rtol=CONVERGED,
        maxiter=MOST_ITERATIONS,
        M=LinearOperator(
            (size, size), matvec=lambda x: ((whole(x) @ vectors / shifted) @ vectors.T)[unknown], dtype=np.float64
        ),
    )
    if failed:
        raise ParameterError(
            "descriptor operators: no functional map was found. Scale them to norms of about 1, and their weight "
            "to that of the descriptors."
        )
    return np.asarray(solution)
