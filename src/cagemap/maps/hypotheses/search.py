"""Search for the cheapest placement: from landmarks, assigned limbs, the files' positions and rotations.

A start gives positions to fit from. Fits have three sizes: a small graph (400 clusters) for many starts, the coarse
stage (1500 clusters, soft or stiff) and the fine stage (the mesh). Constraints are landmarks, curves, and tips of limbs
that are assigned to each other. Fits are ranked by cost times penalty, which is 1 but for starts that turn the files'
axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain, count

from cagemap.deform.fit import coarse_fit, evaluate_clusters, evaluate_placement, fine_fit
from cagemap.deform.multi_start import (
    FEWEST_LANDMARKS,
    StartFits,
    fit_both_starts,
    fit_from_two_starts,
    refine_cheapest,
    spectral_starts,
    zoomout_start,
)
from cagemap.deform.placement import Placement, distinct_placements, mean_distance, rank_placements, sort_by_cost
from cagemap.deform.problem import Clusters, PreparedPair, Problem, Tips, fitted_surface
from cagemap.deform.refit import finish_placement, inverse_positions
from cagemap.maps.hypotheses.starts import (
    STARTS_PER_ROTATION,
    assigned_limbs,
    axis_rotation,
    part_starts,
    refit_distinct_to_tips,
    rigid_starts,
    rotation_name,
    rotation_penalty,
    unmoved_start,
    usual_rotations,
)
from cagemap.maps.masks import WHOLE
from cagemap.maps.pair import Pair, Progress, no_progress
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads, thread_limit

# Suffix of an alignment's name where a better one has the same rotation but assigns limbs differently; then numbers.
ANOTHER_WAY = " (limbs assigned differently)"


def search_both_ways(
    problem: Problem, progress: Progress = no_progress, show: Callable[[Placement], None] = lambda _: None
) -> list[Placement]:
    """Placements of `search_placements`; for some pairs with those of the reverse problem, which deforms the source.

    If one surface is open and the other closed (a part and a whole, docs/lab/parts.md), the inverses of all reverse
    placements are ranked with the others. Otherwise the reverse problem is searched only if the best placement costs
    more than ``max_one_way_cost`` (docs/lab/search.md); the inverse of the best reverse placement then comes first if
    it costs less and is farther than ``max_start_distance`` from the best placement, on average. Only the first of all
    is finished then, if it costs more than ``same_kind_cost`` (its cost after step 5; `search_placements` compares the
    lowest cost of all before that step).
    """
    prepared, reverse_problem = problem.prepared, problem.reverse_problem
    config, areas = prepared.elastic.search, prepared.energy.graph.areas
    if prepared.mesh.is_open != prepared.source_surface.is_open:
        placements = search_placements(problem, progress, show=show)
        reverse = search_placements(reverse_problem, progress)
        return rank_placements([*placements, *(inverse_placement(problem, placed) for placed in reverse)])
    placements = search_placements(problem, progress, show=show, finish=False)
    best = placements[0]
    if best.cost > config.max_one_way_cost:
        reverse = search_placements(reverse_problem, progress, finish=False)
        if reverse[0].penalised_cost < best.penalised_cost:
            inverse = inverse_placement(problem, reverse[0])
            if mean_distance(inverse.positions, best.positions, areas) > config.max_start_distance:
                placements = [inverse, *placements]
    if placements[0].cost <= config.same_kind_cost:
        return placements
    return [finish_placement(problem, placements[0]), *placements[1:]]


def inverse_placement(problem: Problem, reverse: Placement) -> Placement:
    """Placement of the target from one of the source on the target, whose cost it keeps."""
    prepared, energy = problem.prepared, problem.prepared.energy
    weight = prepared.elastic.refit.normal_weight
    start, _ = inverse_positions(prepared.reverse_pair.mesh, reverse.map_positions, prepared.mesh, weight)
    positions = fine_fit(problem, start)
    rotation = axis_rotation(energy.graph.areas, energy.maps(positions))
    name = rotation_name(rotation, usual_rotations(prepared))
    return Placement(positions, reverse.cost, name=name, penalty=reverse.penalty)


def search_placements(
    problem: Problem,
    progress: Progress = no_progress,
    start: FloatArray | None = None,
    show: Callable[[Placement], None] = lambda _: None,
    *,
    finish: bool = True,
) -> list[Placement]:
    """Placements of the target's mesh, best first (`rank_placements`); landmarks are constraints in all of them.

    1. With three landmarks or more, fit from the two starts that they give. If the fits agree, return them.
    2. Else fit a small graph from many starts: assigned limbs, the files' positions and, with fewer landmarks,
       rotations and patches of a whole.
    3. Fit the mesh from the best of these, with the tips of assigned limbs as constraints and without tips.
       With fewer than three landmarks an assignment is left out if its coarse placements cost more than
       ``max_equal_cost`` times the cheapest ones.
    4. For the best fit with constraints whose two starts disagree, add spectral starts.
    5. If the best cost is above ``same_kind_cost`` (bodies of one kind in one pose stay below it), refit with tips near
       each other as constraints.
    6. Finish the best placement (`deform.refit`) if ``finish``; with fewer than three landmarks, not if the lowest cost
       before step 5 is at most ``same_kind_cost``.

    Positions ``start`` (k, 3) of the coarse clusters replace the start by ZoomOut; steps 2 and 3 are left out
    then. ``show`` is called with placements of the small graph.
    """
    has_given_start = start is not None or len(problem.landmarks) >= FEWEST_LANDMARKS
    # For each set of constrained points: clusters, fine placements, and coarse ones if the two starts disagree
    constrained, placements = list[tuple[Clusters, list[Placement], list[Placement]]](), list[Placement]()
    if has_given_start:
        progress("first alignment")
        fine, soft = fit_from_two_starts(problem, problem.coarse_clusters, start)
        if not soft:
            return fine
        constrained.append((problem.coarse_clusters, fine, soft))
    if start is None:
        progress("possible alignments")
        limb_fits, small_fits = fit_small_graph(problem, not has_given_start, show)
        progress("rough alignment")
        max_ratio = math.inf if has_given_start else problem.prepared.elastic.search.max_equal_cost
        for clusters, small_fit, stiff_fits in fit_limbs_stiffly(problem, limb_fits, max_ratio):
            fine, soft = fit_from_two_starts(problem, clusters, stiff_fits=stiff_fits)
            constrained.append((clusters, [placed.with_start_of(small_fit) for placed in fine], soft))
        coarse = fit_without_tips(problem, small_fits)
        placements = in_threads(lambda fits: refine_cheapest(problem, fits)[0].with_start_of(fits[0]), coarse)
    progress("elastic alignment")
    if constrained:
        (clusters, fine, soft), *others = sorted(constrained, key=lambda fits: fits[1][0].penalised_cost)
        if soft:
            starts = spectral_starts(problem, clusters)(soft[0])
            more = in_threads(lambda chosen: coarse_fit(problem, chosen, clusters), starts)
            refined = refine_cheapest(problem, [*soft, *more], fine=fine)
            fine = [placed.with_start_of(fine[0]) for placed in refined]
        placements += [*fine[: None if has_given_start else 1], *(fine[0] for _, fine, _ in others)]
    floor = cost_floor(problem.prepared)
    ranked = rank_placements(placements, floor)
    if min(placed.cost for placed in ranked) > problem.prepared.elastic.search.same_kind_cost:
        ranked = rank_placements(refit_distinct_to_tips(problem, ranked), floor)
    elif not has_given_start:
        return ranked
    return [finish_placement(problem, ranked[0]), *ranked[1:]] if finish else ranked


def fit_small_graph(
    problem: Problem, with_rotations: bool, show: Callable[[Placement], None]
) -> tuple[list[tuple[Tips, Placement]], list[Placement]]:
    """Best fits of a small graph, cheapest first: of assigned limbs, with their tips; and all to fit without tips.

    The second list has those of assigned limbs too: tips of limbs of unlike length do not correspond. With rotations,
    rotated starts are tried unless an assignment is plausible, and fits get a `rotation_penalty`. ``show`` gets the
    best fit of the starts with `usual_rotations`, then the best of all.
    """
    prepared, small = problem.prepared, problem.small_clusters
    config, graph, usual = prepared.elastic.search, small.energy.graph, usual_rotations(prepared)

    def fit_start(start: Placement, clusters: Clusters = small) -> Placement:
        with thread_limit(1):  # one thread for each start: its steps are too short to be split
            placed = coarse_fit(problem, start.positions, clusters)
        rotation = axis_rotation(clusters.energy.graph.areas, placed.maps)
        penalty = rotation_penalty(rotation, prepared) if with_rotations else 1.0
        return replace(placed, name=rotation_name(rotation, usual), penalty=penalty)

    def start_of_limbs(tips: Tips) -> tuple[Tips, Clusters, Placement]:
        clusters = problem.clusters_with(tips, config.small_graph_stage, config.small_graph_vertices)
        return tips, clusters, evaluate_clusters(prepared, clusters, zoomout_start(problem, clusters))

    unmoved = unmoved_start(prepared, graph.positions)
    starts = [*unmoved, *rigid_starts(graph.positions, graph.areas, prepared.source_surface, usual)]
    first = starts[: len(unmoved) + STARTS_PER_ROTATION * len(usual)]
    unrotated = distinct_placements(first, graph.areas, config.min_start_distance)
    rigid_fits = rank_placements(in_threads(fit_start, unrotated))
    show(rigid_fits[0])
    likely = sorted(in_threads(start_of_limbs, assigned_limbs(problem)), key=lambda start: start[2].cost)
    likely = likely[: config.max_fitted_assignments]
    limb_fits = in_threads(lambda start: (start[0], fit_start(start[2], start[1])), likely)
    limb_fits = sorted(limb_fits, key=lambda fit: fit[1].penalised_cost)[: config.max_assigned]
    # A part has a low cost in many places: only the fit of the whole is conclusive.
    if limb_fits and not unmoved and limb_fits[0][1].penalised_cost > config.max_cost * rigid_fits[0].penalised_cost:
        limb_fits = []
    if with_rotations and not limb_fits:
        # Of similar starts the first is kept: the distinct unrotated ones come first.
        starts += part_starts(prepared, graph.positions, graph.areas)
        rotated = distinct_placements(starts, graph.areas, config.min_start_distance)[len(unrotated) :]
        rigid_fits = rank_placements([*rigid_fits, *in_threads(fit_start, rotated)])
    show(rank_placements([*(placed for _, placed in limb_fits), *rigid_fits])[0])
    as_filed = [placed for placed in rigid_fits if placed.penalty <= 1.0][:1]
    if not limb_fits:
        distinct = distinct_placements(rigid_fits, graph.areas, config.min_answer_distance)[: config.max_coarse]
        return [], distinct_placements([*distinct, *as_filed], graph.areas, config.min_answer_distance)
    max_cost = config.max_cost * limb_fits[0][1].penalised_cost
    limb_fits = [(tips, placed) for tips, placed in limb_fits if placed.penalised_cost <= max_cost]
    return limb_fits, [*(placed for _, placed in limb_fits), *as_filed]


def fit_limbs_stiffly(
    problem: Problem, limb_fits: Sequence[tuple[Tips, Placement]], max_ratio: float
) -> list[tuple[Clusters, Placement, StartFits]]:
    """Clusters, small fit and stiff coarse fits of each assignment of limbs.

    Left out: assignments that cost more than ``max_ratio`` times the cheapest one.
    """
    fits, stage = list[tuple[Clusters, Placement, StartFits]](), problem.prepared.elastic.stiff_coarse
    for tips, small_fit in limb_fits:
        clusters = problem.clusters_with(tips)
        fits.append((clusters, small_fit, fit_both_starts(problem, clusters.with_stage(stage))))
    costs = [small_fit.penalty * min(placed.cost for placed in coarse) for _, small_fit, (coarse, _) in fits]
    return [fit for fit, cost in zip(fits, costs, strict=True) if cost <= max_ratio * min(costs)]


def fit_without_tips(problem: Problem, small_fits: Sequence[Placement]) -> list[list[Placement]]:
    """Coarse placements to refine: a list for each distinct fit of the small graph, the cheapest first.

    They are fitted from it and from its spectral starts; only the first list has all of them, others have the cheapest.
    """
    graph, starts = problem.coarse_clusters.energy.graph, spectral_starts(problem, problem.coarse_clusters)
    config = problem.prepared.elastic.search

    def fit_coarse(small_fit: Placement) -> list[Placement]:
        with thread_limit(1):
            first = coarse_fit(problem, small_fit.extrapolate_to(graph, problem.prepared.elastic.graph))
            coarse = sort_by_cost([first, *(coarse_fit(problem, start) for start in starts(first))])
        return [placed.with_start_of(small_fit) for placed in coarse]

    best, *others = sorted(in_threads(fit_coarse, small_fits), key=lambda coarse: coarse[0].penalised_cost)
    first = [best[0], *(coarse[0] for coarse in others)]
    distinct = distinct_placements(first, graph.areas, config.min_answer_distance)
    max_cost = config.max_finish_cost * best[0].penalised_cost
    cheap = [coarse[:1] for coarse in others if coarse[0] in distinct and coarse[0].penalised_cost <= max_cost]
    return [best, *cheap][: config.max_refined]


def cost_floor(prepared: PreparedPair) -> float:
    """Discretisation floor of the cost: the target fitted to itself. Costs below it are ties.

    Scaled by what the masks leave, as the cost of a fit is.
    """
    graph, surface = prepared.energy.graph, fitted_surface(prepared.target, prepared.elastic)
    on_itself = replace(prepared, masks=WHOLE, source_surface=surface)
    shares = graph.areas @ prepared.level_masks.of_target(graph.n), prepared.source_samples.areas.sum()
    return float(min(shares)) * evaluate_placement(on_itself, graph.positions).cost


def distinct_answers(prepared: PreparedPair, placements: Sequence[Placement]) -> tuple[Placement, ...]:
    """Different alignments of the target with the source, in the order of placements, each with its own name."""
    answers, min_distance = dict[str, Placement](), prepared.elastic.search.min_answer_distance
    for placed in distinct_placements(placements, prepared.energy.graph.areas, min_distance):
        names = chain([placed.name, placed.name + ANOTHER_WAY], (f"{placed.name}{ANOTHER_WAY} {k}" for k in count(2)))
        name = next(name for name in names if name not in answers)
        answers[name] = placed.as_answer(name)
    return tuple(answers.values())


@kinds_checked
def fit(prepared: PreparedPair, pair: Pair, progress: Progress = no_progress) -> FloatArray:
    """(n, 3) fitted positions of the target's deformed level near the source: the first of `search_placements`.

    The source has area 1 in their unit. ParameterError if ``prepared`` is of other surfaces than the pair.
    """
    return search_placements(Problem(prepared, pair.landmarks), progress)[0].map_positions
