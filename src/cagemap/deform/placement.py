"""A placement of the target on the source: positions, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cagemap.deform.config import GraphConfig
from cagemap.deform.graph import ElasticGraph, extrapolate
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the vertices of a graph, or of the target's mesh, are placed on the source."""

    positions: FloatArray  #: (n, 3) near the source, at unit area
    cost: float = 0.0  #: sum of `costs`; 0 where it was not asked for
    #: (n,) squared distances both ways and elastic energy by vertex; empty where they were not asked for
    costs: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    name: str = ""  #: the start in words, such as "turned 180 degrees about y"
    doubt: float = 1.0  #: factor on the cost when placements are ranked: above 1 where the files' axes are turned
    #: (n, 3, 3) differentials; empty where nothing is extrapolated from it
    maps: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)), repr=False)
    graph: ElasticGraph | None = field(default=None, repr=False)  #: whose clusters these are
    #: (n, 3) positions after `refit.finished`; placements are compared by ``positions``
    final: FloatArray | None = field(default=None, repr=False)
    #: Places of landmarks whose target points belong to the source points of others, in this placement
    exchange: tuple[tuple[int, int], ...] = ()

    @property
    def answer(self) -> FloatArray:
        """(n, 3) what the map is made of."""
        return self.positions if self.final is None else self.final

    @property
    def rank(self) -> float:
        """Cost times doubt."""
        return self.doubt * self.cost

    def on(self, graph: ElasticGraph, config: GraphConfig) -> FloatArray:
        """(n, 3) where it takes the vertices of another graph of the same shape."""
        assert self.graph is not None
        return extrapolate(self.graph, self.positions, self.maps, graph, config)


def distinct_placements(ranked: Sequence[Placement], areas: FloatArray, least: float) -> list[Placement]:
    """Placements that are at a mean distance of at least ``least`` from every better one."""
    kept: list[Placement] = []
    for one in ranked:
        if all(mean_distance(one.positions, better.positions, areas) >= least for better in kept):
            kept.append(one)
    return kept


def mean_distance(first: FloatArray, second: FloatArray, areas: FloatArray) -> float:
    """Mean distance of two placements (n, 3) of the same vertices with areas (n,) of sum 1."""
    return float(areas @ np.linalg.norm(first - second, axis=1))
