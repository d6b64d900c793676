"""Strain of landmark pairs: leave-one-out residuals of all pairs from one factorisation.

At the finished map the elastic fit is, to second order, a quadratic problem in positions x and linear maps A,

    alpha E(x, A) + sum_i a_i (n_i . (x_i - y_i))^2,

with n_i the source's normals at the images y_i. Everything but the p landmarks is eliminated, which leaves the energy
``(l - l_0)^T H (l - l_0)`` of their positions l. A landmark that is released while the others are fixed moves by
``u_i = -H_ii^-1 (H (l - l_0))_i``: the leave-one-out residual, without fitting p times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.deform.config import ElasticConfig, LandmarkConfig
from cagemap.deform.energy import energy_matrix
from cagemap.deform.graph import ElasticGraph, cluster_graph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization, factor
from cagemap.numerics.threads import kept, row_slices

# Number of landmarks whose blocks of H are computed at once.
LANDMARKS_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class ReducedEnergy:
    """``(l - l_0)^T H (l - l_0)`` of the landmarks' positions l, minimised over all other unknowns f.

    H is the Schur complement ``K_ll - K_fl^T K_ff^-1 K_fl`` of the whole quadratic problem, of which only products and
    diagonal blocks are computed: with thousands of landmarks H would fill the memory.
    """

    own: sparse.csc_array  # (3 p, 3 p) K_ll; rows are landmarks times coordinates
    coupling: sparse.csc_array  # (m, 3 p) K_fl
    others: Factorization  # of K_ff
    load: FloatArray  # (3 p,) ``H l_0``, l_0 the positions if no landmark is fixed

    @classmethod
    def of(cls, matrix: sparse.csc_array, right: FloatArray, landmarks: IndexArray) -> ReducedEnergy:
        """Eliminate all unknowns but the landmarks' (3 p,) from ``z^T K z - 2 z^T b``."""
        rest = np.setdiff1d(np.arange(len(right)), landmarks)
        landmark_columns, columns = matrix[:, landmarks], matrix[:, rest]
        coupling, factors = sparse.csc_array(landmark_columns[rest]), factor(sparse.csc_array(columns[rest]))
        load = right[landmarks] - coupling.T @ factors.solve(right[rest])
        return cls(sparse.csc_array(landmark_columns[landmarks]), coupling, factors, np.asarray(load))

    def times(self, values: FloatArray) -> FloatArray:
        """H x for x (3 p,) or (3 p, q)."""
        return np.asarray(self.own @ values - self.coupling.T @ self.others.solve(self.coupling @ values))

    @kept
    def blocks(self) -> FloatArray:
        """(p, 3, 3) diagonal blocks of H."""
        count = len(self.load) // 3
        blocks = np.empty((count, 3, 3))
        for part in row_slices(count, LANDMARKS_AT_ONCE):
            rows = slice(3 * part.start, 3 * part.stop)
            coupling = self.coupling[:, rows]
            reduced = self.own[rows, rows].toarray() - coupling.T @ self.others.solve(coupling.toarray())
            some = np.arange(part.stop - part.start)
            blocks[part] = np.asarray(reduced).reshape(len(some), 3, len(some), 3)[some, :, some]
        return blocks

    def released(self, places: FloatArray, fixed: IndexArray) -> FloatArray:
        """(p, 3) displacement u_i of every fixed landmark (q,) if released alone; 0 for free landmarks."""
        force, blocks = self.times(places.ravel()) - self.load, self.blocks
        free = np.setdiff1d(np.arange(len(places)), fixed)
        if len(free):  # eliminate the free landmarks too
            free_rows = (3 * free[:, None] + np.arange(3)).ravel()
            chosen = np.zeros((len(force), len(free_rows)))
            chosen[free_rows, np.arange(len(free_rows))] = 1.0
            columns = self.times(chosen)
            weights = np.linalg.solve(columns[free_rows], columns.T)
            force = force - force[free_rows] @ weights
            blocks = blocks - np.einsum(
                "gik,gij->ikj", *(m.reshape(len(free_rows), -1, 3) for m in (columns.T, weights))
            )
        moved = np.zeros_like(places)
        moved[fixed] = -np.linalg.solve(blocks[fixed], force.reshape(-1, 3, 1)[fixed])[:, :, 0]
        return moved


def reduced_energy(
    graph: ElasticGraph,
    images: FloatArray,
    normals: FloatArray,
    landmarks: IndexArray,
    config: ElasticConfig = ElasticConfig(),
) -> ReducedEnergy:
    """Reduced energy of landmarks (p,) at images (n, 3) with the source's normals (n, 3) there."""
    numbers = config.landmarks
    coarse, vertices = cluster_graph(graph, numbers.strain_vertices, landmarks, config.graph)
    plane = normals[vertices]
    blocks = coarse.areas[:, None, None] * plane[:, :, None] * plane[:, None, :]
    blocks = blocks + numbers.strain_ridge / coarse.n * np.eye(3)
    data = sparse.bsr_array((blocks, np.arange(coarse.n), np.arange(coarse.n + 1))).tocoo()
    # Unknown 12 i + c is coordinate c of x_i, 12 i + 3 + 3 b + c is A_i[c, b].
    size = 12 * coarse.n
    at_row, at_column = (_spread(side.astype(np.int64)) for side in data.coords)
    placed = sparse.coo_array((data.data, (at_row, at_column)), shape=(size, size))
    elastic = sparse.kron(
        numbers.strain_stiffness * energy_matrix(coarse, numbers.strain_smoothing), sparse.eye_array(3)
    )
    right = np.zeros(size)
    right[_spread(np.arange(3 * coarse.n))] = np.einsum("nab,nb->na", blocks, images[vertices]).ravel()
    unknowns = _spread(np.arange(3 * len(landmarks)))  # the landmarks are the first clusters
    return ReducedEnergy.of(sparse.csc_array(elastic + placed), right, unknowns)


def strained_pair(
    energy: ReducedEnergy, places: FloatArray, strains: FloatArray, config: LandmarkConfig = LandmarkConfig()
) -> int | None:
    """Index of the one landmark that would move far if released; None if there is none.

    ``strains`` (p,) are lengths of `ReducedEnergy.released`. None as well if there are too few landmarks. The others
    are measured again without the worst one, because a wrong landmark strains its neighbours.
    """
    all_landmarks = np.arange(len(places))
    if len(all_landmarks) < config.fewest_strained:
        return None
    worst = int(np.argmax(strains))
    moved_next = np.linalg.norm(energy.released(places, all_landmarks[all_landmarks != worst]), axis=1)
    least = max(config.min_strain, config.min_strain_of_next * float(moved_next.max()))
    return worst if strains[worst] >= least else None


def _spread(rows: IndexArray) -> IndexArray:
    """Convert rows 3 i + c of positions to rows 12 i + c of positions and maps."""
    return np.asarray(12 * (rows // 3) + rows % 3)
