"""The problem of a fit: two prepared surfaces with landmarks and curves."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import Stage
from cagemap.deform.constraints import Anchors, Constraints
from cagemap.deform.prepared import CoarseShape, PreparedPair
from cagemap.maps.pair import Pair, vertices_near
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept


@dataclass(frozen=True, eq=False)
class Problem:
    """A prepared pair with landmarks; what follows from both is made when it is first asked for, and kept.

    Attributes
    ----------
    prepared : PreparedPair
    pair : Pair
        The same surfaces with their landmarks.
    """

    prepared: PreparedPair
    pair: Pair

    @kept
    def landmark_vertices(self) -> tuple[IndexArray, IndexArray]:
        """(p,) vertices of target and source that landmarks lie on or near, of the levels that are searched."""
        prepared, landmarks = self.prepared, self.pair.landmarks
        target = vertices_near(landmarks.target, prepared.target, prepared.levels[0])
        return target, vertices_near(landmarks.source, prepared.source, prepared.levels[1])

    @kept
    def shape(self) -> CoarseShape:
        """Clusters of the target's mesh, every landmark one of its own."""
        return self.holding(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))

    def holding(self, vertices: IndexArray, places: FloatArray) -> CoarseShape:
        """The clusters where some vertices (q,) of the target's mesh are held at places (q, 3) beside the landmarks."""
        rest, landmarks = self.prepared.rest, self.pair.landmarks
        curves = self.prepared.curves(landmarks)
        held, wanted = (
            np.concatenate([self.landmark_vertices[0], vertices]),
            np.vstack([landmarks.source.positions, places]),
        )
        return CoarseShape.build(rest.graph, held, wanted, self.prepared.elastic, rest.masks, curves)

    @kept
    def constraints(self) -> Constraints:
        """Landmarks and curves on the mesh that the fine stage deforms."""
        prepared, landmarks = self.prepared, self.pair.landmarks
        anchors = Anchors.on_level(prepared.target, prepared.levels[0], landmarks.target, prepared.elastic.data)
        return Constraints(anchors, landmarks.source.positions, prepared.curves(landmarks))

    @kept
    def reversed(self) -> Problem:
        """The reverse problem: the source is deformed onto the target."""
        pair = Pair(self.pair.source, self.pair.target, self.pair.landmarks.reversed())
        return Problem(self.prepared.reversed, pair)

    def without(self, left_out: Collection[int]) -> Problem:
        """The problem without some of the landmarks."""
        return replace(self, pair=self.pair.without(left_out))

    @kept
    def stiff(self) -> Problem:
        """The problem with the stiff coarse stage."""
        return self.staged(self.prepared.elastic.stiff_coarse)

    def staged(self, coarse: Stage, vertices: int | None = None) -> Problem:
        """The problem with another coarse stage, and with about so many clusters for it."""
        elastic = self.prepared.elastic
        elastic = replace(elastic, coarse=coarse, coarse_vertices=vertices or elastic.coarse_vertices)
        return replace(self, prepared=replace(self.prepared, elastic=elastic))
