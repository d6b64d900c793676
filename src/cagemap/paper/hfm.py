"""The paper's method with three named improvements (`hfm`).

1. ZoomOut on one level finds the bands, in place of eqs. 14-16 [Melzi et al. 2019].
2. Landmark coordinates stand beside the basis functions in every search.
3. C is fitted to matches in both directions, so that no limb of the source is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cagemap.errors import ParameterError
from cagemap.maps.level_map import LevelMap
from cagemap.maps.pair import LevelPair, Pair, Progress, silent, vertices_near
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.brief import Brief
from cagemap.paper.constraints import Constraints, DescriptorConfig, MapWeights, gather_constraints
from cagemap.paper.equations import solve_functional_map
from cagemap.paper.fine_rows import Columns, functions_at
from cagemap.paper.levels import Coordinates, down_the_levels, refit, search_level, search_levels, start_map
from cagemap.spectral.landmark_coordinates import landmark_coordinates
from cagemap.spectral.nearest import nearest_both_ways
from cagemap.spectral.samples import Samples, embed_source, embed_target, evenly_spaced, fit_functional_map
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import ZoomOutSchedule, nearest_samples
from cagemap.surface.surface_points import SurfacePoints

FEWEST_FUNCTIONS = 3
# Landmarks that harmonic coordinates need.
FEWEST_LANDMARKS = 2
# Samples of either surface that the bands are found with.
ZOOMOUT_SAMPLES = 3000


@dataclass(frozen=True, repr=False)
class HfmConfig(Brief):
    """Parameters of `hfm`; the defaults are the measured ones.

    Attributes
    ----------
    descriptors : DescriptorConfig
    weights : MapWeights
        Of eq. 13.
    zoomout : ZoomOutSchedule
        Eq. 13 is solved for the first number of functions.
    coordinate_weight : float
        Weight of the landmark coordinates beside the basis functions.
    search_vertices : int
        ZoomOut runs on each side's coarsest level with at least this many vertices.
    source_search_vertices : int
        The same of the source alone; 0: as the target's.
    """

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()
    zoomout: ZoomOutSchedule = ZoomOutSchedule()
    coordinate_weight: float = 1.0
    search_vertices: int = 2000
    source_search_vertices: int = 0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.zoomout.first < FEWEST_FUNCTIONS or not self.coordinate_weight >= 0.0:
            raise ParameterError(
                f"expected at least {FEWEST_FUNCTIONS} first functions and a coordinate weight of at least 0, got "
                f"{self.zoomout.first} and {self.coordinate_weight}"
            )
        if min(self.search_vertices, self.source_search_vertices) < 0:
            raise ParameterError(
                f"expected 0 search vertices or more, got {self.search_vertices} and {self.source_search_vertices}"
            )


def hfm_map(
    pair: Pair,
    config: HfmConfig = HfmConfig(),
    progress: Progress = silent,
    *,
    constraints: Constraints | None = None,
    start: ArrayLike | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of the search levels and of all finer ones, and the point map T12 of the finest ones.

    Parameters
    ----------
    pair : Pair
    config : HfmConfig
    progress : callable
    constraints : Constraints, optional
        One's own, instead of `gather_constraints`.
    start : (k1, k2) or (n,) array, optional
        A functional map of the first functions from elsewhere, instead of the solution of eq. 13, or a source vertex
        for every target vertex of a level.

    Raises
    ------
    ParameterError
        If the surfaces have too few basis functions.
    """
    progress("functional map")
    levels = search_levels(pair.target, pair.source, config.search_vertices, config.source_search_vertices)
    target = _level_samples(pair.target, levels[0], pair.landmarks.target, config.coordinate_weight)
    source = _level_samples(pair.source, levels[1], pair.landmarks.source, config.coordinate_weight)
    most = min(target.rows.shape[1], source.rows.shape[1])
    if most < FEWEST_FUNCTIONS:
        raise ParameterError(f"expected at least {FEWEST_FUNCTIONS} basis functions on both surfaces, got {most}")
    first = min(config.zoomout.first, most)
    if start is None:
        constraints = gather_constraints(pair, config.descriptors) if constraints is None else constraints
        functional_map = solve_functional_map(constraints.leading(first, first), config.weights)
    else:
        functional_map = start_map(pair, start, (first, first))
    functional_map = zoomout_both_ways(target, source, functional_map, config.zoomout)
    first_map = LevelMap(levels, functional_map, nearest_samples(target, source, functional_map))
    beside = Columns(levels[0], target.coordinates), Columns(levels[1], source.coordinates)

    def finer(coarse: LevelMap, levels: LevelPair) -> LevelMap:
        return next_level(pair, coarse, levels, beside)

    return down_the_levels(pair, first_map, finer, progress, beside)


