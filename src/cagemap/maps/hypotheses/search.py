"""From many rough ways to lie on the source to the few that are fitted to the end, ranked by what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cagemap.maps.elastic.config import Stage
from cagemap.maps.elastic.constants import MOST_ENDS, SHEET_VERTICES
from cagemap.maps.elastic.ends import FineFit, different, finished_ends, judged, mean_distance
from cagemap.maps.elastic.fit import CoarseFit, coarse_fit
from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.elastic.starts import SpectralSides, spectral_starts
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.starts import AS_FILED, Start, rigid_starts
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


@dataclass(frozen=True)
class _Candidate:
    """Where a start ended, and where others of the same name did; cheapest first."""

    name: str
    doubt: float
    fits: tuple[CoarseFit, ...]

    @property
    def fit(self) -> CoarseFit:
        return self.fits[0]

    @property
    def rank(self) -> float:
        return self.doubt * self.fit.cost


def found_readings(problem: FitProblem, progress: Progress = silent) -> tuple[Reading, ...]:
    """Different ways in which the target lies on the source, fitted, best first: by cost and doubt.

    Landmarks, if there are any, are held by all of them. Positions are those of the vertices of the level
    that is deformed.
    """
    progress("hypotheses")
    rough = rough_fits(problem)
    progress("coarse fits")
    candidates = coarse_fits(problem, rough)
    progress("elastic fits")

    def finish(candidate: _Candidate) -> FineFit:
        most = MOST_ENDS if candidate is candidates[0] else 1
        return finished_ends(problem, candidate.fits, most)[0]

    ends = in_threads(finish, candidates)
    if min(ended.cost for ended in ends) > OF_ONE_KIND:
        tips = Tips.of(problem)
        ends = in_threads(lambda ended: led_by_tips(problem, tips, ended), ends)
    finished = [
        Reading(candidate.name, ended.cost, ended.positions, candidate.doubt)
        for candidate, ended in zip(candidates, ends, strict=True)
    ]
    least, areas = least_cost(problem.prepared), problem.prepared.rest.graph.areas
    readings = sorted(finished, key=lambda reading: reading.doubt * max(reading.cost, least))
    return tuple(different(readings, lambda reading: reading.positions, areas, DIFFERENT))


def least_cost(prepared: PreparedPair) -> float:
    """What the target costs where it lies on itself: chords and samples, which tell nothing of how a fit is.

    What costs less is as good as what costs as much: a box turned upon itself stretches affinely, which is free, and
    its samples may fall better. Under masks a fit costs less because less of it counts, and so does this.
    """
    target, rest, own = prepared.target, prepared.rest, replace(prepared.rest, masks=WHOLE)
    sheet = target.triangles(target.refinement.coarsest_level(SHEET_VERTICES))
    on_itself = replace(prepared, rest=own, sheet=sheet)
    counts = rest.graph.areas @ rest.masks.of_target(rest.graph.n), rest.pullers(prepared.sheet).areas.sum()
    return float(min(counts)) * judged(on_itself, rest.graph.positions).cost


def rough_problem(problem: FitProblem) -> FitProblem:
    """The same on the small graph on which all starts are tried."""
    return problem.staged(ROUGH, ROUGH_VERTICES)


def rough_fits(problem: FitProblem) -> list[_Candidate]:
    """The different ends of all rigid starts on a small graph, cheapest first."""
    rough = rough_problem(problem)
    small = rough.shape.rest.graph

    def trial(start: Start) -> _Candidate:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            ended = coarse_fit(rough, start.positions)
            return _Candidate(start.name, start.doubt, (ended,))

    starts = rigid_starts(small.positions, problem.prepared.sheet.positions)
    tried = in_threads(trial, different(starts, lambda start: start.positions, small.areas, ALIKE))
    ranked = sorted(tried, key=lambda one: one.rank)
    kept = _first(different(ranked, lambda one: one.fit.positions, small.areas, DIFFERENT), COARSE)
    # What starts of several names lead to has the first one's, which is the simplest.
    firsts = [
        next(t for t in tried if mean_distance(t.fit.positions, one.fit.positions, small.areas) < DIFFERENT)
        for one in kept
    ]
    return [_Candidate(first.name, first.doubt, one.fits) for first, one in zip(firsts, kept, strict=True)]


def coarse_fits(problem: FitProblem, rough: Sequence[_Candidate]) -> list[_Candidate]:
    """Coarse fits of each rough one: from where it is, and from what spectral upsampling makes of that."""
    graph = problem.shape.rest.graph
    sides = SpectralSides.build(problem)

    def improve(candidate: _Candidate) -> _Candidate:
        with thread_limit(1):
            own = coarse_fit(problem, candidate.fit.on(graph))
            others = [coarse_fit(problem, start) for start in spectral_starts(own, sides)]
        return replace(candidate, fits=tuple(sorted([own, *others], key=lambda ended: ended.cost)))

    improved = sorted(in_threads(improve, rough), key=lambda one: one.rank)
    kept = different(improved, lambda one: one.fit.positions, graph.areas, DIFFERENT)
    hopeful = [one for one in kept if one.fit.cost <= HOPELESS * kept[0].fit.cost]
    return _first(hopeful, FINISHED)


def _first(ranked: Sequence[_Candidate], count: int) -> list[_Candidate]:
    """The first candidates, and of the others the one that lies as the files stand."""
    return [*ranked[:count], *(one for one in ranked[count:] if one.name == AS_FILED)]
