"""Which of several fits is the right one: coarse fits that ended apart are finished, and the cheapest end is kept.

Limbs turned about their axis hardly cost anything on the coarse graph; finished, they do (docs/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from cagemap.geometry.closest import build_tree, closest_points
from cagemap.maps.elastic.constants import ENDS_APART, HOPELESS_END, MOST_ENDS, PULLERS
from cagemap.maps.elastic.data import Pullers
from cagemap.maps.elastic.fit import CoarseFit, coarse_cost, fine_fit
from cagemap.maps.elastic.prepared import CoarseShape, PreparedPair
from cagemap.maps.pair import PointPairs
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads

One = TypeVar("One")


@dataclass(frozen=True, eq=False)
class FineFit:
    """Where a fine stage ended.

    Attributes
    ----------
    cost : float
        See `end_cost`.
    positions : (n, 3) float64
        Of the vertices of the target's mesh, near the source.
    """

    cost: float
    positions: FloatArray


def finished_ends(
    prepared: PreparedPair,
    shape: CoarseShape,
    coarse: Sequence[CoarseFit],
    landmarks: PointPairs,
    most: int = MOST_ENDS,
) -> tuple[FineFit, ...]:
    """The fine stage from the cheapest coarse fits that lie apart, by what their ends cost.

    Parameters
    ----------
    prepared : PreparedPair
    shape : CoarseShape
    coarse : sequence of CoarseFit
        From different starts.
    landmarks : PointPairs
    most : int
        How many are finished.
    """
    ranked = sorted(coarse, key=lambda ended: ended.cost)
    hopeful = [ended for ended in ranked if ended.cost <= HOPELESS_END * ranked[0].cost]
    kept = different(hopeful, lambda ended: ended.positions, shape.rest.graph.areas, ENDS_APART)[:most]
    pullers = Pullers.choose(prepared.sheet, int(PULLERS * prepared.rest.graph.n), prepared.rest.masks)

    def finish(ended: CoarseFit) -> FineFit:
        positions = fine_fit(prepared, shape, [ended], landmarks)
        return FineFit(end_cost(prepared, pullers, positions), positions)

    return tuple(sorted(in_threads(finish, kept), key=lambda ended: ended.cost))


def end_cost(prepared: PreparedPair, pullers: Pullers, positions: FloatArray) -> float:
    """What a fitted mesh costs: `coarse_cost`, and the mean squared distance of source points from the mesh.

    The last tells a limb that lies beside its counterpart, or a body squeezed into a part of the other.
    """
    rest, config = prepared.rest, prepared.elastic
    cost = coarse_cost(rest, prepared.sheet, positions, rest.field.solve(positions), config)
    tree = build_tree(positions, prepared.mesh.triangles)
    _, _, distance = closest_points(tree, pullers.points, pullers.planes, normal_weight=config.normal_weight)
    return cost + float(pullers.areas @ distance**2)


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
