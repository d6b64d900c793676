"""The elastic energy of a graph, and its minimisation with other terms: positions and differentials alternate.

Every deformation is one call of `minimise` with its graph, differentials and terms: the coarse and the fine stage,
positions from landmarks alone, the pose of a placement, the response of a map to its landmarks, and the wrap of a net.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from cagemap.deform.config import GraphConfig, Stage
from cagemap.deform.graph import ElasticGraph
from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, nearest_rotations
from cagemap.numerics.sparse_algebra import Factorization, factor
from cagemap.numerics.threads import ThreadPool, kept
from cagemap.surface.triangles import normalize_rows

# Added to the matrices of maps, as a share of their mean diagonal: a flat ring does not determine the normal direction
# of its map. The smoothing does; this is for safety.
RIDGE = 1e-9
DAMPING = 1e-4  # the same for a system of positions whose matrix is singular; single precision keeps it

Solve = Callable[[FloatArray, FloatArray], FloatArray]  # positions (n, 3) for a right side and those before
# From maps (n, 3, 3) and rest normals (n, 3) to the nearest admissible maps, and which of them were bounded (b,).
Admissible = Callable[[FloatArray, FloatArray], tuple[FloatArray, IndexArray]]
NO_VERTICES = np.zeros(0, dtype=np.int64)
Differentials = tuple[FloatArray, IndexArray]  # maps (n, 3, 3) of positions, and which were bounded (b,)


class Quadratic(Protocol):
    """Terms of one iteration, ``x^T B x - 2 b^T x`` up to a constant."""

    @property
    def right(self) -> FloatArray:
        """(n, 3) b."""

    def solver(self, alpha: float, stage: Stage, factors: Any) -> tuple[Any, Solve]:
        """Factors, the given ones unless None, and the solver of the system ``alpha L + B`` with them."""


# Data terms and constraints at positions (n, 3), from their differentials (computed meanwhile), the stiffness alpha and
# the terms of the previous iteration (None in the first).
Terms = Callable[[FloatArray, Future[Differentials], float, Any], Quadratic]


def minimise(
    graph: ElasticGraph,
    differentials: Callable[[FloatArray], Differentials],
    terms: Terms | Quadratic,
    start: FloatArray,
    stage: Stage,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
) -> FloatArray:
    """Positions x (n, 3) that minimise ``alpha E(x, A)`` plus terms; alternates positions and differentials A.

    The terms are a function, or the same in all iterations. Momentum makes the alternation three times faster.
    ``adjust`` is applied to the positions of every iteration, to keep a symmetry.
    """
    positions, before = start, start
    quadratic: Quadratic | None = None
    solve: Solve | None = None
    factors, last_alpha = None, 0.0
    with ThreadPool(1) as pool:
        for iteration, alpha in enumerate(stage.ramped().tolist(), start=1):
            pending = pool.submit(differentials, positions)
            last = quadratic
            quadratic = terms(positions, pending, alpha, quadratic) if callable(terms) else terms
            if solve is None or quadratic is not last or alpha != last_alpha:
                anew = (iteration - 1) % stage.factored == 0
                (factors, solve), last_alpha = quadratic.solver(alpha, stage, None if anew else factors), alpha
            maps, bounded = pending.result()
            right = quadratic.right + alpha * graph.divergence(maps)
            after = adjust(solve(right, positions))
            if iteration >= stage.iterations and len(bounded) <= stage.max_bounded * graph.n:
                return after
            positions = after + stage.momentum * (after - before) if iteration > 1 else after
            before = after
    return np.asarray(before)


@dataclass(frozen=True, eq=False)
class ElasticEnergy:
    """Elastic energy E(x, A) of a graph (`cagemap.deform.graph`), with factors for the maps A.

    The maps solve ``(G_i + epsilon L) a = c``, ``G_i = sum_j w_ij e_ij e_ij^T``: the first term of the energy with A_i
    instead of A_ij, and a smoothing. It approximates the minimum over A, and decouples into the three rows of A, with
    one matrix for all.
    """

    graph: ElasticGraph
    smoothing: float  # epsilon
    admissible: Admissible  # what differentials are restricted to: `bounded_maps`, `rotations` or `any_map`

    @kept
    def factors(self) -> Factorization:
        """Factors of the (3 n, 3 n) matrix ``G + epsilon L``."""
        graph, edges = self.graph, self.graph.edges
        outer = graph.weights[:, None, None] * edges[:, :, None] * edges[:, None, :]
        blocks = grouped_sums(graph.heads, outer.reshape(-1, 9), graph.n).reshape(-1, 3, 3)
        blocks += RIDGE * float(np.einsum("naa->n", blocks).mean()) * np.eye(3)
        return factor(graph.block_matrix(self.smoothing, blocks))

    def with_rest_shape(self, positions: FloatArray, normals: FloatArray, smoothing: float) -> ElasticEnergy:
        """The energy of another rest shape: positions and normals (n, 3)."""
        return replace(self, graph=replace(self.graph, positions=positions, normals=normals), smoothing=smoothing)

    def maps(self, positions: FloatArray) -> FloatArray:
        """(n, 3, 3) maps A for positions x (n, 3): ``(G + epsilon L) a = c``, before they are restricted."""
        transposed = self.factors.solve(self.graph.moments @ positions)  # rows (i, b), columns a: A_i[a, b]
        return np.ascontiguousarray(transposed.reshape(-1, 3, 3).transpose(0, 2, 1))

    def differentials(self, positions: FloatArray) -> Differentials:
        """(n, 3, 3) admissible maps for positions x (n, 3), and which of them were bounded."""
        return self.admissible(self.maps(positions), self.graph.normals)


def bounded_energy(graph: ElasticGraph, smoothing: float, config: GraphConfig) -> ElasticEnergy:
    """Elastic energy of a graph whose differentials are bounded, see `bounded_maps`."""
    return ElasticEnergy(graph, smoothing, partial(bounded_maps, config=config))


def bounded_maps(
    maps: FloatArray, normals: FloatArray, config: GraphConfig = GraphConfig()
) -> tuple[FloatArray, IndexArray]:
    """Bound linear maps that flatten the surface or turn it over; returns also which ones.

    A map whose two stretches in the tangent plane have a ratio below ``config.flat``, or whose determinant is not
    positive, gets its singular values s_1 >= s_2 >= +-s_3 bounded from below by ``config.min_stretch * s_1``: otherwise
    limbs that shrink fold like an accordion. Other maps stay: a part that is thin on the other shape, flat along its
    normal, is no fold.
    """
    across, turned = np.einsum("nab,nb->na", maps, normals), transformed_normals(maps, normals)
    # With stretches s and t in the tangent plane: s t, and s^2 + t^2.
    product = np.linalg.norm(turned, axis=1)
    squares = np.einsum("nab,nab->n", maps, maps) - np.einsum("na,na->n", across, across)
    determinant = np.einsum("na,na->n", turned, across)
    bounded = np.flatnonzero((determinant <= 0) | (product < config.flat / (1.0 + config.flat**2) * squares))
    if not len(bounded):
        return maps, bounded
    left, stretches, right = np.linalg.svd(maps[bounded])
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= sign[:, None]
    stretches[:, 2] *= sign
    stretches = np.maximum(stretches, config.min_stretch * stretches[:, :1])
    changed = maps.copy()
    changed[bounded] = (left * stretches[:, None, :]) @ right
    return changed, bounded


def any_map(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
    """All linear maps are admissible: small displacements."""
    return maps, NO_VERTICES


def rotations(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Only rotations are admissible: the energy is as rigid as possible (Sorkine and Alexa 2007)."""
    return nearest_rotations(maps), NO_VERTICES


