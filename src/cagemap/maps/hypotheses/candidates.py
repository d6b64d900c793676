"""Candidate alignments without landmarks: many rough starts, of which the best are fitted and ranked by cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import Stage
from cagemap.deform.fit import coarse_fit, with_cost
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.pose import common_rotation
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.search import cheapest_first, refine, refine_best
from cagemap.deform.starts import SpectralSides, spectral_starts, start_map
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.limbs import Assignment, LimbStarts
from cagemap.maps.hypotheses.part_starts import in_place
from cagemap.maps.hypotheses.rigid_starts import (
    AS_FILED,
    AS_FILED_STARTS,
    nearest_axis_rotation,
    rigid_starts,
    rotation_doubt,
    rotation_name,
)
from cagemap.maps.hypotheses.tips import OF_ONE_KIND, Tips, led_by_tips
from cagemap.maps.masks import WHOLE
from cagemap.maps.pair import Progress, silent
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.numerics.threads import in_threads, thread_limit

# Size of the graph on which all starts are tried, from stiff, which turns and shifts as a whole, to soft.
ROUGH_VERTICES = 400
ROUGH = Stage(iterations=14, stiffness=(1.0, 2e-4), smoothing=1e-2, momentum=0.6)
# Mean distance, in units of sqrt(area): below it two starts are one, and from it on two fits are two answers.
ALIKE, DIFFERENT = 0.03, 0.08
# Most candidates of the coarse stage, without assigned limbs and with them, and most that are finished. The pose of the
# files is added to them: boxy shapes cost the same on every side, so cost alone could drop it.
MAX_COARSE, MAX_ASSIGNED, MAX_FINISHED = 4, 2, 3
# Suffix of an answer's name where a better answer has the same rotation, with other limbs on each other.
ANOTHER_WAY = " in another way"
# A fit that costs this many times the best one is not finished.
HOPELESS = 2.5
# Assignments of limbs that cost this many times the pose of the files are dropped, such as those of fins.
UNLIKELY = 1.5


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to lie on the source, not yet finished.

    Attributes
    ----------
    rough : Placement
        On the small graph.
    limbs : Assignment or None
        That it started from; None for a rigid start.
    coarse : tuple of Placement
        What the coarse stage made of it, cheapest first.
    held : tuple of Placement
        The same with the tips of the limbs pinned.
    """

    rough: Placement
    limbs: Assignment | None
    coarse: tuple[Placement, ...] = ()
    held: tuple[Placement, ...] = ()

    @property
    def cost(self) -> float:
        """Cost of the cheapest placement, times the doubt: a factor above 1 for unlikely rotations."""
        return self.rough.doubt * self.coarse[0].cost

    def joined_with(self, other: Candidate) -> Candidate:
        """The same with the placements of another one, which lies alike."""
        return replace(
            self, coarse=tuple(cheapest_first([*self.coarse, *other.coarse])), held=(*self.held, *other.held)
        )


def found_readings(problem: Problem, progress: Progress = silent) -> tuple[Reading, ...]:
    """Different ways in which the target lies on the source, fitted, best first: by cost and doubt.

    Landmarks, if there are any, are held by all of them. Positions are those of the vertices of the level
    that is deformed.
    """
    progress("possible alignments")
    limbs = LimbStarts.of(problem)
    rough = rough_fits(problem, limbs)
    progress("rough alignment")
    candidates = coarse_fits(problem, limbs, rough)
    progress("elastic alignment")

    def finish(candidate: Candidate) -> Placement:
        held, first = refine(problem, candidate.held), candidate is candidates[0]
        if held and not first:
            found = held[0]
        else:
            found = refine_best(problem, candidate.coarse, None if first and not held else 1, held)[0]
        return replace(found, name=candidate.rough.name, doubt=candidate.rough.doubt)

    found = in_threads(finish, candidates)
    if min(placed.cost for placed in found) > OF_ONE_KIND:
        tips = Tips.of(problem)
        worst = HOPELESS * min(placed.cost for placed in found)
        found = in_threads(lambda one: led_by_tips(problem, tips, one) if one.cost <= worst else one, found)
    least, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    ranked = sorted(found, key=lambda placed: placed.doubt * max(placed.cost, least))
    answers: dict[str, Reading] = {}
    for placed in distinct(ranked, areas, DIFFERENT):
        name = placed.name
        while name in answers:
            name += ANOTHER_WAY
        answers[name] = Reading(name, placed.cost, placed.positions, placed.doubt)
    return tuple(answers.values())


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


