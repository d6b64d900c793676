"""The hierarchical functional map: each band of functions is found by the descriptors and by the map so far.

Starts from eq. 13 on a few functions. Every further band extends C by eqs. 14-16, to which the map so far adds what it
says about the new functions; the new C gives a better map, with which C is solved for again. So it goes up the bands
on one level, where all vertices of either surface search all of the other, in several ways whose best parts are
joined, and then down the levels with the candidates of Fig. 9, C read off their matches. Functions of finer bands have
values at coarse vertices too, so that this level finds all of C whichever is the finest; a level's own C is the leading
block. In every search landmark coordinates stand beside the functions, and normals of the target as C places it on the
source.
`cagemap.maps.spectral.paper` is the paper's method without the map's part.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cagemap.basis import Surface
from cagemap.errors import ParameterError
from cagemap.functional_map import Constraints, MapWeights, extend_functional_map, solve_functional_map
from cagemap.geometry.points import SurfacePoints
from cagemap.maps.pair import LevelPair, Pair, Progress, near_vertices, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import dirichlet_energy
from cagemap.maps.spectral.constraints import DescriptorConfig, gather_constraints
from cagemap.maps.spectral.facing import LevelMesh, with_normals
from cagemap.maps.spectral.joining import joined_match
from cagemap.maps.spectral.landmark_coordinates import landmark_coordinates
from cagemap.maps.spectral.levels import (
    Beside,
    LevelMap,
    basis_sizes,
    down_the_levels,
    refit,
    require_search,
    search_level,
    search_levels,
)
from cagemap.maps.spectral.row_blocks import Columns, functions_at
from cagemap.maps.spectral.samples import (
    Samples,
    embed_source,
    embed_target,
    fit_both_ways,
    fit_functional_map,
    sizes_between,
    spread,
    subset,
)
from cagemap.maps.spectral.search import nearest_both_ways, nearest_candidates, nearest_rows
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.brief import Brief
from cagemap.numerics.threads import in_threads

logger = logging.getLogger(__name__)

Grown = tuple[FloatArray, IndexArray]

FEWEST_FUNCTIONS = 3
# Samples of either surface for every function that a band is found with, and the fewest.
SAMPLES = 20
FEWEST_SAMPLES = 1000
# Landmarks that harmonic coordinates need.
FEWEST_LANDMARKS = 2


@dataclass(frozen=True)
class Growth:
    """How the number of functions grows while all source vertices are searched.

    Attributes
    ----------
    first : int
        Basis functions that eq. 13 is solved for.
    factor : float
        By which a band makes their number grow.
    coordinate_weight : float
        Weight of harmonic and biharmonic landmark coordinates beside the basis functions.
    normal_weight : float
        That of normals, per sqrt(k) functions: where the map turns a part inside out they disagree.
    """

    first: int = 20
    factor: float = 1.25
    coordinate_weight: float = 0.33
    normal_weight: float = 0.1

    def __post_init__(self) -> None:
        """Check the ranges."""
        weights = self.coordinate_weight, self.normal_weight
        if self.first < FEWEST_FUNCTIONS or self.factor <= 1.0 or not min(weights) >= 0.0:
            raise ParameterError(
                f"expected at least {FEWEST_FUNCTIONS} first functions, a factor above 1 and weights of at least 0, "
                f"got {self}"
            )


# A map may settle with a hand or foot half a turn off. Which weights and bands avoid that differs from pair to pair and
# from hand to hand; each finds a right one somewhere, and joined they have most.
GROWTHS = tuple(
    Growth(first, factor, coordinate_weight, normal_weight)
    for first, factor in ((12, 1.55), (15, 1.6), (20, 1.5))
    for coordinate_weight in (0.1, 0.33, 1.0)
    for normal_weight in (0.1, 0.3, 0.6)
)


@dataclass(frozen=True, repr=False)
class HierarchyConfig(Brief):
    """Parameters of the hierarchical map; the defaults are the measured ones.

    Attributes
    ----------
    descriptors : DescriptorConfig
    weights : MapWeights
        Of eq. 13 and of the map beside the descriptors. Without the Laplacian's operator most maps are as good, and
        one has both hands half a turn off (docs/accuracy.md).
    search_vertices : int
        The point map is searched in full at each side's coarsest level with at least this many vertices. Levels of
        four times as many lose hands.
    source_search_vertices : int
        The same of the source alone; 0: as the target's.
    searched_functions : int
        Basis functions up to which all growths find bands with full searches.
    further_functions : int
        Those up to which their joined map goes on; what the basis has beyond is one band more.
    growths : tuple of Growth
        Ways up to ``searched_functions``. The map is kept whose coverage of the source over its Dirichlet energy is
        largest, with those parts of the others that make it larger still (see `joined_match`).
    further : Growth
        How the joined map goes on to ``further_functions``, and the weights of coordinates and normals on all levels
        below; its ``first`` is not used.
    """

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()
    search_vertices: int = 2000
    source_search_vertices: int = 0
    searched_functions: int = 150
    further_functions: int = 300
    growths: tuple[Growth, ...] = GROWTHS
    further: Growth = Growth(12, 1.5, 0.33, 0.3)

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.searched_functions < FEWEST_FUNCTIONS or not self.growths:
            raise ParameterError(
                f"expected at least {FEWEST_FUNCTIONS} searched functions and one growth, got "
                f"{self.searched_functions} and {len(self.growths)}"
            )
        require_search(self.search_vertices, self.source_search_vertices)


def hierarchical_map(
    pair: Pair,
    config: HierarchyConfig = HierarchyConfig(),
    progress: Progress = silent,
    *,
    constraints: Constraints | None = None,
    start: FloatArray | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of the search levels and of all below, and the point map T12 of the finest ones.

    Parameters
    ----------
    pair : Pair
    config : HierarchyConfig
    progress : callable
    constraints : Constraints, optional
        One's own, instead of `gather_constraints`.
    start : (k, k) array, optional
        A functional map of the first functions from elsewhere, instead of the solution of eq. 13.

    Raises
    ------
    ParameterError
        If the surfaces cannot share descriptors (too few basis functions).
    """
    progress("functional map")
    constraints = gather_constraints(pair, config.descriptors) if constraints is None else constraints
    searched = search_levels(pair.target, pair.source, config.search_vertices, config.source_search_vertices)
    target = level_samples(pair.target, searched[0], pair.landmarks.target)
    source = level_samples(pair.source, searched[1], pair.landmarks.source)
    meshes = LevelMesh(pair.target, searched[0]), LevelMesh(pair.source, searched[1])

    images, placed = pair.source.triangles(searched[1]).positions, pair.target.triangles(searched[0])

    def grown(growth: Growth, last: int = config.searched_functions, begin: FloatArray | None = start) -> Grown:
        return grown_map(constraints, target, source, config.weights, growth, last, begin, meshes)

    def merit(match: IndexArray) -> float:
        """Coverage over Dirichlet energy: a limb that is missed costs the one, parts torn off the other."""
        return covered(match, len(source.areas)) / dirichlet_energy(placed.positions, images[match], placed.triangles)

    matches = [match for _, match in in_threads(grown, config.growths)]
    joined = joined_match(matches, images, placed.triangles, merit)
    size = tuple(min(config.searched_functions, side.rows.shape[1]) for side in (target, source))
    of_joined = fit_functional_map(target, source.rows[joined][:, : size[1]], size[0])
    further = grown(config.further, config.further_functions, of_joined)
    ends = [(of_joined, joined), further]
    merits = [merit(match) for _, match in ends]
    logger.info("merit joined: %.4f, gone on: %.4f", *merits)
    functional_map, match = ends[int(np.argmax(merits))]
    if functional_map.shape != constraints.shape:
        of_match = refit(pair, searched, match, constraints.shape)
        functional_map = extended(constraints, functional_map.shape, of_match, config.weights)
    first = LevelMap(searched, functional_map, match)
    beside = shared_coordinates(target, source, meshes, first.functional_map, config.further)

    def below(coarse: LevelMap, levels: LevelPair) -> LevelMap:
        return descend(pair, coarse, levels, beside)

    maps, points = down_the_levels(pair, first, below, progress, beside)
    return tuple(replace(found, functional_map=leading(pair, found)) for found in maps), points


