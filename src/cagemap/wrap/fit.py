"""My topology, that shape: control points whose *refined* surface lies on the source.

The map says where every point of the target's refined surface belongs. With S the refinement from the net's level to
the finest and P the images of the finest vertices, the net starts at the minimum of ``||S X - P||^2`` and is then drawn
onto the source's tangent planes at the closest points, which lets it slide along the surface:

    sum_i w_i ( (n_i . (S X - q)_i)^2 + anchor |(S X - P)_i|^2 ) + fairness E(X)

E is the elastic fit's as-affine-as-possible energy of the net against its rest shape (`maps.elastic.graph`): it keeps
the flow of edge loops, stops faces from crossing, and carries what has no counterpart (w = 0) along.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.geometry.points import SurfacePoints
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph, bounded_maps
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.operators.laplacian import vertex_areas
from cagemap.refinement import level_triangles
from cagemap.wrap.net import ControlNet

# Levels below the net whose vertices the fit looks at: about 16 for every point of the net.
_SAMPLED_BELOW = 2
# ... but no level that has more vertices than this, where the next one has 4 for every point.
_MOST_SAMPLES = 60_000
# Neighbouring differentials are as alike as this, relative to the energy of the edges between them.
_SMOOTHING = 0.01
# A closest point on the other side of a thin part is further away than one with the right normal, by this length.
NORMAL_WEIGHT = 0.03
# A closest point further from the map's image than so many edges of the net belongs to another part.
_REACH = 2.0
# Rounds of the elastic energy alone that carry along what has no counterpart, before the first fit.
_CARRYING_ROUNDS = 30
# Points of the net that samples pull at by less than this share of the largest pull are free.
_FREE = 1e-6


@dataclass(frozen=True)
class WrapConfig:
    """How closely a net follows.

    Attributes
    ----------
    level : int
        Level whose points are fitted; 0 is the control mesh.
    fairness : float
        Weight of the net's energy against squared distances to the source.
    anchor : float
        Weight of the map's own images along the surface, against the distance from it.
    rounds : int
        Times that closest points are looked for.
    """

    level: int = 0
    fairness: float = 1e-4
    anchor: float = 0.01
    rounds: int = 3

    def __post_init__(self) -> None:
        if self.level < 0 or self.rounds < 0:
            raise ParameterError(f"level and rounds: expected 0 or more, got {self.level} and {self.rounds}")
        if not (0 < self.fairness < np.inf and 0 <= self.anchor < np.inf):
            raise ParameterError(f"fairness > 0, anchor >= 0 expected, got {self.fairness} and {self.anchor}")


@dataclass(frozen=True, eq=False)
class FitData:
    """What a net is fitted to, at unit area of the source.

    Attributes
    ----------
    samples : (s, n_l) csr_array
        Rows of S: vertices of the refined surface from the net's points.
    images : SurfacePoints
        Where the map takes them.
    reach : (s,) float64
        How far from its image a sample may slide: the length of the net's edges there.
    weights : (s,) float64
        Their areas times how far they may follow.
    held : (s,) bool
        Samples that stay at their image (boundaries), instead of sliding along the surface.
    """

    samples: sparse.csr_array
    images: SurfacePoints
    reach: FloatArray
    weights: FloatArray
    held: NDArray[np.bool_]


def fit_data(net: ControlNet, images: SurfacePoints, follow: FloatArray, held: NDArray[np.bool_]) -> FitData:
    """Choose the vertices that the fit looks at, and weigh them.

    Parameters
    ----------
    net : ControlNet
    images : SurfacePoints
        Where the map takes the target's finest vertices.
    follow : (n_f,) float64
        1 where a vertex is to follow, 0 where it has no counterpart.
    held : (n_f,) bool
    """
    refinement, graph = net.refinement, net.graph
    seen = min(net.level + 1, refinement.n_levels)
    while seen < min(net.level + _SAMPLED_BELOW, refinement.n_levels):
        if refinement.levels[seen + 1].n_vertices > _MOST_SAMPLES:
            break
        seen += 1
    level = refinement.levels[seen]
    count = level.n_vertices
    rows = sparse.csr_array(refinement.product(refinement.n_levels, net.level)[:count])
    areas = vertex_areas(level.positions, level_triangles(refinement, seen) if level.faces is None else level.faces)
    lengths = np.linalg.norm(graph.edges, axis=1)
    around = np.bincount(graph.heads, lengths, graph.n) / np.maximum(np.bincount(graph.heads, minlength=graph.n), 1)
    return FitData(
        rows,
        images.at(slice(count)),
        _REACH * (rows @ around),
        follow[:count] * areas / areas.sum(),
        held[:count],
    )


def fit_net(
    net: ControlNet,
    data: FitData,
    config: WrapConfig,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
) -> FloatArray:
    """Fit the points of a net.

    Parameters
    ----------
    net : ControlNet
    data : FitData
    config : WrapConfig
    adjust : callable
        Applied to the net after every round, to keep a symmetry.

    Returns
    -------
    (n_l, 3) float64
        At unit area of the source.
    """
    positions = adjust(start(net, data, config))
    unpulled = free_points(data)
    return rounds(net.graph, data, config, positions, config.rounds, unpulled, adjust)


def start(net: ControlNet, data: FitData, config: WrapConfig) -> FloatArray:
    """(n_l, 3) the net that minimises ``||S X - P||^2`` with a trace of its energy.

    Where nothing follows, the energy alone decides; there the differentials have to travel in from the surroundings.
    """
    graph = net.graph
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, _SMOOTHING)
    weighted = data.samples.T @ sparse.diags_array(data.weights)
    factors = factor(sparse.csc_array(weighted @ data.samples + config.fairness * laplacian))
    right = weighted @ data.images.positions
    positions = factors.solve(right)
    free = free_points(data)
    for _ in range(_CARRYING_ROUNDS if len(free) else 1):
        maps = _differentials(field, graph, positions, free)
        positions = factors.solve(right + config.fairness * field.divergence(maps))
    return positions


def free_points(data: FitData) -> IndexArray:
    """(k,) points of the net that no sample pulls at: what has no counterpart."""
    pull = data.samples.T @ data.weights
    most = data.samples.T @ np.full(len(data.weights), data.weights.max())
    return np.flatnonzero(pull <= _FREE * most)


def _differentials(
    field: DifferentialField, graph: ElasticGraph, positions: FloatArray, free: IndexArray
) -> FloatArray:
    """(n, 3, 3) maps A; what is carried along is turned and scaled, and not sheared more and more as it goes on."""
    maps, _ = bounded_maps(field.solve(positions), graph.normals)
    if len(free):
        left, stretches, right = np.linalg.svd(maps[free])
        left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
        maps = maps.copy()
        maps[free] = np.exp(np.log(np.maximum(stretches, 1e-12)).mean(axis=1))[:, None, None] * (left @ right)
    return maps


def rounds(
    graph: ElasticGraph,
    data: FitData,
    config: WrapConfig,
    positions: FloatArray,
    count: int,
    unpulled: IndexArray,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
    moving: IndexArray | None = None,
) -> FloatArray:
    """Alternate closest points and differentials with the net's positions.

    Parameters
    ----------
    graph : ElasticGraph
        Of the net, or of a part of it.
    data : FitData
        What pulls at that.
    config : WrapConfig
    positions : (n, 3) float64
    count : int
    unpulled : (k,) int64
        Points that nothing pulls at.
    adjust : callable
    moving : (m,) int64, optional
        Points that move; by default all.
    """
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, _SMOOTHING)
    system = _NormalSystem.build(data.samples, laplacian)
    guess, factors = data.images, None
    rows = None if moving is None else (moving + graph.n * np.arange(3)[:, None]).ravel()
    for _ in range(count):
        feet = SurfacePoints.nearest(
            data.images.surface,
            data.samples @ positions,
            data.images.normals,
            normal_weight=NORMAL_WEIGHT,
            guess=guess.triangle,
        )
        guess, normals = feet, feet.normals
        across = normals[:, :, None] * normals[:, None, :]
        held = data.held | (np.linalg.norm(feet.positions - data.images.positions, axis=1) > data.reach)
        across[held] = 0.0
        along = data.weights * np.where(held, 1.0, config.anchor)
        tensors = data.weights[:, None, None] * across
        matrix = system.matrix(tensors + along[:, None, None] * np.eye(3), config.fairness)
        pulls = np.einsum("sab,sb->sa", tensors, feet.positions) + along[:, None] * data.images.positions
        maps = _differentials(field, graph, positions, unpulled)
        right = (data.samples.T @ pulls + config.fairness * field.divergence(maps)).T.ravel()
        solution = positions.T.ravel()
        if rows is None:
            factors = factor(matrix, like=factors)
            solution = factors.solve(right)
        else:
            solution = solution.copy()
            solution[rows] = 0.0
            factors = factor(sparse.csc_array(matrix[rows][:, rows]), like=factors)
            solution[rows] = factors.solve((right - matrix @ solution)[rows])
        positions = adjust(solution.reshape(3, -1).T)
    return positions


@dataclass(frozen=True, eq=False)
class _NormalSystem:
    """(3 n, 3 n) matrices ``S^T (tensors) S + fairness L``, coordinate by coordinate, with one pattern for all rounds.

    Attributes
    ----------
    samples, transposed : (s, n), (n, s) csr_array
    pattern : (n, n) csr_array
        Of S^T S and L together; its values are not read.
    keys : (nnz,) int64
        Of its entries.
    elastic : (nnz,) float64
        L in it.
    """

    samples: sparse.csr_array
    transposed: sparse.csr_array
    pattern: sparse.csr_array
    keys: IndexArray
    elastic: FloatArray

    @classmethod
    def build(cls, samples: sparse.csr_array, laplacian: sparse.csr_array) -> _NormalSystem:
        transposed = sparse.csr_array(samples.T)
        pattern = sparse.csr_array(abs(transposed) @ abs(samples) + abs(laplacian))
        pattern.sort_indices()
        keys = _keys(pattern)
        elastic = np.zeros(pattern.nnz)
        elastic[np.searchsorted(keys, _keys(laplacian))] = laplacian.data
        return cls(samples, transposed, pattern, keys, elastic)

    def matrix(self, tensors: FloatArray, fairness: float) -> sparse.csc_array:
        """The matrix for tensors (s, 3, 3)."""

        def block(a: int, b: int) -> sparse.csr_array:
            product = sparse.csr_array(self.transposed @ (sparse.diags_array(tensors[:, a, b]) @ self.samples))
            values = fairness * self.elastic if a == b else np.zeros(self.pattern.nnz)
            # SciPy leaves zeros out of its products: these have fewer entries than the pattern.
            values[np.searchsorted(self.keys, _keys(product))] += product.data
            return sparse.csr_array((values, self.pattern.indices, self.pattern.indptr), shape=self.pattern.shape)

        upper = {(a, b): block(a, b) for a in range(3) for b in range(a, 3)}
        blocks = [[upper[min(a, b), max(a, b)] for b in range(3)] for a in range(3)]
        return sparse.csc_array(sparse.block_array(blocks))


def _keys(matrix: sparse.csr_array) -> IndexArray:
    """(nnz,) a number for the place of every entry, ascending where the indices are sorted."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return rows * matrix.shape[1] + matrix.indices
