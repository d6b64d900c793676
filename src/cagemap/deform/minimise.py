"""Minimise an elastic energy with other terms: positions and differentials alternate.

Every deformation is one call of `minimise` with its graph, differentials and terms: the coarse and the fine stage,
positions from landmarks alone, the pose of a placement, the response of a map to its landmarks, and the wrap of a net.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Protocol

import numpy as np

from cagemap.deform.config import Stage
from cagemap.deform.graph import ElasticGraph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool

# Maps (n, 3, 3) of positions, and which of them were bounded (b,).
Differentials = tuple[FloatArray, IndexArray]


class System(Protocol):
    """Linear system of the positions."""

    def solve(self, right: FloatArray, positions: FloatArray) -> FloatArray:
        """(n, 3) new positions, from a right side (n, 3) and the positions before (n, 3)."""


class Quadratic(Protocol):
    """Terms of one iteration, ``x^T B x - 2 b^T x`` up to a constant."""

    @property
    def right(self) -> FloatArray:
        """(n, 3) b."""

    def system(self, alpha: float, stage: Stage, before: Any) -> System:
        """System ``alpha L + B``; reuses the factors of the system ``before``, if any."""


# Data terms and constraints at positions (n, 3), from their differentials (computed meanwhile), the stiffness alpha and
# the terms of the previous iteration (None in the first).
Terms = Callable[[FloatArray, Future[Differentials], float, Any], Quadratic]


def minimise(
    graph: ElasticGraph,
    differentials: Callable[[FloatArray], Differentials],
    terms: Terms,
    start: FloatArray,
    stage: Stage,
    adjust: Callable[[FloatArray], FloatArray] = lambda positions: positions,
) -> FloatArray:
    """Positions x (n, 3) that minimise ``alpha E(x, A)`` plus terms; alternates positions and differentials A.

    Momentum makes the alternation three times faster. ``adjust`` is applied to the positions of every iteration, to
    keep a symmetry.
    """
    positions, before = start, start
    quadratic: Quadratic | None = None
    system: System | None = None
    last_alpha = 0.0
    with ThreadPool(1) as pool:
        for iteration, alpha in enumerate(stage.ramped().tolist(), start=1):
            pending = pool.submit(differentials, positions)
            last, quadratic = quadratic, terms(positions, pending, alpha, quadratic)
            if system is None or quadratic is not last or alpha != last_alpha:
                anew = (iteration - 1) % stage.factored == 0
                system, last_alpha = quadratic.system(alpha, stage, None if anew else system), alpha
            maps, bounded = pending.result()
            right = quadratic.right + alpha * graph.divergence(maps)
            after = adjust(system.solve(right, positions))
            if iteration >= stage.iterations and len(bounded) <= stage.max_bounded * graph.n:
                return after
            positions = after + stage.momentum * (after - before) if iteration > 1 else after
            before = after
    return np.asarray(before)