def zoomout_both_ways(
    target: Samples, source: Samples, functional_map: FloatArray, schedule: ZoomOutSchedule
) -> FloatArray:
    """C12 of ZoomOut on some samples of both surfaces, fitted to the matches of both directions.

    Parameters
    ----------
    target, source : Samples
    functional_map : (k1, k2) array
        C12 of the first functions.
    schedule : ZoomOutSchedule
    """
    target, source = (_some(side, ZOOMOUT_SAMPLES) for side in (target, source))
    counts = target.rows.shape[1], source.rows.shape[1]
    for size in schedule.sizes(max(counts)):
        embedded = embed_target(target, functional_map.shape[0]), embed_source(source, functional_map)
        sizes = min(size, counts[0]), min(size, counts[1])
        functional_map = fit_both_ways(target, source, nearest_both_ways(*embedded), sizes)
    return functional_map


def fit_both_ways(
    target: Samples, source: Samples, matches: tuple[IndexArray, IndexArray], sizes: tuple[int, int]
) -> FloatArray:
    """C12 of the matches of both directions, each surface's samples counting as much as the other's.

    Parameters
    ----------
    target, source : Samples
    matches : ((b1,), (b2,)) arrays
        Source sample of every target sample, target sample of every source sample.
    sizes : (int, int)
        Leading basis functions (k1, k2).

    Returns
    -------
    (k1, k2) array
    """
    forward, backward = matches
    rows = np.vstack([target.rows[:, : sizes[0]], target.rows[backward, : sizes[0]]])
    values = np.vstack([source.rows[forward, : sizes[1]], source.rows[:, : sizes[1]]])
    areas = np.concatenate([target.areas / target.areas.sum(), source.areas / source.areas.sum()])
    return fit_functional_map(Samples(rows, areas, np.zeros((len(rows), 0))), values, sizes[0])


def next_level(pair: Pair, coarse: LevelMap, levels: LevelPair, coordinates: Coordinates) -> LevelMap:
    """One level finer: candidates of Fig. 9, C of these matches, and candidates once more."""
    match = search_level(pair, coarse.functional_map, levels, coarse, coordinates)
    functional_map = refit(pair, levels, match, coarse.functional_map.shape)
    return LevelMap(levels, functional_map, search_level(pair, functional_map, levels, coarse, coordinates))


def _level_samples(surface: Surface, level: int, landmarks: SurfacePoints, weight: float) -> Samples:
    """All vertices of a level with their areas and weighted landmark coordinates."""
    operators = surface.operators
    rows = functions_at(surface, level, surface.basis.count)
    coordinates = np.zeros((len(rows), 0))
    if len(landmarks) >= FEWEST_LANDMARKS:
        vertices = vertices_near(landmarks, surface, level)
        coordinates = landmark_coordinates(operators.stiffness[level], operators.mass[level], vertices)
    return Samples(rows, operators.areas(level), weight * coordinates)


def _some(samples: Samples, count: int) -> Samples:
    chosen = evenly_spaced(len(samples.areas), count)
    return Samples(samples.rows[chosen], samples.areas[chosen], samples.coordinates[chosen])
