"""The data term of the elastic fit: closest points both ways, as planes that the deformed target should lie on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.geometry.closest import build_tree, closest_points
from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import normalized
from cagemap.maps.elastic.constants import CLUSTER_TRIP, SLIDING_SHARE
from cagemap.maps.elastic.counterparts import round_trip_weights, trusted
from cagemap.maps.elastic.graph import transformed_normals
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.spectral.samples import spread
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums


@dataclass(frozen=True, eq=False)
class Pullers:
    """Points of the source that pull at the target.

    Attributes
    ----------
    points, planes : (m, 3) float64
        Positions and unit normals.
    areas : (m,) float64
        Sum 1, times the source's mask.
    outer : (m, 9) float64
        Normal times normal.
    """

    points: FloatArray
    planes: FloatArray
    areas: FloatArray
    outer: FloatArray

    @classmethod
    def choose(cls, source: TriangleSurface, count: int, masks: Masks = WHOLE) -> Pullers:
        """Some vertices of a source, spread over its numbering."""
        chosen = spread(len(source.positions), count)
        planes, areas = source.vertex_normals[chosen], source.vertex_areas[chosen]
        outer = (planes[:, :, None] * planes[:, None, :]).reshape(-1, 9)
        shares = areas / areas.sum() * masks.of_source(source.n)[chosen]
        return cls(source.positions[chosen], planes, shares, outer)


@dataclass(frozen=True, eq=False)
class Pull:
    """Quadratic data term ``sum_i (x_i - y_i)^T B_i (x_i - y_i)`` up to a constant, and where it was found.

    Attributes
    ----------
    blocks : (n, 3, 3) float64
        B_i.
    right : (n, 3) float64
        B_i y_i.
    weights : (n,) float64
        Area that every vertex stands for in the term.
    triangles : (m,) int64
        Triangle of every closest point, a guess for the next search.
    feet : (m, 3) float64
        The closest points.
    """

    blocks: FloatArray
    right: FloatArray
    weights: FloatArray
    triangles: IndexArray
    feet: FloatArray

    def distance(self, positions: FloatArray) -> float:
        """Root mean square distance of the vertices (n, 3) that pull, each from its own plane; one foot a vertex."""
        offsets = positions - self.feet
        squared = float(np.einsum("na,nab,nb->", offsets, self.blocks, offsets))
        total = float(self.weights.sum())
        return float(np.sqrt(max(squared, 0.0) / total)) if total > 0 else float("inf")

    def scaled(self, factors: FloatArray) -> Pull:
        """Every vertex's term times a factor (n,)."""
        return replace(
            self,
            blocks=factors[:, None, None] * self.blocks,
            right=factors[:, None] * self.right,
            weights=factors * self.weights,
        )


def pull_to_source(
    areas: FloatArray,
    source: TriangleSurface,
    positions: FloatArray,
    normals: FloatArray,
    guess: IndexArray | None,
    normal_weight: float,
    masks: Masks = WHOLE,
) -> Pull:
    """Point-to-plane term of the deformed vertices: each should lie in the source's tangent plane at its foot.

    Parameters
    ----------
    areas : (n,) float64
        Of the target's vertices.
    source : TriangleSurface
    positions, normals : (n, 3) float64
        Of the deformed target.
    guess : (n,) int64, optional
        Source triangles of an earlier search.
    normal_weight : float
        Of the search, see `closest_points`.
    masks : Masks
        What counts of the target's vertices and of the source's.
    """
    found = SurfacePoints.nearest(source, positions, normals, normal_weight=normal_weight, guess=guess)
    corners = found.corners
    foot = curved_points(source.positions[corners], source.vertex_normals[corners], found.barycentric)
    plane = normalized(found.interpolate(source.vertex_normals))
    weights = areas * np.clip(np.einsum("nd,nd->n", plane, normals), 0.0, 1.0)
    weights *= masks.of_target(len(areas)) * masks.at_source(found)
    blocks = weights[:, None, None] * plane[:, :, None] * plane[:, None, :]
    return Pull(blocks, np.einsum("nab,nb->na", blocks, foot), weights, found.triangle, foot)


