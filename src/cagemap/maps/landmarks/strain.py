"""Landmark pairs that hold a finished map where it does not want to be: all leave-one-out answers of one factorisation.

At the finished map the elastic fit is, to second order, a quadratic problem in positions x and linear maps A,

    alpha E(x, A) + sum_i a_i (n_i . (x_i - y_i))^2,

with n_i the source's normals at the images y_i. Everything but the p landmarks is eliminated, which leaves the energy
``(l - l_0)^T H (l - l_0)`` of their places l. A landmark that is let go while the others are held moves by
``u_i = -H_ii^-1 (H (l - l_0))_i``: the leave-one-out residual, without fitting p times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.maps.elastic.graph import ElasticGraph, cluster_graph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor

# The graph of the quadratic problem; sampling and smoothing are coarse because one landmark's surroundings are.
GRAPH_VERTICES = 300
STIFFNESS = 1e-4
SMOOTHING = 1e-3
# Tangential hold of every vertex, so that the problem without landmarks has one solution.
RIDGE = 1e-7
# A landmark is suspect from this displacement on, of sqrt(area), if no other one would move nearly as far: shapes that
# differ strain many landmarks, and mirror images alike; a mistake stands alone.
LEAST_DISPLACEMENT = 0.05
OF_NEXT = 1.5
# With fewer landmarks the others are too far away to know better, and too few to compare with.
FEWEST_JUDGED = 10


@dataclass(frozen=True, eq=False)
class ReducedEnergy:
    """``(l - rest)^T H (l - rest)`` of the landmarks' places, all else at its best.

    Attributes
    ----------
    hessian : (3 p, 3 p) float64
        H; rows are landmarks times coordinates.
    rest : (p, 3) float64
        l_0, where the landmarks lie when none is held.
    """

    hessian: FloatArray
    rest: FloatArray

    def released(self, places: FloatArray, held: IndexArray) -> FloatArray:
        """(p, 3) displacements u_i of every held landmark let go alone; zero for those not held, which are free.

        Parameters
        ----------
        places : (p, 3) float64
        held : (q,) int64
        """
        free = np.setdiff1d(np.arange(len(places)), held)
        rows, gone = _rows(held), _rows(free)
        hessian = self.hessian[np.ix_(rows, rows)]
        if len(free):
            coupling = self.hessian[np.ix_(gone, rows)]
            hessian = hessian - coupling.T @ np.linalg.solve(self.hessian[np.ix_(gone, gone)], coupling)
        force = (hessian @ (places - self.rest)[held].ravel()).reshape(-1, 3)
        own = hessian.reshape(len(held), 3, len(held), 3)[np.arange(len(held)), :, np.arange(len(held))]
        moved = np.zeros_like(places)
        moved[held] = -np.linalg.solve(own, force[:, :, None])[:, :, 0]
        return moved


def reduced_energy(
    graph: ElasticGraph, images: FloatArray, normals: FloatArray, landmarks: IndexArray
) -> ReducedEnergy:
    """Eliminate everything but the landmarks from the quadratic problem at a map.

    Parameters
    ----------
    graph : ElasticGraph
        Of the target's mesh, at unit area.
    images, normals : (n, 3) float64
        Where the map takes its vertices on the source, and the source's unit normals there.
    landmarks : (p,) int64
    """
    coarse, vertices = cluster_graph(graph, min(GRAPH_VERTICES, graph.n), landmarks)
    plane = normals[vertices]
    blocks = coarse.areas[:, None, None] * plane[:, :, None] * plane[:, None, :] + RIDGE / coarse.n * np.eye(3)
    data = sparse.bsr_array((blocks, np.arange(coarse.n), np.arange(coarse.n + 1))).tocoo()
    # Unknown 12 i + c is coordinate c of x_i, 12 i + 3 + 3 b + c is A_i[c, b].
    size = 12 * coarse.n
    at_row, at_column = (_spread(side.astype(np.int64)) for side in data.coords)
    placed = sparse.coo_array((data.data, (at_row, at_column)), shape=(size, size))
    elastic = sparse.kron(STIFFNESS * elastic_form(coarse, SMOOTHING), sparse.eye_array(3))
    factors = factor(sparse.csc_array(elastic + placed))
    right = np.zeros((size, 3 * len(landmarks) + 1))
    at = _spread(np.arange(3 * len(landmarks)))  # the landmarks are the first clusters
    right[at, np.arange(len(at))] = 1.0
    right[_spread(np.arange(3 * coarse.n)), -1] = np.einsum("nab,nb->na", blocks, images[vertices]).ravel()
    solved = factors.solve(right)[at]
    compliance = 0.5 * (solved[:, :-1] + solved[:, :-1].T)
    return ReducedEnergy(np.asarray(np.linalg.inv(compliance), dtype=np.float64), solved[:, -1].reshape(-1, 3))


def elastic_form(graph: ElasticGraph, epsilon: float) -> sparse.csr_array:
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
    # A flat ring leaves the normal direction of its map open, as in `DifferentialField`.
    ridge = 1e-9 * float(stretch.diagonal().mean())
    change = sparse.kron(epsilon * graph.laplacian() + ridge * sparse.eye_array(graph.n), maps_only)
    return sparse.csr_array(stretch + change)


def strained_pair(energy: ReducedEnergy, places: FloatArray) -> int | None:
    """The landmark that would move far if let go, and alone so; None where there is none.

    The others are asked again with it let go, because a wrong landmark pulls at its neighbours. Fewer than
    `FEWEST_JUDGED` landmarks are not judged.

    Parameters
    ----------
    energy : ReducedEnergy
    places : (p, 3) float64
        Where the map holds the landmarks.
    """
    held = np.arange(len(places))
    if len(held) < FEWEST_JUDGED:
        return None
    moved = np.linalg.norm(energy.released(places, held), axis=1)
    worst = int(np.argmax(moved))
    others = np.linalg.norm(energy.released(places, held[held != worst]), axis=1)
    return worst if moved[worst] >= max(LEAST_DISPLACEMENT, OF_NEXT * float(others.max())) else None


def _rows(landmarks: IndexArray) -> IndexArray:
    """Rows of H of some landmarks."""
    return np.asarray((3 * landmarks[:, None] + np.arange(3)).ravel())


def _spread(rows: IndexArray) -> IndexArray:
    """Row 3 i + c of positions alone to row 12 i + c of positions and maps."""
    return np.asarray(12 * (rows // 3) + rows % 3)
