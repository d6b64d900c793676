"""Whether the target lies better on the source's mirror image: a left shoe on a right one, opposite strides.

No map without folds mirrors, so that a fit then puts a thumb where the little finger is, or twists the hips until legs
have changed places. That costs hardly more than a fit of bodies in different poses, and no other way to lie is cheaper.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.geometry.closest import closest_points
from cagemap.geometry.polylines import Polyline
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic.ends import different
from cagemap.maps.elastic.fit import coarse_fit
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.elastic.ties import Ties
from cagemap.maps.hypotheses.search import ALIKE, rough_problem
from cagemap.maps.hypotheses.starts import Start, rigid_starts
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads, thread_limit

# Starts that are fitted, those that begin nearest to the surface.
NEAREST_STARTS = 4
ACROSS = np.array([-1.0, 1.0, 1.0])


def mirrored_gain(problem: FitProblem, positions: FloatArray) -> float:
    """How many times more the target costs on the source than on its mirror image, both on the small graph.

    On either from the starts that begin nearest to it, on the source from known positions (n, 3) as well: from one
    start alone, two bodies of a kind that stand alike seemed 1.13 times better mirrored.
    """
    rough, sheet = rough_problem(problem), problem.prepared.sheet
    graph, ties = rough.shape.rest.graph, rough.shape.ties
    mirrored = TriangleSurface(sheet.positions * ACROSS, sheet.triangles[:, ::-1])

    def least(side: TriangleSurface, met: Ties, *known: FloatArray) -> float:
        onto = replace(rough, prepared=replace(rough.prepared, sheet=side))
        shape = replace(rough.shape, ties=met)

        def away(start: Start) -> float:
            return float(graph.areas @ closest_points(side.tree, start.positions)[2] ** 2)

        def cost(start: FloatArray) -> float:
            with thread_limit(1):
                return coarse_fit(onto, start, shape).cost

        nearest = sorted(rigid_starts(graph.positions, side.positions), key=away)
        tried = different(nearest, lambda start: start.positions, graph.areas, ALIKE)[:NEAREST_STARTS]
        return min(in_threads(cost, [*known, *(start.positions for start in tried)]))

    given = least(sheet, ties, positions[rough.shape.vertices])
    return given / least(mirrored, mirrored_ties(ties))


def mirrored_ties(ties: Ties) -> Ties:
    """The same points and curves, to be met on the source's mirror image."""
    curves = (
        replace(curve, source=Polyline(curve.source.positions * ACROSS, curve.source.closed)) for curve in ties.curves
    )
    return replace(ties, places=ties.places * ACROSS, curves=tuple(curves))
