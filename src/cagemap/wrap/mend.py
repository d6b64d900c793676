"""The net as a whole, then in parts: what has no counterpart is carried along, faces that fold are mended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.wrap.fit import FitData, WrapConfig
from cagemap.wrap.lone import LonePieces, whole_pieces
from cagemap.wrap.net import SMOOTHING, ControlNet, face_aspects, folded_faces
from cagemap.wrap.rounds import Differentials, Fitting, rounds, start

# Rounds of the elastic energy alone that carry along what has no counterpart, before the first fit.
_CARRYING_ROUNDS = 30
# Points of the net that samples pull at by less than this share of the largest pull are free.
_FREE = 1e-6
# Each time the net is made this much stiffer at the corners of bad faces, so often at most, and where they are small.
_STIFFENING, _MENDINGS, _MENDINGS_SMALL = 10.0, 20, 6
# Around thin faces it becomes less than this, and ten times that at most: they cost distance to the source. Small ones
# cost less of it.
_STIFFEST_THIN, _STIFFEST_THIN_SMALL = 99.0, 999.0
# What still folds at this stiffness has no room on the source: it is carried along, with the samples that depend on it
# by more than this share.
_STIFFEST, _SHARE = 1e3, 0.05
# Only small parts are: a point whose ring has less than this share of the area. Of a coarse cage it would be a limb.
_SMALL = 0.0005
# What folds elsewhere is laid flat before it is fitted again, and stays as it is once it is as stiff as this.
_STIFFEST_FOLD = 1e8
_RELEASED_ROUNDS, _RELEASED_RINGS = 5, 1
# What folds in the end stays flat, with a ring of points more each time, so often and up to this share of the area.
_LAYINGS, _FLAT_AREA = 8, 0.01
# Rings of points around them that move; points that the samples in reach of these depend on lie in three more.
_MOVING, _AROUND = 2, 3
# A net of more points than this has bad faces by the thousand, all of them small: its surroundings draw them back into
# shape, and fewer rings will do.
_MANY, _MOVING_MANY = 10_000, 1
# A face is thin beyond so many times the 99th percentile of all faces at rest, where it has grown by as much; where all
# of its corners are small, there are many of them, and less will do.
_THIN, _THIN_SMALL = 1.5, 1.35

Adjust = Callable[[FloatArray], FloatArray]


def fit_net(
    net: ControlNet, data: FitData, config: WrapConfig, adjust: Adjust = lambda positions: positions
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
    graph, free = net.graph, free_points(data)
    lone = LonePieces.find(graph, free)
    fitting = Fitting.build(graph, data, config, free, lone.attached if len(lone.points) else None)
    positions = start(fitting, net.field.solve)
    loose = np.setdiff1d(free, lone.points)
    positions = LocalFit(net, data, config, free, np.ones(graph.n)).moved(positions, loose, _CARRYING_ROUNDS)
    positions = rounds(fitting, adjust(lone.carried(positions)), config.rounds, net.field.solve, adjust)
    return adjust(lone.carried(positions)) if len(lone.points) else positions


def mend(
    net: ControlNet,
    data: FitData,
    config: WrapConfig,
    positions: FloatArray,
    adjust: Adjust = lambda positions: positions,
) -> FloatArray:
    """(n_l, 3) a fitted net whose faces do not fold and are not much thinner than at rest, as far as that can be had.

    Parameters
    ----------
    net, data, config, adjust
        As `fit_net` takes them.
    positions : (n_l, 3) float64
        Fitted.
    """
    graph = net.graph
    stiffness, released = np.ones(graph.n), np.zeros(graph.n)
    small = graph.areas + np.bincount(graph.heads, graph.areas[graph.tails], graph.n) < _SMALL
    lone = LonePieces.find(graph, free_points(data)).points
    folded_at_rest, aspects = folded_faces(net, graph.positions), face_aspects(net.mesh, graph.positions)
    is_small = np.logical_and.reduceat(small[net.mesh.face_indices], net.mesh.face_offsets[:-1])
    least = np.where(is_small, _THIN_SMALL, _THIN) * np.maximum(aspects, np.percentile(aspects, 99))
    if not config.rounds:
        return positions
    many = graph.n > _MANY
    field = net.field if many else None
    rings = _MOVING_MANY if many else _MOVING
    for mending in range(_MENDINGS):
        folded = _corners(net, folded_faces(net, positions) & ~folded_at_rest)
        folded = folded[small[folded] | (stiffness[folded] < _STIFFEST_FOLD)]
        thin = _corners(net, face_aspects(net.mesh, positions) > least)
        thin = thin[stiffness[thin] < np.where(small[thin], _STIFFEST_THIN_SMALL, _STIFFEST_THIN)]
        corners = np.setdiff1d(np.union1d(folded, thin), lone)
        if mending >= _MENDINGS_SMALL:
            folded, corners = folded[~small[folded]], corners[~small[corners]]
        if not len(corners):
            break
        stiffness[corners] = np.minimum(_STIFFENING * stiffness[corners], _STIFFEST_FOLD)
        lost = folded[small[folded] & (stiffness[folded] > _STIFFEST)]
        if len(lost):
            released[_grown(graph, lost, _RELEASED_RINGS)] = 1.0
            data = replace(data, weights=np.where(data.samples @ released > _SHARE, 0.0, data.weights))
            pieces = LonePieces.find(graph, free_points(data))
            if len(pieces.points) > len(lone):
                positions, lone = adjust(pieces.carried(positions)), pieces.points
        part = LocalFit(net, data, config, np.union1d(free_points(data), np.flatnonzero(released)), stiffness)
        moving = np.setdiff1d(_grown(graph, corners, rings), lone)
        again = folded[~small[folded] & (stiffness[folded] > _STIFFENING)]
        positions = part.moved(_laid_flat(graph, positions, np.intersect1d(again, moving)), moving, 1, field)
        near = np.intersect1d(moving, _grown(graph, lost, rings + _RELEASED_RINGS))
        # What is carried along has further to go.
        positions = adjust(part.moved(positions, near, _RELEASED_ROUNDS, field))
    return _without_folds(net, positions, folded_at_rest, lone, adjust)


def _without_folds(
    net: ControlNet, positions: FloatArray, folded_at_rest: NDArray[np.bool_], lone: IndexArray, adjust: Adjust
) -> FloatArray:
    """(n, 3) the net with the last faces that fold laid flat, where they are small; the one with the fewest folds."""
    graph, best, fewest = net.graph, positions, net.mesh.n_faces + 1
    flat = lone[:0]
    for laying in range(_LAYINGS + 1):
        folded = folded_faces(net, positions) & ~folded_at_rest
        if (count := int(np.count_nonzero(folded))) < fewest:
            best, fewest = positions, count
        corners = _grown(graph, _corners(net, folded), min(laying, 1))
        flat = np.setdiff1d(np.union1d(flat, corners), lone)
        if not count or graph.areas[flat].sum() > _FLAT_AREA:
            break
        positions = adjust(_laid_flat(graph, positions, flat))
    return best


def _laid_flat(graph: ElasticGraph, positions: FloatArray, flat: IndexArray) -> FloatArray:
    """(n, 3) a net in which some points (m,) are the means of their neighbours; pieces of nothing else stay.

    Tutte's placement: in a plane, inside a convex border, no face of a patch folds whose points are such means.
    """
    flat = flat[~np.isin(flat, whole_pieces(graph, flat)[0])]
    if not len(flat):
        return positions
    around = np.setdiff1d(_grown(graph, flat, 1), flat)
    rows = replace(graph, weights=np.ones(len(graph.heads))).laplacian()[flat]
    moved = positions.copy()
    moved[flat] = factor(sparse.csc_array(rows[:, flat])).solve(-(rows[:, around] @ positions[around]))
    return moved


def free_points(data: FitData) -> IndexArray:
    """(k,) points of the net that no sample pulls at: what has no counterpart."""
    pull = data.samples.T @ data.weights
    most = data.samples.T @ np.full(len(data.weights), data.weights.max())
    return np.flatnonzero(pull <= _FREE * most)


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


@dataclass(frozen=True, eq=False)
class LocalFit:
    """What moves parts of a net on their own.

    Attributes
    ----------
    net, data, config
        As `fit_net` takes them.
    similar : (k,) int64
        Points whose differential is a similarity.
    stiffness : (n,) float64
    """

    net: ControlNet
    data: FitData
    config: WrapConfig
    similar: IndexArray
    stiffness: FloatArray

    def moved(
        self, positions: FloatArray, moving: IndexArray, count: int, field: DifferentialField | None = None
    ) -> FloatArray:
        """(n, 3) the net after some rounds in which few points (m,) move.

        Their differentials are those of a part around them, as stiff as it is and anew in every round; or, given the
        field of the whole net, what that says of the positions before, which costs no factorisation.
        """
        if not len(moving):
            return positions
        part = _grown(self.net.graph, moving, _AROUND)
        graph, pulls = _part_of(self.net.graph, self.stiffness, self.data, moving, part)
        inside = np.searchsorted(part, np.intersect1d(part, self.similar))
        fitting = Fitting.build(graph, pulls, self.config, inside, np.searchsorted(part, moving))
        if field is None:
            own = DifferentialField.build(graph, fitting.laplacian, SMOOTHING)
            differentials: Differentials = own.solve
        else:
            differentials = partial(_these, field.solve(positions)[part])
        moved = positions.copy()
        moved[part] = rounds(fitting, positions[part], count, differentials)
        return moved


def _these(maps: FloatArray, positions: FloatArray) -> FloatArray:
    """(n, 3, 3) differentials that stay as they are, wherever the net goes."""
    return maps


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
    seen = np.flatnonzero((data.samples @ moves > 0) & (data.weights > 0))
    pulls = replace(
        data,
        samples=data.samples[seen][:, part],
        images=data.images.at(seen),
        reach=data.reach[seen],
        weights=data.weights[seen],
        held=data.held[seen],
    )
    return own, pulls
