"""The elastic energy of a graph, solved for its differentials: which maps A go with which positions x."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import sparse

from cagemap.deform.config import FoldConfig
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.system import BlockPattern, ConstantTerms, VertexTerms
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, nearest_rotations
from cagemap.numerics.factorization import Factorization
from cagemap.surface.triangles import normalized

# From maps (n, 3, 3) and rest normals (n, 3) to the nearest admissible maps, and which of them were bounded (b,).
Admissible = Callable[[FloatArray, FloatArray], tuple[FloatArray, IndexArray]]
NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class ElasticEnergy:
    """E(x, A) of a graph (`cagemap.deform.graph`), with the factors that give the maps A for positions x.

    The normal equations ``(G_i + epsilon L) a = c``, ``G_i = sum_j w_ij e_ij e_ij^T``, are those of the energy with A_i
    instead of A_ij in its first term; they decouple into the three rows of A, with one matrix for all.
    """

    graph: ElasticGraph
    pattern: BlockPattern  # of its Laplacian, and of the positions' matrices
    factors: Factorization  # of ``G + epsilon L``
    admissible: Admissible  # what differentials are restricted to: `bounded_maps`, `rotations` or `any_map`

    @classmethod
    def build(cls, graph: ElasticGraph, smoothing: float, admissible: Admissible | None = None) -> ElasticEnergy:
        """Factor the (3 n, 3 n) matrix once for all iterations; by default maps are bounded."""
        edges = graph.edges
        outer = graph.weights[:, None, None] * edges[:, :, None] * edges[:, None, :]
        blocks = grouped_sums(graph.heads, outer.reshape(-1, 9), graph.n).reshape(-1, 3, 3)
        # A flat ring leaves its normal direction open: lean on the neighbours, and a trace of ridge for safety.
        blocks += 1e-9 * float(np.einsum("naa->n", blocks).mean()) * np.eye(3)
        pattern = BlockPattern.build(graph.laplacian)
        return cls(graph, pattern, pattern.factor(smoothing, blocks), admissible or bounded_maps)

    def maps(self, positions: FloatArray) -> FloatArray:
        """(n, 3, 3) maps A that minimise the energy for positions x (n, 3)."""
        transposed = self.factors.solve(self.graph.moments @ positions)  # rows (i, b), columns a: A_i[a, b]
        return np.ascontiguousarray(transposed.reshape(-1, 3, 3).transpose(0, 2, 1))

    def differentials(self, positions: FloatArray) -> tuple[FloatArray, IndexArray]:
        """(n, 3, 3) admissible maps for positions x (n, 3), and which of them were bounded."""
        return self.admissible(self.maps(positions), self.graph.normals)

    def terms(
        self,
        blocks: FloatArray,
        right: FloatArray,
        distance: float = np.inf,
        guesses: tuple[IndexArray | None, IndexArray | None] = (None, None),
    ) -> VertexTerms:
        """Terms of one iteration, see `VertexTerms`."""
        return VertexTerms(self.pattern, self.factors, blocks, right, distance, guesses)

    def constant_terms(self, blocks: FloatArray, right: FloatArray) -> ConstantTerms:
        """Terms that stay the same in all iterations, from blocks (n, 3, 3) and a right side (n, 3)."""
        return ConstantTerms(self.pattern, self.factors, blocks, right)


def any_map(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
    """All linear maps are admissible: small displacements."""
    return maps, NONE


def rotations(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Only rotations are admissible: the energy is as rigid as possible (Sorkine and Alexa 2007)."""
    return nearest_rotations(maps), NONE


def bounded_maps(
    maps: FloatArray, normals: FloatArray, config: FoldConfig = FoldConfig()
) -> tuple[FloatArray, IndexArray]:
    """Linear maps without those that flatten a surface or turn it over.

    The energy alone lets a differential pass through zero and come out mirrored: limbs that have to shrink fold like an
    accordion. A map whose two stretches in the tangent plane have a ratio below ``config.flat``, or whose determinant
    is not positive, gets its singular values s_1 >= s_2 >= +-s_3 bounded from below by ``config.min_stretch * s_1``;
    the last of them has the determinant's sign before. All others stay as they are: a part that is thin on the other
    shape, flat along its normal, is no fold.
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


def bounded_by(config: FoldConfig) -> Admissible:
    """`bounded_maps` with these bounds."""
    return partial(bounded_maps, config=config)


def transformed_normals(maps: FloatArray, normals: FloatArray) -> FloatArray:
    """(n, 3) normals after linear maps (n, 3, 3), as long as areas are stretched: cofactor matrices times normals."""
    # Rows of the cofactor matrix are cross products of the map's rows.
    cofactors = np.stack([np.cross(maps[:, (k + 1) % 3], maps[:, (k + 2) % 3]) for k in range(3)], axis=1)
    return np.asarray(np.einsum("nab,nb->na", cofactors, normals))


def deformed_normals(normals: FloatArray, maps: FloatArray) -> FloatArray:
    """(n, 3) unit normals of a deformed graph, from its normals (n, 3) at rest and its maps (n, 3, 3)."""
    return normalized(transformed_normals(maps, normals))


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
    # A flat ring leaves the normal direction of its map open, as in `ElasticEnergy.build`.
    ridge = 1e-9 * float(stretch.diagonal().mean())
    change = sparse.kron(smoothing * graph.laplacian + ridge * sparse.eye_array(graph.n), maps_only)
    return sparse.csr_array(stretch + change)
