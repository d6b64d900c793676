"""Search for the cheapest placement: from landmarks, from assigned limbs, from the files' own alignment."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cagemap.deform.multi_start import FEWEST_LANDMARKS, AnchoredFits, finished
from cagemap.deform.placement import Placement, distinct
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.candidates import least_cost, released_fits, rough_fits
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.tips import Tips, led_by_tips
from cagemap.maps.pair import Progress, silent
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads

# Suffix of an alignment's name where a better one has the same rotation but assigns limbs differently.
ANOTHER_WAY = " (limbs assigned differently)"


def search(
    problem: Problem,
    progress: Progress = silent,
    start: FloatArray | None = None,
    show: Callable[[Placement], None] = lambda _: None,
) -> list[Placement]:
    """Placements of the target's mesh, best first by cost and doubt; all of them hold the landmarks.

    Enough landmarks start fits of their own. Where these disagree, or landmarks are too few, limbs are assigned to
    limbs in the ways that the landmarks leave, and the cheapest placement wins. The best one is led to the tips that it
    missed and finished, unless bodies of one kind stand alike.

    Parameters
    ----------
    problem : Problem
    progress : callable
    start : (k, 3) float64, optional
        Places on the source of the coarse shape's vertices, instead of the spectral map of the landmarks; no others are
        tried. It alone counts where there are fewer than `FEWEST_LANDMARKS`.
    show : callable
        Called during the search with placements of the small graph that rough fits use.
    """
    decided = start is not None or len(problem.pair.landmarks) >= FEWEST_LANDMARKS
    fits, found = list[AnchoredFits](), list[Placement]()
    if decided:
        progress("first alignment")
        fits.append(AnchoredFits.of(problem, problem.shape, problem.landmark_vertices, start))
        if fits[0].agree:
            return list(fits[0].refined)
    if start is None:
        progress("possible alignments")
        assigned, released = rough_fits(problem, not decided, show)
        progress("rough alignment")
        fits += [AnchoredFits.of(problem, one.shape(problem), one.vertices).like(rough) for one, rough in assigned]
        found = released_fits(problem, released)
    progress("elastic alignment")
    if fits:
        first, *others = sorted(fits, key=lambda one: one.refined[0].rank)
        best = first if first.agree else first.upsampled(problem)
        found += [*best.refined[: None if decided else 1], *(one.refined[0] for one in others)]
    least, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    config = problem.prepared.elastic.hypotheses

    def best_first(placements: Sequence[Placement]) -> list[Placement]:
        return sorted(placements, key=lambda placed: placed.doubt * max(placed.cost, least))

    ranked = best_first(found)
    cheapest = min(placed.cost for placed in ranked)
    if cheapest > config.of_one_kind:
        tips, most = Tips.of(problem), problem.prepared.elastic.search.max_cost * cheapest
        tried = [placed for placed in distinct(ranked, areas, config.different) if placed.cost <= most]

        def led(placed: Placement) -> Placement:
            return led_by_tips(problem, tips, placed) if placed in tried else placed

        ranked = best_first(in_threads(led, ranked))
    elif not decided:
        return ranked
    return [finished(problem, ranked[0]), *ranked[1:]]


def found_readings(
    problem: Problem, progress: Progress = silent, show: Callable[[Placement], None] = lambda _: None
) -> tuple[Reading, ...]:
    """Different alignments of the target with the source, best first, by `search`.

    Positions are those of the vertices of the level that is deformed.
    """
    prepared, answers = problem.prepared, dict[str, Reading]()
    different = prepared.elastic.hypotheses.different
    for placed in distinct(search(problem, progress, show=show), prepared.rest.graph.areas, different):
        name = placed.name
        while name in answers:
            name += ANOTHER_WAY
        answers[name] = Reading(name, placed.cost, placed.answer, placed.doubt)
    return tuple(answers.values())
