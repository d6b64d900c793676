"""Whether a pair may still be 'sure': from early on most pairs of different kinds may not, and need no finished map."""

from __future__ import annotations

from cagemap.deform.search import refine_best

from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.candidates import coarse_fits, rough_fits
from cagemap.maps.hypotheses.confidence import SURE_COST, SURE_TURNED_COST
from cagemap.maps.hypotheses.tips import Tips, led_by_tips
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.threads import one_blas_thread
from cagemap.pipeline import pair_of, prepare_pair
from cagemap.spectral import Surface


def may_be_sure(target: Surface, source: Surface) -> bool:
    """Whether any answer without landmarks costs little enough; its gap and its shape are not asked for.

    A coarse fit costs less than what is made of it: of 134 that were finished, between kinds, the cost grew by a third
    at least and tenfold in the median. So an answer whose coarse fit costs too much already is not finished.
    """
    prepared = prepare_pair(target, source)
    problem = Problem(prepared, pair_of(prepared.target, prepared.source, Landmarks.none()))
    with one_blas_thread():
        candidates = coarse_fits(problem, rough_fits(problem))
        tips = Tips.of(problem)
        for candidate in candidates:
            bound = SURE_COST if candidate[0].doubt == 1.0 else SURE_TURNED_COST
            if candidate[0].cost <= bound:
                ended = refine_best(problem, candidate, None if candidate is candidates[0] else 1)[0]
                if min(ended.cost, led_by_tips(problem, tips, ended).cost) <= bound:
                    return True
    return False