def pull_by_source(
    target_triangles: IndexArray,
    pullers: Pullers,
    positions: FloatArray,
    normals: FloatArray,
    guess: IndexArray | None,
    normal_weight: float,
    feet: FloatArray,
    alpha: float,
    masks: Masks = WHOLE,
) -> Pull:
    """Point-to-plane term of source vertices: each should lie on the deformed target.

    The residual r = n . (q - sum_k b_k x_k) of a source vertex q is asked of each corner of the triangle that holds
    its closest point, n . x_k -> n . x_k + r with weight b_k: an upper bound of the true term (Jensen), equal at the
    current positions, that keeps the blocks apart.

    Parameters
    ----------
    target_triangles : (t1, 3) int64
    pullers : Pullers
    positions, normals : (n, 3) float64
        Of the deformed target.
    guess : (m,) int64, optional
        Target triangles of an earlier search.
    normal_weight : float
    feet : (n, 3) float64
        Where the target's vertices lie nearest on the source.
    alpha : float
        Stiffness of the energy, see `round_trip_weights`.
    masks : Masks
        What counts of the target's vertices; the pullers' areas know of the source's.
    """
    points, planes = pullers.points, pullers.planes
    tree = build_tree(positions, target_triangles)
    held_by, barycentric, _ = closest_points(tree, points, planes, normal_weight=normal_weight, guess=guess)
    corners = target_triangles[held_by]
    foot = curved_points(positions[corners], normals[corners], barycentric)
    residual = np.einsum("nd,nd->n", planes, points - foot)
    facing = tree.normals_of(held_by)
    shares = pullers.areas * np.clip(np.einsum("nd,nd->n", facing, planes), 0.0, 1.0)
    shares *= round_trip_weights(np.einsum("mk,mkd->md", barycentric, feet[corners]) - points, residual, alpha)
    if masks.target is not None:
        shares *= np.einsum("mk,mk->m", barycentric, masks.target[corners])
    # Column j gives what source vertex j asks to the three corners around its foot.
    gather = sparse.csc_array(
        ((shares[:, None] * barycentric).ravel(), corners.ravel(), 3 * np.arange(len(points) + 1)),
        shape=(len(positions), len(points)),
    )
    gathered = gather @ np.hstack([pullers.outer, residual[:, None] * planes, np.ones((len(points), 1))])
    blocks = gathered[:, :9].reshape(-1, 3, 3)
    right = np.einsum("nab,nb->na", blocks, positions) + gathered[:, 9:12]
    return Pull(blocks, right, gathered[:, 12], held_by, foot)


def pull_on_clusters(
    pullers: Pullers,
    positions: FloatArray,
    normals: FloatArray,
    normal_weight: float,
    feet: FloatArray,
    masks: Masks = WHOLE,
) -> Pull:
    """Term of source points, each of which pulls the coarse vertex that is nearest to it in position and normal.

    A short leg inside a long one lies on it, and nothing that it asks for tells: what the long one has beyond its end
    does. The plane in which the vertex should lie has the mean of both normals (symmetric ICP, Rusinkiewicz 2019): that
    of the point alone lies outside of a round part. `SLIDING_SHARE` of the pull is towards the point itself: few points
    at a leg's end face along it.

    Parameters
    ----------
    pullers : Pullers
    positions, normals : (k, 3) float64
        Of the deformed clusters.
    normal_weight : float
        Length by which normals count.
    feet : (k, 3) float64
        Where its vertices lie nearest on the source.
    masks : Masks
        What counts of the clusters; the pullers' areas know of the source's.
    """
    points, planes = pullers.points, pullers.planes
    tree = cKDTree(np.hstack([positions, normal_weight * normals]))
    pulled = np.asarray(tree.query(np.hstack([points, normal_weight * planes]))[1], dtype=np.int64)
    between, facing = normalized(planes + normals[pulled]), np.einsum("md,md->m", planes, normals[pulled])
    shares = pullers.areas * np.clip(facing, 0.0, 1.0) * trusted(feet[pulled] - points, CLUSTER_TRIP)
    shares *= masks.of_target(len(positions))[pulled]
    towards = (1.0 - SLIDING_SHARE) * between[:, :, None] * between[:, None, :] + SLIDING_SHARE * np.eye(3)
    right = np.einsum("mab,mb->ma", towards, points)
    asked = np.hstack([towards.reshape(-1, 9), right, np.ones((len(points), 1))])
    summed = grouped_sums(pulled, shares[:, None] * asked, len(positions))
    return Pull(summed[:, :9].reshape(-1, 3, 3), summed[:, 9:12], summed[:, 12], pulled, positions[pulled])


def curved_points(corners: FloatArray, normals: FloatArray, barycentric: FloatArray) -> FloatArray:
    """(m, 3) points of the curved surface above those of its triangles, exact for quadratic surfaces.

    A triangle lies h^2 / 8 R inside a surface of radius R. Vertices that are fitted to triangles, and triangles that
    are fitted to vertices, would shrink and swell by that; the energy then slides the map sideways. Half the mean of
    the projections onto the corners' tangent planes (Boubekeur and Alexa 2008) takes it away.

    Parameters
    ----------
    corners, normals : (m, 3, 3) float64
        Positions and unit normals of the triangles' corners.
    barycentric : (m, 3) float64
    """
    flat = np.einsum("mk,mkd->md", barycentric, corners)
    heights = np.einsum("mkd,mkd->mk", corners - flat[:, None], normals)
    return np.asarray(flat + 0.5 * np.einsum("mk,mkd->md", barycentric * heights, normals))


def deformed_normals(normals: FloatArray, maps: FloatArray) -> FloatArray:
    """(n, 3) unit normals of a deformed graph, from its normals (n, 3) at rest and its maps (n, 3, 3)."""
    return normalized(transformed_normals(maps, normals))
