"""Areas, normals, centres, neighbours and vertex sums of triangle arrays."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, read_only, real_numbers, whole_numbers
from cagemap.numerics.threads import row_slices

CACHED = 16_384  # number of triangles or points whose arrays fit into a core's cache

_MIN_AREA_SHARE = 1e-6  # a triangle of a polygon is flat or flipped if its area is below this share of the polygon's
_MAX_CLIPPED_CORNERS = 200  # larger polygons are split into fans: clipping ears takes time cubic in the corners
_MAX_CLIPPED_PAIRS = 1_000_000  # of corners, at a time: some 100 MB


def mesh_arrays(
    positions: ArrayLike, faces: ArrayLike, corners: tuple[int, ...] = (3, 4)
) -> tuple[FloatArray, IndexArray]:
    """Contiguous positions (n, 3) and faces of 3 or 4 corners; ParameterError for others, or missing vertices."""
    places = np.ascontiguousarray(real_numbers(positions, "positions"))
    numbers = whole_numbers(faces, "faces")
    if places.ndim != 2 or places.shape[1] != 3 or numbers.ndim != 2 or numbers.shape[1] not in corners:
        sizes = " or ".join(f"(m, {size})" for size in corners)
        raise ParameterError(f"expected positions (n, 3) and faces {sizes}, got {places.shape} and {numbers.shape}")
    if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(places):
        raise ParameterError(f"faces: expected vertices 0 to {len(places) - 1}, got {numbers.min()} to {numbers.max()}")
    return places, numbers


def triangle_areas(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t,) areas of triangles (t, 3); positions may be (n, 2) or (n, 3)."""
    if positions.shape[1] == 2:
        a, b, c = (positions[triangles[:, k]] for k in range(3))
        return 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    areas = np.empty(len(triangles))
    for part in row_slices(len(triangles), CACHED):
        areas[part] = 0.5 * row_lengths(triangle_normals(positions, triangles[part]))
    return areas


