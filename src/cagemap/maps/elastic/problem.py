"""What one fit is given: two prepared surfaces, and the landmarks and curves that it has to meet."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.config import Stage
from cagemap.maps.elastic.curves import curves_on_mesh
from cagemap.maps.elastic.prepared import CoarseShape, PreparedPair
from cagemap.maps.elastic.ties import Ties
from cagemap.maps.pair import Pair, near_vertices
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept


@dataclass(frozen=True, eq=False)
class FitProblem:
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
    def near(self) -> tuple[IndexArray, IndexArray]:
        """(p,) vertices of target and source that landmarks lie on or near, of the levels that are searched."""
        prepared, landmarks = self.prepared, self.pair.landmarks
        target = near_vertices(landmarks.target, prepared.target, prepared.levels[0])
        return target, near_vertices(landmarks.source, prepared.source, prepared.levels[1])

    @kept
    def shape(self) -> CoarseShape:
        """Clusters of the target's mesh, every landmark one of its own."""
        return self.holding(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))

    def holding(self, vertices: IndexArray, places: FloatArray) -> CoarseShape:
        """The clusters where some vertices (q,) of the target's mesh are held at places (q, 3) beside the landmarks."""
        rest, landmarks = self.prepared.rest, self.pair.landmarks
        curves = curves_on_mesh(self.prepared.mesh, landmarks.curves)
        held, wanted = np.concatenate([self.near[0], vertices]), np.vstack([landmarks.source.positions, places])
        return CoarseShape.build(rest.graph, held, wanted, self.prepared.elastic, rest.masks, curves)

    @kept
    def ties(self) -> Ties:
        """Landmarks and curves on the mesh that the fine stage deforms."""
        mesh, landmarks = self.prepared.mesh, self.pair.landmarks
        anchors = Anchors.on_mesh(mesh, landmarks.target)
        return Ties(anchors, landmarks.source.positions, curves_on_mesh(mesh, landmarks.curves))

    @kept
    def reversed(self) -> FitProblem:
        """The same landmarks, to be met by the source on the target."""
        pair = Pair(self.pair.source, self.pair.target, self.pair.landmarks.reversed())
        return FitProblem(self.prepared.reversed, pair)

    def without(self, left_out: Collection[int]) -> FitProblem:
        """The problem without some of the landmarks."""
        return replace(self, pair=self.pair.without(left_out))

    def staged(self, coarse: Stage, vertices: int | None = None) -> FitProblem:
        """The problem with another coarse stage, and with about so many clusters for it."""
        elastic = self.prepared.elastic
        elastic = replace(elastic, coarse=coarse, coarse_vertices=vertices or elastic.coarse_vertices)
        return replace(self, prepared=replace(self.prepared, elastic=elastic))
