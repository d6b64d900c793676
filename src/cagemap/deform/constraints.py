"""Constraints of a placement: points at given positions, and curves on curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import DataConfig, ElasticConfig
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.polylines import Polyline, normal_projections


def add_to_corners(
    points: CagePoints,
    terms: FloatArray,
    forces: FloatArray,
    blocks: FloatArray,
    right: FloatArray,
    positions: FloatArray,
) -> None:
    """Add ``(sum_k b_k x_k - y)^T B (sum_k b_k x_k - y)`` of points to a data term (n, 3, 3), (n, 3), by their corners.

    ``terms`` are B (p, 3, 3), ``forces`` are B (y - sum_k b_k x_k) (p, 3).
    """
    at_corners = np.einsum("pab,pkb->pka", terms, positions[points.corners]) + forces[:, None]
    np.add.at(blocks, points.corners, points.weights[:, :, None, None] * terms[:, None])
    np.add.at(right, points.corners, points.weights[:, :, None] * at_corners)


@dataclass(frozen=True, eq=False)
class CurveConstraint:
    """A curve of a graph, constrained to its source curve, along which it may slide."""

    anchors: CagePoints  # (m,) points of the graph's mesh along the curve
    rest: Polyline  # their positions in the rest shape
    source: Polyline

    def terms(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Term of the curve for its points: B (m, 3, 3) of ``sum_i (x_i - y_i)^T B_i (x_i - y_i)``, and B (y - x).

        Closest points of the two polylines, both ways; distances are measured across the curve. A source point's
        residual is given to the two points beside its closest point, as in `source_to_target`. Ends correspond to ends.
        """
        polyline = Polyline(self.anchors.of(positions), self.source.closed)
        places, _, _, tangents = self.source.nearest(polyline.positions)
        blocks = self.rest.point_lengths[:, None, None] * normal_projections(tangents)
        moved = np.einsum("mab,mb->ma", blocks, places - polyline.positions)
        places, ends, share, tangents = polyline.nearest(self.source.positions)
        lengths = self.source.point_lengths * (self.rest.length / self.source.length)
        weights = lengths[:, None, None] * normal_projections(tangents)
        residual = np.einsum("mab,mb->ma", weights, self.source.positions - places)
        for side, weight in enumerate((1.0 - share, share)):
            np.add.at(blocks, ends[:, side], weight[:, None, None] * weights)
            np.add.at(moved, ends[:, side], weight[:, None] * residual)
        return blocks, moved

    def thinned(self, count: int) -> CurveConstraint:
        """The curve with at most ``count`` of its points, each moved to its nearest vertex."""
        chosen = self.rest.spread(count)
        vertices = self.anchors.at(chosen).heaviest_corners
        rows = np.sort(np.unique(vertices, return_index=True)[1])
        rest = Polyline(self.rest.positions[chosen][rows], self.rest.closed)
        return CurveConstraint(CagePoints.of_vertices(vertices[rows]), rest, self.source)


def constrained_clusters(
    curves: Sequence[CurveConstraint], constrained: IndexArray, vertices: int, config: DataConfig
) -> tuple[IndexArray, tuple[CurveConstraint, ...]]:
    """Vertices (p + c,) that need clusters of their own, constrained ones (p,) first; and curves on these."""
    each = max(vertices // config.curve_share // max(len(curves), 1), config.min_curve_points)
    thinned = [curve.thinned(each) for curve in curves]
    listed = np.concatenate([constrained, *(curve.anchors.corners[:, 0] for curve in thinned)])
    values, first = np.unique(listed, return_index=True)
    place = np.argsort(np.argsort(first))  # position of every value among the vertices
    numbered = (
        replace(curve, anchors=CagePoints.of_vertices(place[np.searchsorted(values, curve.anchors.corners[:, 0])]))
        for curve in thinned
    )
    return listed[np.sort(first)], tuple(numbered)


@dataclass(frozen=True, eq=False)
class PlacementConstraints:
    """Points and curves of a graph with their counterparts on the source."""

    anchors: CagePoints  # (p,) points of the graph's mesh
    places: FloatArray  # (p, 3) positions of these points on the source
    curves: tuple[CurveConstraint, ...] = ()

    def add(self, blocks: FloatArray, right: FloatArray, positions: FloatArray, config: ElasticConfig) -> None:
        """Add the terms of curves and points to a data term (n, 3, 3), (n, 3) at positions (n, 3)."""
        self.add_curves(blocks, right, positions, config)
        self.add_points(blocks, right, positions, config)

    def add_curves(self, blocks: FloatArray, right: FloatArray, positions: FloatArray, config: ElasticConfig) -> None:
        """Add the terms of curves alone."""
        for curve in self.curves:
            terms, forces = (config.curve_weight * part for part in curve.terms(positions))
            add_to_corners(curve.anchors, terms, forces, blocks, right, positions)

    def add_points(self, blocks: FloatArray, right: FloatArray, positions: FloatArray, config: ElasticConfig) -> None:
        """Add the terms of points alone.

        A point at a vertex replaces the vertex's other terms. Between vertices, ``|sum_k b_k x_k - y|^2`` gives every
        corner the residual with weight b_k, as in `source_to_target`.
        """
        weight, at_vertex = config.landmark_weight, self.anchors.weights[:, 0] == 1.0
        vertices = self.anchors.corners[at_vertex, 0]
        blocks[vertices] = weight * np.eye(3)
        right[vertices] = weight * self.places[at_vertex]
        between = self.anchors.at(np.flatnonzero(~at_vertex))
        missed = self.places[~at_vertex] - between.of(positions)
        terms = np.tile(weight * np.eye(3), (len(missed), 1, 1))
        add_to_corners(between, terms, weight * missed, blocks, right, positions)
