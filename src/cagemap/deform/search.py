"""Search from several starts: coarse placements that are apart are refined, and the cheapest one wins.

Limbs turned about their axis hardly cost anything on the coarse graph; refined, they do (docs/lab/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from cagemap.deform.best_parts import best_parts
from cagemap.deform.fit import coarse_fit, fine_fit, fine_stage, with_cost
from cagemap.deform.inverse_consistency import inverse_consistent
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.pose import fit_in_pose, largest_limb_rotation, pose_difference
from cagemap.deform.problem import Problem
from cagemap.deform.starts import SpectralSides, spectral_starts, start_map
from cagemap.maps.pair import Progress, silent
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import ThreadPool, in_threads

# Landmarks that a similarity needs.
FEWEST_LANDMARKS = 2


def search(problem: Problem, progress: Progress = silent, start: FloatArray | None = None) -> tuple[Placement, ...]:
    """Placements of the target's mesh, the cheapest first; several only where it was not clear from the start.

    The coarse stage starts from the spectral map and from the landmarks alone. Where these two end apart, or a limb is
    posed otherwise, limbs may be turned (`multi_start`). Elsewhere no joint needs the soft stage, and the stiff one
    spreads the strain more evenly.

    Parameters
    ----------
    problem : Problem
    progress : callable
    start : (k, 3) float64, optional
        Places on the source of the coarse shape's vertices, instead of the spectral map. It alone counts where there
        are fewer than two landmarks.
    """
    progress("first alignment")
    elastic, graph = problem.prepared.elastic, problem.shape.rest.graph
    config, stiff = elastic.search, problem.stiff
    # The start from the landmarks is another one in the stiff stage: differentials are smoothed over its length.
    stiff_shape = problem.shape.smoothed(elastic.stiff_coarse.smoothing)

    def both_stages(rough: FloatArray | None) -> list[Placement]:
        """By the soft coarse stage and by the stiff one."""
        return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), [(problem, None), (stiff, stiff_shape)])

    if start is not None and len(problem.pair.landmarks) < FEWEST_LANDMARKS:
        return tuple(refine(problem, both_stages(start)))
    with ThreadPool(1) as aside:  # from the landmarks alone, while the functional map is made
        blind = aside.submit(both_stages, None)
        start = start_map(problem) if start is None else start
        progress("elastic alignment")
        soft_ones, stiff_ones = zip(both_stages(start), blind.result(), strict=True)
    # The costs of the coarse ones differ too little to choose by; a turned elbow shows on the mesh alone.
    refined = refine(problem, stiff_ones)
    rotation = largest_limb_rotation(problem.prepared.rest, refined[0].positions, config.limb_area)
    apart = mean_distance(soft_ones[0].positions, soft_ones[1].positions, graph.areas)
    if apart <= config.doubtful and rotation <= config.limb_rotation:
        return (refined[0],)
    return multi_start(problem, soft_ones, refined)


def multi_start(problem: Problem, coarse: Sequence[Placement], refined: Sequence[Placement]) -> tuple[Placement, ...]:
    """Placements, cheapest first, of two coarse ones that are apart and others that are refined.

    Spectral upsampling makes further starts of the first one. Unless there are masks, the best is moved on: where poses
    differ, it is fitted again in the source's pose (`fit_in_pose`), and made inverse consistent. Its cost stays as
    before, to compare with the others'.
    """
    rest = problem.prepared.rest
    starts = spectral_starts(coarse[0], SpectralSides.build(problem))
    more = in_threads(lambda rough: coarse_fit(problem, rough), starts)
    first, *others = refine_best(problem, [*coarse, *more], refined=refined)
    if rest.masks.any:  # what is masked is fitted back as well, and drags what is not with it
        return first, *others
    moved = first.positions
    if pose_difference(rest, moved) > problem.prepared.elastic.pose.difference:
        moved = fit_in_pose(problem, moved)
    return replace(first, final=inverse_consistent(problem, moved)), *others


def refine_best(
    problem: Problem, coarse: Sequence[Placement], most: int | None = None, refined: Sequence[Placement] = ()
) -> list[Placement]:
    """The fine stage from the cheapest coarse placements that are apart, by the cost of the mesh, beside refined ones.

    Where a cheaper one can be made of the best parts of all (`best_parts`), it comes first.
    """
    prepared, config = problem.prepared, problem.prepared.elastic.search
    ranked, areas = cheapest_first(coarse), problem.shape.rest.graph.areas
    areas = areas if ranked[0].graph is None else ranked[0].graph.areas
    hopeful = [placed for placed in ranked if placed.cost <= config.max_cost * ranked[0].cost]
    kept = distinct(hopeful, areas, config.min_distance)[: most or config.max_refined]
    found = cheapest_first([*refine(problem, kept), *refined])
    mixed = best_parts(prepared.rest.graph, found, config)
    if mixed is None:
        return found
    return cheapest_first([*found, with_cost(prepared, fine_stage(problem, mixed))])


def refine(problem: Problem, coarse: Sequence[Placement]) -> list[Placement]:
    """The fine stage from coarse placements, by the cost of the mesh."""
    return cheapest_first(in_threads(lambda one: with_cost(problem.prepared, fine_fit(problem, one)), coarse))


def cheapest_first(placements: Iterable[Placement]) -> list[Placement]:
    """Placements in the order of their costs."""
    return sorted(placements, key=lambda placed: placed.cost)
