"""Fit a control net: control points whose *refined* surface lies on the source.

The map says where every point of the target's refined surface belongs. The net starts at the minimum of
``||S X - P||^2`` and is then drawn onto the source's tangent planes at the closest points (`cagemap.wrap.terms`), which
lets it slide along the surface. The as-affine-as-possible energy of the net keeps the flow of edge loops, stops faces
from crossing, and carries what has no counterpart along.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.config import Stage
from cagemap.deform.energy import Admissible, ElasticEnergy, bounded_maps
from cagemap.deform.fit import fit_similarity
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.minimise import Energy, minimise
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components, nearest_rotations
from cagemap.wrap.config import NetConfig, WrapConfig
from cagemap.wrap.net import ControlNet
from cagemap.wrap.terms import NetTerms, Samples

Adjust = Callable[[FloatArray], FloatArray]


def keep_positions(positions: FloatArray) -> FloatArray:
    """No symmetry to keep."""
    return positions


def fit_net(net: ControlNet, samples: Samples, config: WrapConfig, adjust: Adjust = keep_positions) -> FloatArray:
    """(n_l, 3) fitted points of a net, at unit area of the source; ``adjust`` keeps a symmetry after every round."""
    free = free_points(samples, config)
    pieces = detached_pieces(net.graph, free)
    detached = np.concatenate([free[:0], *pieces])
    attached = np.setdiff1d(np.arange(net.graph.n), detached)
    terms = NetTerms.build(net.graph, samples, config, attached if pieces else None)
    energy = replace(net.energy, admissible=similar_at(free))
    positions = terms.start(energy)
    moving = np.setdiff1d(free, detached)
    positions = moved_locally(
        net, samples, config, free, np.ones(net.graph.n), positions, moving, config.net.carrying_rounds
    )
    positions = adjust(carry_detached_pieces(net.graph, pieces, positions, config.net))
    positions = run_rounds(energy, terms, positions, config.rounds, adjust)
    return adjust(carry_detached_pieces(net.graph, pieces, positions, config.net)) if pieces else positions


def free_points(samples: Samples, config: WrapConfig) -> IndexArray:
    """(k,) points of the net that no sample acts on: what has no counterpart."""
    own = samples.rows.T @ samples.weights
    most = samples.rows.T @ np.full(len(samples.weights), samples.weights.max())
    return np.flatnonzero(own <= config.net.min_weight * most)


def whole_pieces(graph: ElasticGraph, points: IndexArray) -> list[IndexArray]:
    """Connected pieces of a graph that lie in points (k,) as a whole."""
    piece = label_components(graph.heads, graph.tails, graph.n)
    sizes = np.bincount(piece)
    whole = np.bincount(piece[points], minlength=len(sizes)) == sizes
    order = np.argsort(piece, kind="stable")
    return np.split(order[whole[piece[order]]], np.cumsum(sizes[whole]))[:-1]


def detached_pieces(graph: ElasticGraph, free: IndexArray) -> list[IndexArray]:
    """Connected pieces of free points (k,) alone, such as eyes or teeth; that is not all of the graph."""
    pieces = whole_pieces(graph, free)
    if sum(map(len, pieces)) == graph.n:
        raise ParameterError("expected a part of the target that follows the source, got weights of 0 everywhere")
    return pieces


def carry_detached_pieces(
    graph: ElasticGraph, pieces: Sequence[IndexArray], positions: FloatArray, config: NetConfig
) -> FloatArray:
    """(n, 3) positions with every detached piece moved as the points nearest to it at rest: by a similarity."""
    if not pieces:
        return positions
    rest = graph.positions
    attached = np.setdiff1d(np.arange(graph.n), np.concatenate(pieces))
    tree, moved = cKDTree(rest[attached]), positions.copy()
    for own in pieces:
        _, nearest = tree.query(rest[own].mean(axis=0), k=min(config.nearest_points, len(attached)))
        near = attached[np.atleast_1d(nearest)]
        rotation, scale, shift = fit_similarity(rest[near], positions[near])
        moved[own] = scale * rest[own] @ rotation.T + shift
    return moved


def run_rounds(
    energy: Energy, terms: NetTerms, positions: FloatArray, count: int, adjust: Adjust = keep_positions
) -> FloatArray:
    """(n, 3) positions after so many rounds, adjusted after each; what does not move is as it was."""
    if not count:
        return positions
    config = terms.config
    stage = Stage(count, (config.fairness, config.fairness), config.net.smoothing)
    return minimise(energy, terms, positions, stage, adjust)


def similar_at(points: IndexArray) -> Admissible:
    """Bounded differentials; those of some points (k,) are similarities: turned and scaled, and not sheared."""

    def admissible(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
        maps, bounded = bounded_maps(maps, normals)
        if len(points):
            maps, near = maps.copy(), maps[points]
            size = np.cbrt(np.abs(np.linalg.det(near)))
            maps[points] = size[:, None, None] * nearest_rotations(near)
        return maps, bounded

    return admissible


@dataclass(frozen=True, eq=False)
class FixedMaps:
    """An energy whose differentials stay as they are, wherever the net goes: it needs no factorisation."""

    graph: ElasticGraph
    maps: tuple[FloatArray, IndexArray]

    def differentials(self, positions: FloatArray) -> tuple[FloatArray, IndexArray]:
        """(n, 3, 3) the maps, and which of them were bounded."""
        return self.maps


def moved_locally(
    net: ControlNet,
    samples: Samples,
    config: WrapConfig,
    similar: IndexArray,
    stiffness: FloatArray,
    positions: FloatArray,
    moving: IndexArray,
    count: int,
    *,
    fixed: bool = False,
) -> FloatArray:
    """(n, 3) a net after some rounds in which few points (m,) move, with similarities at some points (k,).

    Differentials are those of a part around them, as stiff as it is (n,), or fixed ones, which costs no factorisation.
    """
    if not len(moving):
        return positions
    part = net.graph.rings(moving, config.net.around)
    graph = net.graph.part(part, stiffness)
    moves = np.zeros(net.graph.n)
    moves[moving] = 1.0
    seen = np.flatnonzero((samples.rows @ moves > 0) & (samples.weights > 0))
    terms = NetTerms.build(graph, samples.of_part(seen, part), config, np.searchsorted(part, moving))
    admissible = similar_at(np.searchsorted(part, np.intersect1d(part, similar)))
    energy: Energy
    if fixed:
        energy = FixedMaps(graph, admissible(net.energy.maps(positions)[part], graph.normals))
    else:
        energy = ElasticEnergy.build(graph, config.net.smoothing, admissible)
    moved = positions.copy()
    moved[part] = run_rounds(energy, terms, positions[part], count)
    return moved