def rough_fits(problem: Problem, limbs: LimbStarts) -> list[Candidate]:
    """The different placements of all starts on a small graph, cheapest first.

    Limbs assigned to limbs, and the files' axes; all rigid starts where no assignment is plausible.
    """
    rough = rough_problem(problem)
    shape = limbs.shape(rough)
    areas = shape.rest.graph.areas

    def fitted(start: FloatArray, one: Assignment | None = None) -> Candidate:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            found = coarse_fit(rough, start, shape if one is None else one.hold(shape))
        turn = nearest_axis_rotation(common_rotation(areas, nearest_rotations(found.maps)))
        return Candidate(replace(found, name=rotation_name(turn), doubt=rotation_doubt(turn)), one)

    points = shape.rest.graph.positions
    filed = in_place(problem.prepared, points)
    rigid = [*filed, *rigid_starts(points, problem.prepared.source_surface.positions)]

    def fit_rigid(starts: Sequence[Placement]) -> list[Candidate]:
        return in_threads(lambda start: fitted(start.positions), distinct(starts, areas, ALIKE))

    own = fit_rigid(rigid[: len(filed) + AS_FILED_STARTS] if limbs.assignments else rigid)
    led = in_threads(lambda one: fitted(start_map(rough, shape, one.vertices), one), limbs.assignments)
    # A part costs little in many places: only the whole fit tells.
    if led and not filed and cheapest_rank(led) > UNLIKELY * cheapest_rank(own):
        led, own = [], fit_rigid(rigid)
    ranked = sorted([*led, *own], key=lambda one: one.rough.rank)
    as_filed = [one for one in ranked if one.limbs is None and one.rough.name == AS_FILED][:1]
    if not led:
        return _apart([*_apart(ranked, areas, DIFFERENT)[:MAX_COARSE], *as_filed], areas, DIFFERENT)
    likely = [one for one in ranked if one.limbs][:MAX_ASSIGNED]
    hopeful = [one for one in likely if one.rough.rank <= HOPELESS * likely[0].rough.rank]
    return _apart([*hopeful, *as_filed], areas, ALIKE)


def cheapest_rank(candidates: Sequence[Candidate]) -> float:
    """Cost times doubt of the best rough placement."""
    return min(one.rough.rank for one in candidates)


def coarse_fits(problem: Problem, limbs: LimbStarts, rough: Sequence[Candidate]) -> list[Candidate]:
    """Coarse placements of each rough one: from where it is, and from what spectral upsampling makes of that.

    Where limbs are assigned, further ones hold their tips and start by ZoomOut from these, soft and stiff.
    """
    shape, stiff = limbs.shape(problem), problem.stiff
    stiff_shape = shape.smoothed(stiff.prepared.elastic.coarse.smoothing)
    graph, sides = shape.rest.graph, SpectralSides.build(problem, shape)

    def improve(one: Candidate) -> Candidate:
        with thread_limit(1):
            own = coarse_fit(problem, one.rough.on(graph, problem.prepared.elastic.graph), shape)
            others = [coarse_fit(problem, start, shape) for start in spectral_starts(own, sides)]
            coarse = tuple(cheapest_first([own, *others]))
            if one.limbs is None:
                return replace(one, coarse=coarse)
            start = start_map(problem, shape, one.limbs.vertices)
            held = (
                coarse_fit(problem, start, one.limbs.hold(shape)),
                coarse_fit(stiff, start, one.limbs.hold(stiff_shape)),
            )
        return replace(one, coarse=coarse, held=held)

    improved: list[Candidate] = []
    for one in sorted(in_threads(improve, rough), key=lambda one: one.cost):
        distances = [
            mean_distance(one.coarse[0].positions, other.coarse[0].positions, graph.areas) for other in improved
        ]
        # The pose of the files is finished by itself, also near an assignment, which may be wrong.
        if min(distances, default=np.inf) >= DIFFERENT or (limbs.assignments and one.limbs is None):
            improved.append(one)
        elif limbs.assignments:
            improved[int(np.argmin(distances))] = improved[int(np.argmin(distances))].joined_with(one)
    hopeful = [one for one in improved if one.cost <= HOPELESS * improved[0].cost]
    as_filed = [one for one in hopeful[MAX_FINISHED:] if one.rough.name == AS_FILED]
    return [*hopeful[:MAX_FINISHED], *as_filed[:1]]


def _apart(ranked: Sequence[Candidate], areas: FloatArray, least: float) -> list[Candidate]:
    """Candidates whose rough placements are at least ``least`` away from every better one."""
    kept = distinct([one.rough for one in ranked], areas, least)
    return [one for one in ranked if one.rough in kept]