@dataclass(frozen=True, eq=False)
class VertexTerms:
    """Terms ``sum_i x_i^T B_i x_i - 2 b_i^T x_i`` of one iteration, or the same in all iterations."""

    energy: ElasticEnergy
    blocks: FloatArray  # (n, 3, 3): B_i
    right: FloatArray  # (n, 3): b_i
    guesses: tuple[IndexArray | None, IndexArray | None] = (None, None)  # triangles of closest points
    constant: bool = False  # the same in all iterations: one factorisation, in double precision

    def solver(self, alpha: float, stage: Stage, factors: Factorization | None) -> tuple[Factorization, Solve]:
        """Solver of ``alpha L + B`` by given or new factors; the next iteration corrects errors of inexact factors."""
        graph, like = self.energy.graph, self.energy.factors
        matrix = graph.block_matrix(alpha, self.blocks)
        if self.constant:
            exact = factor(matrix, like=like)
            return exact, lambda right, _: exact.solve(right.ravel()).reshape(-1, 3)
        step: Callable[[FloatArray], FloatArray]
        if factors is not None:
            step = partial(conjugate_gradients, matrix, factors, stage)
        else:
            try:
                factors = factor(matrix, like=like, dtype=np.float32)
            except SolverError:  # a motion is free, as where nothing of the source faces the positions: damp it
                ridge = DAMPING * float(abs(matrix.diagonal()).mean()) * np.eye(3)
                factors = factor(graph.block_matrix(alpha, self.blocks + ridge), like=like, dtype=np.float32)
            step = factors.solve
        return factors, lambda right, at: at + step(right.ravel() - matrix @ at.ravel()).reshape(-1, 3)


