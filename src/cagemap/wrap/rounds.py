"""Rounds of the fit: closest points and differentials alternate with the positions of a net, or of a part of it.

The system of a round couples the three coordinates, through the tangent planes. It is solved by conjugate gradients
from where the net is; the system without planes, ``S^T w S + fairness L``, is the preconditioner, the same for all
coordinates and all rounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from cagemap.geometry.points import SurfacePoints
from cagemap.maps.elastic.graph import ElasticGraph, bounded_maps, divergence
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization, factor
from cagemap.numerics.rotations import nearest_rotations
from cagemap.wrap.fit import FitData, WrapConfig

# A closest point on the other side of a thin part is further away than one with the right normal, by this length.
NORMAL_WEIGHT = 0.03
# From positions of a net (n, 3) to its differentials (n, 3, 3).
Differentials = Callable[[FloatArray], FloatArray]

# A round's system is solved to this part of what it starts with, in so many steps at most: the next round differs more.
_ACCURACY, _STEPS = 3e-2, 200


@dataclass(frozen=True, eq=False)
class Fitting:
    """A net, or a part of it, with what pulls at it.

    Attributes
    ----------
    graph : ElasticGraph
    data : FitData
    config : WrapConfig
    moving : (m,) int64
        Points that move.
    similar : (k,) int64
        Points whose differential is a similarity: turned and scaled, and not sheared.
    transposed : (n, s) csr_array
        S^T of the samples.
    laplacian : (n, n) csr_array
    moments : (3 n, n) csr_array
        Of the graph.
    factors : Factorization
        Of ``S^T w S + fairness L`` over the points that move.
    """

    graph: ElasticGraph
    data: FitData
    config: WrapConfig
    moving: IndexArray
    similar: IndexArray
    transposed: sparse.csr_array
    laplacian: sparse.csr_array
    moments: sparse.csr_array
    factors: Factorization

    @classmethod
    def build(
        cls,
        graph: ElasticGraph,
        data: FitData,
        config: WrapConfig,
        similar: IndexArray,
        moving: IndexArray | None = None,
    ) -> Fitting:
        """Factor the system that all rounds share; by default all points move."""
        laplacian = graph.laplacian()
        transposed = sparse.csr_array(data.samples.T)
        weighted = transposed @ sparse.diags_array(data.weights) @ data.samples
        matrix = sparse.csr_array(weighted + config.fairness * laplacian)
        if moving is None:
            moving = np.arange(graph.n)
        else:
            matrix = matrix[moving][:, moving]
        factors = factor(sparse.csc_array(matrix))
        return cls(graph, data, config, moving, similar, transposed, laplacian, graph.moments(), factors)

    def elastic_pull(self, maps: FloatArray) -> FloatArray:
        """(n, 3) right side of the energy, with differentials (n, 3, 3) of which none may flatten or turn over."""
        maps, _ = bounded_maps(maps, self.graph.normals)
        if len(self.similar):
            maps, near = maps.copy(), maps[self.similar]
            size = np.cbrt(np.abs(np.linalg.det(near)))
            maps[self.similar] = size[:, None, None] * nearest_rotations(near)
        return self.config.fairness * divergence(self.moments, maps)


def start(fitting: Fitting, differentials: Differentials) -> FloatArray:
    """(n, 3) the net that minimises ``||S X - P||^2`` with a trace of its energy; what does not move is at rest.

    What moves is whole pieces of the net: nothing else pulls at them.
    """
    data, moving, positions = fitting.data, fitting.moving, fitting.graph.positions.copy()
    right = fitting.transposed @ (data.weights[:, None] * data.images.positions)
    positions[moving] = fitting.factors.solve(right[moving])
    positions[moving] = fitting.factors.solve((right + fitting.elastic_pull(differentials(positions)))[moving])
    return positions


def rounds(
    fitting: Fitting,
    positions: FloatArray,
    count: int,
    differentials: Differentials,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
) -> FloatArray:
    """(n, 3) positions after so many rounds, adjusted after each; what does not move is as it was."""
    guess = fitting.data.images.triangle
    for _ in range(count):
        system = RoundSystem.at(fitting, positions, differentials(positions), guess)
        guess = system.feet.triangle
        positions = adjust(system.solve(positions))
    return positions


@dataclass(frozen=True, eq=False)
class RoundSystem:
    """The system of one round.

    Attributes
    ----------
    fitting : Fitting
    feet : SurfacePoints
        Closest points of the source to the samples.
    across, along : (s,) float64
        Weights of the distance to the planes there, and of that to the images.
    right : (n, 3) float64
    """

    fitting: Fitting
    feet: SurfacePoints
    across: FloatArray
    along: FloatArray
    right: FloatArray

    @classmethod
    def at(cls, fitting: Fitting, positions: FloatArray, maps: FloatArray, guess: IndexArray) -> RoundSystem:
        """The round from positions (n, 3) and differentials (n, 3, 3), with triangles (s,) that are probably near."""
        data, images = fitting.data, fitting.data.images
        places = data.samples @ positions
        feet = SurfacePoints.nearest(images.surface, places, images.normals, normal_weight=NORMAL_WEIGHT, guess=guess)
        held = data.held | (np.linalg.norm(feet.positions - images.positions, axis=1) > data.reach)
        across = np.where(held, 0.0, data.weights)
        along = np.where(held, 1.0, fitting.config.anchor) * data.weights
        heights = np.einsum("sd,sd->s", feet.normals, feet.positions)
        pulls = (across * heights)[:, None] * feet.normals + along[:, None] * images.positions
        return cls(fitting, feet, across, along, fitting.transposed @ pulls + fitting.elastic_pull(maps))

    def times(self, positions: FloatArray) -> FloatArray:
        """(n, 3) the system's matrix times positions (n, 3)."""
        fitting, normals = self.fitting, self.feet.normals
        places = fitting.data.samples @ positions
        heights = np.einsum("sd,sd->s", normals, places)
        pulls = (self.across * heights)[:, None] * normals + self.along[:, None] * places
        elastic = fitting.config.fairness * (fitting.laplacian @ positions)
        return np.asarray(fitting.transposed @ pulls + elastic)

    def solve(self, positions: FloatArray) -> FloatArray:
        """(n, 3) the solution, over the points that move, from positions (n, 3)."""
        moving, shape = self.fitting.moving, positions.shape
        missing = (self.right - self.times(positions))[moving]

        def times(flat: FloatArray) -> FloatArray:
            spread = np.zeros(shape)
            spread[moving] = flat.reshape(-1, 3)
            return self.times(spread)[moving].ravel()

        def precondition(flat: FloatArray) -> FloatArray:
            return self.fitting.factors.solve(flat.reshape(-1, 3)).ravel()

        size = (3 * len(moving), 3 * len(moving))
        step, _ = linalg.cg(
            linalg.LinearOperator(size, matvec=times, dtype=np.float64),
            missing.ravel(),
            rtol=_ACCURACY,
            maxiter=_STEPS,
            M=linalg.LinearOperator(size, matvec=precondition, dtype=np.float64),
        )
        moved = positions.copy()
        moved[moving] += step.reshape(-1, 3)
        return moved
