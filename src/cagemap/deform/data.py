"""Data terms, point-to-plane distances to closest points both ways; and constraints by landmarks and curves.

A term is ``sum_i (x_i - y_i)^T B_i (x_i - y_i)`` up to a constant: blocks B (n, 3, 3) and right side B y (n, 3). Its
planes have unit normals, so that the trace of B_i is the area weight of vertex i.

Closest points also pair parts without a counterpart (cavities, skin between toes, fingers in a mitten) with something:
the inside of a mouth with the chin. Two tests detect them, and their terms get no weight: such a part of the target
receives none of the source's area, and the round trip from such a point of the source to the target and back does not
return to it. Both stages of `deform.fit` sum these terms (`cluster_terms`, `mesh_terms`): add a new one there.

`PlacementConstraints` adds the terms of landmarks and curves to the same blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.deform.config import DataConfig, ElasticConfig
from cagemap.maps.masks import WHOLE, Masks
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, places_of
from cagemap.numerics.sparse_algebra import Factorization
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.polylines import Polyline, normal_projections
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows


class SurfaceSamples(NamedTuple):
    """Points (m, 3) of a surface, with normals (m, 3) and the areas (m,) that they stand for, at any scale."""

    points: FloatArray
    normals: FloatArray
    areas: FloatArray

    @classmethod
    def at_vertices(cls, surface: TriangleSurface, count: int, weights: FloatArray | None = None) -> SurfaceSamples:
        """Vertices evenly spaced by number; areas have the sum 1, times weights (n,) of all vertices."""
        chosen = evenly_spaced_vertices(surface.n, count)
        areas = surface.vertex_areas[chosen]
        shares = areas / areas.sum() * (1.0 if weights is None else weights[chosen])
        return cls(surface.positions[chosen], surface.vertex_normals[chosen], shares)


def target_to_source(
    areas: FloatArray, nearest: SurfacePoints, normals: FloatArray, masks: Masks = WHOLE, *, beyond: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Point-to-plane term of the deformed vertices, to tangent planes of the source; and its closest points (n, 3).

    Normals (n, 3) are of the deformed target. Beyond the source's boundary a vertex has a term only if ``beyond``:
    needed without source-to-target terms, where a target could move off the source.
    """
    source, corners = nearest.surface, nearest.corners
    corner_normals = source.vertex_normals[corners]
    closest = curved_points(source.positions[corners], corner_normals, nearest.barycentric)
    plane = normalize_rows(np.einsum("mk,mkd->md", nearest.barycentric, corner_normals))
    weights = areas * np.clip(np.einsum("nd,nd->n", plane, normals), 0.0, 1.0)
    weights *= masks.of_target(len(areas)) * masks.at_source(nearest)
    if not beyond:
        weights *= ~nearest.at_boundary
    blocks = weights[:, None, None] * plane[:, :, None] * plane[:, None, :]
    return blocks, np.einsum("nab,nb->na", blocks, closest), closest


def source_to_target(
    target: TriangleSurface,
    samples: SurfaceSamples,
    positions: FloatArray,
    normals: FloatArray,
    closest: FloatArray,
    alpha: float,
    guess: IndexArray | None = None,
    masks: Masks = WHOLE,
    config: ElasticConfig = ElasticConfig(),
) -> tuple[FloatArray, FloatArray, FloatArray, IndexArray]:
    """Point-to-plane term of source vertices, to the deformed target.

    Returns blocks and right sides, the source area (n,) that each vertex receives, and the triangles (m,) of the
    closest points.

    ``closest`` (n, 3) are the source's points closest to the target's vertices, at the ends of round trips; the guess
    (m,) has triangles of an earlier search.

    The residual r = n . (q - sum_k b_k x_k) of a source vertex q is given to each corner of the triangle that holds its
    closest point, with weight b_k: an upper bound of the true term (Jensen), equal at the current positions.
    """
    points, sample_normals, areas = samples
    tree = build_tree(positions, target.triangles)
    triangles, barycentric, _ = closest_points(
        tree, points, sample_normals, normal_weight=config.normal_weight, guess=guess
    )
    corners = target.triangles[triangles]
    own_closest = curved_points(positions[corners], normals[corners], barycentric)
    residual = np.einsum("nd,nd->n", sample_normals, points - own_closest)
    facing = tree.normals_of(triangles)
    shares = areas * np.clip(np.einsum("nd,nd->n", facing, sample_normals), 0.0, 1.0)
    trips = np.einsum("mk,mkd->md", barycentric, closest[corners]) - points
    shares *= round_trip_weights(trips, residual, alpha, config.data) * ~target.at_boundary(triangles, barycentric)
    if masks.target is not None:
        shares *= np.einsum("mk,mk->m", barycentric, masks.target[corners])
    # Column j gives the term of source vertex j to the three corners around its closest point.
    gather = sparse.csc_array(
        ((shares[:, None] * barycentric).ravel(), corners.ravel(), 3 * np.arange(len(points) + 1)),
        shape=(len(positions), len(points)),
    )
    outer = (sample_normals[:, :, None] * sample_normals[:, None, :]).reshape(-1, 9)
    gathered = gather @ np.hstack([outer, residual[:, None] * sample_normals, np.ones((len(points), 1))])
    blocks = gathered[:, :9].reshape(-1, 3, 3)
    right = np.einsum("nab,nb->na", blocks, positions) + gathered[:, 9:12]
    return blocks, right, gathered[:, 12], triangles


