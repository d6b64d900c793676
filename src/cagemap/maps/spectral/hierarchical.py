"""The hierarchical functional map: each band of functions is found by the descriptors and by the map so far.

Starts from eq. 13 on a few functions. Every further band extends C by eqs. 14-16, to which the map so far adds what it
says about the new functions, C = Phi1^+ P12 Phi2; the new C gives a better map, with which C is solved for again. So it
goes up the bands on one level, where all source vertices are searched, and then down the levels with the candidates of
Fig. 9. `cagemap.maps.spectral.paper` is the paper's method without the map's part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.basis import Surface
from cagemap.errors import ParameterError
from cagemap.functional_map import Constraints, MapWeights, extend_functional_map, solve_functional_map
from cagemap.maps.pair import LevelPair, Pair, Progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.spectral.constraints import DescriptorConfig, gather_constraints
from cagemap.maps.spectral.landmark_coordinates import landmark_coordinates
from cagemap.maps.spectral.levels import LevelMap, basis_sizes, ladder, recover_points, refit, search_level
from cagemap.maps.spectral.samples import (
    FIT_SAMPLES,
    Samples,
    embed_source,
    embed_target,
    fit_functional_map,
    growth,
    spread,
    subset,
)
from cagemap.maps.spectral.search import nearest_rows
from cagemap.numerics.arrays import FloatArray, IndexArray

FEWEST_FUNCTIONS = 3
# The search levels have this many functions on both sides, where the bases do.
ENOUGH_FUNCTIONS = 50
# Landmarks that harmonic coordinates need.
FEWEST_LANDMARKS = 2


@dataclass(frozen=True)
class HierarchyConfig:
    """Parameters of the hierarchical map; the defaults are the measured ones.

    Attributes
    ----------
    descriptors : DescriptorConfig
    weights : MapWeights
        Of eq. 13 and of the map beside the descriptors, the same on all levels.
    search_vertices : int
        The point map is searched in full at each side's coarsest level with at least this many vertices.
    first_functions : int
        Basis functions that eq. 13 is solved for.
    searched_functions : int
        Basis functions up to which bands are found with full searches; those above are found further down, where
        vertices move only among candidates.
    growth : float
        Factor by which a band makes the number of functions grow during full searches.
    coordinate_weight : float
        Weight of harmonic and biharmonic landmark coordinates beside the basis functions in full searches.
    """

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()
    search_vertices: int = 3000
    first_functions: int = 20
    searched_functions: int = 150
    growth: float = 1.25
    coordinate_weight: float = 0.33

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.first_functions, self.searched_functions) < FEWEST_FUNCTIONS or self.growth <= 1.0:
            raise ParameterError(
                f"expected at least {FEWEST_FUNCTIONS} functions and a growth above 1, got first_functions "
                f"{self.first_functions}, searched_functions {self.searched_functions}, growth {self.growth}"
            )


def hierarchical_map(
    pair: Pair, config: HierarchyConfig = HierarchyConfig(), progress: Progress = lambda stage: None
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of the search levels and of all below, and the point map T12 of the finest ones.

    Raises
    ------
    ParameterError
        If the surfaces cannot share descriptors (too few basis functions).
    """
    progress("functional map")
    constraints = gather_constraints(pair, config.descriptors)
    searched = search_levels(pair.target, pair.source, config)
    target = _samples(pair.target, searched[0], pair.target_landmarks, config)
    source = _samples(pair.source, searched[1], pair.source_landmarks, config)
    maps = [LevelMap(searched, *grown_map(constraints, target, source, config))]
    for levels in ladder(pair, searched):
        progress(f"point map, levels {levels[0]} and {levels[1]}")
        maps.append(descend(pair, constraints, maps[-1], levels, config))
    progress("vertex to point")
    return tuple(maps), recover_points(pair, maps[-1])


def search_levels(target: Surface, source: Surface, config: HierarchyConfig) -> LevelPair:
    """The levels whose point map is searched in full: the coarsest ones with enough vertices and basis functions."""

    def first(surface: Surface) -> int:
        functions = min(ENOUGH_FUNCTIONS, surface.basis.count)
        enough = (
            i
            for i, level in enumerate(surface.refinement.levels)
            if len(level.positions) >= config.search_vertices and surface.basis.size(i) >= functions
        )
        return next(enough, surface.finest)

    return first(target), first(source)


