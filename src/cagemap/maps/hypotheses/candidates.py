"""Candidate alignments without landmarks: many rough starts, of which the best are fitted and ranked by cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import Stage
from cagemap.deform.fit import coarse_fit, with_cost
from cagemap.deform.multi_start import cheapest_first
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.pose import common_rotation
from cagemap.deform.prepared import PreparedPair
from cagemap.deform.problem import Problem
from cagemap.deform.starts import SpectralSides, spectral_starts, start_map
from cagemap.maps.hypotheses.limbs import Assignment, LimbStarts
from cagemap.maps.hypotheses.rigid_starts import (
    AS_FILED,
    AS_FILED_STARTS,
    nearest_axis_rotation,
    rigid_starts,
    rotation_doubt,
    rotation_name,
)
from cagemap.maps.masks import WHOLE
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.rotations import nearest_rotations
from cagemap.numerics.threads import in_threads, thread_limit

# Size of the graph on which all starts are tried, from stiff, which turns and shifts as a whole, to soft.
ROUGH_VERTICES = 400
ROUGH = Stage(iterations=14, stiffness=(1.0, 2e-4), smoothing=1e-2, momentum=0.6)
# Mean distance, in units of sqrt(area): below it two starts are one, and from it on two fits are two answers.
ALIKE, DIFFERENT = 0.03, 0.08
# Most candidates of the coarse stage, without assigned limbs and with them, and most that are finished. The pose of the
# files is added to them: boxy shapes cost the same on every side, so cost alone could drop it.
MAX_COARSE, MAX_ASSIGNED, MAX_FINISHED = 4, 2, 3
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
    """

    rough: Placement
    limbs: Assignment | None
    coarse: tuple[Placement, ...] = ()

    @property
    def cost(self) -> float:
        """Cost of the cheapest placement, times the doubt: a factor above 1 for unlikely rotations."""
        return self.rough.doubt * self.coarse[0].cost


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


def rough_fits(problem: Problem, limbs: LimbStarts, rigid: bool = True) -> list[Candidate]:
    """The different placements of all starts on a small graph, cheapest first.

    Limbs assigned to limbs, and the files' axes; all rigid starts where no assignment is plausible. ``rigid`` is for
    pairs whose landmarks start fits of their own, which need no rigid ones.
    """
    rough = rough_problem(problem)
    shape = limbs.shape(rough)
    areas = shape.rest.graph.areas

    def fitted(start: FloatArray, one: Assignment | None = None) -> Candidate:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            found = coarse_fit(rough, start, shape if one is None else one.hold(shape))
        turn = nearest_axis_rotation(common_rotation(areas, nearest_rotations(found.maps)))
        return Candidate(replace(found, name=rotation_name(turn), doubt=rotation_doubt(turn)), one)

    starts = rigid_starts(shape.rest.graph.positions, problem.prepared.source_surface.positions) if rigid else []

    def fit_rigid(starts: Sequence[Placement]) -> list[Candidate]:
        return in_threads(lambda start: fitted(start.positions), distinct(starts, areas, ALIKE))

    own = fit_rigid(starts[:AS_FILED_STARTS] if limbs.assignments else starts)
    led = in_threads(lambda one: fitted(start_map(rough, shape, one.vertices), one), limbs.assignments)
    if led and own and cheapest_rank(led) > UNLIKELY * cheapest_rank(own):
        led, own = [], fit_rigid(starts)
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
    """Coarse placements of each rough one, which are different ways to lie on the source, cheapest first.

    Assigned limbs start by ZoomOut from their tips and hold them, soft and stiff; rigid starts from where the rough
    placement is, and from what spectral upsampling makes of that.
    """
    if not rough:
        return []
    shape, stiff = limbs.shape(problem), problem.stiff
    stiff_shape = shape.smoothed(stiff.prepared.elastic.coarse.smoothing)
    graph, sides = shape.rest.graph, SpectralSides.build(problem, shape)

    def improve(one: Candidate) -> Candidate:
        with thread_limit(1):
            if one.limbs is None:
                own = coarse_fit(problem, one.rough.on(graph, problem.prepared.elastic.graph), shape)
                others = [coarse_fit(problem, start, shape) for start in spectral_starts(own, sides)]
                return replace(one, coarse=tuple(cheapest_first([own, *others])))
            start = start_map(problem, shape, one.limbs.vertices)
            soft = coarse_fit(problem, start, one.limbs.hold(shape))
            return replace(one, coarse=(soft, coarse_fit(stiff, start, one.limbs.hold(stiff_shape))))

    improved: list[Candidate] = []
    for one in sorted(in_threads(improve, rough), key=lambda one: one.cost):
        apart = (mean_distance(one.coarse[0].positions, other.coarse[0].positions, graph.areas) for other in improved)
        # The pose of the files is finished by itself, also near an assignment, which may be wrong.
        if min(apart, default=np.inf) >= DIFFERENT or (limbs.assignments and one.limbs is None):
            improved.append(one)
    hopeful = [one for one in improved if one.cost <= HOPELESS * improved[0].cost]
    as_filed = [one for one in hopeful[MAX_FINISHED:] if one.rough.name == AS_FILED]
    return [*hopeful[:MAX_FINISHED], *as_filed[:1]]


def _apart(ranked: Sequence[Candidate], areas: FloatArray, least: float) -> list[Candidate]:
    """Candidates whose rough placements are at least ``least`` away from every better one."""
    kept = distinct([one.rough for one in ranked], areas, least)
    return [one for one in ranked if one.rough in kept]
