"""Candidate alignments without landmarks: many rough starts, of which the best are fitted and ranked by cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cagemap.deform.fit import coarse_fit, with_cost
from cagemap.deform.multi_start import cheapest_first, refine_best
from cagemap.deform.placement import Placement, distinct
from cagemap.deform.problem import CoarseShape, PreparedPair, Problem
from cagemap.deform.refit import common_rotation
from cagemap.deform.starts import spectral_starts, start_map
from cagemap.maps.hypotheses.limbs import Assignment, assigned_limbs
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
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.numerics.threads import in_threads, thread_limit


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
    config = problem.prepared.elastic.search
    return problem.staged(config.rough, config.rough_vertices)


def rough_fits(
    problem: Problem, rigid: bool, show: Callable[[Placement], None]
) -> tuple[list[tuple[Assignment, Placement]], list[Placement]]:
    """The best placements on a small graph, cheapest first: assignments of limbs to hold, and placements to release.

    Assignments are released too: tips of limbs of unlike length are no counterparts. Of rigid starts how the files
    stand is enough, unless no assignment is plausible. With landmarks enough it always is: then ``rigid`` is false, and
    rotations are not doubted. ``show`` is called with the best fit that keeps the files' axes, then with the best
    of all.
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
    apart = distinct(starts if rigid else starts[:n_filed], graph.areas, config.alike)
    n_first = len(distinct(starts[:n_filed], graph.areas, config.alike))
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
        kept = distinct(own, graph.areas, config.different)[: config.max_coarse]
        return [], distinct([*kept, *as_filed], graph.areas, config.different)
    likely = [one for one in led if one[1].rank <= most * led[0][1].rank]
    return likely, [*(one for _, one in likely), *as_filed]


def released_fits(problem: Problem, rough: Sequence[Placement]) -> list[Placement]:
    """The fine stage from rough placements that end apart, the best of each.

    Coarse placements start where a rough one is, and from what spectral upsampling makes of that.
    """
    if not rough:
        return []
    graph, starts = problem.shape.rest.graph, spectral_starts(problem)
    config = problem.prepared.elastic.search

    def improve(one: Placement) -> list[Placement]:
        with thread_limit(1):
            own = coarse_fit(problem, one.on(graph, problem.prepared.elastic.graph))
            coarse = cheapest_first([own, *(coarse_fit(problem, start) for start in starts(own))])
        return [replace(placed, name=one.name, doubt=one.doubt) for placed in coarse]

    improved = sorted(in_threads(improve, rough), key=lambda coarse: coarse[0].rank)
    apart = distinct([coarse[0] for coarse in improved], graph.areas, config.different)
    most = config.hopeless * improved[0][0].rank
    hopeful = [coarse for coarse in improved if coarse[0] in apart and coarse[0].rank <= most]
    as_filed = [coarse for coarse in hopeful[config.max_finished :] if coarse[0].name == AS_FILED]

    def finish(coarse: list[Placement]) -> Placement:
        found = refine_best(problem, coarse, None if coarse is improved[0] else 1)[0]
        return replace(found, name=coarse[0].name, doubt=coarse[0].doubt)

    return in_threads(finish, [*hopeful[: config.max_finished], *as_filed[:1]])
