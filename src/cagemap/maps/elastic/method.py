"""The default method: the spectral map with landmark coordinates finds the basin, the elastic fit finishes in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.basis import Surface
from cagemap.geometry.closest import TriangleTree, build_tree
from cagemap.maps.elastic.fit import ElasticConfig, RestShape, coarse_fit, fit
from cagemap.maps.elastic.update import respond
from cagemap.maps.pair import Pair, Progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import finest_surface, fit_shapes, level_graph, project, refined_positions
from cagemap.maps.quality import map_positions
from cagemap.maps.spectral.constraints import gather_constraints
from cagemap.maps.spectral.hierarchical import HierarchyConfig, grown_map, search_levels
from cagemap.maps.spectral.landmark_coordinates import landmark_coordinates
from cagemap.maps.spectral.samples import FIT_SAMPLES, Samples, fit_functional_map, spread
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool, in_threads
from cagemap.refinement import level_triangles

# Source vertices that a start is sought among: twice as many as there are vertices to start.
START_SAMPLES = 3000
START_GROWTH = 1.5


@dataclass(frozen=True)
class RefinedConfig:
    """Parameters of the two halves of the method."""

    hierarchy: HierarchyConfig = HierarchyConfig()
    elastic: ElasticConfig = ElasticConfig()


def refined_map(pair: Pair, config: RefinedConfig, progress: Progress = lambda stage: None) -> PointMap:
    """Point map T12 of the finest levels.

    The functional map starts as the paper's (eqs. 13-16) and grows on the search levels beside harmonic and biharmonic
    landmark coordinates; the elastic fit deforms the target's search level onto the source, and its subdivision is
    projected once.

    Raises
    ------
    InvalidLandmarksError
        If there are fewer than two landmarks.
    """
    levels = search_levels(pair, config.hierarchy)
    fitted, tree = _fitted(pair, levels, config, progress)
    progress("projection")
    return project(refined_positions(pair.target.refinement, levels[0], fitted), pair, tree, config.elastic)


def updated_map(
    pair: Pair, point_map: PointMap, config: RefinedConfig, progress: Progress = lambda stage: None
) -> PointMap:
    """Point map T12 of the finest levels after landmarks changed, from the one before.

    Parameters
    ----------
    pair : Pair
        With the landmarks as they are now.
    point_map : PointMap
        Of the finest levels.
    config : RefinedConfig
    progress : callable
    """
    progress("elastic response")
    level = search_levels(pair, config.hierarchy)[0]
    graph, triangles = level_graph(pair.target, level)
    on_source, source_triangles = finest_surface(pair.source)
    before = point_map.triangle[: graph.n], point_map.barycentric[: graph.n]
    images = map_positions(on_source, source_triangles, *before)
    fitted = respond(graph, triangles, images, pair.target_landmarks, on_source[pair.source_landmarks], config.elastic)
    progress("projection")
    tree = build_tree(on_source, source_triangles)
    return project(refined_positions(pair.target.refinement, level, fitted), pair, tree, config.elastic)


def start_map(
    pair: Pair, levels: tuple[int, int], vertices: IndexArray, areas: FloatArray, config: HierarchyConfig
) -> IndexArray:
    """Where the spectral map sends some vertices: all that the elastic fit needs to know of it.

    Parameters
    ----------
    pair : Pair
    levels : (int, int)
        Levels of target and source that are searched.
    vertices : (q,) int64
        Target vertices of that level.
    areas : (q,) float64
        Share of the surface that each stands for.
    config : HierarchyConfig

    Returns
    -------
    (q,) int64
        Source vertices of their level.
    """
    constraints = gather_constraints(pair, config.descriptors)
    candidates = spread(len(pair.source.refinement.levels[levels[1]].positions), START_SAMPLES)
    candidates = np.union1d(candidates, pair.source_landmarks)
    sides = [
        (pair.target, levels[0], pair.target_landmarks, vertices, areas),
        (pair.source, levels[1], pair.source_landmarks, candidates, np.ones(len(candidates))),
    ]
    target, source = in_threads(lambda side: _samples(*side), sides)
    _, match = grown_map(constraints, target, source, config, START_GROWTH)
    return candidates[match]


def functional_map_of(pair: Pair, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2)."""
    target, source = pair.target, pair.source
    chosen = spread(len(point_map.triangle), FIT_SAMPLES)
    corners, places = np.unique(
        level_triangles(source.refinement, source.finest)[point_map.triangle[chosen]], return_inverse=True
    )
    at_vertices, at_corners = in_threads(
        lambda side: side[0].basis.rows(side[0].finest, side[1]),
        [(target, chosen), (source, corners)],
    )
    weights = point_map.barycentric[chosen]
    pulled = sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3))
    samples = Samples(at_vertices, target.operators.finest_areas[chosen], np.zeros((len(chosen), 0)))
    return fit_functional_map(samples, pulled, target.basis.count)


def _fitted(
    pair: Pair, levels: tuple[int, int], config: RefinedConfig, progress: Progress
) -> tuple[FloatArray, TriangleTree]:
    """Positions of the target's search level on the source, and the tree of the source's finest triangles."""
    on_source, triangles = finest_surface(pair.source)
    places, elastic = on_source[pair.source_landmarks], config.elastic
    progress("functional map")
    shapes = fit_shapes(pair, levels[0], elastic)
    with ThreadPool(1) as aside:  # what does not need the functional map, in the order in which it is asked for
        coarse = aside.submit(RestShape.build, shapes.coarse, None, elastic.coarse.smoothing)
        blind = aside.submit(lambda: coarse_fit(coarse.result(), shapes.sheet, None, places, elastic))
        fine = aside.submit(RestShape.build, shapes.graph, shapes.triangles, elastic.fine.smoothing)
        tree = aside.submit(build_tree, on_source, triangles)
        match = start_map(pair, levels, shapes.vertices, shapes.coarse.areas, config.hierarchy)
        progress("elastic fit")
        guided = coarse_fit(coarse.result(), shapes.sheet, on_source[match], places, elastic)
        started = guided, blind.result()
        return fit(shapes, fine.result(), started, pair.target_landmarks, places, elastic), tree.result()


def _samples(surface: Surface, level: int, landmarks: IndexArray, vertices: IndexArray, areas: FloatArray) -> Samples:
    """Some vertices of a level, with their landmark coordinates."""
    operators = surface.operators
    coordinates = landmark_coordinates(operators.stiffness[level], operators.mass[level], landmarks)
    return Samples(surface.basis.rows(level, vertices), areas, coordinates[vertices])
