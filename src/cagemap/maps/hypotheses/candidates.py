"""Candidate alignments without landmarks: many rough starts, of which the best are fitted and ranked by cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cagemap.deform.config import Stage
from cagemap.deform.fit import coarse_fit, with_cost
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.search import refine_best
from cagemap.deform.starts import SpectralSides, spectral_starts
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.rigid_starts import AS_FILED, rigid_starts
from cagemap.maps.hypotheses.tips import OF_ONE_KIND, Tips, led_by_tips
from cagemap.maps.masks import WHOLE
from cagemap.maps.pair import Progress, silent
from cagemap.numerics.threads import in_threads, thread_limit

# Size of the graph on which all starts are tried, from stiff, which turns and shifts as a whole, to soft.
ROUGH_VERTICES = 400
ROUGH = Stage(14, (1.0, 2e-4), 1e-2, momentum=0.6)
# Mean distance, of sqrt(area), of two starts below which one of them is enough, and of two fits that are two answers.
ALIKE, DIFFERENT = 0.03, 0.08
# How many different ones go on to the coarse stage of the fit, and from there to its end; beside them, how the files
# stand, which costs of boxy shapes alone, all sides alike, may put behind.
COARSE, FINISHED = 4, 3
# A fit that costs this many times the best one is not finished.
HOPELESS = 2.5


Candidate = tuple[Placement, ...]  # coarse placements from one start, cheapest first


def found_readings(problem: Problem, progress: Progress = silent) -> tuple[Reading, ...]:
    """Different ways in which the target lies on the source, fitted, best first: by cost and doubt.

    Landmarks, if there are any, are held by all of them. Positions are those of the vertices of the level
    that is deformed.
    """
    progress("possible alignments")
    rough = rough_fits(problem)
    progress("rough alignment")
    candidates = coarse_fits(problem, rough)
    progress("elastic alignment")

    def refine(candidate: Candidate) -> Placement:
        refined = refine_best(problem, candidate, None if candidate is candidates[0] else 1)[0]
        return replace(refined, name=candidate[0].name, doubt=candidate[0].doubt)

    found = in_threads(refine, candidates)
    if min(placed.cost for placed in found) > OF_ONE_KIND:
        tips = Tips.of(problem)
        found = in_threads(lambda placed: led_by_tips(problem, tips, placed), found)
    least, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    ranked = sorted(found, key=lambda placed: placed.doubt * max(placed.cost, least))
    return tuple(
        Reading(placed.name, placed.cost, placed.positions, placed.doubt)
        for placed in distinct(ranked, areas, DIFFERENT)
    )


def least_cost(prepared: PreparedPair) -> float:
    """Discretisation floor of the cost: the target fitted to itself. Costs below it are ties.

    What costs less is as good as what costs as much: a box turned upon itself stretches affinely, which is free, and
    its samples may fall better. Under masks a fit costs less because less of it counts, and so does this.
    """
    target, rest, own = prepared.target, prepared.rest, replace(prepared.rest, masks=WHOLE)
    surface = target.triangles(target.hierarchy.coarsest_level(prepared.elastic.source_vertices))
    on_itself = replace(prepared, rest=own, source_surface=surface)
    counts = rest.graph.areas @ rest.masks.of_target(rest.graph.n), prepared.source_samples.areas.sum()
    return float(min(counts)) * with_cost(on_itself, rest.graph.positions).cost


def rough_problem(problem: Problem) -> Problem:
    """The same on the small graph on which all starts are tried."""
    return problem.staged(ROUGH, ROUGH_VERTICES)


def rough_fits(problem: Problem) -> list[Candidate]:
    """The different placements of all rigid starts on a small graph, cheapest first."""
    rough = rough_problem(problem)
    small = rough.shape.rest.graph

    def trial(start: Placement) -> Placement:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            return replace(coarse_fit(rough, start.positions), name=start.name, doubt=start.doubt)

    starts = rigid_starts(small.positions, problem.prepared.source_surface.positions)
    tried = in_threads(trial, distinct(starts, small.areas, ALIKE))
    ranked = sorted(tried, key=lambda placed: placed.rank)
    kept = _first([(placed,) for placed in distinct(ranked, small.areas, DIFFERENT)], COARSE)
    # What starts of several names lead to has the first one's, which is the simplest.
    firsts = [
        next(t for t in tried if mean_distance(t.positions, one.positions, small.areas) < DIFFERENT) for (one,) in kept
    ]
    return [(replace(one, name=first.name, doubt=first.doubt),) for first, (one,) in zip(firsts, kept, strict=True)]


def coarse_fits(problem: Problem, rough: Sequence[Candidate]) -> list[Candidate]:
    """Coarse placements of each rough one: from where it is, and from what spectral upsampling makes of that."""
    graph = problem.shape.rest.graph
    sides = SpectralSides.build(problem)

    def improve(candidate: Candidate) -> Candidate:
        (placed,) = candidate
        with thread_limit(1):
            own = coarse_fit(problem, placed.on(graph, problem.prepared.elastic.graph))
            others = [coarse_fit(problem, start) for start in spectral_starts(own, sides)]
        named = [replace(one, name=placed.name, doubt=placed.doubt) for one in (own, *others)]
        return tuple(sorted(named, key=lambda one: one.cost))

    improved = sorted(in_threads(improve, rough), key=lambda candidate: candidate[0].rank)
    best = distinct([candidate[0] for candidate in improved], graph.areas, DIFFERENT)
    kept = [candidate for candidate in improved if candidate[0] in best]
    hopeful = [candidate for candidate in kept if candidate[0].cost <= HOPELESS * kept[0][0].cost]
    return _first(hopeful, FINISHED)


def _first(ranked: Sequence[Candidate], count: int) -> list[Candidate]:
    """The first candidates, and of the others the one that lies as the files stand."""
    return [*ranked[:count], *(one for one in ranked[count:] if one[0].name == AS_FILED)]