def triangles(faces: IndexArray) -> IndexArray:
    """Split quads (m, 4) into triangles (2 m, 3): corners (0, 1, 2), (0, 2, 3); triangles (m, 3) are unchanged."""
    if faces.shape[1] == 3:
        return faces
    return faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def fan_triangles(offsets: IndexArray, indices: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Fans (v0, v1, v2), ... of polygons ``indices[offsets[i]:offsets[i + 1]]``, and the polygon of each (t,)."""
    counts = np.maximum(np.diff(offsets) - 2, 0)
    faces = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(faces)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    first = offsets[faces]
    return indices[np.column_stack([first, first + step, first + step + 1])], faces


def polygon_triangles(positions: FloatArray, offsets: IndexArray, indices: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Triangles (t, 3) of polygons and the polygon (t,) of each, as numbers of corners.

    As `fan_triangles`, but polygons whose fan has a flat or flipped triangle, as at collinear and concave corners, are
    split otherwise where that adds no area: self-intersecting ones may keep their fans.
    """
    corners, faces = fan_triangles(offsets, np.arange(len(indices)))
    sizes, places = np.diff(offsets), positions[indices]
    of_triangles = triangle_normals(places, corners)
    normals = grouped_sums(faces, of_triangles, len(sizes))
    of_polygons = normals[faces]
    flat = np.einsum("td,td->t", of_triangles, of_polygons) <= _MIN_AREA_SHARE * (of_polygons**2).sum(axis=1)
    chosen = np.bincount(faces, flat, minlength=len(sizes)) > 0
    chosen &= (sizes > 3) & (sizes <= _MAX_CLIPPED_CORNERS) & normals.any(axis=1)
    for size in np.unique(sizes[chosen]).tolist():
        of_size = np.flatnonzero(chosen & (sizes == size))
        for polygons in np.array_split(of_size, len(of_size) * size**2 // _MAX_CLIPPED_PAIRS + 1):
            first = offsets[polygons]
            clipped = _clip_ears(places[first[:, None] + np.arange(size)], normals[polygons]) + first[:, None, None]
            rows = np.searchsorted(faces, polygons)[:, None] + np.arange(size - 2)
            before, after = (
                triangle_areas(places, split.reshape(-1, 3)).reshape(rows.shape).sum(axis=1)
                for split in (corners[rows], clipped)
            )
            better = after <= (1 + _MIN_AREA_SHARE) * before
            corners[rows[better]] = clipped[better]
    return corners, faces


def _clip_ears(points: FloatArray, normals: FloatArray) -> IndexArray:
    """Triangles (k, s - 2, 3), as corners, of polygons (k, s, 3): the roundest free ear is cut off, again and again."""
    count, size = points.shape[:2]
    rows = np.arange(count)
    left, found = np.tile(np.arange(size), (count, 1)), np.zeros((count, 0, 3), dtype=np.int64)
    tolerance = _MIN_AREA_SHARE * (normals**2).sum(axis=1)[:, None, None]
    for most in range(size, 2, -1):
        ears = np.stack([np.roll(left, 1, axis=1), left, np.roll(left, -1, axis=1)], axis=2)
        corners = points[rows[:, None, None], ears]
        sides = np.roll(corners, -1, axis=2) - corners
        area = np.einsum("kid,kd->ki", np.cross(sides[:, :, 0], sides[:, :, 1]), normals)
        roundness = area / np.maximum((sides**2).sum(axis=(2, 3)), 1e-300)
        inside = (left[:, None, :, None] != ears[:, :, None, :]).all(axis=3)
        for k in range(3):
            to_others = points[rows[:, None], left][:, None] - corners[:, :, None, k]
            inside &= np.einsum("kijd,kd->kij", np.cross(sides[:, :, None, k], to_others), normals) >= -tolerance
        free = ~inside.any(axis=2) & (area > tolerance[:, 0])
        best = np.where(free | ~free.any(axis=1, keepdims=True), roundness, -np.inf).argmax(axis=1)
        found = np.concatenate([found, ears[rows, best][:, None]], axis=1)
        left = left[np.arange(most) != best[:, None]].reshape(count, most - 1)
    return found


def surface_area(positions: FloatArray, faces: IndexArray) -> float:
    """Area of faces (m, 4) or (m, 3); of quads, which need not be flat, the mean over both triangulations."""
    if faces.shape[1] == 3:
        return float(triangle_areas(positions, faces).sum())
    areas, total = np.empty(len(faces)), 0.0
    for split in (0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3):
        for part in row_slices(len(faces), CACHED):
            areas[part] = triangle_areas(positions, faces[part].take(split, axis=1))
        total += float(areas.sum())
    return 0.5 * total


def triangle_normals(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t, 3) normals of length twice the area, by the right-hand rule."""
    normals = np.empty((len(triangles), 3))
    _fill_normals(read_only(np.ascontiguousarray(positions, dtype=np.float64)), read_only(triangles), normals)
    return normals


def triangle_centres(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t, 3) means of the triangles' corners."""
    centres = positions.take(triangles[:, 0], axis=0)
    for k in (1, 2):
        centres += positions.take(triangles[:, k], axis=0)
    return np.asarray(centres / 3.0)


def vertex_normals(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(n, 3) unit vertex normals, area-weighted means of the adjacent triangles' normals."""
    return normalize_rows(corner_sums(triangles, triangle_normals(positions, triangles), len(positions)))


def corner_sums(triangles: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """(count, d) sums of triangle rows (t, d) around each of the first ``count`` vertices."""
    sums = np.zeros((count, values.shape[1]))
    _add_to_corners(read_only(triangles), values, sums)
    return sums


def row_lengths(vectors: FloatArray) -> FloatArray:
    """Lengths along the last axis; unlike ``np.linalg.norm`` fast for short rows."""
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", vectors, vectors)))


def normalize_rows(vectors: FloatArray) -> FloatArray:
    """Rows scaled to unit length; zero rows stay zero."""
    lengths = row_lengths(vectors)[..., None]
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def triangle_frames(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t, 3, 3) first corner a, and gradients g1, g2 of the barycentric coordinates: b_i(p) = g_i . (p - a).

    A degenerate triangle is treated as a segment: only the coordinate along its longer edge varies.
    """
    a = positions[triangles[:, 0]]
    u, v = positions[triangles[:, 1]] - a, positions[triangles[:, 2]] - a
    uu, uv, vv = (np.einsum("ij,ij->i", p, q)[:, None] for p, q in ((u, u), (u, v), (v, v)))
    area2 = uu * vv - uv * uv
    flat = area2 <= 1e-14 * uu * vv
    scale = 1.0 / np.where(flat, 1.0, area2)
    lengths = np.where(np.maximum(uu, vv) > 0, np.maximum(uu, vv), 1.0)
    g1 = np.where(flat, np.where(uu >= vv, u / lengths, 0.0), (vv * u - uv * v) * scale)
    g2 = np.where(flat, np.where(uu >= vv, 0.0, v / lengths), (uu * v - uv * u) * scale)
    return np.ascontiguousarray(np.stack([a, g1, g2], axis=1))


def triangle_neighbors(corners: IndexArray) -> NDArray[np.int32]:
    """(t, 3) triangle across the edge *opposite* to every corner, -1 on the boundary; several are paired in order."""
    neighbors = np.full(corners.shape, -1, dtype=np.int32)
    head = np.full(int(corners.max(initial=-1)) + 1, -1, dtype=np.int32)
    rest = np.full(corners.size, -1, dtype=np.int32)
    _pair_edges(read_only(np.ascontiguousarray(corners)), neighbors, head, rest)
    return neighbors


# Kernels fill arrays allocated by the caller: allocation inside doubles their compile time.
@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill_normals(positions, triangles, normals):  # type: ignore[no-untyped-def]
    """Cross products of the edges leaving every triangle's first corner."""
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = positions[a, 0], positions[a, 1], positions[a, 2]
        ux, uy, uz = positions[b, 0] - ax, positions[b, 1] - ay, positions[b, 2] - az
        vx, vy, vz = positions[c, 0] - ax, positions[c, 1] - ay, positions[c, 2] - az
        normals[t, 0] = uy * vz - uz * vy
        normals[t, 1] = uz * vx - ux * vz
        normals[t, 2] = ux * vy - uy * vx


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_to_corners(triangles, values, sums):  # type: ignore[no-untyped-def]
    """Add every triangle's row to the rows of its corners below ``len(sums)``."""
    for t in range(len(triangles)):
        for k in range(3):
            corner = triangles[t, k]
            if corner < len(sums):
                for i in range(values.shape[1]):
                    sums[corner, i] += values[t, i]


@numba.njit(cache=True, nogil=True)
def _pair_edges(corners, neighbors, head, rest):  # type: ignore[no-untyped-def]
    """Match edges through a linked list of still unmatched ones at each edge's lower vertex."""
    for t in range(len(corners)):
        for k in range(3):
            a, b = corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
            low, high = (a, b) if a < b else (b, a)
            previous, edge = np.int32(-1), head[low]
            while edge >= 0:
                neighbor, j = edge // 3, edge % 3
                if corners[neighbor, (j + 1) % 3] == high or corners[neighbor, (j + 2) % 3] == high:
                    break
                previous, edge = edge, rest[edge]
            if edge < 0:
                rest[3 * t + k] = head[low]
                head[low] = 3 * t + k
                continue
            neighbors[t, k], neighbors[edge // 3, edge % 3] = edge // 3, t
            if previous < 0:
                head[low] = rest[edge]
            else:
                rest[previous] = rest[edge]
