"""The paper's method with four named improvements (`hfm`).

1. ZoomOut on one level extends C to all bands, instead of eqs. 14-16 [Melzi et al. 2019].
2. Every search uses, in addition to the basis functions, positions and normals of the target displaced onto the source
   by few basis functions [Eisenberger, Lahner, Cremers 2020, Smooth Shells].
3. C and the displacement are fitted to matches in both directions, so that all limbs of the source are matched.
4. On every level the map is given by the source's closest points to the displaced target, instead of Fig. 9.

Effect of each: docs/paper/index.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import MapLike
from cagemap.maps.pair import LevelPair, Pair, Progress, no_progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import facing_points
from cagemap.maps.result import LevelMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Brief
from cagemap.paper.constraints import Constraints, DescriptorConfig, MapWeights, gather_constraints
from cagemap.paper.equations import solve_functional_map
from cagemap.paper.levels import FEWEST_FUNCTIONS, ladder, search_levels, start_map
from cagemap.paper.search import functions_at, spectral_rows
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import (
    Embedding,
    Samples,
    ZoomOutSchedule,
    evenly_spaced_vertices,
    fit_functional_map,
    nearest_rows,
)
from cagemap.surface.triangles import vertex_normals

# Number of vertices of each surface in ZoomOut.
ZOOMOUT_SAMPLES = 3000
# Weights of normals in closest points: of the first search, and where the sides of a thin part differ.
FACING_WEIGHTS = (0.03, 0.1)


@dataclass(frozen=True, repr=False)
class HfmConfig(Brief):
    """Parameters of `hfm`; the defaults were found by measurement."""

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()  #: weights of eq. 13
    zoomout: ZoomOutSchedule = ZoomOutSchedule()  #: eq. 13 is solved for the first number of functions
    position_weight: float = 10.0  #: weight of displaced positions relative to basis functions, times sqrt(k)
    normal_weight: float = 1.0  #: weight of the displaced normals, times sqrt(k)
    displacement_share: float = 0.5  #: number of functions of the displacement, as a share of C's
    search_vertices: int = 2000  #: ZoomOut runs on each side's coarsest level with at least this many vertices
    source_search_vertices: int = 0  #: the same number for the source, if it differs; 0: as for the target

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.zoomout.first < FEWEST_FUNCTIONS:
            raise ParameterError(f"expected at least {FEWEST_FUNCTIONS} first functions, got {self.zoomout.first}")
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not (np.isfinite(value) and value >= 0.0):
                raise ParameterError(f"{name}: expected a number of at least 0, got {value}")


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of target points x to x R + Phi~1 tau: rotation R (3, 3), coefficients tau (k, 3)."""

    rotation: FloatArray
    coefficients: FloatArray

    def at(self, surface: Surface, level: int) -> FloatArray:
        """(n_level, 3) displaced vertices of a level of the target."""
        positions = surface.triangles(level).positions
        rows = spectral_rows(surface, level, len(self.coefficients), self.coefficients)
        return positions @ self.rotation + rows(np.arange(len(positions)))


