"""Deformation of the space around the source's body by affine frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, nearest_rotations
from cagemap.numerics.kinds import Config
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import corner_sums, normalize_rows, row_lengths


@dataclass(frozen=True)
class FrameConfig(Config):
    """Numbers of `BodyFrames`; lengths in units of sqrt(area). What was tried: docs/lab/passengers.md."""

    smoothing_rounds: int = 20  # rounds of averaging over neighbouring vertices
    max_samples: int = 16_000
    neighbors: int = 64  # samples that are averaged for a point
    min_distance: float = 2e-3  # smaller distances are raised to about this
    min_cosine: float = -0.3  # of the sample's normal with the closest point's normal: weight 0 here, 1 at cosine 1
    rotation_weight: float = 1e-6  # weight of the body's rotation in a frame, for neighbourhoods that form a line
    # largest stretch of a frame, divided by the median stretch of all frames. Frames that stretch more are changed: the
    # map collapses there (docs/lab/passengers.md)
    max_stretch: float = 4.0


@dataclass(frozen=True, eq=False)
class SignedDistances:
    """Signed distances of points from a body."""

    heights: FloatArray  # (m,) negative inside the body; infinite where no closest point was found
    normals: FloatArray  # (m, 3) unit normals of the body at the closest points
    closest: FloatArray  # (m, 3) closest points

    @classmethod
    def of(
        cls,
        body: TriangleSurface,
        points: FloatArray,
        normals: FloatArray | None = None,
        minimum_cosine: float = -2.0,
        within: float = np.inf,
    ) -> SignedDistances:
        """Of points (m, 3); options as in `closest_points`."""
        triangle, barycentric, distance = closest_points(
            body.tree, points, normals, minimum_cosine=minimum_cosine, within=within
        )
        corners = body.triangles[triangle]
        closest = np.einsum("nc,ncd->nd", barycentric, body.positions[corners])
        body_normals = normalize_rows(np.einsum("nc,ncd->nd", barycentric, body.vertex_normals[corners]))
        side = np.einsum("nd,nd->n", points - closest, body_normals)
        return cls(np.where(side < 0.0, -distance, distance), body_normals, closest)


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """Affine frames of a map at the target's vertices.

    An offset from the source, as a row, times one of the ``matrices`` is the offset from the target. A frame transforms
    tangents by the map's averaged derivative, and the source's unit normal to the target's. Lengths are those of unit
    area.
    """

    point_map: PointMap
    config: FrameConfig = FrameConfig()

    @kept
    def samples(self) -> IndexArray:
        """(k,) vertices of the target that serve as samples."""
        return np.arange(0, self.point_map.target.n, -(-self.point_map.target.n // self.config.max_samples))

    @kept
    def tree(self) -> cKDTree:
        """Search tree of the samples' images on the source."""
        return cKDTree(self.point_map.images.positions[self.samples])

    @kept
    def source_normals(self) -> FloatArray:
        """(n1, 3) unit normals of the source at the images."""
        return normalize_rows(self.point_map.images.interpolate(self.point_map.source.vertex_normals))

    @kept
    def rotation(self) -> FloatArray:
        """(3, 3) rotation of the body as a whole, for rows."""
        areas, images = self.point_map.target.vertex_areas[:, None], self.point_map.images.positions
        centre = (areas * images).sum(axis=0)
        return nearest_rotations(((images - centre).T @ (areas * self.point_map.target.positions))[None])[0]

    @kept
    def matrices(self) -> FloatArray:
        """(n1, 3, 3) frames of all target vertices."""
        target, images = self.point_map.target, self.point_map.images.positions
        corners, positions, count = target.triangles, target.positions, target.n
        moments, covariance = np.zeros((len(corners), 3, 3)), np.zeros((len(corners), 3, 3))
        for k in range(3):
            start, end = corners[:, k], corners[:, (k + 1) % 3]
            edges, images_of = positions[end] - positions[start], images[end] - images[start]
            moments += images_of[:, :, None] * images_of[:, None]
            covariance += images_of[:, :, None] * edges[:, None]
        table = np.concatenate([moments.reshape(-1, 9), covariance.reshape(-1, 9)], axis=1)
        table = np.concatenate([corner_sums(corners, table, count), self.source_normals, target.vertex_normals], axis=1)
        average = neighbor_means(corners, count)
        for _ in range(self.config.smoothing_rounds):
            table = average @ table
        moments, covariance = table[:, :9].reshape(-1, 3, 3), table[:, 9:18].reshape(-1, 3, 3)
        normals, target_normals = normalize_rows(table[:, 18:21]), normalize_rows(table[:, 21:24])
        # Edges give the tangential part only; the normal keeps its length.
        source_tangent, target_tangent = (
            np.eye(3) - unit[:, :, None] * unit[:, None] for unit in (normals, target_normals)
        )
        weight = np.maximum(np.trace(moments, axis1=1, axis2=2), 1e-300)[:, None, None]
        rotation_weight = self.config.rotation_weight * weight
        moments = (
            source_tangent @ moments @ source_tangent
            + weight * normals[:, :, None] * normals[:, None]
            + rotation_weight * np.eye(3)
        )
        covariance = (
            source_tangent @ covariance @ target_tangent
            + weight * normals[:, :, None] * target_normals[:, None]
            + rotation_weight * self.rotation
        )
        return limit_stretches(np.linalg.solve(moments, covariance), self.config.max_stretch)

    def carry(self, points: FloatArray, distances: SignedDistances) -> tuple[FloatArray, FloatArray]:
        """Positions (m, 3) near the target of points near the source, and their frames (m, 3, 3)."""
        config, point_map = self.config, self.point_map
        count = min(config.neighbors, len(self.samples))
        distance, vertices = self.tree.query(points, k=count)
        vertices = self.samples[np.reshape(vertices, (len(points), count))]
        distance = np.reshape(distance, (len(points), count))
        # Weights fall to 0 at the last neighbour, so that positions are continuous.
        inside = np.maximum(0.0, 1.0 - (distance / (1.001 * distance[:, -1:] + 1e-300)) ** 2) ** 2
        weights = point_map.target.vertex_areas[vertices] * inside / (distance**2 + config.min_distance**2) ** 2
        cosines = np.einsum("nkd,nd->nk", self.source_normals[vertices], distances.normals)
        weights *= np.clip((cosines - config.min_cosine) / (1.0 - config.min_cosine), 1e-9, 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        starts = np.arange(0, vertices.size + 1, count)
        averages = sparse.csr_array(
            (weights.ravel(), vertices.ravel(), starts), shape=(len(points), point_map.target.n)
        )
        images, matrices = point_map.images.positions, self.matrices
        offsets = point_map.target.positions - np.einsum("nd,nde->ne", images, matrices)
        frames = (averages @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)
        return np.asarray(averages @ offsets + np.einsum("nd,nde->ne", points, frames)), frames


def with_split_triangles(point_map: PointMap, count: int) -> PointMap:
    """The map with the target's triangles split in four until it has ``count`` vertices or more."""
    triangles, positions, images = point_map.target.triangles, point_map.target.positions, point_map.images.positions
    while len(positions) < count:
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
        edges, middles = np.unique(sides, axis=0, return_inverse=True)
        corners = np.column_stack([triangles, len(positions) + middles.reshape(-1, 3)])
        triangles = corners[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)
        positions, images = (np.concatenate([of, of[edges].mean(axis=1)]) for of in (positions, images))
    target = replace(point_map.target, positions=positions, triangles=triangles)
    return PointMap(target, SurfacePoints.nearest(point_map.source, images))


def neighbor_means(corners: IndexArray, count: int) -> sparse.csr_array:
    """(count, count) matrix of the mean over a vertex and its neighbours."""
    heads, tails = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    pairs = (np.concatenate([heads, tails, np.arange(count)]), np.concatenate([tails, heads, np.arange(count)]))
    matrix = sparse.csr_array(sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count)))
    matrix.sum_duplicates()
    matrix.data[:] = 1.0
    return sparse.csr_array(sparse.diags_array(1.0 / matrix.sum(axis=1)) @ matrix)