def leading(pair: Pair, found: LevelMap) -> FloatArray:
    """C_l, the block of the functions that these levels have."""
    k1, k2 = basis_sizes(pair, found.levels)
    return found.functional_map[:k1, :k2]


def covered(match: IndexArray, count: int) -> float:
    """Share of so many source samples that some target sample is matched to; a limb that is missed costs many."""
    return len(np.unique(match)) / count


def grown_map(
    constraints: Constraints,
    target: Samples,
    source: Samples,
    weights: MapWeights,
    growth: Growth = Growth(),
    last: int = 150,
    start: FloatArray | None = None,
    meshes: tuple[LevelMesh, LevelMesh] | None = None,
) -> tuple[FloatArray, IndexArray]:
    """Functional map and match of samples: eq. 13 on the first functions, then band after band with full searches.

    Parameters
    ----------
    constraints : Constraints
        Of the whole bases.
    target, source : Samples
        Their landmark coordinates are weighted by the growth.
    weights : MapWeights
    growth : Growth
    last : int
        Basis functions up to which it grows, where there are as many.
    start : (k1, k2) array, optional
        Instead of the solution of eq. 13.
    meshes : pair of LevelMesh, optional
        Of the samples, where these are all vertices of a level: normals are then compared too, and the source's
        samples searched for on the target.

    Returns
    -------
    functional_map : (k1, k2) array
    match : (b1,) array
        Source sample of every target sample.
    """
    most = target.rows.shape[1], source.rows.shape[1]
    if min(most) < FEWEST_FUNCTIONS:
        raise ParameterError(f"expected at least {FEWEST_FUNCTIONS} basis functions on both surfaces, got {most}")
    target, source = weighted(target, growth.coordinate_weight), weighted(source, growth.coordinate_weight)

    def matched(functional_map: FloatArray, sizes: tuple[int, int]) -> FloatArray:
        """What the point map of C says about so many functions."""
        if meshes is None:
            match = search_samples(target, source, functional_map)
            return fit_functional_map(target, source.rows[match][:, : sizes[1]], sizes[0])
        facing = with_normals((target, source), meshes, functional_map, growth.normal_weight)
        count = max(FEWEST_SAMPLES, SAMPLES * max(sizes))
        few = [subset(side, spread(len(side.areas), count)) for side in facing]
        return fit_both_ways(few[0], few[1], search_both_ways(few[0], few[1], functional_map), sizes)

    if start is None:
        first = min(growth.first, *most)
        functional_map = solve_functional_map(constraints.leading(first, first), weights)
    else:
        first, functional_map = max(start.shape), start
    stop = max(first, min(last, max(most)))
    _, *further = sizes_between(first, stop, growth.factor)
    for k in further:
        of_match = matched(functional_map, (min(k, most[0]), min(k, most[1])))
        functional_map = extended(constraints, functional_map.shape, of_match, weights)
    of_match = matched(functional_map, functional_map.shape)
    functional_map = solve_functional_map(constraints.leading(*functional_map.shape), weights, match=of_match)
    if meshes is None:
        return functional_map, search_samples(target, source, functional_map)
    facing = with_normals((target, source), meshes, functional_map, growth.normal_weight)
    return functional_map, search_near_few(facing, functional_map, meshes)