def hfm_map(
    pair: Pair,
    config: HfmConfig = HfmConfig(),
    progress: Progress = no_progress,
    *,
    constraints: Constraints | None = None,
    start: MapLike | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of the search levels and all finer ones, and the finest point map T12.

    The options are those of `cagemap.paper.method.paper_map`; a start is a map of the first functions.

    Raises
    ------
    ParameterError
        If the surfaces have too few basis functions.
    """
    progress("functional map")
    levels = search_levels(pair.target, pair.source, config.search_vertices, config.source_search_vertices)
    most = min(pair.target.basis.count, pair.source.basis.count)
    if most < FEWEST_FUNCTIONS:
        raise ParameterError(
            f"basis: expected at least {FEWEST_FUNCTIONS} functions on both surfaces, got {most}. Give a larger count."
        )
    first = min(config.zoomout.first, most)
    if start is None:
        constraints = gather_constraints(pair, config.descriptors) if constraints is None else constraints
        functional_map = solve_functional_map(constraints.leading(first, first), config.weights)
    else:
        functional_map = start_map(pair, start, (first, first))
    functional_map, displacement = zoomout_all_bands(pair, levels, functional_map, config)
    maps = []
    for finer in [levels, *ladder(pair, levels)]:
        progress(f"point map, levels {finer[0]} and {finer[1]}")
        maps.append(closest_map(pair, finer, functional_map, displacement))
    points = maps[-1].points
    assert points is not None
    return tuple(maps), points


def zoomout_all_bands(
    pair: Pair, levels: LevelPair, functional_map: FloatArray, config: HfmConfig
) -> tuple[FloatArray, Displacement]:
    """C12 of all bands and the displacement, by ZoomOut in both directions from an initial C12."""
    target = LevelSamples.of(pair.target, levels[0])
    source = LevelSamples.of(pair.source, levels[1])
    counts = target.rows.shape[1], source.rows.shape[1]
    displacement: Displacement | None = None
    for size in config.zoomout.sizes(max(counts)):
        k1, k2 = functional_map.shape
        placed = None if displacement is None else displacement.at(pair.target, levels[0])
        still = None if displacement is None else pair.source.triangles(levels[1]).positions
        on_target = target.embedding(target.rows[:, :k1], placed, config)
        on_source = source.embedding(source.rows[:, :k2] @ functional_map.T, still, config)
        matches = nearest_rows(on_target, on_source), nearest_rows(on_source, on_target)
        k1, k2 = min(size, counts[0]), min(size, counts[1])
        of_target, of_source, areas = both_directions(target, source, matches)
        samples = Samples(target.rows[of_target, :k1], areas, np.zeros((len(areas), 0)))
        functional_map = fit_functional_map(samples, source.rows[of_source, :k2], k1)
        functions = max(FEWEST_FUNCTIONS, round(config.displacement_share * k1))
        displacement = fit_displacement(samples, target.positions[of_target], source.positions[of_source], functions)
    assert displacement is not None
    return functional_map, displacement


@dataclass(frozen=True, eq=False)
class LevelSamples:
    """Sampled vertices (b,) of a level, with rows Phi~(x, :) and areas that sum to 1."""

    surface: Surface
    level: int
    vertices: IndexArray
    rows: FloatArray
    areas: FloatArray

    @classmethod
    def of(cls, surface: Surface, level: int) -> LevelSamples:
        """Evenly spaced vertices of a level."""
        vertices = evenly_spaced_vertices(surface.triangles(level).n, ZOOMOUT_SAMPLES)
        areas = surface.operators.areas(level)[vertices]
        rows = functions_at(surface, level, surface.basis.count)[vertices]
        return cls(surface, level, vertices, rows, areas / areas.sum())

    @property
    def positions(self) -> FloatArray:
        """(b, 3) positions of the samples, at unit area."""
        return self.surface.triangles(self.level).positions[self.vertices]

    def embedding(self, spectral: FloatArray, places: FloatArray | None, config: HfmConfig) -> Embedding:
        """Spectral rows (b, k), extended by weighted positions (n, 3) and normals at the samples, if given.

        The extension is scaled by sqrt(k), so that its share does not decrease with k.
        """
        if places is None:
            return spectral.astype(np.float32)
        normals = vertex_normals(places, self.surface.triangles(self.level).triangles)
        extension = np.hstack([config.position_weight * places, config.normal_weight * normals])[self.vertices]
        return np.hstack([spectral, np.sqrt(spectral.shape[1]) * extension]).astype(np.float32)


def both_directions(
    target: LevelSamples, source: LevelSamples, matches: tuple[IndexArray, IndexArray]
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Target samples, source samples and areas of the pairs matched in both directions."""
    forward, backward = matches
    of_target = np.concatenate([np.arange(len(forward)), backward])
    of_source = np.concatenate([forward, np.arange(len(backward))])
    return of_target, of_source, np.concatenate([target.areas, source.areas])


def fit_displacement(samples: Samples, positions: FloatArray, images: FloatArray, functions: int) -> Displacement:
    """Fit the rotation R and tau = Phi~1^+ (P12 X2 - X1 R) to matched points (b, 3)."""
    centred_images, centred_positions = (
        points - samples.areas @ points / samples.areas.sum() for points in (images, positions)
    )
    rotation = Rotation.align_vectors(centred_images, centred_positions, weights=samples.areas)[0].as_matrix().T
    return Displacement(rotation, fit_functional_map(samples, images - positions @ rotation, functions))


def closest_map(pair: Pair, levels: LevelPair, functional_map: FloatArray, displacement: Displacement) -> LevelMap:
    """Map of two levels: the source's closest points, by position and normal, to the displaced target."""
    target, source = pair.target.triangles(levels[0]), pair.source.triangles(levels[1])
    places = displacement.at(pair.target, levels[0])
    points = facing_points(source, places, vertex_normals(places, target.triangles), FACING_WEIGHTS)
    rows = np.arange(len(points))
    match = points.corners[rows, points.barycentric.argmax(axis=1)]
    return LevelMap(levels, functional_map, match, PointMap(target, points))
