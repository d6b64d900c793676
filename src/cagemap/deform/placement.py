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
    """Where the vertices of a graph, or of the target's mesh, are placed on the source.

    Attributes
    ----------
    positions : (n, 3) float64
        Near the source, at unit area.
    cost : float
        Sum of `costs`; 0 where it was not asked for.
    costs : (n,) float64
        Squared distances both ways and elastic energy by vertex; empty where they were not asked for.
    name : str
        The start in words, such as "turned 180 degrees about y".
    doubt : float
        Factor on the cost when placements are ranked.
    maps : (n, 3, 3) float64
        Differentials; empty where nothing is extrapolated from it.
    graph : ElasticGraph or None
        Whose clusters these are.
    final : (n, 3) float64 or None
        Positions after the refit in the source's pose and the average with the inverse, if there was one; others
        compare by ``positions``.
    """

    positions: FloatArray
    cost: float = 0.0
    costs: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    name: str = ""
    doubt: float = 1.0
    maps: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)), repr=False)
    graph: ElasticGraph | None = field(default=None, repr=False)
    final: FloatArray | None = field(default=None, repr=False)

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


def distinct(ranked: Sequence[Placement], areas: FloatArray, least: float) -> list[Placement]:
    """Placements that are at a mean distance of at least ``least`` from every better one."""
    kept: list[Placement] = []
    for one in ranked:
        if all(mean_distance(one.positions, better.positions, areas) >= least for better in kept):
            kept.append(one)
    return kept


def mean_distance(first: FloatArray, second: FloatArray, areas: FloatArray) -> float:
    """Mean distance of two placements (n, 3) of the same vertices with areas (n,) of sum 1."""
    return float(areas @ np.linalg.norm(first - second, axis=1))