def weighted(samples: Samples, weight: float) -> Samples:
    """Samples with another weight of landmark coordinates."""
    return replace(samples, coordinates=weight * samples.coordinates)


def shared_coordinates(
    target: Samples, source: Samples, meshes: tuple[LevelMesh, LevelMesh], functional_map: FloatArray, growth: Growth
) -> Beside:
    """Landmark coordinates, and normals of the target as C places it, as a growth weighs them; of target and source."""
    sides = weighted(target, growth.coordinate_weight), weighted(source, growth.coordinate_weight)
    one, two = with_normals(sides, meshes, functional_map, growth.normal_weight)
    return Columns(meshes[0].level, one.coordinates), Columns(meshes[1].level, two.coordinates)


def extended(constraints: Constraints, low: tuple[int, int], of_match: FloatArray, weights: MapWeights) -> FloatArray:
    """C_l by descriptors and map on the low functions, and beside it the blocks of the next band (eqs. 14-16)."""
    coarse = solve_functional_map(constraints.leading(*low), weights, match=of_match[: low[0], : low[1]])
    return extend_functional_map(coarse, constraints.leading(*of_match.shape), weights, match=of_match)


def search_samples(target: Samples, source: Samples, functional_map: FloatArray) -> IndexArray:
    """Nearest source sample of every target sample in the embedding (paper, 5.4)."""
    return nearest_rows(embed_target(target, functional_map.shape[0]), embed_source(source, functional_map))


def search_near_few(
    sides: tuple[Samples, Samples], functional_map: FloatArray, meshes: tuple[LevelMesh, LevelMesh]
) -> IndexArray:
    """The same for all vertices of a level: a few of them are searched in full, all others near these ones' matches."""
    rows = embed_target(sides[0], functional_map.shape[0]), embed_source(sides[1], functional_map)
    match = nearest_rows(*(of[mesh.few] for of, mesh in zip(rows, meshes, strict=True)))
    return nearest_candidates(*rows, meshes[0].near, sparse.csc_array(meshes[1].near), match)


def search_both_ways(target: Samples, source: Samples, functional_map: FloatArray) -> tuple[IndexArray, IndexArray]:
    """The same, and the nearest target sample of every source sample."""
    return nearest_both_ways(embed_target(target, functional_map.shape[0]), embed_source(source, functional_map))


def descend(pair: Pair, coarse: LevelMap, levels: LevelPair, beside: Beside | None = None) -> LevelMap:
    """One step down: candidates of Fig. 9, C of these matches, and candidates once more.

    Descriptors are not asked again: matches get more exact from level to level, descriptors do not, and each further
    solve with them would draw C back to what they say (docs/accuracy.md).
    """
    match = search_level(pair, coarse.functional_map, levels, coarse, beside)
    functional_map = refit(pair, levels, match, coarse.functional_map.shape)
    return LevelMap(levels, functional_map, search_level(pair, functional_map, levels, coarse, beside))


def level_samples(surface: Surface, level: int, landmarks: SurfacePoints) -> Samples:
    """All vertices of a level, with the row sums of its mass matrix as areas and their landmark coordinates."""
    operators = surface.operators
    rows = functions_at(surface, level, surface.basis.count)
    coordinates = np.zeros((len(rows), 0))
    if len(landmarks) >= FEWEST_LANDMARKS:
        vertices = near_vertices(landmarks, surface, level)
        coordinates = landmark_coordinates(operators.stiffness[level], operators.mass[level], vertices)
    return Samples(rows, operators.areas(level), coordinates)
