"""Find the source point of every texel: map the texel by T12, then walk to the closest source triangle.

The three corners of a target triangle are mapped to source points. A sample's image is their barycentric combination in
space. A walk over adjacent source triangles, from the image of the nearest corner, finds the closest triangle. Every
sample interpolates the texture coordinates of *one* source triangle, so no seam of the source is crossed. If one source
triangle holds all three corners, the walk begins in it: from another one it may stop at a sharp fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, joined_runs, offsets_of
from cagemap.surface.triangles import triangle_centres, triangle_frames, triangle_neighbors
from cagemap.transfer.texels import EDGE_TOLERANCE
from cagemap.transfer.textured_surface import TexturedSurface

_INSIDE = -1e-9
# Most steps of a walk. Images of one triangle's corners are a few source triangles apart, unless the map tears.
_LONGEST_WALK = 512
# Largest extrapolation of a triangle, in its barycentric coordinates (gutter, slivers).
_EXTENSION = 2.0


class MappedSurface(NamedTuple):
    """Target triangles, images of their corners under T12, and the source's triangles with their adjacency.

    A tuple, because Numba takes it whole.
    """

    target_triangles: IndexArray  # (t1, 3)
    start_triangles: IndexArray  # (n1,) source triangle of every target vertex
    whole: IndexArray  # (t1,) source triangle that holds all corners of a target triangle, -1: none
    mapped: FloatArray  # (n1, 3) source point of every target vertex, in space
    # (t2, 3, 3) first corner, and the gradients of the barycentric coordinates of corners 1 and 2, of every source
    # triangle
    frames: FloatArray
    neighbors: NDArray[np.int32]  # (t2, 3) source triangle across the edge opposite to every corner, -1 on the boundary


def map_surface(target: TexturedSurface, source: TexturedSurface, point_map: PointMap) -> MappedSurface:
    """Evaluate the point map at every target vertex."""
    mapped = point_map.pull_back(source.positions)
    return MappedSurface(
        np.ascontiguousarray(target.triangles),
        np.ascontiguousarray(point_map.triangle, dtype=np.int64),
        whole_triangles(target.triangles, source.triangles, point_map.triangle, point_map.barycentric),
        np.ascontiguousarray(mapped),
        triangle_frames(source.positions, source.triangles),
        triangle_neighbors(source.triangles),
    )


def whole_triangles(
    target_triangles: IndexArray, source_triangles: IndexArray, triangle: IndexArray, barycentric: FloatArray
) -> IndexArray:
    """(t1,) source triangle with the images of all corners of a target triangle; -1: none.

    Exactly three vertices of the source have weights in these images, ``triangle`` (n1,) and ``barycentric`` (n1, 3),
    and they form a triangle, whose border is included.
    """
    corners = source_triangles[triangle]
    heaviest = np.take_along_axis(corners, barycentric.argmax(axis=1)[:, None], axis=1)
    carriers = np.where(barycentric > 0.0, corners, heaviest)
    nine = np.sort(carriers[target_triangles].reshape(-1, 9), axis=1)
    steps = nine[:, 1:] != nine[:, :-1]
    held = np.flatnonzero(steps.sum(axis=1) == 2)
    low, middle, high = nine[held, 0], nine[held, steps[held].argmax(axis=1) + 1], nine[held, 8]
    sorted_corners = np.sort(source_triangles, axis=1)
    count = int(source_triangles.max(initial=0)) + 1
    keys = sorted_corners[:, 0] * count + sorted_corners[:, 1]
    order = np.argsort(keys, kind="stable")
    first = np.searchsorted(keys[order], low * count + middle)
    result = np.full(len(target_triangles), -1, dtype=np.int64)
    for side in (0, 1):  # the triangles on both sides of an edge
        candidates = order[np.minimum(first + side, len(order) - 1)]
        matches = (sorted_corners[candidates] == np.column_stack([low, middle, high])).all(axis=1)
        result[held[matches]] = candidates[matches]
    return result


@dataclass(frozen=True, eq=False)
class TexelSamples:
    """Source points of texels' samples; texel i has the samples ``first[i]:first[i + 1]``."""

    target_triangle: NDArray[np.int32]  # (k,) target triangle of every texel
    cells: IndexArray  # (k,) the texels, as ``(row - top) * width + column``
    width: int
    top: int
    first: IndexArray  # (k + 1,)
    triangle: IndexArray  # (s,) source triangle of every sample
    barycentric: FloatArray  # (s, 3) not negative, rows sum to 1

    @classmethod
    def of_points(cls, target_triangle: IndexArray, triangle: IndexArray, barycentric: FloatArray) -> TexelSamples:
        """Samples at given source points (k,), one for each of k texels in a single row of an image."""
        texels = np.arange(len(triangle))
        return cls(
            target_triangle.astype(np.int32), texels, len(texels), 0, np.arange(len(texels) + 1), triangle, barycentric
        )

    def part(self, texels: IndexArray) -> TexelSamples:
        """Samples of some texels, given by their index."""
        first, sample_rows = joined_runs(self.first[texels], np.diff(self.first)[texels])
        chosen = replace(self, target_triangle=self.target_triangle[texels], cells=self.cells[texels], first=first)
        return replace(chosen, triangle=self.triangle[sample_rows], barycentric=self.barycentric[sample_rows])

    def single(self) -> TexelSamples:
        """Every sample as a texel of its own."""
        repeats, count = np.diff(self.first), len(self.triangle)
        triangles, cells = np.repeat(self.target_triangle, repeats), np.repeat(self.cells, repeats)
        return replace(self, target_triangle=triangles, cells=cells, first=np.arange(count + 1))

    def mean(self, values: FloatArray) -> FloatArray:
        """(k, c) mean of the (s, c) sample values over every texel."""
        return np.add.reduceat(values, self.first[:-1], axis=0) / np.diff(self.first)[:, None]


