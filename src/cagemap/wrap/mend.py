"""Faces that fold or grow thin are mended where they are: the net is made stiffer there and fitted anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.elastic.graph import ElasticGraph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.wrap.fit import FitData, WrapConfig, free_points, rounds
from cagemap.wrap.net import ControlNet, face_aspects, folded_faces

# Each time the net is made this much stiffer at the corners of such faces, so often at most.
_STIFFENING, _MENDINGS, _ROUNDS = 10.0, 8, 2
# Around thin faces it becomes less than this, and ten times that at most: they cost distance to the source.
_STIFFEST_THIN = 99.0
# Rings of points around them that move; points that the samples in reach of these depend on lie in three more.
_MOVING, _AROUND = 4, 3
# A face is thin beyond so many times the 99th percentile of all faces at rest, where it has grown by as much.
_THIN = 1.5


def mend(
    net: ControlNet,
    data: FitData,
    config: WrapConfig,
    positions: FloatArray,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
) -> FloatArray:
    """(n, 3) a fitted net whose faces do not fold and are not much thinner than at rest, as far as that can be had.

    Parameters
    ----------
    net : ControlNet
    data : FitData
    config : WrapConfig
    positions : (n, 3) float64
        Fitted.
    adjust : callable
        Applied to the net after every change, to keep a symmetry.
    """
    stiffness, unpulled = np.ones(net.graph.n), free_points(data)
    rest = net.graph.positions
    folded_at_rest, aspects = folded_faces(net, rest), face_aspects(net.mesh, rest)
    least = _THIN * np.maximum(aspects, np.percentile(aspects, 99))
    for _ in range(_MENDINGS if config.rounds else 0):
        folded = folded_faces(net, positions) & ~folded_at_rest
        thin = _corners(net, face_aspects(net.mesh, positions) > least)
        corners = np.union1d(_corners(net, folded), thin[stiffness[thin] < _STIFFEST_THIN])
        if not len(corners):
            break
        stiffness[corners] *= _STIFFENING
        moving = _grown(net.graph, corners, _MOVING)
        part = _grown(net.graph, moving, _AROUND)
        graph, pulls = _part_of(net.graph, stiffness, data, moving, part)
        inside = np.searchsorted(part, np.intersect1d(part, unpulled))
        moved = rounds(graph, pulls, config, positions[part], _ROUNDS, inside, moving=np.searchsorted(part, moving))
        positions = positions.copy()
        positions[part] = moved
        positions = adjust(positions)
    return positions


def _corners(net: ControlNet, faces: NDArray[np.bool_]) -> IndexArray:
    """(k,) points of some faces (m,)."""
    return np.unique(net.mesh.face_indices[faces[net.mesh.corner_faces]])


def _grown(graph: ElasticGraph, points: IndexArray, rings: int) -> IndexArray:
    """(k,) points and those up to so many edges away, ascending."""
    inside = np.zeros(graph.n, dtype=np.bool_)
    inside[points] = True
    for _ in range(rings):
        inside[graph.heads[inside[graph.tails]]] = True
    return np.flatnonzero(inside)


def _part_of(
    graph: ElasticGraph, stiffness: FloatArray, data: FitData, moving: IndexArray, part: IndexArray
) -> tuple[ElasticGraph, FitData]:
    """The net's graph on a part of its points, with its stiffness, and the samples that moving points are seen in."""
    number = np.full(graph.n, -1, dtype=np.int64)
    number[part] = np.arange(len(part))
    edges = (number[graph.heads] >= 0) & (number[graph.tails] >= 0)
    heads, tails = graph.heads[edges], graph.tails[edges]
    weights = graph.weights[edges] * np.sqrt(stiffness[heads] * stiffness[tails])
    own = ElasticGraph(
        graph.positions[part], graph.normals[part], graph.areas[part], number[heads], number[tails], weights
    )
    moves = np.zeros(graph.n)
    moves[moving] = 1.0
    seen = np.flatnonzero(data.samples @ moves > 0)
    pulls = replace(
        data,
        samples=data.samples[seen][:, part],
        images=data.images.at(seen),
        reach=data.reach[seen],
        weights=data.weights[seen],
        held=data.held[seen],
    )
    return own, pulls
