"""Mend faces of a fitted net that fold or grow thin."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.deform.graph import ElasticGraph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.wrap.config import MendConfig, WrapConfig
from cagemap.wrap.fit import (
    Adjust,
    carry_detached_pieces,
    detached_pieces,
    free_points,
    keep_positions,
    moved_locally,
    whole_pieces,
)
from cagemap.wrap.net import ControlNet, Samples, face_aspects, folded_faces


def mend(
    net: ControlNet, samples: Samples, config: WrapConfig, positions: FloatArray, adjust: Adjust = keep_positions
) -> FloatArray:
    """(n_l, 3) fitted net after mending faces that fold or are much thinner than at rest.

    Bad faces become stiffer and are fitted again. Small faces that still fold are released from the source; larger ones
    are flattened before the fit.
    """
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
            pieces = detached_pieces(graph, free_points(samples, config))
            if sum(map(len, pieces)) > len(detached):
                positions, detached = (
                    adjust(carry_detached_pieces(graph, pieces, positions, config.net)),
                    np.concatenate(pieces),
                )
        similar = np.union1d(free_points(samples, config), np.flatnonzero(released))
        moved = partial(moved_locally, net, samples, config, similar=similar, stiffness=stiffness, fixed=many)
        moving = np.setdiff1d(graph.rings(corners, rings), detached)
        still_folded = folded[~small[folded] & (stiffness[folded] > numbers.stiffening)]
        flat = _lay_flat(graph, positions, np.intersect1d(still_folded, moving))
        positions = moved(flat, moving, rounds=1)
        near = np.intersect1d(moving, graph.rings(lost, rings + numbers.release_rings))
        # Released points move further: more rounds.
        positions = adjust(moved(positions, near, rounds=numbers.release_rounds))
    return _without_folds(net, positions, folded_at_rest, detached, adjust, numbers)


def _without_folds(
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
