"""Maps of pairs of levels, for methods that go from level to level, and which levels these are."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.maps.pair import LevelPair, Pair
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral.surface import Surface


@dataclass(frozen=True, eq=False)
class LevelMap:
    """Functional map and vertex matches between one level of the target and one of the source."""

    levels: LevelPair  # of target and source
    functional_map: FloatArray  # (k1, k2) C12 on the basis functions of these levels
    match: IndexArray  # (n1,) source vertex of every target vertex
    points: PointMap | None = None  # the same as points of the source; None while the finer levels are not found yet


# The search levels have this many functions on both sides, where the bases do.
ENOUGH_FUNCTIONS = 50
# Two levels are walked down together while neither has this many times the other's vertices.
COMPARABLE = 2.5


def search_levels(target: Surface, source: Surface, vertices: int, source_vertices: int = 0) -> LevelPair:
    """The levels whose point map is searched in full: the coarsest ones with enough vertices and basis functions.

    ``source_vertices`` are those of the source, if not 0.
    """

    def first(surface: Surface, wanted: int) -> int:
        functions = min(ENOUGH_FUNCTIONS, surface.basis.count)
        enough = (
            i
            for i, level in enumerate(surface.hierarchy.levels)
            if len(level.positions) >= wanted and surface.basis.size(i) >= functions
        )
        return next(enough, surface.finest)

    return first(target, vertices), first(source, source_vertices or vertices)


def ladder(pair: Pair, start: LevelPair) -> list[LevelPair]:
    """Pairs of levels from just above `start` to the finest ones, each side at most one level a step.

    Both sides go together while their sizes are comparable; otherwise the coarser one catches up first.
    """
    steps = []
    l1, l2 = start
    while (l1, l2) != (pair.target.finest, pair.source.finest):
        n1, n2 = pair.target.triangles(l1).n, pair.source.triangles(l2).n
        target_may, source_may = l1 < pair.target.finest, l2 < pair.source.finest
        move_target = target_may and (not source_may or n1 < COMPARABLE * n2)
        move_source = source_may and (not target_may or n2 < COMPARABLE * n1)
        l1, l2 = l1 + move_target, l2 + move_source
        steps.append((l1, l2))
    return steps
