"""Search for the cheapest placement: from landmarks, from assigned limbs, from the files' places, from rotations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit
from cagemap.deform.multi_start import (
    FEWEST_LANDMARKS,
    fit_held,
    refine_cheapest,
    refine_more_starts,
    sort_by_cost,
    spectral_starts,
    start_map,
)
from cagemap.deform.placement import Placement, distinct_placements
from cagemap.deform.problem import CoarseShape, PreparedPair, Problem
from cagemap.deform.refit import common_rotation, finish_placement, inverse_positions
from cagemap.maps.hypotheses.limbs import assigned_limbs, find_tips, refit_to_tips
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
from cagemap.maps.pair import Pair, Progress, no_progress
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads, thread_limit

# Suffix of an alignment's name where a better one has the same rotation but assigns limbs differently.
ANOTHER_WAY = " (limbs assigned differently)"

# Corresponding tips (k,) of limbs, as vertices of the searched levels of target and source.
Tips = tuple[IndexArray, IndexArray]


def least_cost(prepared: PreparedPair) -> float:
    """Discretisation floor of the cost: the target fitted to itself. Costs below it are ties.

    Scaled by what the masks leave, as the cost of a fit is.
    """
    target, rest, unmasked = prepared.target, prepared.rest, replace(prepared.rest, masks=WHOLE)
    surface = target.triangles(target.hierarchy.coarsest_level(prepared.elastic.source_vertices))
    on_itself = replace(prepared, rest=unmasked, source_surface=surface)
    counts = rest.graph.areas @ rest.masks.of_target(rest.graph.n), prepared.source_samples.areas.sum()
    return float(min(counts)) * evaluate_placement(on_itself, rest.graph.positions).cost


def rough_fits(
    problem: Problem, rigid: bool, show: Callable[[Placement], None]
) -> tuple[list[tuple[Tips, Placement]], list[Placement]]:
    """Best placements on a small graph, cheapest first: with tips of limbs to hold, and those to refine without.

    Placements of assignments are refined without held tips too: tips of limbs of unlike length do not correspond.
    With ``rigid``, rotated starts are tried where no assignment is plausible, and rotations are doubted. ``show`` gets
    the best fit that keeps the files' axes, then the best of all.
    """
    small, config = problem.rough, problem.prepared.elastic.search
    graph = small.shape.rest.graph

    def fit(start: FloatArray, shape: CoarseShape) -> Placement:
        with thread_limit(1):  # one thread for each start: its steps are too short to be split
            placed = coarse_fit(small, start, shape)
        rotation = axis_rotation(shape.rest.graph.areas, placed.maps)
        return replace(placed, name=rotation_name(rotation), doubt=rotation_doubt(rotation, config) if rigid else 1.0)

    def fit_rigid(starts: Sequence[Placement]) -> list[Placement]:
        return in_threads(lambda start: fit(start.positions, small.shape), starts)

    def fit_limbs(tips: Tips) -> tuple[Tips, Placement]:
        shape = small.holding(*tips)
        return tips, fit(start_map(small, shape), shape)

    in_files = in_place(problem.prepared, graph.positions)
    starts = [*in_files, *rigid_starts(graph.positions, problem.prepared.source_surface.positions)]
    unrotated = starts[: len(in_files) + AS_FILED_STARTS]
    # Of similar starts the first is kept: the distinct ones of `unrotated` begin the list of all distinct ones.
    distinct_starts = distinct_placements(starts if rigid else unrotated, graph.areas, config.alike)
    n_unrotated = len(distinct_placements(unrotated, graph.areas, config.alike))
    rigid_fits = sorted(fit_rigid(distinct_starts[:n_unrotated]), key=_rank)
    show(rigid_fits[0])
    limb_fits = sorted(in_threads(fit_limbs, assigned_limbs(problem)), key=lambda fit: fit[1].rank)
    limb_fits = limb_fits[: config.max_assigned]
    # A part has a low cost in many places: only the fit of the whole is conclusive.
    if limb_fits and not in_files and limb_fits[0][1].rank > config.unlikely * rigid_fits[0].rank:
        limb_fits = []
    if not limb_fits:
        rigid_fits = sorted([*rigid_fits, *fit_rigid(distinct_starts[n_unrotated:])], key=_rank)
    show(min((*(placed for _, placed in limb_fits), *rigid_fits), key=_rank))
    as_filed = [placed for placed in rigid_fits if placed.name == AS_FILED][:1]
    if not limb_fits:
        kept = distinct_placements(rigid_fits, graph.areas, config.different)[: config.max_coarse]
        return [], distinct_placements([*kept, *as_filed], graph.areas, config.different)
    likely = [fit for fit in limb_fits if fit[1].rank <= config.max_cost * limb_fits[0][1].rank]
    return likely, [*(placed for _, placed in likely), *as_filed]


def axis_rotation(areas: FloatArray, maps: FloatArray) -> FloatArray:
    """(3, 3) rotation of axes to axes nearest to the differentials (n, 3, 3) of a placement."""
    return nearest_axis_rotation(common_rotation(areas, nearest_rotations(maps)))


def fit_released(problem: Problem, rough: Sequence[Placement]) -> list[Placement]:
    """Fine placements from rough ones and their spectral starts: the best of each, if they differ."""
    if not rough:
        return []
    graph, starts = problem.shape.rest.graph, spectral_starts(problem)
    config = problem.prepared.elastic.search

    def fit_coarse(placed: Placement) -> list[Placement]:
        with thread_limit(1):
            first = coarse_fit(problem, placed.on(graph, problem.prepared.elastic.graph))
            coarse = sort_by_cost([first, *(coarse_fit(problem, start) for start in starts(first))])
        return [one.named_like(placed) for one in coarse]

    candidates = sorted(in_threads(fit_coarse, rough), key=lambda coarse: coarse[0].rank)
    apart = distinct_placements([coarse[0] for coarse in candidates], graph.areas, config.different)
    max_rank = config.hopeless * candidates[0][0].rank
    hopeful = [coarse for coarse in candidates if coarse[0] in apart and coarse[0].rank <= max_rank]
    as_filed = [coarse for coarse in hopeful[config.max_finished :] if coarse[0].name == AS_FILED]

    def fit_fine(coarse: list[Placement]) -> Placement:
        return refine_cheapest(problem, coarse, None if coarse is candidates[0] else 1)[0].named_like(coarse[0])

    return in_threads(fit_fine, [*hopeful[: config.max_finished], *as_filed[:1]])


def inverse_placement(problem: Problem, reverse: Placement) -> Placement:
    """Placement of the target from one of the source on the target, whose cost it keeps."""
    prepared, rest = problem.prepared, problem.prepared.rest
    weight = prepared.elastic.refit.normal_weight
    start, _ = inverse_positions(prepared.reversed.mesh, reverse.answer, prepared.mesh, weight)
    positions = fine_fit(problem, start)
    rotation = axis_rotation(rest.graph.areas, rest.energy.maps(positions))
    return Placement(positions, reverse.cost, name=rotation_name(rotation), doubt=reverse.doubt)


def search(
    problem: Problem,
    progress: Progress = no_progress,
    start: FloatArray | None = None,
    show: Callable[[Placement], None] = lambda _: None,
) -> list[Placement]:
    """Placements of the target's mesh, best first by cost and doubt; all of them hold the landmarks.

    1. With three landmarks or more a fit starts from them; if its fits agree, the search ends.
    2. Otherwise limbs are assigned to limbs, in the ways that the landmarks allow, and starts by rotation are tried.
    3. The best placements are refitted with tips of limbs held, and the best of all is finished
       (`deform.refit.finish_placement`). For bodies of one kind in one pose no tips are held, and without landmarks
       nothing is finished.

    Places ``start`` (k, 3) of the coarse shape's vertices replace the landmarks' functional map; then nothing else is
    tried. ``show`` is called with placements of the small graph.
    """
    has_start = start is not None or len(problem.landmarks) >= FEWEST_LANDMARKS
    # Fits that hold points, each with its shape, refined placements, and soft ones where more starts are needed
    held, placements = list[tuple[CoarseShape, list[Placement], list[Placement]]](), list[Placement]()
    if has_start:
        progress("first alignment")
        refined, soft = fit_held(problem, problem.shape, start)
        if not soft:
            return refined
        held.append((problem.shape, refined, soft))
    if start is None:
        progress("possible alignments")
        assigned, released = rough_fits(problem, not has_start, show)
        progress("rough alignment")
        for tips, rough in assigned:
            shape = problem.holding(*tips)
            refined, soft = fit_held(problem, shape)
            held.append((shape, [one.named_like(rough) for one in refined], soft))
        placements = fit_released(problem, released)
    progress("elastic alignment")
    if held:
        (shape, refined, soft), *others = sorted(held, key=lambda fits: fits[1][0].rank)
        best = refine_more_starts(problem, shape, refined, soft) if soft else refined
        placements += [*best[: None if has_start else 1], *(refined[0] for _, refined, _ in others)]
    floor, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    config = problem.prepared.elastic.search

    def best_first(placements: Sequence[Placement]) -> list[Placement]:
        return sorted(placements, key=lambda placed: placed.doubt * max(placed.cost, floor))

    ranked = best_first(placements)
    cheapest = min(placed.cost for placed in ranked)
    if cheapest > config.of_one_kind:
        all_tips, max_cost = find_tips(problem), config.max_cost * cheapest
        refitted = [
            placed for placed in distinct_placements(ranked, areas, config.different) if placed.cost <= max_cost
        ]

        def refit(placed: Placement) -> Placement:
            return refit_to_tips(problem, all_tips, placed) if placed in refitted else placed

        ranked = best_first(in_threads(refit, ranked))
    elif not has_start:
        return ranked
    return [finish_placement(problem, ranked[0]), *ranked[1:]]


def search_directions(
    problem: Problem, progress: Progress = no_progress, *, show: Callable[[Placement], None] = lambda _: None
) -> list[Placement]:
    """Placements of `search`; for a part and a whole those of the reverse problem too.

    There one direction often fails (docs/lab/parts.md).
    """
    placements = search(problem, progress, show=show)
    if problem.prepared.mesh.is_open == problem.prepared.source_surface.is_open:
        return placements
    reverse = search(problem.reversed, progress)
    return sorted([*placements, *(inverse_placement(problem, placed) for placed in reverse)], key=_rank)


@kinds_checked
def fit(prepared: PreparedPair, pair: Pair, progress: Progress = no_progress) -> FloatArray:
    """(n, 3) fitted positions of the target's deformed level near the source: the first of `search`.

    The source has area 1 in their unit.
    """
    return search(Problem(prepared, pair.landmarks), progress)[0].answer


def distinct_answers(prepared: PreparedPair, placements: Sequence[Placement]) -> tuple[Placement, ...]:
    """Different alignments of the target with the source, in the order of placements, each with its own name."""
    answers, different = dict[str, Placement](), prepared.elastic.search.different
    for placed in distinct_placements(placements, prepared.rest.graph.areas, different):
        name = placed.name
        while name in answers:
            name += ANOTHER_WAY
        answers[name] = Placement(placed.answer, placed.cost, name=name, doubt=placed.doubt)
    return tuple(answers.values())


def _rank(placed: Placement) -> float:
    return placed.rank
