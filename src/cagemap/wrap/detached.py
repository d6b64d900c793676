"""Detached pieces of a net without samples, such as eyes or teeth: they follow their surroundings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.fit import similarity
from cagemap.deform.graph import ElasticGraph
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.graphs import components
from cagemap.wrap.config import NetConfig


@dataclass(frozen=True, eq=False)
class DetachedPieces:
    """Connected pieces of a net without a sample; no equation says where they are."""

    graph: ElasticGraph
    points: IndexArray  # (k,) of all pieces, one piece after the other
    ends: IndexArray  # (p,) where each piece ends in ``points``
    attached: IndexArray  # (n - k,) all others

    @classmethod
    def find(cls, graph: ElasticGraph, free: IndexArray) -> DetachedPieces:
        """Those of a graph that consist of free points (k,) alone.

        Raises
        ------
        ParameterError
            If that is all of it.
        """
        points, ends = whole_pieces(graph, free)
        if len(points) == graph.n:
            raise ParameterError("expected a part of the target that follows the source, got weights of 0 everywhere")
        return cls(graph, points, ends, np.setdiff1d(np.arange(graph.n), points))

    def carried(self, positions: FloatArray, config: NetConfig) -> FloatArray:
        """(n, 3) positions with every piece moved by the similarity that the points nearest to it at rest follow."""
        if not len(self.points):
            return positions
        rest = self.graph.positions
        tree, moved = cKDTree(rest[self.attached]), positions.copy()
        for own in np.split(self.points, self.ends[:-1]):
            _, nearest = tree.query(rest[own].mean(axis=0), k=min(config.nearest_points, len(self.attached)))
            near = self.attached[np.atleast_1d(nearest)]
            rotation, scale, shift = similarity(rest[near], positions[near])
            moved[own] = scale * rest[own] @ rotation.T + shift
        return moved


def whole_pieces(graph: ElasticGraph, points: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Connected pieces of a graph that lie in points (k,) as a whole, one after the other, and where each ends."""
    piece = components(graph.heads, graph.tails, graph.n)
    sizes = np.bincount(piece)
    whole = np.bincount(piece[points], minlength=len(sizes)) == sizes
    order = np.argsort(piece, kind="stable")
    return order[whole[piece[order]]], np.cumsum(sizes[whole])
