"""The default method: the spectral map with landmark coordinates finds the basin, the elastic fit finishes in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cagemap.basis import Surface
from cagemap.maps.elastic.both_ways import both_ways
from cagemap.maps.elastic.constants import DOUBTFUL, LIMB_POSED, POSES_DIFFER
from cagemap.maps.elastic.ends import FineFit, finished_ends, mean_distance
from cagemap.maps.elastic.fit import CoarseFit, coarse_fit, fine_fit
from cagemap.maps.elastic.pose import fit_in_pose, limb_turn, turn
from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.elastic.starts import SpectralSides, spectral_starts, start_map
from cagemap.maps.elastic.update import respond
from cagemap.maps.pair import Pair, Progress, silent
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.maps.spectral.samples import FIT_SAMPLES, Samples, fit_functional_map, spread
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import ThreadPool, in_threads


def elastic_answers(problem: FitProblem, progress: Progress = silent) -> tuple[PointMap, tuple[FineFit, ...]]:
    """Point map T12 of the finest levels: fitted on the level that is deformed, projected once, unfolded.

    Parameters
    ----------
    problem : FitProblem
    progress : callable

    Returns
    -------
    point_map : PointMap
    ends : tuple of FineFit
        Where the fit ended, see `fits`; the first is the map's own end.

    Raises
    ------
    InvalidLandmarksError
        If there are fewer than two landmarks.
    """
    found = fits(problem, progress)
    progress("projection")
    return map_of_places(problem.prepared, found[0].answer, problem.pair.landmarks), found


@kinds_checked
def fit(prepared: PreparedPair, pair: Pair, progress: Progress = silent) -> FloatArray:
    """Places (n, 3) near the source of the target's vertices of the level that is deformed: the first of `fits`.

    In the unit in which the source has area 1.
    """
    return fits(FitProblem(prepared, pair), progress)[0].answer


def fits(problem: FitProblem, progress: Progress = silent) -> tuple[FineFit, ...]:
    """Where the elastic fit ends, the cheapest end first; others only where it was not clear from the start.

    The functional map starts as the paper's (eqs. 13-16) and grows on the search levels beside harmonic and biharmonic
    landmark coordinates; from where it sends some vertices, and from the landmarks alone, the coarse stage of the
    elastic fit starts. Where these two end apart, or a limb is posed otherwise, limbs may be turned (`doubtful_ends`).
    Elsewhere no joint needs the soft stage, and a stiffer one spreads the strain more evenly.
    """
    progress("functional map")
    graph, settled = problem.shape.rest.graph, problem.staged(problem.prepared.elastic.settled)
    # The start from the landmarks is another one in the stiffer stage: differentials are smoothed over its length.
    stiffer = problem.shape.smoothed(settled.prepared.elastic.coarse.smoothing)

    def ends_from(rough: FloatArray | None) -> list[CoarseFit]:
        """Where both coarse stages end, the soft one and the stiffer one."""
        return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), [(problem, None), (settled, stiffer)])

    with ThreadPool(1) as aside:  # from the landmarks alone, while the functional map is made
        blind = aside.submit(ends_from, None)
        start = start_map(problem)
        progress("elastic fit")
        ends, stiff = zip(ends_from(start), blind.result(), strict=True)
    if mean_distance(ends[0].positions, ends[1].positions, graph.areas) > DOUBTFUL:
        return doubtful_ends(problem, ends, stiff[0])
    best = min(stiff, key=lambda ended: ended.cost)
    found = FineFit(best.cost, fine_fit(problem, best))
    if limb_turn(problem.prepared.rest, found.positions) > LIMB_POSED:  # which only the mesh shows of a single elbow
        return doubtful_ends(problem, ends, stiff[0])
    return (found,)


def doubtful_ends(problem: FitProblem, ends: Sequence[CoarseFit], stiff: CoarseFit) -> tuple[FineFit, ...]:
    """Finished ends, cheapest first, where two coarse fits ended apart.

    Spectral upsampling makes further starts of the first one's end, and the fine stage goes on from all that lie apart,
    and from where the stiffer coarse stage ends. Unless there are masks, the best is moved on: where poses differ, the
    target is brought into the pose that it shows and fitted anew (`fit_in_pose`); then half-way to what it is seen from
    the source (`both_ways`). Its cost stays that of the end, to compare with the others'.

    Parameters
    ----------
    problem : FitProblem
    ends : (CoarseFit, CoarseFit)
        From where the spectral map puts the coarse vertices, and from the landmarks alone.
    stiff : CoarseFit
        From the spectral map, of the stiffer stage.
    """
    rest = problem.prepared.rest
    starts = spectral_starts(ends[0], SpectralSides.build(problem))
    more = in_threads(lambda rough: coarse_fit(problem, rough), starts)
    first, *others = finished_ends(problem, [*ends, *more], stiff=[stiff])
    if rest.masks.any:  # what is masked is fitted back as well, and drags what is not with it
        return first, *others
    moved = first.positions
    if turn(rest, moved) > POSES_DIFFER:
        moved = fit_in_pose(problem, moved)
    return replace(first, moved=both_ways(problem, moved)), *others


def updated_map(prepared: PreparedPair, pair: Pair, before: PointMap, progress: Progress = silent) -> PointMap:
    """Point map T12 of the finest levels after landmarks changed, from the one before.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With the landmarks as they are now.
    before : PointMap
        Of the finest levels.
    progress : callable
    """
    progress("elastic response")
    moved = respond(FitProblem(prepared, pair), before)
    progress("projection")
    return map_of_places(prepared, moved, pair.landmarks)


@kinds_checked
def functional_map_of(target: Surface, source: Surface, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2)."""
    chosen = spread(len(point_map.images), FIT_SAMPLES)
    sampled = point_map.images.at(chosen)
    corners, places = np.unique(sampled.corners, return_inverse=True)
    at_vertices, at_corners = in_threads(
        lambda side: side[0].basis.rows(side[0].finest, side[1]), [(target, chosen), (source, corners)]
    )
    weights = sampled.barycentric
    pulled = np.asarray(sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3)))
    samples = Samples(at_vertices, target.triangles(target.finest).vertex_areas[chosen], np.zeros((len(chosen), 0)))
    return fit_functional_map(samples, pulled, target.basis.count)