def locate_samples(
    surface: MappedSurface,
    layout_corners: FloatArray,
    cells: IndexArray,
    width: int,
    top: int,
    target_triangle: NDArray[np.int32],
    samples_per_axis: NDArray[np.int32],
) -> TexelSamples:
    """Find the source points of a grid of samples in every texel (k,).

    ``cells`` are the texels, ascending, as ``(row - top) * width + column``. Whole rows at a time make results
    repeatable where a map is torn and a point has several closest ones. ``layout_corners`` (t1, 3, 2) are texel
    coordinates, ``samples_per_axis`` (t1, 2) counts along x and y in a texel.
    """
    along = samples_per_axis[target_triangle]
    first = offsets_of(along[:, 0].astype(np.int64) * along[:, 1])
    triangle = np.empty(first[-1], dtype=np.int64)
    barycentric = np.empty((first[-1], 3))
    found = first, triangle, barycentric
    _locate(surface, layout_corners, cells, width, top, target_triangle, samples_per_axis, *found)
    return TexelSamples(target_triangle, cells, width, top, first, triangle, barycentric)


def locate_centers(surface: MappedSurface) -> IndexArray:
    """(t1,) source triangle at the image of every target triangle's centre."""
    centers = triangle_centres(surface.mapped, surface.target_triangles)
    starts = np.where(surface.whole >= 0, surface.whole, surface.start_triangles[surface.target_triangles[:, 0]])
    return walk_from(surface.frames, surface.neighbors, starts, centers)[0]


def walk_from(
    frames: FloatArray, neighbors: NDArray[np.int32], starts: IndexArray, points: FloatArray
) -> tuple[IndexArray, FloatArray]:
    """Walk from triangles (k,) to points (k, 3) close to the surface, across edges that have neighbours.

    ``frames`` and ``neighbors`` are as in `MappedSurface`. Returns triangles (k,) and barycentric coordinates (k, 3),
    not negative, rows sum to 1. A walk that ends before its point gives a point on the last triangle's border.
    """
    triangle, inside = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
    _walk_all(frames, neighbors, np.ascontiguousarray(starts), np.ascontiguousarray(points), triangle, inside)
    barycentric = np.column_stack([1.0 - inside.sum(axis=1), inside])
    # Corners stay corners in spite of rounding.
    barycentric[np.abs(barycentric) < -_INSIDE] = 0.0
    return triangle, barycentric / barycentric.sum(axis=1, keepdims=True)


def target_barycentric(layout_corners: FloatArray, samples: TexelSamples) -> FloatArray:
    """(k, 3) barycentric coordinates of texel centres in their target triangles, clamped to them."""
    rows, columns = np.divmod(samples.cells, samples.width)
    a, b, c = (layout_corners[samples.target_triangle, corner] for corner in range(3))
    p = np.column_stack([columns + 0.5, rows + samples.top + 0.5]) - a
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - v[:, 0] * u[:, 1]
    b1 = (p[:, 0] * v[:, 1] - v[:, 0] * p[:, 1]) / area
    b2 = (u[:, 0] * p[:, 1] - p[:, 0] * u[:, 1]) / area
    inside = np.maximum(np.column_stack([1 - b1 - b2, b1, b2]), 0)
    return np.asarray(inside / inside.sum(axis=1, keepdims=True))


