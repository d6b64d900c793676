"""Search from several starts: coarse placements that are apart are refined, and the cheapest one wins.

Limbs turned about their axis hardly cost anything on the coarse graph; refined, they do (docs/lab/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cagemap.deform.fit import coarse_fit, fine_fit, with_cost
from cagemap.deform.inverse_consistency import inverse_consistent
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.pose import fit_in_pose, largest_limb_rotation, pose_difference
from cagemap.deform.problem import Problem
from cagemap.deform.starts import SpectralSides, spectral_starts, start_map
from cagemap.maps.pair import Progress, silent
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import ThreadPool, in_threads


def search(problem: Problem, progress: Progress = silent) -> tuple[Placement, ...]:
    """Placements of the target's mesh, the cheapest first; several only where it was not clear from the start.

    The coarse stage starts from the spectral map and from the landmarks alone. Where these two end apart, or a limb is
    posed otherwise, limbs may be turned (`multi_start`). Elsewhere no joint needs the soft stage, and the stiff one
    spreads the strain more evenly.
    """
    progress("functional map")
    elastic, graph = problem.prepared.elastic, problem.shape.rest.graph
    config, stiff = elastic.search, problem.stiff
    # The start from the landmarks is another one in the stiff stage: differentials are smoothed over its length.
    stiff_shape = problem.shape.smoothed(elastic.stiff_coarse.smoothing)

    def both_stages(rough: FloatArray | None) -> list[Placement]:
        """By the soft coarse stage and by the stiff one."""
        return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), [(problem, None), (stiff, stiff_shape)])

    with ThreadPool(1) as aside:  # from the landmarks alone, while the functional map is made
        blind = aside.submit(both_stages, None)
        start = start_map(problem)
        progress("elastic alignment")
        soft_ones, stiff_ones = zip(both_stages(start), blind.result(), strict=True)
    if mean_distance(soft_ones[0].positions, soft_ones[1].positions, graph.areas) > config.doubtful:
        return multi_start(problem, soft_ones, stiff_ones[0])
    best = min(stiff_ones, key=lambda placed: placed.cost)
    found = Placement(fine_fit(problem, best), best.cost)
    rotation = largest_limb_rotation(problem.prepared.rest, found.positions, config.limb_area)
    if rotation > config.limb_rotation:  # which only the mesh shows of a single elbow
        return multi_start(problem, soft_ones, stiff_ones[0])
    return (found,)


def multi_start(problem: Problem, coarse: Sequence[Placement], stiff: Placement) -> tuple[Placement, ...]:
    """Refined placements, cheapest first, where two coarse ones are apart.

    Spectral upsampling makes further starts of the first one. Unless there are masks, the best is moved on: where poses
    differ, it is fitted again in the source's pose (`fit_in_pose`), and made inverse consistent. Its cost stays as
    before, to compare with the others'.
    """
    rest = problem.prepared.rest
    starts = spectral_starts(coarse[0], SpectralSides.build(problem))
    more = in_threads(lambda rough: coarse_fit(problem, rough), starts)
    first, *others = refine_best(problem, [*coarse, *more], stiff=[stiff])
    if rest.masks.any:  # what is masked is fitted back as well, and drags what is not with it
        return first, *others
    moved = first.positions
    if pose_difference(rest, moved) > problem.prepared.elastic.pose.difference:
        moved = fit_in_pose(problem, moved)
    return replace(first, final=inverse_consistent(problem, moved)), *others


def refine_best(
    problem: Problem, coarse: Sequence[Placement], most: int | None = None, stiff: Sequence[Placement] = ()
) -> tuple[Placement, ...]:
    """The fine stage from the cheapest coarse placements that are apart, by the cost of the mesh."""
    config = problem.prepared.elastic.search
    ranked = sorted(coarse, key=lambda placed: placed.cost)
    hopeful = [placed for placed in ranked if placed.cost <= config.max_cost * ranked[0].cost]
    kept = distinct(hopeful, problem.shape.rest.graph.areas, config.min_distance)[: most or config.max_refined]
    found = in_threads(lambda one: with_cost(problem.prepared, fine_fit(problem, one)), [*kept, *stiff])
    return tuple(sorted(found, key=lambda placed: placed.cost))
