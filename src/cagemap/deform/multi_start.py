"""Fits from several starts: coarse placements that are apart are refined, and the cheapest one wins.

Limbs turned about their axis hardly cost anything on the coarse graph; refined, they do (docs/lab/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from cagemap.deform.best_parts import best_parts
from cagemap.deform.fit import coarse_fit, fine_fit, fine_stage, with_cost
from cagemap.deform.inverse_consistency import inverse_consistent
from cagemap.deform.placement import Placement, distinct, mean_distance
from cagemap.deform.pose import fit_in_pose, largest_limb_rotation, pose_difference
from cagemap.deform.prepared import CoarseShape
from cagemap.deform.problem import Problem
from cagemap.deform.starts import SpectralSides, spectral_starts, start_map
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool, in_threads

# With fewer landmarks, they only help to choose among hypotheses; from here on they start a fit of their own.
FEWEST_LANDMARKS = 3


@dataclass(frozen=True, eq=False)
class AnchoredFits:
    """What held points lead to: landmarks, or the tips of assigned limbs beside them.

    Attributes
    ----------
    shape : CoarseShape
        The clusters that hold them.
    soft : tuple of Placement
        Of the soft coarse stage, from the spectral map and from the points' elastic energy alone.
    refined : tuple of Placement
        The fine stage, which holds landmarks only, from those of the stiff coarse stage; cheapest first.
    agree : bool
        Whether both starts end alike, and no limb is posed otherwise: then no joint needs the soft stage, and the
        stiff one spreads the strain more evenly.
    """

    shape: CoarseShape
    soft: tuple[Placement, ...]
    refined: tuple[Placement, ...]
    agree: bool

    @classmethod
    def of(
        cls,
        problem: Problem,
        shape: CoarseShape,
        vertices: tuple[IndexArray, IndexArray],
        start: FloatArray | None = None,
    ) -> AnchoredFits:
        """Fit from both starts.

        Parameters
        ----------
        problem : Problem
        shape : CoarseShape
        vertices : (p,) int64, (p,) int64
            What the shape holds, of the levels of target and source that are searched.
        start : (k, 3) float64, optional
            Places of the clusters, instead of the spectral map; it alone counts where too few points are held.
        """
        elastic, stiff = problem.prepared.elastic, problem.stiff
        # The start from the points is another one in the stiff stage: differentials are smoothed over its length.
        stages = (problem, shape), (stiff, shape.smoothed(elastic.stiff_coarse.smoothing))

        def both_stages(rough: FloatArray | None) -> list[Placement]:
            """By the soft coarse stage and by the stiff one."""
            return in_threads(lambda stage: coarse_fit(stage[0], rough, stage[1]), stages)

        if start is not None and len(vertices[0]) < FEWEST_LANDMARKS:
            return cls(shape, (), tuple(refine(problem, both_stages(start))), agree=True)
        with ThreadPool(1) as aside:  # from the points alone, while the functional map is made
            blind = aside.submit(both_stages, None)
            first = both_stages(start_map(problem, shape, vertices) if start is None else start)
            soft, stiff_ones = zip(first, blind.result(), strict=True)
        # The costs of the coarse ones differ too little to choose by; a turned elbow shows on the mesh alone.
        refined = tuple(refine(problem, stiff_ones))
        rotation = largest_limb_rotation(problem.prepared.rest, refined[0].positions, elastic.search.limb_area)
        apart = mean_distance(soft[0].positions, soft[1].positions, shape.rest.graph.areas)
        agree = apart <= elastic.search.doubtful and rotation <= elastic.search.limb_rotation
        return cls(shape, soft, refined, agree)

    def upsampled(self, problem: Problem) -> AnchoredFits:
        """The same with what spectral upsampling makes of the first soft one, and with the best parts of all."""
        starts = spectral_starts(self.soft[0], SpectralSides.build(problem, self.shape))
        more = in_threads(lambda rough: coarse_fit(problem, rough, self.shape), starts)
        refined = refine_best(problem, [*self.soft, *more], refined=self.refined)
        return replace(self, refined=tuple(refined)).like(self.refined[0])

    def like(self, placed: Placement) -> AnchoredFits:
        """The same with the name and the doubt of a placement."""
        return replace(self, refined=tuple(replace(one, name=placed.name, doubt=placed.doubt) for one in self.refined))


def finished(problem: Problem, placed: Placement) -> Placement:
    """The placement fitted again in the source's pose, and made inverse consistent where that costs hardly more.

    Its cost and positions stay as before, to compare with others'. Not under masks: what is masked would be fitted back
    as well, and drag what is not with it.
    """
    prepared, posed = problem.prepared, placed
    if prepared.rest.masks.any:
        return placed
    if pose_difference(prepared.rest, placed.positions) > prepared.elastic.pose.difference:
        posed = with_cost(prepared, fit_in_pose(problem, placed.positions))
    both_ways = with_cost(prepared, inverse_consistent(problem, posed.positions))
    cheap = both_ways.cost <= prepared.elastic.search.as_cheap * posed.cost
    return replace(placed, final=(both_ways if cheap else posed).positions)


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
    """Placements sorted by cost, ascending."""
    return sorted(placements, key=lambda placed: placed.cost)
