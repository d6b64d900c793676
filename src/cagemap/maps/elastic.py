"""Point maps by the elastic method: deform the target, project it once, unfold it."""

from __future__ import annotations

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.update import linear_update
from cagemap.maps.hypotheses.search import search
from cagemap.maps.pair import Pair, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked


def elastic_map(
    problem: Problem, progress: Progress = silent, start: FloatArray | None = None
) -> tuple[PointMap, list[Placement]]:
    """Point map T12 of the finest levels, and the placements that `search` found; the first is the map's own.

    ``start`` as in `search`.
    """
    placements = search(problem, progress, start)
    progress("closest points")
    return map_of_places(problem.prepared, placements[0].answer, problem.pair.landmarks), placements


@kinds_checked
def fit(prepared: PreparedPair, pair: Pair, progress: Progress = silent) -> FloatArray:
    """Places (n, 3) near the source of the target's vertices of the level that is deformed: the first of `search`.

    In the unit in which the source has area 1.
    """
    return search(Problem(prepared, pair), progress)[0].answer


def updated_map(prepared: PreparedPair, pair: Pair, before: PointMap, progress: Progress = silent) -> PointMap:
    """Point map T12 of the finest levels after landmarks changed, from the one before.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With the landmarks as they are now.
    before : PointMap
        Of the finest levels.
    progress : callable
    """
    progress("elastic update")
    moved = linear_update(Problem(prepared, pair), before)
    progress("closest points")
    return map_of_places(prepared, moved, pair.landmarks)
