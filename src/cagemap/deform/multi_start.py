"""Fits from several starts: ZoomOut from landmark coordinates or from a fit, and landmarks alone; the cheapest wins.

Different coarse placements are refined before they are compared: a limb rotated about its axis costs almost nothing on
the coarse graph, but does on the mesh (docs/lab/fit_experiments.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.energy import deformed_normals
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit, landmark_start
from cagemap.deform.placement import Placement, best_parts, distinct_placements, mean_distance, sort_by_cost
from cagemap.deform.problem import Clusters, Problem
from cagemap.deform.refit import largest_limb_rotation
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool, in_threads
from cagemap.spectral.zoomout import (
    ZoomOutSchedule,
    evenly_spaced_vertices,
    landmark_coordinates,
    nearest_rows,
    zoomout,
)

# Landmarks from which on they give a start of their own; fewer only restrict the search.
FEWEST_LANDMARKS = 3


class StartFits(NamedTuple):
    """Coarse fits from two starts, ZoomOut and the constrained points alone; and ZoomOut's start, for other stages."""

    placements: list[Placement]
    start: FloatArray  # (k, 3)


def fit_from_two_starts(
    problem: Problem, clusters: Clusters, start: FloatArray | None = None, stiff_fits: StartFits | None = None
) -> tuple[list[Placement], list[Placement]]:
    """Fine placements from two starts, cheapest first; and the soft coarse ones of both, none if the starts agree.

    The starts are ZoomOut from landmark coordinates (`zoomout_start`), or positions ``start`` (k, 3), and the
    constrained points alone (`landmark_start`). Clusters are fitted from each by the stiff coarse stage, which spreads
    strain evenly (unless these ``stiff_fits`` are given), and the distinct placements are refined. The starts disagree
    if these are far apart or a limb of the best one is rotated; then the soft stage, that of ``clusters``, is fitted
    too, for `spectral_starts`. With a start and fewer than three constrained points nothing else is possible: it is
    fitted by both stages.
    """
    elastic, areas = problem.prepared.elastic, clusters.energy.graph.areas
    stiff = clusters.with_stage(elastic.stiff_coarse)
    if start is not None and len(clusters.constrained_vertices[0]) < FEWEST_LANDMARKS:
        both_stages = in_threads(lambda chosen: coarse_fit(problem, start, chosen), (clusters, stiff))
        return refine_placements(problem, both_stages), []
    coarse, first = stiff_fits or fit_both_starts(problem, stiff, start)
    search = elastic.search
    # Costs of different coarse placements are too alike to choose by: a rotated elbow shows in the fine stage alone.
    distinct = distinct_placements(sort_by_cost(coarse), areas, search.min_coarse_distance)
    fine = refine_placements(problem, distinct)
    rotation = largest_limb_rotation(
        problem.prepared.energy, problem.prepared.level_masks, fine[0].positions, search.limb_area
    )
    distance = mean_distance(coarse[0].positions, coarse[1].positions, areas)
    if distance <= search.max_start_distance and rotation <= search.max_limb_rotation:
        return fine, []
    return fine, fit_both_starts(problem, clusters, first).placements


def fit_both_starts(problem: Problem, clusters: Clusters, start: FloatArray | None = None) -> StartFits:
    """Coarse fits from ZoomOut, or from positions (k, 3) in its place, and from the constrained points alone."""
    with ThreadPool(1) as pool:  # at the same time as ZoomOut
        from_points = pool.submit(lambda: coarse_fit(problem, landmark_start(problem, clusters), clusters))
        start = zoomout_start(problem, clusters) if start is None else start
        return StartFits([coarse_fit(problem, start, clusters), from_points.result()], start)


