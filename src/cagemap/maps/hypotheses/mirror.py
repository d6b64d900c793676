"""Whether the target lies better on the source's mirror image: a left shoe on a right one, opposite strides.

No map without folds mirrors, so that a fit then puts a thumb where the little finger is, or twists the hips until legs
have changed places. That costs hardly more than a fit of bodies in different poses, and no other way to lie is cheaper.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.deform.constraints import Constraints
from cagemap.deform.fit import coarse_fit
from cagemap.deform.placement import Placement, distinct
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.candidates import rough_problem
from cagemap.maps.hypotheses.rigid_starts import rigid_starts
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads, thread_limit
from cagemap.surface.closest_points import closest_points
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import TriangleSurface

ACROSS = np.array([-1.0, 1.0, 1.0])


def mirrored_gain(problem: Problem, positions: FloatArray) -> float:
    """How many times more the target costs on the source than on its mirror image, both on the small graph.

    On either from the starts that begin nearest to it, on the source from known positions (n, 3) as well: from one
    start alone, two bodies of a kind that stand alike seemed 1.13 times better mirrored.
    """
    rough, source = rough_problem(problem), problem.prepared.source_surface
    graph, constraints = rough.shape.rest.graph, rough.shape.constraints
    config = problem.prepared.elastic.hypotheses
    mirrored = TriangleSurface(source.positions * ACROSS, source.triangles[:, ::-1])

    def least(side: TriangleSurface, held: Constraints, *known: FloatArray) -> float:
        onto = replace(rough, prepared=replace(rough.prepared, source_surface=side))
        shape = replace(rough.shape, constraints=held)

        def away(start: Placement) -> float:
            return float(graph.areas @ closest_points(side.tree, start.positions)[2] ** 2)

        def cost(start: FloatArray) -> float:
            with thread_limit(1):
                return coarse_fit(onto, start, shape).cost

        nearest = sorted(rigid_starts(graph.positions, side.positions), key=away)
        tried = distinct(nearest, graph.areas, config.alike)[: config.mirrored_starts]
        return min(in_threads(cost, [*known, *(start.positions for start in tried)]))

    given = least(source, constraints, positions[rough.shape.vertices])
    return given / least(mirrored, mirrored_constraints(constraints))


def mirrored_constraints(constraints: Constraints) -> Constraints:
    """The same points and curves on the source's mirror image."""
    curves = (
        replace(curve, source=Polyline(curve.source.positions * ACROSS, curve.source.closed))
        for curve in constraints.curves
    )
    return replace(constraints, places=constraints.places * ACROSS, curves=tuple(curves))
