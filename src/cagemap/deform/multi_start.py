"""Fits from several starts: ZoomOut from landmark coordinates or from a fit, and landmarks alone; the cheapest wins.

Coarse placements that are apart are refined. Limbs turned about their axis hardly cost anything on the coarse graph;
refined, they do (docs/lab/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cagemap.deform.config import SearchConfig
from cagemap.deform.energy import deformed_normals
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit, fine_stage
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement, distinct_placements, mean_distance
from cagemap.deform.problem import CoarseShape, Problem
from cagemap.deform.refit import largest_limb_rotation
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components
from cagemap.numerics.threads import ThreadPool, in_threads
from cagemap.spectral.landmark_coordinates import landmark_coordinates
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import Samples, ZoomOutSchedule, evenly_spaced_vertices, nearest_coordinates, zoomout

# With fewer landmarks, they only help to choose among hypotheses; from here on they start a fit of their own.
FEWEST_LANDMARKS = 3


def start_map(
    problem: Problem, shape: CoarseShape | None = None, held: tuple[IndexArray, IndexArray] | None = None
) -> FloatArray:
    """(k, 3) places on the source of a coarse shape's vertices: nearest coordinates of held vertices, then ZoomOut."""
    prepared, shape = problem.prepared, shape or problem.shape
    vertices, held = shape.vertices, held or problem.landmark_vertices
    levels, areas = prepared.levels, shape.rest.graph.areas
    areas = areas * prepared.rest.masks.for_vertices(vertices).of_target(len(vertices))
    n_searched = prepared.source.hierarchy.levels[levels[1]].n_vertices
    candidates = np.union1d(evenly_spaced_vertices(n_searched, prepared.start.samples), held[1])
    of_curves = curve_vertices(problem)

    def samples(side: int, chosen: IndexArray, areas: FloatArray) -> Samples:
        surface, level = (prepared.target, prepared.source)[side], levels[side]
        operators = surface.operators
        coordinates = landmark_coordinates(
            operators.stiffness[level], operators.mass[level], held[side], of_curves[side]
        )
        return Samples(basis_rows(surface, level, chosen), areas, coordinates[chosen])

    sides = (0, vertices, areas), (1, candidates, np.ones(len(candidates)))
    target, source = in_threads(lambda side: samples(*side), sides)
    match = zoomout(target, source, nearest_coordinates(target, source), prepared.start.zoomout)
    return prepared.source.triangles(levels[1]).positions[candidates[match]]


def curve_vertices(problem: Problem) -> tuple[list[IndexArray], list[IndexArray]]:
    """Vertices of both levels along every curve, all different; curves that landmarks or others cover are left out."""
    prepared, taken = problem.prepared, list(problem.landmark_vertices)
    found: tuple[list[IndexArray], list[IndexArray]] = ([], [])
    count = prepared.start.curve_points
    for pair in problem.pair.landmarks.curves:
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
    """A function from a fit of a coarse shape to (k, 3) places on the source by ZoomOut from its closest points.

    They find limbs in other poses. The first number of functions says how much of the fit is trusted.
    """
    prepared, shape = problem.prepared, shape or problem.shape
    config, surface = prepared.start, prepared.source_surface
    level = prepared.source.hierarchy.coarsest_level(prepared.elastic.source_vertices)
    vertices = evenly_spaced_vertices(surface.n, config.places)
    places = surface.positions[vertices]
    tree = cKDTree(np.hstack([places, config.normal_length * surface.vertex_normals[vertices]]))
    sides = (
        (prepared.target, prepared.levels[0], shape.vertices, shape.rest.graph.areas),
        (prepared.source, level, vertices, np.ones(len(vertices))),
    )
    target, source = (
        Samples(basis_rows(side, on, chosen), areas, np.zeros((len(chosen), 0))) for side, on, chosen, areas in sides
    )
    schedules = [ZoomOutSchedule(first, config.last_functions, config.growth) for first in config.trusted_functions]

    def starts(fitted: Placement) -> list[FloatArray]:
        assert fitted.graph is not None
        normals = deformed_normals(fitted.graph.normals, fitted.maps)
        near = tree.query(np.hstack([fitted.positions, config.normal_length * normals]))[1]
        match = np.asarray(near, dtype=np.int64)
        return [places[zoomout(target, source, match, schedule)] for schedule in schedules]

    return starts


def basis_rows(surface: Surface, level: int, vertices: IndexArray) -> FloatArray:
    """(q, k) values of all basis functions at vertices of a level, which are vertices of all finer ones."""
    fine = max(level, surface.basis.last_level)
    return surface.basis.rows(fine, surface.hierarchy.vertices_on(fine, level)[vertices])