def grown_map(
    constraints: Constraints, target: Samples, source: Samples, config: HierarchyConfig, factor: float | None = None
) -> tuple[FloatArray, IndexArray]:
    """Functional map and match of samples: eq. 13 on the first functions, then band after band with full searches.

    Parameters
    ----------
    constraints : Constraints
        Of the whole bases.
    target, source : Samples
    config : HierarchyConfig
    factor : float, optional
        Instead of ``config.growth``.

    Returns
    -------
    functional_map : (k1, k2) array
    match : (b1,) array
        Source sample of every target sample.
    """
    most = target.rows.shape[1], source.rows.shape[1]
    if min(most) < FEWEST_FUNCTIONS:
        raise ParameterError(f"expected at least {FEWEST_FUNCTIONS} basis functions on both surfaces, got {most}")
    few = subset(target, spread(len(target.areas), FIT_SAMPLES)), subset(source, spread(len(source.areas), FIT_SAMPLES))
    stop = min(config.searched_functions, max(most))
    first, *further = growth(min(config.first_functions, *most), stop, config.growth if factor is None else factor)
    functional_map = solve_functional_map(constraints.leading(first, first), config.weights)
    match = search_samples(*few, functional_map)
    for k in further:
        functional_map = extended(
            constraints, *few, match, functional_map.shape, (min(k, most[0]), min(k, most[1])), config
        )
        match = search_samples(*few, functional_map)
    functional_map = solved(constraints, *few, match, functional_map.shape, config)
    return functional_map, search_samples(target, source, functional_map)


def extended(
    constraints: Constraints,
    target: Samples,
    source: Samples,
    match: IndexArray,
    low: tuple[int, int],
    high: tuple[int, int],
    config: HierarchyConfig,
) -> FloatArray:
    """C_l by descriptors and map on the low functions, and beside it the blocks of the next band (eqs. 14-16)."""
    of_match = fit_functional_map(target, source.rows[match][:, : high[1]], high[0])
    coarse = solve_functional_map(constraints.leading(*low), config.weights, match=of_match[: low[0], : low[1]])
    return extend_functional_map(coarse, constraints.leading(*high), config.weights, match=of_match)


def solved(
    constraints: Constraints,
    target: Samples,
    source: Samples,
    match: IndexArray,
    sizes: tuple[int, int],
    config: HierarchyConfig,
) -> FloatArray:
    """C by the descriptors and the map together, eq. 13 with the map's part."""
    of_match = fit_functional_map(target, source.rows[match][:, : sizes[1]], sizes[0])
    return solve_functional_map(constraints.leading(*sizes), config.weights, match=of_match)


def search_samples(target: Samples, source: Samples, functional_map: FloatArray) -> IndexArray:
    """Nearest source sample of every target sample in the embedding (paper, 5.4)."""
    return nearest_rows(embed_target(target, functional_map.shape[0]), embed_source(source, functional_map))


def descend(
    pair: Pair, constraints: Constraints, coarse: LevelMap, levels: LevelPair, config: HierarchyConfig
) -> LevelMap:
    """One step down: C extended by the levels' bands (eqs. 14-16), candidates (Fig. 9), C solved again, once more."""
    sizes = basis_sizes(pair, levels)
    functional_map, known = coarse.functional_map, constraints.leading(*sizes)
    if functional_map.shape != sizes:
        of_match = refit(pair, levels, coarse.match, coarse.levels[0])
        functional_map = extend_functional_map(functional_map, known, config.weights, match=of_match)
    match = search_level(pair, functional_map, levels, coarse)
    functional_map = solve_functional_map(known, config.weights, match=refit(pair, levels, match))
    return LevelMap(levels, functional_map, search_level(pair, functional_map, levels, coarse))


def _samples(surface: Surface, level: int, landmarks: IndexArray, config: HierarchyConfig) -> Samples:
    """All vertices of a level, with the row sums of its mass matrix as areas and their landmark coordinates."""
    operators = surface.operators
    rows = surface.basis.at(level)
    coordinates = np.zeros((len(rows), 0))
    if config.coordinate_weight > 0.0 and len(landmarks) >= FEWEST_LANDMARKS:
        made = landmark_coordinates(operators.stiffness[level], operators.mass[level], landmarks)
        coordinates = config.coordinate_weight * made
    return Samples(rows, operators.areas(level), coordinates)
