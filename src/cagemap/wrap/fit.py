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
from dataclasses import dataclass, replace

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
from cagemap.wrap.net import ControlNet, folded_faces

# Levels below the net whose vertices the fit looks at: about 16 for every point of the net.
_SAMPLED_BELOW = 2
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
# Where faces fold, the net is made this much stiffer, so many times at most.
_STIFFENING, _MENDINGS = 10.0, 8


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
    rounds: int = 4

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
    seen = min(net.level + _SAMPLED_BELOW, refinement.n_levels)
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
    before = folded_faces(net, net.graph.positions)
    stiffness = np.ones(net.graph.n)
    positions = start(net, data, config)
    positions = _rounds(net, data, config, stiffness, adjust(positions), config.rounds, adjust)
    for _ in range(_MENDINGS):
        folded = folded_faces(net, positions) & ~before
        if not folded.any() or config.rounds == 0:
            break
        stiffness[np.unique(net.mesh.face_indices[folded[net.mesh.corner_faces]])] *= _STIFFENING
        positions = _rounds(net, data, config, stiffness, positions, 1, adjust)
    return positions


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


def _rounds(
    net: ControlNet,
    data: FitData,
    config: WrapConfig,
    stiffness: FloatArray,
    positions: FloatArray,
    count: int,
    adjust: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Alternate closest points and differentials with the net's positions."""
    graph = net.graph
    stiff = replace(graph, weights=graph.weights * np.sqrt(stiffness[graph.heads] * stiffness[graph.tails]))
    laplacian = stiff.laplacian()
    field = DifferentialField.build(stiff, laplacian, _SMOOTHING)
    energy = config.fairness * sparse.block_diag([laplacian] * 3)
    guess, free = data.images, free_points(data)
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
        matrix = sparse.csc_array(_normal_matrix(data.samples, tensors, along) + energy)
        pulls = np.einsum("sab,sb->sa", tensors, feet.positions) + along[:, None] * data.images.positions
        maps = _differentials(field, graph, positions, free)
        right = data.samples.T @ pulls + config.fairness * field.divergence(maps)
        positions = adjust(factor(matrix).solve(right.T.ravel()).reshape(3, -1).T)
    return positions


def _normal_matrix(samples: sparse.csr_array, tensors: FloatArray, weights: FloatArray) -> sparse.csc_array:
    """(3 n, 3 n) ``S^T (tensors + weights I) S``, coordinate by coordinate."""
    transposed = sparse.csr_array(samples.T)

    def block(a: int, b: int) -> sparse.csr_array:
        values = tensors[:, a, b] + (weights if a == b else 0.0)
        return sparse.csr_array(transposed @ (sparse.diags_array(values) @ samples))

    upper = {(a, b): block(a, b) for a in range(3) for b in range(a, 3)}
    return sparse.csc_array(sparse.block_array([[upper[min(a, b), max(a, b)] for b in range(3)] for a in range(3)]))
