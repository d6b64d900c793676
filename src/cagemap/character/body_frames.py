"""How a map moves the space around the source's body: samples of the body, each with an affine frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangles import corner_sums, normalized


@dataclass(frozen=True)
class FrameConfig:
    """Numbers of `BodyFrames`; lengths in units of sqrt(area). What was tried: docs/lab/passengers.md."""

    smoothing: int = 20  # rounds of averaging over neighbouring vertices
    samples: int = 16_000  # of the body at most
    neighbors: int = 64  # samples that carry a point
    closest: float = 2e-3  # no closer than this counts as closer
    # Samples count fully where they face as the point's closest point does, not at all below this cosine.
    facing: float = -0.3
    prior: float = 1e-6  # share of the whole body's rotation in a frame: decides where a neighbourhood is a line


@dataclass(frozen=True, eq=False)
class Anchors:
    """Where points are bound to the source's body.

    Attributes
    ----------
    heights : (m,) float64
        Signed distance from the source, negative inside.
    normals : (m, 3) float64
        Unit normals of the source at the closest points.
    """

    heights: FloatArray
    normals: FloatArray


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """Samples of a map with the affine map of space around each: offsets, as rows, times ``linear``.

    A frame takes tangents as the map does, averaged over its surroundings, and the source's normal to the target's
    at unit length. All lengths are those of unit area.

    Attributes
    ----------
    point_map : PointMap
    config : FrameConfig
    """

    point_map: PointMap
    config: FrameConfig = FrameConfig()

    @kept
    def samples(self) -> IndexArray:
        """(k,) vertices of the target that serve as samples."""
        return np.arange(0, self.point_map.target.n, -(-self.point_map.target.n // self.config.samples))

    @kept
    def tree(self) -> cKDTree:
        """Over the samples' images on the source."""
        return cKDTree(self.point_map.images.positions[self.samples])

    @kept
    def source_normals(self) -> FloatArray:
        """(n1, 3) unit normals of the source at the images."""
        return normalized(self.point_map.images.interpolate(self.point_map.source.vertex_normals))

    @kept
    def rotation(self) -> FloatArray:
        """(3, 3) rotation of the body as a whole, for rows."""
        areas, images = self.point_map.target.vertex_areas[:, None], self.point_map.images.positions
        centre = (areas * images).sum(axis=0)
        return nearest_rotations(((images - centre).T @ (areas * self.point_map.target.positions))[None])[0]

    @kept
    def linear(self) -> FloatArray:
        """(n1, 3, 3) frames of all target vertices."""
        target, images = self.point_map.target, self.point_map.images.positions
        corners, positions, count = target.triangles, target.positions, target.n
        before, mixed = np.zeros((len(corners), 3, 3)), np.zeros((len(corners), 3, 3))
        for k in range(3):
            start, end = corners[:, k], corners[:, (k + 1) % 3]
            edges, images_of = positions[end] - positions[start], images[end] - images[start]
            before += images_of[:, :, None] * images_of[:, None]
            mixed += images_of[:, :, None] * edges[:, None]
        table = np.concatenate([before.reshape(-1, 9), mixed.reshape(-1, 9)], axis=1)
        table = np.concatenate([corner_sums(corners, table, count), self.source_normals, target.vertex_normals], axis=1)
        average = neighbor_means(corners, count)
        for _ in range(self.config.smoothing):
            table = average @ table
        before, mixed = table[:, :9].reshape(-1, 3, 3), table[:, 9:18].reshape(-1, 3, 3)
        normals, goals = normalized(table[:, 18:21]), normalized(table[:, 21:24])
        # Tangents from the edges, the normal on its own: its length stays.
        across, along = (np.eye(3) - of[:, :, None] * of[:, None] for of in (normals, goals))
        weight = np.maximum(np.trace(before, axis1=1, axis2=2), 1e-300)[:, None, None]
        prior = self.config.prior * weight
        before = across @ before @ across + weight * normals[:, :, None] * normals[:, None] + prior * np.eye(3)
        mixed = across @ mixed @ along + weight * normals[:, :, None] * goals[:, None] + prior * self.rotation
        return np.asarray(np.linalg.solve(before, mixed))

    def anchors(self, points: FloatArray) -> Anchors:
        """Closest points of the source to points (m, 3)."""
        source = self.point_map.source
        triangle, barycentric, distance = closest_points(source.tree, points)
        corners = source.triangles[triangle]
        feet = np.einsum("nc,ncd->nd", barycentric, source.positions[corners])
        normals = normalized(np.einsum("nc,ncd->nd", barycentric, source.vertex_normals[corners]))
        side = np.einsum("nd,nd->n", points - feet, normals)
        return Anchors(np.copysign(distance, side), normals)

    def carry(self, points: FloatArray, anchors: Anchors) -> tuple[FloatArray, FloatArray]:
        """Places (m, 3) of points near the source in the target, and the affine maps (m, 3, 3) around them."""
        config, point_map = self.config, self.point_map
        count = min(config.neighbors, len(self.samples))
        distance, near = self.tree.query(points, k=count)
        near = self.samples[np.reshape(near, (len(points), count))]
        distance = np.reshape(distance, (len(points), count))
        # Weights fall to 0 at the last neighbour, so that places change smoothly.
        inside = np.maximum(0.0, 1.0 - (distance / (1.001 * distance[:, -1:] + 1e-300)) ** 2) ** 2
        weights = point_map.target.vertex_areas[near] * inside / (distance**2 + config.closest**2) ** 2
        cosines = np.einsum("nkd,nd->nk", self.source_normals[near], anchors.normals)
        weights *= np.clip((cosines - config.facing) / (1.0 - config.facing), 1e-9, 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        starts = np.arange(0, near.size + 1, count)
        mean = sparse.csr_array((weights.ravel(), near.ravel(), starts), shape=(len(points), point_map.target.n))
        images, linear = point_map.images.positions, self.linear
        shifts = point_map.target.positions - np.einsum("nd,nde->ne", images, linear)
        frames = (mean @ linear.reshape(-1, 9)).reshape(-1, 3, 3)
        return np.asarray(mean @ shifts + np.einsum("nd,nde->ne", points, frames)), frames


def neighbor_means(corners: IndexArray, count: int) -> sparse.csr_array:
    """(count, count) matrix of the mean over a vertex and its neighbours."""
    heads, tails = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    both = (np.concatenate([heads, tails, np.arange(count)]), np.concatenate([tails, heads, np.arange(count)]))
    matrix = sparse.csr_array(sparse.coo_array((np.ones(len(both[0])), both), shape=(count, count)))
    matrix.sum_duplicates()
    matrix.data[:] = 1.0
    return sparse.csr_array(sparse.diags_array(1.0 / matrix.sum(axis=1)) @ matrix)