def zoomout_start(problem: Problem, clusters: Clusters) -> FloatArray:
    """(k, 3) places on the source of clusters, by ZoomOut from the constrained points' coordinates."""
    prepared = problem.prepared
    vertices, constrained = clusters.vertices, clusters.constrained_vertices
    levels, areas = prepared.levels, clusters.energy.graph.areas
    areas = areas * clusters.masks.of_target(len(vertices))
    n_searched = prepared.source.hierarchy.levels[levels[1]].n_vertices
    candidates = np.union1d(evenly_spaced_vertices(n_searched, prepared.start.samples), constrained[1])
    of_curves = curve_vertices(problem)

    def sampled(side: int, chosen: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Basis rows and landmark coordinates of chosen vertices."""
        surface, level = (prepared.target, prepared.source)[side], levels[side]
        operators = surface.operators
        coordinates = landmark_coordinates(
            operators.stiffness[level], operators.mass[level], constrained[side], of_curves[side]
        )
        return surface.basis_rows(chosen, level), coordinates[chosen]

    (target, on_target), (source, on_source) = in_threads(lambda side: sampled(*side), ((0, vertices), (1, candidates)))
    coordinates = on_target, on_source
    match = nearest_rows(*(values.astype(np.float32) for values in coordinates))
    match = zoomout(target, areas, source, match, prepared.start.zoomout, coordinates)
    return prepared.source.triangles(levels[1]).positions[candidates[match]]


def curve_vertices(problem: Problem) -> tuple[list[IndexArray], list[IndexArray]]:
    """Vertices of both levels along each curve, no vertex twice; a curve without free vertices is left out."""
    prepared, taken = problem.prepared, list(problem.landmark_vertices)
    found: tuple[list[IndexArray], list[IndexArray]] = ([], [])
    count = prepared.start.curve_points
    for pair in problem.landmarks.curves:
        own = []
        sides = (prepared.target, prepared.levels[0], pair.target), (prepared.source, prepared.levels[1], pair.source)
        for side, (surface, level, curve) in enumerate(sides):
            places = curve.points.positions[curve.line.spread(count)]
            near = cKDTree(surface.triangles(level).positions).query(places)[1]
            own.append(np.setdiff1d(np.asarray(near, dtype=np.int64), taken[side]))
            taken[side] = np.union1d(taken[side], own[side])
        if all(len(vertices) for vertices in own):
            for listed, vertices in zip(found, own, strict=True):
                listed.append(vertices)
    return found


def spectral_starts(problem: Problem, clusters: Clusters) -> Callable[[Placement], list[FloatArray]]:
    """A function that gives starts (k, 3) from a coarse fit, by ZoomOut from its closest points.

    They find limbs in other poses. One start for each number of functions that the fit is trusted to determine.
    """
    prepared = problem.prepared
    config, surface = prepared.start, prepared.source_surface
    vertices = evenly_spaced_vertices(surface.n, config.samples)
    places = surface.positions[vertices]
    tree = cKDTree(np.hstack([places, config.normal_length * surface.vertex_normals[vertices]]))
    target = prepared.target.basis_rows(clusters.vertices, prepared.levels[0])
    source, areas = prepared.source.basis_rows(vertices, prepared.source_level), clusters.energy.graph.areas
    schedules = [ZoomOutSchedule(first, config.last_functions, config.growth) for first in config.trusted_functions]

    def starts(fitted: Placement) -> list[FloatArray]:
        assert fitted.graph is not None
        normals = deformed_normals(fitted.graph.normals, fitted.maps)
        near = tree.query(np.hstack([fitted.positions, config.normal_length * normals]))[1]
        match = np.asarray(near, dtype=np.int64)
        return [places[zoomout(target, areas, source, match, schedule)] for schedule in schedules]

    return starts


def refine_cheapest(problem: Problem, coarse: Sequence[Placement], fine: Sequence[Placement] = ()) -> list[Placement]:
    """Fine placements, cheapest first: from the cheapest distinct coarse ones, given ones, and `best_parts` of all."""
    prepared, config = problem.prepared, problem.prepared.elastic.search
    ranked = sort_by_cost(coarse)
    graph = ranked[0].graph
    assert graph is not None
    cheap = [placed for placed in ranked if placed.cost <= config.max_cost * ranked[0].cost]
    kept = distinct_placements(cheap, graph.areas, config.min_coarse_distance)[: config.max_refined]
    fine = sort_by_cost([*refine_placements(problem, kept), *fine])
    mixed = best_parts(prepared.energy.graph, fine, config)
    if mixed is None:
        return fine
    return sort_by_cost([*fine, evaluate_placement(prepared, fine_fit(problem, mixed))])


def refine_placements(problem: Problem, coarse: Sequence[Placement]) -> list[Placement]:
    """Fine placements from coarse ones, cheapest first."""
    return sort_by_cost(
        in_threads(lambda start: evaluate_placement(problem.prepared, fine_fit(problem, start)), coarse)
    )
