"""Which of several fits is the right one: coarse fits that ended apart are finished, and the cheapest end is kept.

Limbs turned about their axis hardly cost anything on the coarse graph; finished, they do (docs/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cagemap.geometry.closest import build_tree, closest_points
from cagemap.maps.elastic.constants import ENDS_APART, HOPELESS_END, LEAST_PART, MOST_ENDS, PART_RINGS, PARTS_APART
from cagemap.maps.elastic.fit import CoarseFit, fine_fit, fine_stage, vertex_costs
from cagemap.maps.elastic.graph import ElasticGraph
from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.elastic.problem import FitProblem
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.graphs import components
from cagemap.numerics.threads import in_threads

One = TypeVar("One")


@dataclass(frozen=True, eq=False)
class FineFit:
    """Where a fine stage ended.

    Attributes
    ----------
    cost : float
        See `judged`.
    positions : (n, 3) float64
        Of the vertices of the target's mesh, near the source.
    costs : (n,) float64
        Share of the cost that every vertex has; empty if nobody asked.
    moved : (n, 3) float64 or None
        What became of it where joints are in doubt, see `cagemap.maps.elastic.method.fits`; other ends are not moved,
        so that it compares with them by its own positions.
    """

    cost: float
    positions: FloatArray
    costs: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    moved: FloatArray | None = field(default=None, repr=False)

    @property
    def answer(self) -> FloatArray:
        """(n, 3) what the map is made of."""
        return self.positions if self.moved is None else self.moved


def finished_ends(
    problem: FitProblem,
    coarse: Sequence[CoarseFit],
    most: int = MOST_ENDS,
    stiff: Sequence[CoarseFit] = (),
) -> tuple[FineFit, ...]:
    """The fine stage from the cheapest coarse fits that lie apart, by what their ends cost.

    One of them may be right about an arm, another about a leg: where that makes a cheaper one, the first is made of
    the best parts of all.

    Parameters
    ----------
    problem : FitProblem
    coarse : sequence of CoarseFit
        From different starts.
    most : int
        How many are finished.
    stiff : sequence of CoarseFit
        Finished too; their costs are of another energy.
    """
    ranked = sorted(coarse, key=lambda ended: ended.cost)
    hopeful = [ended for ended in ranked if ended.cost <= HOPELESS_END * ranked[0].cost]
    kept = different(hopeful, lambda ended: ended.positions, ranked[0].graph.areas, ENDS_APART)[:most]

    def finish(ended: CoarseFit) -> FineFit:
        return judged(problem.prepared, fine_fit(problem, ended))

    found = sorted(in_threads(finish, [*kept, *stiff]), key=lambda ended: ended.cost)
    mixed = best_parts(problem.prepared.rest.graph, found)
    if mixed is not None:
        found.append(judged(problem.prepared, fine_stage(problem, mixed)))
    return tuple(sorted(found, key=lambda ended: ended.cost))


def judged(prepared: PreparedPair, positions: FloatArray) -> FineFit:
    """A fitted mesh with what it costs: `vertex_costs`, and the mean squared distance of source points from the mesh.

    The last tells a limb that lies beside its counterpart, or a body squeezed into a part of the other.
    """
    rest, config, triangles = prepared.rest, prepared.elastic, prepared.mesh.triangles
    pullers = rest.pullers(prepared.sheet)
    costs = vertex_costs(rest, prepared.sheet, positions, rest.field.solve(positions), config)
    tree = build_tree(positions, triangles)
    at, barycentric, distance = closest_points(tree, pullers.points, pullers.planes, normal_weight=config.normal_weight)
    missed = barycentric * (pullers.areas * distance**2)[:, None]
    costs = costs + np.bincount(triangles[at].ravel(), missed.ravel(), rest.graph.n)
    return FineFit(float(costs.sum()), positions, costs)


def best_parts(graph: ElasticGraph, ranked: Sequence[FineFit]) -> FloatArray | None:
    """The first of some ends with those parts of the others that are cheaper there; None if there are none.

    A part is a connected piece of the surface where two ends lie `PARTS_APART`, a limb most often; around it they
    agree, so that one fits into the other.

    Parameters
    ----------
    graph : ElasticGraph
    ranked : sequence of FineFit
        Cheapest first.
    """
    positions, costs, changed = ranked[0].positions, ranked[0].costs, False
    for other in ranked[1:]:
        apart = np.linalg.norm(positions - other.positions, axis=1) > PARTS_APART
        part, share = _parts(graph, apart)
        inside, count = part >= 0, int(part.max()) + 1
        gains = np.bincount(part[inside], (costs - other.costs)[inside], count)
        areas = np.bincount(part[apart], graph.areas[apart], count)
        better = np.append((gains > 0) & (areas >= LEAST_PART), False)
        if not better.any():
            continue
        share = share * better[part]
        positions = positions + share[:, None] * (other.positions - positions)
        costs, changed = np.where(share > 0, other.costs, costs), True
    return positions if changed else None


def _parts(graph: ElasticGraph, apart: NDArray[np.bool_]) -> tuple[IndexArray, FloatArray]:
    """Number (n,) of the connected piece that vertices are of, rings around it included, -1 elsewhere; share (n,)."""
    both = apart[graph.heads] & apart[graph.tails]
    _, numbers = np.unique(components(graph.heads[both], graph.tails[both], graph.n)[apart], return_inverse=True)
    part, share = np.full(graph.n, -1), apart.astype(np.float64)
    part[apart] = numbers
    for ring in range(PART_RINGS):
        reached = np.full(graph.n, -1)
        np.maximum.at(reached, graph.heads, part[graph.tails])
        new = (part < 0) & (reached >= 0)
        part[new], share[new] = reached[new], 1.0 - (ring + 1) / (PART_RINGS + 1)
    return part, share


def different(
    ranked: Sequence[One], positions_of: Callable[[One], FloatArray], areas: FloatArray, least: float
) -> list[One]:
    """Those that are at a mean distance of at least ``least`` from every better one."""
    kept: list[One] = []
    for one in ranked:
        if all(mean_distance(positions_of(one), positions_of(better), areas) >= least for better in kept):
            kept.append(one)
    return kept


def mean_distance(first: FloatArray, second: FloatArray, areas: FloatArray) -> float:
    """Mean distance of two placements (n, 3) of the same vertices with areas (n,) of sum 1."""
    return float(areas @ np.linalg.norm(first - second, axis=1))
