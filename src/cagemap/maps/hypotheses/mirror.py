"""Whether the target lies better on the source's mirror image: a left shoe on a right one, opposite strides.

No map without folds mirrors, so that a fit then puts a thumb where the little finger is, or twists the hips until legs
have changed places. That costs hardly more than a fit of bodies in different poses, and no other way to lie is cheaper.
"""

from __future__ import annotations

import numpy as np

from cagemap.geometry.closest import closest_points
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic.ends import different
from cagemap.maps.elastic.fit import coarse_fit
from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.search import ALIKE, rough_shape
from cagemap.maps.hypotheses.starts import Start, rigid_starts
from cagemap.maps.pair import Pair
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads, thread_limit

# Starts on the mirror image that are fitted, those that begin nearest to it.
MIRRORED_STARTS = 4
ACROSS = np.array([-1.0, 1.0, 1.0])


def mirrored_gain(prepared: PreparedPair, pair: Pair, reading: Reading) -> float:
    """How many times more a reading costs than the target on the source's mirror image, both on the small graph."""
    rough, config = rough_shape(prepared, pair)
    sheet, places = prepared.sheet, pair.landmarks.source.positions
    mirrored = TriangleSurface(sheet.positions * ACROSS, sheet.triangles[:, ::-1])

    def cost(side: TriangleSurface, start: FloatArray, held: FloatArray) -> float:
        with thread_limit(1):
            return coarse_fit(rough, side, start, held, config).cost

    graph, tree = rough.rest.graph, mirrored.tree

    def away(start: Start) -> float:
        return float(graph.areas @ closest_points(tree, start.positions)[2] ** 2)

    nearest = sorted(rigid_starts(graph.positions, mirrored.positions), key=away)
    tried = different(nearest, lambda start: start.positions, graph.areas, ALIKE)[:MIRRORED_STARTS]
    own = cost(sheet, reading.positions[rough.vertices], places)
    return own / min(in_threads(lambda start: cost(mirrored, start.positions, places * ACROSS), tried))
