"""Fit a control net: control points whose *refined* surface lies on the source; then mend faces that fold or are thin.

The map gives the image P of every point of the target's refined surface. The net starts at the minimum of
``||S X - P||^2``. It is then fitted to the source's tangent planes at closest points (`cagemap.wrap.net`), so that it
can slide along the surface. The as-affine-as-possible energy of the net keeps the flow of edge loops, prevents crossing
faces, and places parts without a counterpart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.deform.config import GraphConfig, Stage
from cagemap.deform.energy import Admissible, Differentials, ElasticEnergy, bounded_maps, minimise
from cagemap.deform.graph import ElasticGraph
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components, mask_of, members_of, nearest_rotations
from cagemap.numerics.sparse_algebra import factor
from cagemap.surface.alignment import fit_similarity
from cagemap.wrap.net import ControlNet, MendConfig, NetTerms, Samples, WrapConfig, face_aspects, folded_faces

# Messages for a net without a point that follows the source: from the beginning, and after mending.
NOTHING_FOLLOWS = (
    "weights: expected a part of the target that follows the source, got 0 everywhere. Give weights above 0."
)
ALL_RELEASED = (
    "wrap: expected a net that folds in few places, got folds at all of its points, so that none follows the source. "
    "Look at the map: it may fold there, or lead to another mesh."
)

Adjust = Callable[[FloatArray], FloatArray]


def keep_positions(positions: FloatArray) -> FloatArray:
    """The positions unchanged: there is no symmetry to keep."""
    return positions


def fit_net(net: ControlNet, samples: Samples, config: WrapConfig, adjust: Adjust = keep_positions) -> FloatArray:
    """(n_l, 3) fitted points of a net, at unit area of the source; ``adjust`` keeps a symmetry."""
    free = free_points(samples, config)
    pieces = detached_pieces(net.graph, free)
    detached = np.concatenate([free[:0], *pieces])
    attached = np.setdiff1d(np.arange(net.graph.n), detached)
    terms = NetTerms.build(net.graph, samples, config, attached if pieces else None)
    energy = replace(net.energy, admissible=similar_at(free, config.graph))
    positions = terms.start(energy)
    moving, stiffness = np.setdiff1d(free, detached), np.ones(net.graph.n)
    positions = move_locally(
        net, samples, config, positions, moving, rounds=config.carrying_rounds, similar=free, stiffness=stiffness
    )
    positions = adjust(carry_detached_pieces(net.graph, pieces, positions, config))
    positions = run_rounds(net.graph, energy.differentials, terms, positions, config.rounds, adjust)
    return adjust(carry_detached_pieces(net.graph, pieces, positions, config)) if pieces else positions


def free_points(samples: Samples, config: WrapConfig) -> IndexArray:
    """(k,) points of the net without sample weight: they have no counterpart."""
    weights = samples.rows.T @ samples.weights
    most = samples.rows.T @ np.full(len(samples.weights), samples.weights.max())
    return np.flatnonzero(weights <= config.min_weight * most)


def whole_pieces(graph: ElasticGraph, points: IndexArray) -> list[IndexArray]:
    """Connected pieces of a graph whose vertices are all in points (k,)."""
    inside = mask_of(points, graph.n)
    pieces = members_of(label_components(graph.heads, graph.tails, graph.n))
    return [piece for piece in pieces if inside[piece].all()]


def detached_pieces(graph: ElasticGraph, free: IndexArray, fault: str = NOTHING_FOLLOWS) -> list[IndexArray]:
    """Connected pieces of free points (k,) only, such as eyes; ParameterError ``fault`` without other points."""
    pieces = whole_pieces(graph, free)
    if sum(map(len, pieces)) == graph.n:
        raise ParameterError(fault)
    return pieces


def carry_detached_pieces(
    graph: ElasticGraph, pieces: Sequence[IndexArray], positions: FloatArray, config: WrapConfig
) -> FloatArray:
    """(n, 3) positions with every detached piece moved by the similarity of its nearest points."""
    if not pieces:
        return positions
    rest = graph.positions
    attached = np.setdiff1d(np.arange(graph.n), np.concatenate(pieces))
    tree, moved = cKDTree(rest[attached]), positions.copy()
    for piece in pieces:
        _, nearest = tree.query(rest[piece].mean(axis=0), k=min(config.nearest_points, len(attached)))
        near = attached[np.atleast_1d(nearest)]
        rotation, scale, shift = fit_similarity(rest[near], positions[near])
        moved[piece] = scale * rest[piece] @ rotation.T + shift
    return moved


def run_rounds(
    graph: ElasticGraph,
    differentials: Callable[[FloatArray], Differentials],
    terms: NetTerms,
    positions: FloatArray,
    count: int,
    adjust: Adjust = keep_positions,
) -> FloatArray:
    """(n, 3) positions after ``count`` rounds, adjusted after each; points that do not move are unchanged."""
    if not count:
        return positions
    config = terms.config
    stage = Stage(count, (config.fairness, config.fairness), config.smoothing)
    return minimise(graph, differentials, terms.at, positions, stage, adjust)


def similar_at(points: IndexArray, config: GraphConfig) -> Admissible:
    """Restriction of differentials: bounded, and similarities (rotation and scale) at points (k,)."""

    def admissible(maps: FloatArray, normals: FloatArray) -> tuple[FloatArray, IndexArray]:
        maps, bounded = bounded_maps(maps, normals, config)
        if len(points):
            maps, near = maps.copy(), maps[points]
            size = np.cbrt(np.abs(np.linalg.det(near)))
            maps[points] = size[:, None, None] * nearest_rotations(near)
        return maps, bounded

    return admissible


def move_locally(
    net: ControlNet,
    samples: Samples,
    config: WrapConfig,
    positions: FloatArray,
    moving: IndexArray,
    *,
    rounds: int,
    similar: IndexArray,
    stiffness: FloatArray,
    fixed: bool = False,
) -> FloatArray:
    """(n, 3) net after rounds that move few points (m,); similarities at ``similar``; constant maps if ``fixed``."""
    if not len(moving):
        return positions
    part = net.graph.rings(moving, config.energy_rings)
    graph = net.graph.part(part, stiffness)
    moves = np.zeros(net.graph.n)
    moves[moving] = 1.0
    seen = np.flatnonzero((samples.rows @ moves > 0) & (samples.weights > 0))
    terms = NetTerms.build(graph, samples.of_part(seen, part), config, np.searchsorted(part, moving))
    admissible = similar_at(np.searchsorted(part, np.intersect1d(part, similar)), config.graph)
    if fixed:
        maps = admissible(net.energy.maps(positions)[part], graph.normals)
        changed = run_rounds(graph, lambda _: maps, terms, positions[part], rounds)
    else:
        energy = ElasticEnergy(graph, config.smoothing, admissible)
        changed = run_rounds(graph, energy.differentials, terms, positions[part], rounds)
    moved = positions.copy()
    moved[part] = changed
    return moved


def mend(
    net: ControlNet, samples: Samples, config: WrapConfig, positions: FloatArray, adjust: Adjust = keep_positions
) -> FloatArray:
    """(n_l, 3) net after bad faces, folded or much thinner than at rest, were stiffened, released or flattened."""
    if not config.rounds:
        return positions
    graph, numbers = net.graph, config.mending
    stiffness, released = np.ones(graph.n), np.zeros(graph.n)
    small = graph.areas + np.bincount(graph.heads, graph.areas[graph.tails], graph.n) < numbers.small
    free = free_points(samples, config)
    detached = np.concatenate([free[:0], *detached_pieces(graph, free)])
    folded_at_rest, aspects = folded_faces(net, graph.positions), face_aspects(net.mesh, graph.positions)
    is_small = np.logical_and.reduceat(small[net.mesh.face_indices], net.mesh.face_offsets[:-1])
    least = np.where(is_small, numbers.small_thin, numbers.thin) * np.maximum(aspects, np.percentile(aspects, 99))
    many = graph.n > numbers.many
    rings = numbers.many_rings if many else numbers.rings
    for mending in range(numbers.rounds):
        folded = _corners(net, folded_faces(net, positions) & ~folded_at_rest)
        folded = folded[small[folded] | (stiffness[folded] < numbers.max_fold)]
        thin = _corners(net, face_aspects(net.mesh, positions) > least)
        thin = thin[stiffness[thin] < np.where(small[thin], numbers.small_max_thin, numbers.max_thin)]
        corners = np.setdiff1d(np.union1d(folded, thin), detached)
        if mending >= numbers.small_rounds:
            folded, corners = folded[~small[folded]], corners[~small[corners]]
        if not len(corners):
            break
        stiffness[corners] = np.minimum(numbers.stiffening * stiffness[corners], numbers.max_fold)
        lost = folded[small[folded] & (stiffness[folded] > numbers.max_small_fold)]
        if len(lost):
            released[graph.rings(lost, numbers.release_rings)] = 1.0
            weights = np.where(samples.rows @ released > numbers.share, 0.0, samples.weights)
            samples = replace(samples, weights=weights)
            pieces = detached_pieces(graph, free_points(samples, config), ALL_RELEASED)
            if sum(map(len, pieces)) > len(detached):
                positions, detached = (
                    adjust(carry_detached_pieces(graph, pieces, positions, config)),
                    np.concatenate(pieces),
                )
        similar = np.union1d(free_points(samples, config), np.flatnonzero(released))
        moved = partial(move_locally, net, samples, config, similar=similar, stiffness=stiffness, fixed=many)
        moving = np.setdiff1d(graph.rings(corners, rings), detached)
        still_folded = folded[~small[folded] & (stiffness[folded] > numbers.stiffening)]
        flat = _lay_flat(graph, positions, np.intersect1d(still_folded, moving))
        positions = moved(flat, moving, rounds=1)
        near = np.intersect1d(moving, graph.rings(lost, rings + numbers.release_rings))
        # Control points released from the constraint move further, which takes more rounds.
        positions = adjust(moved(positions, near, rounds=numbers.release_rounds))
    return _flatten_last_folds(net, positions, folded_at_rest, detached, adjust, numbers)


def _flatten_last_folds(
    net: ControlNet,
    positions: FloatArray,
    folded_at_rest: NDArray[np.bool_],
    detached: IndexArray,
    adjust: Adjust,
    config: MendConfig,
) -> FloatArray:
    """(n, 3) net with the fewest folds, after flattening the last folded faces if they are small."""
    graph, best, fewest = net.graph, positions, net.mesh.n_faces + 1
    flat = detached[:0]
    for flattening in range(config.flattenings + 1):
        folded = folded_faces(net, positions) & ~folded_at_rest
        if (count := int(np.count_nonzero(folded))) < fewest:
            best, fewest = positions, count
        corners = graph.rings(_corners(net, folded), min(flattening, 1))
        flat = np.setdiff1d(np.union1d(flat, corners), detached)
        if not count or graph.areas[flat].sum() > config.max_flat:
            break
        positions = adjust(_lay_flat(graph, positions, flat))
    return best


def _lay_flat(graph: ElasticGraph, positions: FloatArray, flat: IndexArray) -> FloatArray:
    """(n, 3) net with points (m,) at the means of their neighbours: unfolds a patch (Tutte 1963)."""
    flat = np.setdiff1d(flat, np.concatenate([flat[:0], *whole_pieces(graph, flat)]))
    if not len(flat):
        return positions
    around = np.setdiff1d(graph.rings(flat, 1), flat)
    rows = replace(graph, weights=np.ones(len(graph.heads))).laplacian[flat]
    moved = positions.copy()
    moved[flat] = factor(sparse.csc_array(rows[:, flat])).solve(-(rows[:, around] @ positions[around]))
    return moved


def _corners(net: ControlNet, faces: NDArray[np.bool_]) -> IndexArray:
    """(k,) points of some faces (m,)."""
    return np.unique(net.mesh.face_indices[faces[net.mesh.corner_faces]])
