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
from cagemap.maps.functional_maps import LevelMap, MapLike, functional_map_from
from cagemap.maps.pair import LevelPair, Pair, Progress, no_progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import facing_points
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.paper.constraints import ConstraintConfig, Constraints, gather_constraints
from cagemap.paper.embeddings import functions_at, spectral_rows
from cagemap.paper.equations import solve_functional_map
from cagemap.paper.method import FEWEST_FUNCTIONS, finer_level_pairs, search_levels
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import ZoomOutSchedule, evenly_spaced_vertices, fit_functional_map, nearest_rows
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals

ZOOMOUT_SAMPLES = 3000  # number of vertices of each surface in ZoomOut
FACING_WEIGHTS = (0.03, 0.1)  # weights of normals: first search; where the sides of a thin part differ
Displacement = tuple[FloatArray, FloatArray]  # of x to x R + Phi~1 tau: rotation R (3, 3), coefficients tau (k, 3)


@dataclass(frozen=True, repr=False)
class HfmConfig(ConstraintConfig):
    """Parameters of `hfm`; the defaults were found by measurement."""

    zoomout: ZoomOutSchedule = ZoomOutSchedule()  #: eq. 13 is solved for the first number of functions
    position_weight: float = 10.0  #: weight of displaced positions relative to basis functions, times sqrt(k)
    normal_weight: float = 1.0  #: weight of the displaced normals, times sqrt(k)
    displacement_share: float = 0.5  #: number of functions of the displacement, as a share of C's
    search_vertices: int = 2000  #: ZoomOut runs on each side's coarsest level with at least this many vertices
    source_search_vertices: int = 0  #: the same number for the source, if it differs; 0: as for the target

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.zoomout.first < FEWEST_FUNCTIONS:
            raise ParameterError(f"expected at least {FEWEST_FUNCTIONS} first functions, got {self.zoomout.first}")


@kinds_checked
def hfm_map(
    pair: Pair,
    config: HfmConfig = HfmConfig(),
    progress: Progress = no_progress,
    *,
    constraints: Constraints | None = None,
    start: MapLike | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of the search levels and all finer ones, and the finest point map T12.

    The options are those of `cagemap.paper.method.paper_map`; a start is a map of the first functions. ParameterError
    if the surfaces have too few basis functions.
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
        constraints = gather_constraints(pair, config) if constraints is None else constraints
        functional_map = solve_functional_map(constraints.leading(first, first), config)
    else:
        functional_map = functional_map_from(pair, start, (first, first))
    functional_map, displacement = zoomout_all_bands(pair, levels, functional_map, config)
    maps = []
    for finer in [levels, *finer_level_pairs(pair, levels)]:
        progress(f"point map, levels {finer[0]} and {finer[1]}")
        maps.append(closest_map(pair, finer, functional_map, displacement))
    points = maps[-1].points
    assert points is not None
    return tuple(maps), points


def zoomout_all_bands(
    pair: Pair, levels: LevelPair, functional_map: FloatArray, config: HfmConfig
) -> tuple[FloatArray, Displacement]:
    """C12 of all bands and the displacement, by ZoomOut in both directions from an initial C12."""
    target, source = pair.target.triangles(levels[0]), pair.source.triangles(levels[1])
    sampled = [evenly_spaced_vertices(mesh.n, ZOOMOUT_SAMPLES) for mesh in (target, source)]
    sides = list(zip((pair.target, pair.source), levels, sampled, strict=True))
    rows = [functions_at(surface, level, surface.basis.count)[vertices] for surface, level, vertices in sides]
    areas = [surface.operators.areas(level)[vertices] for surface, level, vertices in sides]
    shares = areas[0] / areas[0].sum(), areas[1] / areas[1].sum()
    counts = rows[0].shape[1], rows[1].shape[1]
    displacement: Displacement | None = None
    for size in config.zoomout.sizes(max(counts)):
        k1, k2 = functional_map.shape
        on_target, on_source = rows[0][:, :k1], rows[1][:, :k2] @ functional_map.T
        if displacement is not None:
            places = displaced_vertices(pair.target, levels[0], displacement)
            on_target = extended_rows(on_target, places, target, sampled[0], config)
            on_source = extended_rows(on_source, source.positions, source, sampled[1], config)
        embeddings = on_target.astype(np.float32), on_source.astype(np.float32)
        matches = nearest_rows(*embeddings), nearest_rows(*embeddings[::-1])
        k1, k2 = min(size, counts[0]), min(size, counts[1])
        of_target, of_source, weights = both_directions(shares, matches)
        target_rows = rows[0][of_target, :k1]
        functional_map = fit_functional_map(target_rows, weights, rows[1][of_source, :k2])
        functions = max(FEWEST_FUNCTIONS, round(config.displacement_share * k1))
        points, images = target.positions[sampled[0]][of_target], source.positions[sampled[1]][of_source]
        displacement = fit_displacement(target_rows[:, :functions], weights, points, images)
    assert displacement is not None
    return functional_map, displacement


def extended_rows(
    rows: FloatArray, places: FloatArray, mesh: TriangleSurface, vertices: IndexArray, config: HfmConfig
) -> FloatArray:
    """Spectral rows (b, k) with weighted positions and normals of the mesh at places (n, 3), times sqrt(k)."""
    normals = vertex_normals(places, mesh.triangles)
    extension = np.hstack([config.position_weight * places, config.normal_weight * normals])[vertices]
    return np.hstack([rows, np.sqrt(rows.shape[1]) * extension])


def both_directions(
    areas: tuple[FloatArray, FloatArray], matches: tuple[IndexArray, IndexArray]
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Target samples, source samples and areas of the pairs matched in both directions; areas of each sum to 1."""
    forward, backward = matches
    of_target = np.concatenate([np.arange(len(forward)), backward])
    of_source = np.concatenate([forward, np.arange(len(backward))])
    return of_target, of_source, np.concatenate(areas)


def fit_displacement(rows: FloatArray, areas: FloatArray, positions: FloatArray, images: FloatArray) -> Displacement:
    """Fit the rotation R and tau = Phi~1^+ (P12 X2 - X1 R) to matched points (b, 3) with rows (b, k) of Phi~1."""
    centred_images, centred_positions = (points - areas @ points / areas.sum() for points in (images, positions))
    rotation = Rotation.align_vectors(centred_images, centred_positions, weights=areas)[0].as_matrix().T
    return rotation, fit_functional_map(rows, areas, images - positions @ rotation)


def displaced_vertices(surface: Surface, level: int, displacement: Displacement) -> FloatArray:
    """(n_level, 3) displaced vertices of a level of the target."""
    positions, (rotation, coefficients) = surface.triangles(level).positions, displacement
    rows = spectral_rows(surface, level, len(coefficients), coefficients)
    return positions @ rotation + rows(np.arange(len(positions)))


def closest_map(pair: Pair, levels: LevelPair, functional_map: FloatArray, displacement: Displacement) -> LevelMap:
    """Map of two levels: the source's closest points, by position and normal, to the displaced target."""
    target, source = pair.target.triangles(levels[0]), pair.source.triangles(levels[1])
    places = displaced_vertices(pair.target, levels[0], displacement)
    points = facing_points(source, places, vertex_normals(places, target.triangles), FACING_WEIGHTS)
    return LevelMap(levels, functional_map, points.heaviest_corners, PointMap(target, points))
