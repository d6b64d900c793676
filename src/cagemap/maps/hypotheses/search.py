"""Search for the cheapest placement: from landmarks, from assigned limbs, from the files' places, from rotations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cagemap.deform.fit import coarse_fit, evaluate_placement
from cagemap.deform.multi_start import (
    FEWEST_LANDMARKS,
    AnchoredFits,
    refine_cheapest,
    sort_by_cost,
    spectral_starts,
    start_map,
)
from cagemap.deform.placement import Placement, distinct_placements
from cagemap.deform.problem import CoarseShape, PreparedPair, Problem
from cagemap.deform.refit import common_rotation, finish_placement
from cagemap.maps.hypotheses.limbs import Assignment, Tips, assigned_limbs, refit_to_tips
from cagemap.maps.hypotheses.rigid_starts import (
    AS_FILED,
    AS_FILED_STARTS,
    in_place,
    nearest_axis_rotation,
    rigid_starts,
    rotation_doubt,
    rotation_name,
)
from cagemap.maps.masks import WHOLE
from cagemap.maps.pair import Progress, no_progress
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.numerics.threads import in_threads, thread_limit

# Suffix of an alignment's name where a better one has the same rotation but assigns limbs differently.
ANOTHER_WAY = " (limbs assigned differently)"


def least_cost(prepared: PreparedPair) -> float:
    """Discretisation floor of the cost: the target fitted to itself. Costs below it are ties.

    Masks count in it as in a fit: less of the surface costs less.
    """
    target, rest, own = prepared.target, prepared.rest, replace(prepared.rest, masks=WHOLE)
    surface = target.triangles(target.hierarchy.coarsest_level(prepared.elastic.source_vertices))
    on_itself = replace(prepared, rest=own, source_surface=surface)
    counts = rest.graph.areas @ rest.masks.of_target(rest.graph.n), prepared.source_samples.areas.sum()
    return float(min(counts)) * evaluate_placement(on_itself, rest.graph.positions).cost


def rough_problem(problem: Problem) -> Problem:
    """The same on the small graph on which all starts are tried."""
    config = problem.prepared.elastic.search
    return problem.staged(config.rough, config.rough_vertices)


def rough_fits(
    problem: Problem, rigid: bool, show: Callable[[Placement], None]
) -> tuple[list[tuple[Assignment, Placement]], list[Placement]]:
    """The best placements on a small graph, cheapest first: assignments of limbs to hold, and placements to release.

    Assignments are released too: tips of limbs of unlike length are no counterparts. Rotations are tried, and doubted,
    where ``rigid`` is true and no assignment is plausible.
    """
    rough, config = rough_problem(problem), problem.prepared.elastic.search

    def fitted(start: FloatArray, shape: CoarseShape) -> Placement:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            found = coarse_fit(rough, start, shape)
        turn = nearest_axis_rotation(common_rotation(shape.rest.graph.areas, nearest_rotations(found.maps)))
        return replace(found, name=rotation_name(turn), doubt=rotation_doubt(turn, config) if rigid else 1.0)

    def fit_rigid(starts: Sequence[Placement]) -> list[Placement]:
        return in_threads(lambda start: fitted(start.positions, rough.shape), starts)

    def fit_limbs(one: Assignment) -> tuple[Assignment, Placement]:
        shape = one.shape(rough)
        return one, fitted(start_map(rough, shape, one.vertices), shape)

    graph, most = rough.shape.rest.graph, problem.prepared.elastic.search.max_cost
    filed = in_place(problem.prepared, graph.positions)
    starts = [*filed, *rigid_starts(graph.positions, problem.prepared.source_surface.positions)]
    n_filed = len(filed) + AS_FILED_STARTS
    # What is distinct among the first starts is the beginning of what is distinct among all.
    apart = distinct_placements(starts if rigid else starts[:n_filed], graph.areas, config.alike)
    n_first = len(distinct_placements(starts[:n_filed], graph.areas, config.alike))
    own = sorted(fit_rigid(apart[:n_first]), key=lambda one: one.rank)
    show(own[0])
    led = sorted(in_threads(fit_limbs, assigned_limbs(problem)), key=lambda one: one[1].rank)[: config.max_assigned]
    # A part costs little in many places: only the whole fit decides.
    if led and not filed and led[0][1].rank > config.unlikely * own[0].rank:
        led = []
    own = own if led else sorted([*own, *fit_rigid(apart[n_first:])], key=lambda one: one.rank)
    show(min((*(one for _, one in led), *own), key=lambda one: one.rank))
    as_filed = [one for one in own if one.name == AS_FILED][:1]
    if not led:
        kept = distinct_placements(own, graph.areas, config.different)[: config.max_coarse]
        return [], distinct_placements([*kept, *as_filed], graph.areas, config.different)
    likely = [one for one in led if one[1].rank <= most * led[0][1].rank]
    return likely, [*(one for _, one in likely), *as_filed]


def fit_released(problem: Problem, rough: Sequence[Placement]) -> list[Placement]:
    """The fine stage from rough placements, and their spectral upsampling, that end apart; the best of each."""
    if not rough:
        return []
    graph, starts = problem.shape.rest.graph, spectral_starts(problem)
    config = problem.prepared.elastic.search

    def improve(one: Placement) -> list[Placement]:
        with thread_limit(1):
            own = coarse_fit(problem, one.on(graph, problem.prepared.elastic.graph))
            coarse = sort_by_cost([own, *(coarse_fit(problem, start) for start in starts(own))])
        return [replace(placed, name=one.name, doubt=one.doubt) for placed in coarse]

    improved = sorted(in_threads(improve, rough), key=lambda coarse: coarse[0].rank)
    apart = distinct_placements([coarse[0] for coarse in improved], graph.areas, config.different)
    most = config.hopeless * improved[0][0].rank
    hopeful = [coarse for coarse in improved if coarse[0] in apart and coarse[0].rank <= most]
    as_filed = [coarse for coarse in hopeful[config.max_finished :] if coarse[0].name == AS_FILED]

    def finish(coarse: list[Placement]) -> Placement:
        found = refine_cheapest(problem, coarse, None if coarse is improved[0] else 1)[0]
        return replace(found, name=coarse[0].name, doubt=coarse[0].doubt)

    return in_threads(finish, [*hopeful[: config.max_finished], *as_filed[:1]])


def search(
    problem: Problem,
    progress: Progress = no_progress,
    start: FloatArray | None = None,
    show: Callable[[Placement], None] = lambda _: None,
) -> list[Placement]:
    """Placements of the target's mesh, best first by cost and doubt; all of them hold the landmarks.

    Enough landmarks start fits of their own. Where these disagree, or landmarks are too few, limbs are assigned to
    limbs in the ways that the landmarks leave. The best one is led to tips that it missed and finished, unless bodies
    of one kind stand alike. Places ``start`` (k, 3) of the coarse shape's vertices stand for the landmarks' spectral
    map, and nothing else is tried. ``show`` is called with placements of the small graph.
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
        found = fit_released(problem, released)
    progress("elastic alignment")
    if fits:
        first, *others = sorted(fits, key=lambda one: one.refined[0].rank)
        best = first if first.agree else first.upsampled(problem)
        found += [*best.refined[: None if decided else 1], *(one.refined[0] for one in others)]
    least, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    config = problem.prepared.elastic.search

    def best_first(placements: Sequence[Placement]) -> list[Placement]:
        return sorted(placements, key=lambda placed: placed.doubt * max(placed.cost, least))

    ranked = best_first(found)
    cheapest = min(placed.cost for placed in ranked)
    if cheapest > config.of_one_kind:
        tips, most = Tips.of(problem), problem.prepared.elastic.search.max_cost * cheapest
        tried = [placed for placed in distinct_placements(ranked, areas, config.different) if placed.cost <= most]

        def led(placed: Placement) -> Placement:
            return refit_to_tips(problem, tips, placed) if placed in tried else placed

        ranked = best_first(in_threads(led, ranked))
    elif not decided:
        return ranked
    return [finish_placement(problem, ranked[0]), *ranked[1:]]


def find_answers(
    problem: Problem, progress: Progress, show: Callable[[Placement], None] = lambda _: None
) -> tuple[Placement, ...]:
    """Different alignments of the target with the source, best first, by `search`."""
    prepared, answers = problem.prepared, dict[str, Placement]()
    different = prepared.elastic.search.different
    for placed in distinct_placements(search(problem, progress, show=show), prepared.rest.graph.areas, different):
        name = placed.name
        while name in answers:
            name += ANOTHER_WAY
        answers[name] = Placement(placed.answer, placed.cost, name=name, doubt=placed.doubt)
    return tuple(answers.values())
