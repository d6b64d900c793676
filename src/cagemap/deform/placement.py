"""A placement of the target on the source: positions and their cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import GraphConfig, SearchConfig
from cagemap.deform.graph import ElasticGraph, extrapolate
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components


@dataclass(frozen=True, eq=False)
class Placement:
    """Positions on the source of a graph's, or the target mesh's, vertices."""

    positions: FloatArray = field(repr=False)  #: (n, 3) near the source, at unit area
    cost: float = 0.0  #: sum of `costs`; 0 if not computed
    costs: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)  #: (n,) by vertex, or empty
    name: str = ""  #: the start in words, such as "turned 180 degrees about y"
    penalty: float = 1.0  #: factor on the cost in a ranking: above 1 if the files' axes are turned, which is rare
    maps: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)), repr=False)  #: (n, 3, 3) or empty
    graph: ElasticGraph | None = field(default=None, repr=False)  #: graph of the positions, for clusters
    #: (n, 3) positions after `refit.finish_placement`; placements are compared by ``positions``
    finished_positions: FloatArray | None = field(default=None, repr=False)
    exchange: tuple[tuple[int, int], ...] = ()  #: pairs of landmarks whose source points are exchanged here

    @property
    def map_positions(self) -> FloatArray:
        """(n, 3) positions for the map: ``finished_positions``, else ``positions``."""
        return self.positions if self.finished_positions is None else self.finished_positions

    @property
    def penalised_cost(self) -> float:
        """Cost times penalty."""
        return self.penalty * self.cost

    def with_start_of(self, other: Placement) -> Placement:
        """The placement with the name and the penalty of another one, from which it was fitted."""
        return replace(self, name=other.name, penalty=other.penalty)

    def as_answer(self, name: str) -> Placement:
        """The positions for the map, with their cost and penalty, under a name for a user."""
        return Placement(self.map_positions, self.cost, name=name, penalty=self.penalty)

    def extrapolate_to(self, graph: ElasticGraph, config: GraphConfig) -> FloatArray:
        """(n, 3) positions of another graph of the same shape, extrapolated from this placement."""
        assert self.graph is not None
        return extrapolate(self.graph, self.positions, self.maps, graph, config)


def sort_by_cost(placements: Iterable[Placement]) -> list[Placement]:
    """Placements sorted by cost, ascending."""
    return sorted(placements, key=lambda placed: placed.cost)


def rank_placements(placements: Iterable[Placement], floor: float = 0.0) -> list[Placement]:
    """Placements sorted by cost times penalty, ascending; costs below a floor are ties."""
    return sorted(placements, key=lambda placed: placed.penalty * max(placed.cost, floor))


def distinct_placements(ranked: Sequence[Placement], areas: FloatArray, least: float) -> list[Placement]:
    """Placements that are at a mean distance of at least ``least`` from every better one."""
    kept: list[Placement] = []
    for placement in ranked:
        if all(mean_distance(placement.positions, better.positions, areas) >= least for better in kept):
            kept.append(placement)
    return kept


def mean_distance(first: FloatArray, second: FloatArray, areas: FloatArray) -> float:
    """Mean distance of two placements (n, 3) of the same vertices with areas (n,) of sum 1."""
    return float(areas @ np.linalg.norm(first - second, axis=1))


def best_parts(
    graph: ElasticGraph, placements: Sequence[Placement], config: SearchConfig, factor: float = 1.0
) -> FloatArray | None:
    """(n, 3) the first placement, with parts of the others in it; None if there are none.

    A part is a connected piece of the surface where two placements differ, such as a limb. It is taken if it costs less
    there, even times a factor.
    """
    positions, costs, changed = placements[0].positions, placements[0].costs, False
    for other in placements[1:]:
        apart = np.linalg.norm(positions - other.positions, axis=1) > config.part_distance
        part, share = _parts(graph, apart, config.part_rings)
        inside, count = part >= 0, int(part.max()) + 1
        gains = np.bincount(part[inside], (costs - factor * other.costs)[inside], count)
        areas = np.bincount(part[apart], graph.areas[apart], count)
        better = np.append((gains > 0) & (areas >= config.part_area), False)
        share = share * better[part]
        positions = positions + share[:, None] * (other.positions - positions)
        costs, changed = np.where(share > 0, other.costs, costs), changed or bool(better.any())
    return positions if changed else None


def _parts(graph: ElasticGraph, apart: NDArray[np.bool_], rings: int) -> tuple[IndexArray, FloatArray]:
    """Part (n,) of each vertex, -1 for none, and its weight (n,), which fades over rings around the part."""
    both = apart[graph.heads] & apart[graph.tails]
    _, numbers = np.unique(label_components(graph.heads[both], graph.tails[both], graph.n)[apart], return_inverse=True)
    part, share = np.full(graph.n, -1), apart.astype(np.float64)
    part[apart] = numbers
    for ring in range(rings):
        reached = np.full(graph.n, -1)
        np.maximum.at(reached, graph.heads, part[graph.tails])
        new = (part < 0) & (reached >= 0)
        part[new], share[new] = reached[new], 1.0 - (ring + 1) / (rings + 1)
    return part, share