def weighted_means(rows: IndexArray, weights: FloatArray, moves: FloatArray, count: int) -> FloatArray:
    """(count, 3) weighted means of the moves (k, 3) of each row's vertex; 0 at others."""
    total = np.bincount(rows, weights, minlength=count)[:, None]
    return np.asarray(grouped_sums(rows, weights[:, None] * moves, count) / np.where(total, total, 1.0))


def spread_push(means: sparse.csr_array, push: FloatArray, rounds: int) -> FloatArray:
    """A push (n, 3) that spreads to neighbouring vertices by `neighbor_means`, and fades with each step."""
    for _ in range(rounds):
        push = longer_rows(push, means @ push)
    return push


def longer_rows(first: FloatArray, second: FloatArray) -> FloatArray:
    """(n, 3) the longer vector of each row."""
    return np.where((row_lengths(first) >= row_lengths(second))[:, None], first, second)


def limit_stretches(frames: FloatArray, max_stretch: float) -> FloatArray:
    """Reduce singular values of frames (n, 3, 3) that are larger than ``max_stretch`` times the median stretch m.

    A singular value s above the limit L = ``max_stretch`` m becomes max(m, L^2 / s), which is continuous at L.
    """
    sizes = np.linalg.norm(frames, axis=(1, 2))  # no singular value is larger
    median = float(np.median(sizes)) / np.sqrt(3.0)
    limit = max_stretch * median
    beyond = sizes > limit
    left, stretches, right = np.linalg.svd(frames[beyond])
    reduced = np.maximum(median, limit**2 / np.maximum(stretches, limit))
    limited = frames.copy()
    limited[beyond] = (left * np.where(stretches > limit, reduced, stretches)[:, None]) @ right
    return limited
