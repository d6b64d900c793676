"""Arrays of triangles: areas, normals, centres, sums around vertices, and who lies across each edge."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray, IndexArray, read_only
from cagemap.numerics.threads import parts

CACHED = 16_384  # triangles or points whose figures stay within a core's cache from one array operation to the next


def triangle_areas(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t,) areas of triangles with the given (t, 3) vertices; positions may be (n, 2) or (n, 3)."""
    if positions.shape[1] == 2:
        a, b, c = (positions[triangles[:, k]] for k in range(3))
        return 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    areas = np.empty(len(triangles))
    for part in parts(len(triangles), CACHED):
        areas[part] = 0.5 * row_lengths(triangle_normals(positions, triangles[part]))
    return areas


def triangles(faces: IndexArray) -> IndexArray:
    """Triangles of refined faces, by the one rule: quad q is (0, 1, 2), number 2q, and (0, 2, 3), number 2q + 1.

    Parameters
    ----------
    faces : (m, 4) or (m, 3) int64
        Vertex (or UV) numbers.

    Returns
    -------
    (2 m, 3) or (m, 3) int64
    """
    if faces.shape[1] == 3:
        return faces
    return faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def fan_triangles(offsets: IndexArray, indices: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Split polygons (v0, v1, ..., vk) into fans (v0, v1, v2), (v0, v2, v3), ...; agrees with `triangles` on quads.

    Parameters
    ----------
    offsets : (m + 1,) int64
        Where each polygon starts in ``indices``.
    indices : (c,) int64
        Vertex of every corner.

    Returns
    -------
    triangles : (t, 3) int64
    faces : (t,) int64
        Polygon of every triangle. One of fewer than three corners has none.
    """
    counts = np.maximum(np.diff(offsets) - 2, 0)
    faces = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(faces)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    first = offsets[faces]
    return indices[np.column_stack([first, first + step, first + step + 1])], faces


def surface_area(positions: FloatArray, faces: IndexArray) -> float:
    """Area of a surface of triangles or quads; a quad, which need not be flat, counts as the mean of its two splits.

    Parameters
    ----------
    positions : (n, 3) float64
    faces : (m, 4) or (m, 3) int64
    """
    if faces.shape[1] == 3:
        return float(triangle_areas(positions, faces).sum())
    areas, total = np.empty(len(faces)), 0.0
    for split in (0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3):
        for part in parts(len(faces), CACHED):
            areas[part] = triangle_areas(positions, faces[part][:, split])
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
    return normalized(corner_sums(triangles, triangle_normals(positions, triangles), len(positions)))


def corner_sums(triangles: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """(count, d) sums of rows (t, d) over the triangles around each of the first vertices."""
    sums = np.zeros((count, values.shape[1]))
    _add_to_corners(read_only(triangles), values, sums)
    return sums


def ring_sums(positions: FloatArray, triangles: IndexArray, count: int) -> FloatArray:
    """(count, 6) sums over the triangles around each of the first vertices.

    Columns: the normals of length twice the area, the areas, the means of the edges' lengths, and ones.
    """
    sums = np.zeros((count, 6))
    for part in parts(len(triangles), CACHED):
        near = triangles[part]
        first, second, third = (near < count).T
        near = near[first | second | third]
        normals = triangle_normals(positions, near)
        corners = [positions.take(near[:, k], axis=0) for k in range(3)]
        edges = sum(row_lengths(corners[k] - corners[k - 1]) for k in range(3)) / 3
        figures = np.column_stack([normals, 0.5 * row_lengths(normals), edges, np.ones(len(near))])
        _add_to_corners(read_only(near), figures, sums)
    return sums


def row_lengths(vectors: FloatArray) -> FloatArray:
    """Lengths along the last axis; unlike ``np.linalg.norm`` fast for short rows."""
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", vectors, vectors)))


def normalized(vectors: FloatArray) -> FloatArray:
    """Rows scaled to unit length; zero rows stay zero."""
    lengths = row_lengths(vectors)[..., None]
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def triangle_neighbors(corners: IndexArray) -> NDArray[np.int32]:
    """(t, 3) triangle across the edge *opposite* to every corner, -1 on the boundary.

    Edges are matched by their unordered pair of vertices; where more than two triangles share one, they are paired
    in order, which is what a UV layout with faces laid over each other needs.
    """
    neighbors = np.full(corners.shape, -1, dtype=np.int32)
    head = np.full(int(corners.max(initial=-1)) + 1, -1, dtype=np.int32)
    rest = np.full(corners.size, -1, dtype=np.int32)
    _pair_edges(read_only(np.ascontiguousarray(corners)), neighbors, head, rest)
    return neighbors


def load_kernels() -> None:
    """Have Numba load its own definitions, which takes longer than any kernel, before the first one is needed."""
    triangle_areas(np.eye(3), np.arange(3)[None])


# Kernels fill arrays that they are given: to allocate inside would double the time they take to compile.
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
    """Add every triangle's row to the rows of its corners, of those that have one."""
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
                other, j = edge // 3, edge % 3
                if corners[other, (j + 1) % 3] == high or corners[other, (j + 2) % 3] == high:
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
