"""The paper's method, level by level (section 5), without additions from later papers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import MapLike
from cagemap.maps.pair import LevelPair, Pair, Progress, no_progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import LevelMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Brief
from cagemap.paper.constraints import Constraints, DescriptorConfig, MapWeights, gather_constraints
from cagemap.paper.equations import extend_functional_map, solve_functional_map
from cagemap.paper.levels import (
    FEWEST_FUNCTIONS,
    basis_sizes,
    ladder,
    recover_points,
    refit_map,
    search_full,
    search_level,
    start_map,
)


@dataclass(frozen=True, repr=False)
class PaperConfig(Brief):
    """Parameters of the paper's method; the paper gives no values, as its section 6 is missing."""

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()  #: alpha(O), the same on all levels
    rounds: int = 1  #: alternations of P and orthonormal C on every level (2.1.4); 0: keep C of eqs. 13-16

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.rounds < 0:
            raise ParameterError(f"rounds: expected 0 or more alternations, got {self.rounds}")


def paper_map(
    pair: Pair,
    config: PaperConfig = PaperConfig(),
    progress: Progress = no_progress,
    *,
    constraints: Constraints | None = None,
    start: MapLike | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Vertex-to-point maps of all levels, and the point map of the finest ones.

    Parameters
    ----------
    pair : Pair
    config : PaperConfig
    progress : callable
    constraints : Constraints, optional
        Used instead of `gather_constraints`.
    start : map, optional
        Used instead of the solution of eq. 13: a functional map, a source vertex for every target vertex of a level, or
        a point map. If its size is not that of level 0, its leading block is used and extended by eqs. 14-16.

    Raises
    ------
    ParameterError
        If level 0 has too few basis functions, or the start is no map.
    """
    progress("functional map, level 0")
    constraints = gather_constraints(pair, config.descriptors) if constraints is None else constraints
    maps = [_first_level(pair, constraints, config, start)]
    for levels in ladder(pair, maps[0].levels):
        progress(f"functional and point map, levels {levels[0]} and {levels[1]}")
        maps.append(_next_level(pair, constraints, maps[-1], levels, config))
    progress("point map")
    maps = [replace(level_map, points=recover_points(pair, level_map)) for level_map in maps]
    assert maps[-1].points is not None
    return tuple(maps), maps[-1].points


def _first_level(pair: Pair, constraints: Constraints, config: PaperConfig, start: MapLike | None) -> LevelMap:
    """Map of level 0: eq. 13, and the full search (5.3.1, 5.4)."""
    sizes = basis_sizes(pair, (0, 0))
    if min(sizes) < FEWEST_FUNCTIONS:
        raise ParameterError(
            f"expected at least {FEWEST_FUNCTIONS} basis functions on level 0 of both surfaces, got {sizes}: give a "
            "schedule such as 100,50,50"
        )
    wanted = constraints.leading(*sizes)
    if start is None:
        functional_map = solve_functional_map(wanted, config.weights)
    else:
        functional_map = start_map(pair, start, sizes)[: sizes[0], : sizes[1]]
        if functional_map.shape != sizes:
            functional_map = extend_functional_map(functional_map, wanted, config.weights)
    return _alternate(pair, (0, 0), functional_map, config.rounds, lambda c: search_full(pair, c, (0, 0)))


def _next_level(
    pair: Pair, constraints: Constraints, coarse: LevelMap, levels: LevelPair, config: PaperConfig
) -> LevelMap:
    """Map of level l + 1: eqs. 14-16, and search among children of the parents' matches (5.3.2, Fig. 9)."""
    functional_map, sizes = coarse.functional_map, basis_sizes(pair, levels)
    if sizes != functional_map.shape:
        functional_map = extend_functional_map(functional_map, constraints.leading(*sizes), config.weights)
    return _alternate(pair, levels, functional_map, config.rounds, lambda c: search_level(pair, c, levels, coarse))


def _alternate(
    pair: Pair, levels: LevelPair, functional_map: FloatArray, rounds: int, search: Callable[[FloatArray], IndexArray]
) -> LevelMap:
    """Alternate the point map P and orthonormal C, starting from C (2.1.4)."""
    match = search(functional_map)
    for _ in range(rounds):
        functional_map = nearest_orthonormal(refit_map(pair, levels, match))
        match = search(functional_map)
    return LevelMap(levels, functional_map, match)


def nearest_orthonormal(functional_map: FloatArray) -> FloatArray:
    """Nearest matrix to C with orthonormal rows or columns, by singular vectors (2.1.4)."""
    left, _, right = np.linalg.svd(functional_map, full_matrices=False)
    return np.asarray(left @ right)