def source_to_clusters(
    samples: SurfaceSamples,
    positions: FloatArray,
    normals: FloatArray,
    masks: Masks = WHOLE,
    config: ElasticConfig = ElasticConfig(),
) -> tuple[FloatArray, FloatArray]:
    """Point-to-plane term of source samples, each for the coarse vertex nearest in position and normal.

    Only source-to-target terms detect a short leg inside a long one. The plane has the mean of both normals (symmetric
    ICP, Rusinkiewicz 2019).
    """
    points, sample_normals, areas = samples
    tree = cKDTree(np.hstack([positions, config.normal_weight * normals]))
    nearest = np.asarray(tree.query(np.hstack([points, config.normal_weight * sample_normals]))[1], dtype=np.int64)
    between, facing = (
        normalize_rows(sample_normals + normals[nearest]),
        np.einsum("md,md->m", sample_normals, normals[nearest]),
    )
    shares = areas * np.clip(facing, 0.0, 1.0) * masks.of_target(len(positions))[nearest]
    planes_between = between[:, :, None] * between[:, None, :]
    right = np.einsum("mab,mb->ma", planes_between, points)
    terms = np.hstack([planes_between.reshape(-1, 9), right])
    summed = grouped_sums(nearest, shares[:, None] * terms, len(positions))
    return summed[:, :9].reshape(-1, 3, 3), summed[:, 9:]


def curved_points(corners: FloatArray, normals: FloatArray, barycentric: FloatArray) -> FloatArray:
    """(m, 3) points of the curved surface above those of its triangles, exact for quadratics (Boubekeur, Alexa 2008).

    A triangle is h^2 / 8 R inside a surface of radius R, so that without this fits shrink or swell, and maps slide
    sideways.
    """
    flat = np.einsum("mk,mkd->md", barycentric, corners)
    heights = np.einsum("mkd,mkd->mk", corners - flat[:, None], normals)
    return np.asarray(flat + 0.5 * np.einsum("mk,mkd->md", barycentric * heights, normals))


def round_trip_weights(
    trips: FloatArray, heights: FloatArray, alpha: float, config: DataConfig = DataConfig()
) -> FloatArray:
    """(m,) weights ``1 / (1 + d^2 / s^2)^2`` of source points by round trips d (m, 3) (Geman and McClure 1985).

    The scale s is smaller for points inside the deformed target, because it does not expand inwards.
    """
    scale = np.where(heights > 0, config.outside_trips * np.sqrt(alpha), config.inside_trip)
    return np.asarray(1.0 / (1.0 + np.einsum("md,md->m", trips, trips) / scale**2) ** 2)


def received_weights(
    smoother: Factorization, received: FloatArray, config: DataConfig = DataConfig(), *, of_parts: bool
) -> FloatArray:
    """(n,) weights from 0 to 1, by the source's area that vertices receive (n,), relative to their own.

    For parts of surfaces, whose unit areas are not comparable, densities are relative to the mean density.
    """
    none, full = config.received
    density = smoother.solve(received)
    if of_parts:
        density = density * (received.sum() / max(float(received @ density), 1e-12))
    return np.clip((density - none) / (full - none), 0.0, 1.0)


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


def constrained_clusters(
    curves: Sequence[CurveConstraint], constrained: IndexArray, vertices: int, config: DataConfig
) -> tuple[IndexArray, tuple[CurveConstraint, ...]]:
    """Vertices (p + c,) that need clusters of their own, constrained ones (p,) first; and curves on these."""
    each = max(vertices // config.curve_share // max(len(curves), 1), config.min_curve_points)
    thinned = [curve.thinned(each) for curve in curves]
    listed = np.concatenate([constrained, *(curve.anchors.corners[:, 0] for curve in thinned)])
    distinct = listed[np.sort(np.unique(listed, return_index=True)[1])]
    place = places_of(distinct, int(distinct.max(initial=-1)) + 1)
    on_clusters = tuple(replace(curve, anchors=curve.anchors.renumbered(place.__getitem__)) for curve in thinned)
    return distinct, on_clusters