def conjugate_gradients(
    matrix: sparse.csc_array, factors: Factorization, stage: Stage, residual: FloatArray
) -> FloatArray:
    """``A^-1 r`` by conjugate gradients (Hestenes, Stiefel 1952) with old factors; by new ones if they fail."""
    near = LinearOperator(matrix.shape, matvec=factors.solve, dtype=np.float64)
    step, missed = cg(matrix, residual, rtol=stage.tolerance, maxiter=stage.gradient_steps, M=near)
    unsolved = stage.max_unsolved * np.linalg.norm(residual)
    if missed and not np.linalg.norm(residual - matrix @ step) <= unsolved:
        step = factor(matrix, like=factors).solve(residual)
    return np.asarray(step)


def transformed_normals(maps: FloatArray, normals: FloatArray) -> FloatArray:
    """(n, 3) cofactor matrices of maps (n, 3, 3) times normals: deformed normals, scaled by area stretch."""
    # Row k of the cofactor matrix is the cross product of rows k + 1 and k + 2 of the map, counted modulo 3. Written
    # out, since `np.cross` takes three times as long on small graphs.
    next_one, next_two = [1, 2, 0], [2, 0, 1]
    first, second = maps[:, next_one], maps[:, next_two]
    cofactors = first[:, :, next_one] * second[:, :, next_two] - first[:, :, next_two] * second[:, :, next_one]
    return np.asarray(np.einsum("nab,nb->na", cofactors, normals))


def deformed_normals(normals: FloatArray, maps: FloatArray) -> FloatArray:
    """(n, 3) unit normals of a deformed graph, from its normals (n, 3) at rest and its maps (n, 3, 3)."""
    return normalize_rows(transformed_normals(maps, normals))


def energy_matrix(graph: ElasticGraph, smoothing: float) -> sparse.csr_array:
    """(4 n, 4 n) matrix Q of E(x, A) for one coordinate: z^T Q z with z_i = (x_i, row of A_i)."""
    once = graph.heads < graph.tails
    heads, tails, weights, edges = graph.heads[once], graph.tails[once], graph.weights[once], graph.edges[once]
    ones = np.ones((len(heads), 1))
    values = np.hstack([ones, -0.5 * edges, -ones, -0.5 * edges])
    columns = np.hstack([4 * heads[:, None] + np.arange(4), 4 * tails[:, None] + np.arange(4)])
    rows = np.repeat(np.arange(len(heads)), 8)
    residual = sparse.csr_array((values.ravel(), (rows, columns.ravel())), shape=(len(heads), 4 * graph.n))
    stretch = residual.T @ sparse.diags_array(weights) @ residual
    maps_only = sparse.diags_array([0.0, 1.0, 1.0, 1.0])
    ridge = RIDGE * float(stretch.diagonal().mean())
    change = sparse.kron(smoothing * graph.laplacian + ridge * sparse.eye_array(graph.n), maps_only)
    return sparse.csr_array(stretch + change)
