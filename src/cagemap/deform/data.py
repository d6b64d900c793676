"""Data terms: point-to-plane distances to closest points, target to source and source to target.

A term is ``sum_i (x_i - y_i)^T B_i (x_i - y_i)`` up to a constant: blocks B (n, 3, 3) and right side B y (n, 3). Its
planes have unit normals, so that the trace of B_i is the area weight of vertex i.

Closest points also pair parts without a counterpart (cavities, skin between toes, fingers in a mitten) with something:
the inside of a mouth with the chin. Two tests detect them, and their terms get no weight: such a part of the target
receives none of the source's area, and the round trip from such a point of the source to the target and back does not
return to it. Both stages of `deform.fit` sum these terms (`cluster_terms`, `mesh_terms`): add a new one there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.deform.config import DataConfig
from cagemap.maps.masks import WHOLE, Masks
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums
from cagemap.numerics.factorization import Factorization
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows


@dataclass(frozen=True, eq=False)
class SourceSamples:
    """Sampled vertices of the source that should be on the target."""

    points: FloatArray  # (m, 3)
    planes: FloatArray  # (m, 3): unit normals
    areas: FloatArray  # (m,): sum 1, times the source's mask
    outer: FloatArray  # (m, 9): normal times normal

    @classmethod
    def choose(cls, source: TriangleSurface, count: int, masks: Masks = WHOLE) -> SourceSamples:
        """Sample vertices of a source, evenly spaced by number."""
        chosen = evenly_spaced_vertices(len(source.positions), count)
        planes, areas = source.vertex_normals[chosen], source.vertex_areas[chosen]
        outer = (planes[:, :, None] * planes[:, None, :]).reshape(-1, 9)
        shares = areas / areas.sum() * masks.of_source(source.n)[chosen]
        return cls(source.positions[chosen], planes, shares, outer)


def target_to_source(
    areas: FloatArray, nearest: SurfacePoints, normals: FloatArray, masks: Masks = WHOLE, *, beyond: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Point-to-plane term of the deformed vertices, to tangent planes of the source; and its closest points (n, 3).

    Normals (n, 3) are of the deformed target. Beyond the source's boundary a vertex has a term only if ``beyond``:
    needed without source-to-target terms, where a target could move off the source.
    """
    source, corners = nearest.surface, nearest.corners
    closest = curved_points(source.positions[corners], source.vertex_normals[corners], nearest.barycentric)
    plane = normalize_rows(nearest.interpolate(source.vertex_normals))
    weights = areas * np.clip(np.einsum("nd,nd->n", plane, normals), 0.0, 1.0)
    weights *= masks.of_target(len(areas)) * masks.at_source(nearest)
    if not beyond:
        weights *= ~nearest.at_boundary
    blocks = weights[:, None, None] * plane[:, :, None] * plane[:, None, :]
    return blocks, np.einsum("nab,nb->na", blocks, closest), closest


def source_to_target(
    target: TriangleSurface,
    samples: SourceSamples,
    positions: FloatArray,
    normals: FloatArray,
    *,
    closest: FloatArray,
    alpha: float,
    normal_weight: float,
    guess: IndexArray | None = None,
    masks: Masks = WHOLE,
    config: DataConfig = DataConfig(),
) -> tuple[FloatArray, FloatArray, FloatArray, IndexArray]:
    """Point-to-plane term of source vertices, to the deformed target.

    Returns blocks and right sides, the source area (n,) that each vertex receives, and the triangles (m,) of the
    closest points.

    ``closest`` (n, 3) are the source's points closest to the target's vertices, at the ends of round trips; the guess
    (m,) has triangles of an earlier search.

    The residual r = n . (q - sum_k b_k x_k) of a source vertex q is given to each corner of the triangle that holds its
    closest point, with weight b_k: an upper bound of the true term (Jensen), equal at the current positions.
    """
    points, planes = samples.points, samples.planes
    tree = build_tree(positions, target.triangles)
    triangles, barycentric, _ = closest_points(tree, points, planes, normal_weight=normal_weight, guess=guess)
    corners = target.triangles[triangles]
    own_closest = curved_points(positions[corners], normals[corners], barycentric)
    residual = np.einsum("nd,nd->n", planes, points - own_closest)
    facing = tree.normals_of(triangles)
    shares = samples.areas * np.clip(np.einsum("nd,nd->n", facing, planes), 0.0, 1.0)
    trips = np.einsum("mk,mkd->md", barycentric, closest[corners]) - points
    shares *= round_trip_weights(trips, residual, alpha, config) * ~target.at_boundary(triangles, barycentric)
    if masks.target is not None:
        shares *= np.einsum("mk,mk->m", barycentric, masks.target[corners])
    # Column j gives the term of source vertex j to the three corners around its closest point.
    gather = sparse.csc_array(
        ((shares[:, None] * barycentric).ravel(), corners.ravel(), 3 * np.arange(len(points) + 1)),
        shape=(len(positions), len(points)),
    )
    gathered = gather @ np.hstack([samples.outer, residual[:, None] * planes, np.ones((len(points), 1))])
    blocks = gathered[:, :9].reshape(-1, 3, 3)
    right = np.einsum("nab,nb->na", blocks, positions) + gathered[:, 9:12]
    return blocks, right, gathered[:, 12], triangles


def source_to_clusters(
    samples: SourceSamples,
    positions: FloatArray,
    normals: FloatArray,
    *,
    normal_weight: float,
    masks: Masks = WHOLE,
) -> tuple[FloatArray, FloatArray]:
    """Point-to-plane term of source samples, each for the coarse vertex nearest in position and normal.

    Only source-to-target terms detect a short leg inside a long one. The plane has the mean of both normals (symmetric
    ICP, Rusinkiewicz 2019).
    """
    points, planes = samples.points, samples.planes
    tree = cKDTree(np.hstack([positions, normal_weight * normals]))
    nearest = np.asarray(tree.query(np.hstack([points, normal_weight * planes]))[1], dtype=np.int64)
    between, facing = normalize_rows(planes + normals[nearest]), np.einsum("md,md->m", planes, normals[nearest])
    shares = samples.areas * np.clip(facing, 0.0, 1.0) * masks.of_target(len(positions))[nearest]
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


def round_trip_weights(
    trips: FloatArray, heights: FloatArray, alpha: float, config: DataConfig = DataConfig()
) -> FloatArray:
    """(m,) weights ``1 / (1 + d^2 / s^2)^2`` of source points by round trips d (m, 3) (Geman and McClure 1985).

    The scale s is smaller for points inside the deformed target, because it does not expand inwards.
    """
    scale = np.where(heights > 0, config.outside_trips * np.sqrt(alpha), config.inside_trip)
    return np.asarray(1.0 / (1.0 + np.einsum("md,md->m", trips, trips) / scale**2) ** 2)