@numba.njit(cache=True, nogil=True)
def _walk(frames, neighbors, start, x, y, z):  # type: ignore[no-untyped-def]
    """Triangle, and barycentric coordinates of its corners 1 and 2, of a point close to (x, y, z).

    Crosses the edge with the most negative coordinate until the point projects inside a triangle. Above a ridge or a
    peak it projects inside none: the walk stops when it comes back to a triangle, or after `_LONGEST_WALK` steps, and
    returns the last triangle's border.
    """
    t, previous, before = start, np.int64(-1), np.int64(-1)
    b0, b1, b2 = 0.0, 0.0, 0.0
    for _ in range(_LONGEST_WALK):
        dx, dy, dz = x - frames[t, 0, 0], y - frames[t, 0, 1], z - frames[t, 0, 2]
        b1 = frames[t, 1, 0] * dx + frames[t, 1, 1] * dy + frames[t, 1, 2] * dz
        b2 = frames[t, 2, 0] * dx + frames[t, 2, 1] * dy + frames[t, 2, 2] * dz
        b0 = 1.0 - b1 - b2
        if b0 >= _INSIDE and b1 >= _INSIDE and b2 >= _INSIDE:
            break
        following, furthest = np.int64(-1), 0.0
        if b0 < furthest and neighbors[t, 0] >= 0:
            following, furthest = np.int64(neighbors[t, 0]), b0
        if b1 < furthest and neighbors[t, 1] >= 0:
            following, furthest = np.int64(neighbors[t, 1]), b1
        if b2 < furthest and neighbors[t, 2] >= 0:
            following, furthest = np.int64(neighbors[t, 2]), b2
        if following < 0 or following == previous or following == before:
            break
        before, previous, t = previous, t, following
    b0, b1, b2 = max(b0, 0.0), max(b1, 0.0), max(b2, 0.0)
    total = b0 + b1 + b2
    return t, b1 / total, b2 / total


@numba.njit(cache=True, nogil=True)
def _walk_all(frames, neighbors, starts, points, found, inside):  # type: ignore[no-untyped-def]
    """Walk to every point; ``inside`` gets barycentric coordinates of corners 1 and 2."""
    for i in range(len(points)):
        found[i], inside[i, 0], inside[i, 1] = _walk(
            frames, neighbors, starts[i], points[i, 0], points[i, 1], points[i, 2]
        )


@numba.njit(cache=True, nogil=True)
def _locate(  # type: ignore[no-untyped-def]
    surface, layout_corners, cells, width, top, target_triangle, samples_per_axis, first, found, barycentric
):
    """Walk to every sample; see :func:`locate_samples`.

    A walk begins in the source triangle that holds all corners. Without one, it begins at the last sample's end within
    a row of one target triangle, and at the nearest corner's image otherwise.
    """
    target_triangles, start_triangles, whole, mapped, frames, neighbors = surface
    found_t = np.int64(-1)
    for texel in range(len(cells)):
        row = cells[texel] // width
        column = cells[texel] - row * width
        t = target_triangle[texel]
        i, j, k = target_triangles[t, 0], target_triangles[t, 1], target_triangles[t, 2]
        x0, y0 = layout_corners[t, 0, 0], layout_corners[t, 0, 1]
        x1, y1 = layout_corners[t, 1, 0] - x0, layout_corners[t, 1, 1] - y0
        x2, y2 = layout_corners[t, 2, 0] - x0, layout_corners[t, 2, 1] - y0
        scale = 1.0 / (x1 * y2 - x2 * y1)
        nx, ny = samples_per_axis[t, 0], samples_per_axis[t, 1]
        if texel == 0 or column == 0 or cells[texel] != cells[texel - 1] + 1 or t != target_triangle[texel - 1]:
            found_t = np.int64(-1)
        for s in range(nx * ny):
            x = column + (s % nx + 0.5) / nx - x0
            y = row + top + (s // nx + 0.5) / ny - y0
            b1 = (x * y2 - x2 * y) * scale
            b2 = (x1 * y - x * y1) * scale
            b0 = 1.0 - b1 - b2
            lowest = min(b0, b1, b2)
            inside = lowest >= -EDGE_TOLERANCE  # points outside by rounding stay on this side of a seam
            if lowest < -_EXTENSION or (inside and lowest < 0.0):
                c0, c1, c2 = max(b0, 0.0), max(b1, 0.0), max(b2, 0.0)
                total = c0 + c1 + c2
                reach = 0.0 if inside else -_EXTENSION / lowest
                b1 = c1 / total + (b1 - c1 / total) * reach
                b2 = c2 / total + (b2 - c2 / total) * reach
                b0 = 1.0 - b1 - b2
            if whole[t] >= 0:
                start = whole[t]
            elif found_t >= 0:
                start = found_t
            elif b0 >= b1 and b0 >= b2:
                start = start_triangles[i]
            elif b1 >= b2:
                start = start_triangles[j]
            else:
                start = start_triangles[k]
            px = b0 * mapped[i, 0] + b1 * mapped[j, 0] + b2 * mapped[k, 0]
            py = b0 * mapped[i, 1] + b1 * mapped[j, 1] + b2 * mapped[k, 1]
            pz = b0 * mapped[i, 2] + b1 * mapped[j, 2] + b2 * mapped[k, 2]
            found_t, found_1, found_2 = _walk(frames, neighbors, start, px, py, pz)
            sample = first[texel] + s
            found[sample] = found_t
            barycentric[sample, 0] = max(1.0 - found_1 - found_2, 0.0)
            barycentric[sample, 1] = found_1
            barycentric[sample, 2] = found_2