@dataclass(frozen=True, eq=False)
class AnchoredFits:
    """What held points lead to: landmarks, or the tips of assigned limbs beside them."""

    shape: CoarseShape  # the clusters that hold them
    # Of the soft coarse stage, from the spectral map and from the points' elastic energy alone
    soft: tuple[Placement, ...]
    # The fine stage, which holds landmarks only, from those of the stiff coarse stage; cheapest first
    refined: tuple[Placement, ...]
    # Whether both starts end alike, and no limb is posed otherwise: then no joint needs the soft stage, and the stiff
    # one spreads the strain more evenly
    agree: bool

    @classmethod
    def of(
        cls,
        problem: Problem,
        shape: CoarseShape,
        vertices: tuple[IndexArray, IndexArray],
        start: FloatArray | None = None,
    ) -> AnchoredFits:
        """Fit from both starts; the shape holds vertices (p,) of the levels of target and source that are searched.

        A start (k, 3) stands for the spectral map. It alone counts where too few points are held.
        """
        elastic, stiff = problem.prepared.elastic, problem.stiff
        # The start from the points is another one in the stiff stage: differentials are smoothed over its length.
        stages = (problem, shape), (stiff, shape.smoothed(elastic.stiff_coarse.smoothing))

        def both_stages(rough: FloatArray | None) -> list[Placement]:
            """By the soft coarse stage and by the stiff one."""
            return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), stages)

        if start is not None and len(vertices[0]) < FEWEST_LANDMARKS:
            return cls(shape, (), tuple(refine_placements(problem, both_stages(start))), agree=True)
        with ThreadPool(1) as aside:  # from the points alone, while the functional map is made
            blind = aside.submit(both_stages, None)
            first = both_stages(start_map(problem, shape, vertices) if start is None else start)
            soft, stiff_ones = zip(first, blind.result(), strict=True)
        # The costs of the coarse ones differ too little to choose by; a turned elbow shows on the mesh alone.
        refined = tuple(refine_placements(problem, stiff_ones))
        rotation = largest_limb_rotation(problem.prepared.rest, refined[0].positions, elastic.search.limb_area)
        apart = mean_distance(soft[0].positions, soft[1].positions, shape.rest.graph.areas)
        agree = apart <= elastic.search.doubtful and rotation <= elastic.search.limb_rotation
        return cls(shape, soft, refined, agree)

    def upsampled(self, problem: Problem) -> AnchoredFits:
        """The same with what spectral upsampling makes of the first soft one, and with the best parts of all."""
        starts = spectral_starts(problem, self.shape)(self.soft[0])
        more = in_threads(lambda rough: coarse_fit(problem, rough, self.shape), starts)
        refined = refine_cheapest(problem, [*self.soft, *more], refined=self.refined)
        return replace(self, refined=tuple(refined)).like(self.refined[0])

    def like(self, placed: Placement) -> AnchoredFits:
        """The same with the name and the doubt of a placement."""
        return replace(self, refined=tuple(replace(one, name=placed.name, doubt=placed.doubt) for one in self.refined))


def refine_cheapest(
    problem: Problem, coarse: Sequence[Placement], most: int | None = None, refined: Sequence[Placement] = ()
) -> list[Placement]:
    """The fine stage from the cheapest coarse placements that are apart, with refined ones and their `best_parts`."""
    prepared, config = problem.prepared, problem.prepared.elastic.search
    ranked, areas = sort_by_cost(coarse), problem.shape.rest.graph.areas
    areas = areas if ranked[0].graph is None else ranked[0].graph.areas
    hopeful = [placed for placed in ranked if placed.cost <= config.max_cost * ranked[0].cost]
    kept = distinct_placements(hopeful, areas, config.min_distance)[: most or config.max_refined]
    found = sort_by_cost([*refine_placements(problem, kept), *refined])
    mixed = best_parts(prepared.rest.graph, found, config)
    if mixed is None:
        return found
    return sort_by_cost([*found, evaluate_placement(prepared, fine_stage(problem, mixed))])


def refine_placements(problem: Problem, coarse: Sequence[Placement]) -> list[Placement]:
    """The fine stage from coarse placements, by the cost of the mesh."""
    return sort_by_cost(in_threads(lambda one: evaluate_placement(problem.prepared, fine_fit(problem, one)), coarse))


def sort_by_cost(placements: Iterable[Placement]) -> list[Placement]:
    """Placements sorted by cost, ascending."""
    return sorted(placements, key=lambda placed: placed.cost)


def best_parts(graph: ElasticGraph, ranked: Sequence[Placement], config: SearchConfig) -> FloatArray | None:
    """(n, 3) the cheapest of some placements with those parts of the others that cost less; None if there are none.

    A part is a connected piece of the surface where two placements are apart, a limb most often.
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
    """Number (n,) of the connected piece that vertices are of, rings around it included, -1 elsewhere; share (n,)."""
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
