"""Fits from several starts: ZoomOut from landmark coordinates or from a fit, and landmarks alone; the cheapest wins.

Different coarse placements are refined before they are compared: a limb rotated about its axis costs almost nothing on
the coarse graph, but does on the mesh (docs/lab/fit_experiments.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cagemap.deform.config import SearchConfig
from cagemap.deform.energy import deformed_normals
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement, distinct_placements, mean_distance
from cagemap.deform.problem import CoarseShape, Problem
from cagemap.deform.refit import largest_limb_rotation
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components
from cagemap.numerics.threads import ThreadPool, in_threads
from cagemap.spectral.landmark_coordinates import landmark_coordinates
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import ZoomOutSchedule, evenly_spaced_vertices, nearest_rows, zoomout

# Landmarks from which on they give a start of their own; fewer only restrict the search.
FEWEST_LANDMARKS = 3


def start_map(problem: Problem, shape: CoarseShape | None = None) -> FloatArray:
    """(k, 3) places on the source of a coarse shape's vertices: nearest coordinates of held points, then ZoomOut."""
    prepared, shape = problem.prepared, shape or problem.shape
    vertices, held = shape.vertices, shape.held
    levels, areas = prepared.levels, shape.rest.graph.areas
    areas = areas * prepared.rest.masks.for_vertices(vertices).of_target(len(vertices))
    n_searched = prepared.source.hierarchy.levels[levels[1]].n_vertices
    candidates = np.union1d(evenly_spaced_vertices(n_searched, prepared.start.samples), held[1])
    of_curves = curve_vertices(problem)

    def sampled(side: int, chosen: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Basis rows and landmark coordinates of chosen vertices."""
        surface, level = (prepared.target, prepared.source)[side], levels[side]
        operators = surface.operators
        coordinates = landmark_coordinates(
            operators.stiffness[level], operators.mass[level], held[side], of_curves[side]
        )
        return basis_rows(surface, level, chosen), coordinates[chosen]

    sides = in_threads(lambda side: sampled(*side), ((0, vertices), (1, candidates)))
    (target, on_target), (source, on_source) = sides
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


def spectral_starts(problem: Problem, shape: CoarseShape | None = None) -> Callable[[Placement], list[FloatArray]]:
    """A function that gives starts (k, 3) from a coarse fit, by ZoomOut from its closest points.

    They find limbs in other poses. One start for each number of functions that the fit is trusted to determine.
    """
    prepared, shape = problem.prepared, shape or problem.shape
    config, surface = prepared.start, prepared.source_surface
    level = prepared.source.hierarchy.coarsest_level(prepared.elastic.source_vertices)
    vertices = evenly_spaced_vertices(surface.n, config.places)
    places = surface.positions[vertices]
    tree = cKDTree(np.hstack([places, config.normal_length * surface.vertex_normals[vertices]]))
    target = basis_rows(prepared.target, prepared.levels[0], shape.vertices)
    source, areas = basis_rows(prepared.source, level, vertices), shape.rest.graph.areas
    schedules = [ZoomOutSchedule(first, config.last_functions, config.growth) for first in config.trusted_functions]

    def starts(fitted: Placement) -> list[FloatArray]:
        assert fitted.graph is not None
        normals = deformed_normals(fitted.graph.normals, fitted.maps)
        near = tree.query(np.hstack([fitted.positions, config.normal_length * normals]))[1]
        match = np.asarray(near, dtype=np.int64)
        return [places[zoomout(target, areas, source, match, schedule)] for schedule in schedules]

    return starts


def basis_rows(surface: Surface, level: int, vertices: IndexArray) -> FloatArray:
    """(q, k) values of all basis functions at vertices of a level, which are vertices of all finer ones."""
    fine = max(level, surface.basis.last_level)
    return surface.basis.rows(fine, surface.hierarchy.vertices_on(fine, level)[vertices])


def fit_held(
    problem: Problem, shape: CoarseShape, start: FloatArray | None = None
) -> tuple[list[Placement], list[Placement]]:
    """Refined placements from the functional map and from the held points, and the soft coarse ones of both.

    `refine_more_starts` takes the soft ones. There are none if both starts end in one placement and no limb is in
    another pose: then the stiff stage is enough, and it spreads the strain more evenly. A start (k, 3) replaces the
    functional map; it is the only start where too few points are held.
    """
    elastic, stiff = problem.prepared.elastic, problem.stiff
    # The smoothing of a stage also decides its start from the held points.
    stages = (problem, shape), (stiff, shape.smoothed(elastic.stiff_coarse.smoothing))

    def both_stages(rough: FloatArray | None) -> list[Placement]:
        """Placements of the soft and of the stiff coarse stage."""
        return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), stages)

    if start is not None and len(shape.held[0]) < FEWEST_LANDMARKS:
        return refine_placements(problem, both_stages(start)), []
    with ThreadPool(1) as pool:  # at the same time as the functional map
        from_points = pool.submit(both_stages, None)
        first = both_stages(start_map(problem, shape) if start is None else start)
        soft, stiff_ones = zip(first, from_points.result(), strict=True)
    # Costs of coarse placements differ too little to choose by: a rotated elbow costs only on the mesh.
    refined = refine_placements(problem, stiff_ones)
    rotation = largest_limb_rotation(problem.prepared.rest, refined[0].positions, elastic.search.limb_area)
    distance = mean_distance(soft[0].positions, soft[1].positions, shape.rest.graph.areas)
    agree = distance <= elastic.search.doubtful and rotation <= elastic.search.limb_rotation
    return refined, [] if agree else list(soft)


def refine_more_starts(
    problem: Problem, shape: CoarseShape, refined: Sequence[Placement], soft: Sequence[Placement]
) -> list[Placement]:
    """Refined placements of `fit_held` and more: from spectral starts of the first soft one, and best parts of all."""
    starts = spectral_starts(problem, shape)(soft[0])
    more = in_threads(lambda rough: coarse_fit(problem, rough, shape), starts)
    return [one.named_like(refined[0]) for one in refine_cheapest(problem, [*soft, *more], refined=refined)]


def refine_cheapest(
    problem: Problem, coarse: Sequence[Placement], most: int | None = None, refined: Sequence[Placement] = ()
) -> list[Placement]:
    """Fine placements from the cheapest different coarse ones, those already refined, and their `best_parts`."""
    prepared, config = problem.prepared, problem.prepared.elastic.search
    ranked, areas = sort_by_cost(coarse), problem.shape.rest.graph.areas
    areas = areas if ranked[0].graph is None else ranked[0].graph.areas
    cheap = [placed for placed in ranked if placed.cost <= config.max_cost * ranked[0].cost]
    kept = distinct_placements(cheap, areas, config.min_distance)[: most or config.max_refined]
    fine = sort_by_cost([*refine_placements(problem, kept), *refined])
    mixed = best_parts(prepared.rest.graph, fine, config)
    if mixed is None:
        return fine
    return sort_by_cost([*fine, evaluate_placement(prepared, fine_fit(problem, mixed))])


def refine_placements(problem: Problem, coarse: Sequence[Placement]) -> list[Placement]:
    """Fine placements from coarse ones, cheapest first."""
    return sort_by_cost(in_threads(lambda one: evaluate_placement(problem.prepared, fine_fit(problem, one)), coarse))


def sort_by_cost(placements: Iterable[Placement]) -> list[Placement]:
    """Placements sorted by cost, ascending."""
    return sorted(placements, key=lambda placed: placed.cost)


def best_parts(graph: ElasticGraph, ranked: Sequence[Placement], config: SearchConfig) -> FloatArray | None:
    """(n, 3) the cheapest placement, with cheaper parts of the others in it; None if no part is cheaper.

    A part is a connected piece of the surface where two placements differ, such as a limb.
    """
    positions, costs, changed = ranked[0].positions, ranked[0].costs, False
    for other in ranked[1:]:
        apart = np.linalg.norm(positions - other.positions, axis=1) > config.part_distance
        part, share = _parts(graph, apart, config.part_rings)
        inside, count = part >= 0, int(part.max()) + 1
        gains = np.bincount(part[inside], (costs - other.costs)[inside], count)
        areas = np.bincount(part[apart], graph.areas[apart], count)
        better = np.append((gains > 0) & (areas >= config.part_area), False)
        share = share * better[part]
        positions = positions + share[:, None] * (other.positions - positions)
        costs, changed = np.where(share > 0, other.costs, costs), changed or bool(better.any())
    return positions if changed else None


def _parts(graph: ElasticGraph, apart: NDArray[np.bool_], rings: int) -> tuple[IndexArray, FloatArray]:
    """Part (n,) of each vertex, -1 for none, and its weight (n,), which fades over rings around the part."""
    both = apart[graph.heads] & apart[graph.tails]
    _, numbers = np.unique(label_components(graph.heads[both], graph.tails[both], graph.n)[apart], return_inverse=True)
    part, share = np.full(graph.n, -1), apart.astype(np.float64)
    part[apart] = numbers
    for ring in range(rings):
        reached = np.full(graph.n, -1)
        np.maximum.at(reached, graph.heads, part[graph.tails])
        new = (part < 0) & (reached >= 0)
        part[new], share[new] = reached[new], 1.0 - (ring + 1) / (rings + 1)
    return part, share
