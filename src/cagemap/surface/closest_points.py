"""Closest points on a triangle mesh, by distance and optionally by normals.

The search uses an implicit bounding-volume tree with boxes of positions and normals; node ``i`` has the children
``2 i + 1`` and ``2 i + 2``. If runs of consecutive triangles are compact, as after subdivision, they are the leaves;
otherwise all triangles are sorted along a space-filling curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, places_of, read_only
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.surface.triangles import CACHED, normalize_rows, triangle_areas, triangle_centres, triangle_normals

_LEAF_SIZE = 8  # triangles
_STACK_SIZE = 64  # nodes
_SHIFTS = 32, 16, 8, 4, 2  # with the masks: insert two zero bits before each of the lowest 21 bits
_MASKS = 0x1F00000000FFFF, 0x1F0000FF0000FF, 0x100F00F00F00F00F, 0x10C30C30C30C30C3, 0x1249249249249249
_QUERY_CHUNK = 512  # consecutive queries of a thread; each starts from the previous answer
_MAX_RUN_EXTENT = 6.0  # largest mean extent of runs of triangles that serve as leaves, in mean triangle sizes


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Triangles of a surface, ordered for closest-point search."""

    #: (nodes, 12) lower and upper bounds of positions, then of normals. Padding nodes are empty (lower > upper
    #: position). Single precision, rounded outwards: bounds only leave triangles out.
    boxes: NDArray[np.float32]
    order: NDArray[np.int32]  #: (t,) triangle of the mesh at every position of the tree; ``places`` is the inverse
    places: NDArray[np.int32]
    positions: FloatArray  #: (n, 3) vertices of the mesh
    corners: NDArray[np.int32]  #: (t, 3) vertices of the triangles in tree order
    normals: FloatArray  #: (t, 3) unit normals in tree order, zero for degenerate triangles

    def normals_of(self, triangles: IndexArray) -> FloatArray:
        """(m, 3) unit normals of some triangles (m,) of the mesh."""
        return self.normals.take(self.places.take(triangles), axis=0)


def build_tree(positions: FloatArray, triangles: IndexArray) -> TriangleTree:
    """Search tree of triangles (t, 3) with vertices (n, 3); ParameterError if empty or not finite."""
    if len(triangles) == 0:
        raise ParameterError("triangles: expected at least one to search, got none. Give a surface with faces.")
    positions = np.ascontiguousarray(positions, dtype=np.float64)
    if not np.isfinite(positions).all():
        bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
        raise ParameterError(
            f"positions: expected finite ones, got {len(bad)} that are not, first at vertices {bad[:5]}. "
            "Repair the mesh."
        )
    order = _leaf_order(positions, triangles)
    corners = triangles.take(order, axis=0).astype(np.int32)
    normals = normalize_rows(triangle_normals(positions, triangles).take(order, axis=0))
    n_leaves = 1 << int(np.ceil(np.log2(max(1, -(-len(order) // _LEAF_SIZE)))))
    boxes = np.empty((2 * n_leaves - 1, 12), dtype=np.float32)
    _fill_boxes(read_only(positions), corners, normals, boxes)
    places = places_of(order, len(order)).astype(np.int32)
    return TriangleTree(boxes, order.astype(np.int32), places, read_only(positions), corners, normals)


def closest_points(
    tree: TriangleTree,
    points: FloatArray,
    normals: FloatArray | None = None,
    *,
    normal_weight: float = 0.0,
    minimum_cosine: float = -2.0,
    guess: IndexArray | None = None,
    within: FloatArray | float = np.inf,
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Closest surface point of every query: triangle (m,), barycentric coordinates (m, 3) and distance (m,).

    Minimises ``|q - p|^2 + w^2 |n_q - n_p|^2`` over the surface's points ``p``, with ``n_p`` the normal of the triangle
    of ``p`` and ``w = normal_weight``, a length. Only triangles with a cosine of at least ``minimum_cosine`` between
    ``n_p`` and ``n_q`` are searched, and only costs below the square of ``within``, (m,) or one length, are accepted.
    Without an accepted point the triangle is -1 and the distance infinite. ``guess`` (m,) are triangles near the
    queries, -1 for none; they only make the search faster.
    """
    if normals is None and (normal_weight > 0 or minimum_cosine > -1):
        raise ParameterError(
            "normals: expected those of the queries, got none: normal_weight and minimum_cosine need them"
        )
    queries = read_only(np.ascontiguousarray(points, dtype=np.float64))
    given = np.zeros(queries.shape) if normals is None else normals
    directions = read_only(np.ascontiguousarray(given, dtype=np.float64))
    start = np.full(len(queries), -1, dtype=np.int64) if guess is None else np.where(guess >= 0, tree.places[guess], -1)
    # Near queries follow each other: one without a guess starts from the result of the query before it.
    sequence = np.argsort(_morton_codes(queries) if guess is None else start, kind="stable")
    nearest = np.full(len(queries), -1, dtype=np.int64)
    barycentric, squared = np.zeros((len(queries), 3)), np.full(len(queries), np.inf)
    limits = np.full(len(queries), np.square(within), dtype=np.float64)  # writable, else the kernel is compiled twice

    searched = tree.boxes, tree.positions, tree.corners, tree.normals
    asked = queries, directions, limits, start
    options, answers = (float(normal_weight) ** 2, float(minimum_cosine)), (nearest, barycentric, squared)
    # Chunks must not depend on the number of threads: among equally close points the start decides.
    chunks = [sequence[part] for part in row_slices(len(sequence), _QUERY_CHUNK)]
    in_threads(lambda chunk: _search(searched, asked, options, chunk, answers), chunks)
    triangle = np.where(nearest >= 0, tree.order[nearest], -1)
    return triangle, barycentric, np.sqrt(squared)


def closest_among(
    positions: FloatArray, triangles: IndexArray, starts: IndexArray, candidates: IndexArray, points: FloatArray
) -> tuple[IndexArray, FloatArray]:
    """Nearest of triangles ``candidates[starts[i, 0]:starts[i, 1]]`` to point i: triangle (m,), barycentric (m, 3)."""
    triangle, barycentric = np.empty(len(points), dtype=np.int64), np.empty((len(points), 3))
    given = positions, triangles, starts, candidates, points
    p, t, s, among, q = (read_only(np.ascontiguousarray(array)) for array in given)
    _search_among(p, t, s, among, q, triangle, barycentric)
    return triangle, barycentric


def _leaf_order(positions: FloatArray, triangles: IndexArray) -> IndexArray:
    """(t,) triangles in the order of the tree's leaves, along a space-filling curve."""
    leaves = len(triangles) // _LEAF_SIZE
    centres = triangle_centres(positions, triangles)
    runs = np.ascontiguousarray(centres[: leaves * _LEAF_SIZE].reshape(-1, _LEAF_SIZE, 3).transpose(1, 2, 0))
    extents = np.linalg.norm(runs.max(axis=0) - runs.min(axis=0), axis=0)
    sizes = triangle_areas(positions, triangles)
    if not leaves or extents.mean() > _MAX_RUN_EXTENT * np.sqrt(2.0 * sizes).mean():
        return np.argsort(_morton_codes(centres), kind="stable")
    first = _LEAF_SIZE * np.argsort(_morton_codes(runs.mean(axis=0).T), kind="stable")
    return np.concatenate(
        [(first[:, None] + np.arange(_LEAF_SIZE)).ravel(), np.arange(leaves * _LEAF_SIZE, len(triangles))]
    )


def _morton_codes(points: FloatArray) -> IndexArray:
    """(t,) positions of points along a space-filling curve, 21 bits an axis."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    low, high = (np.array([extreme(column) for column in points.T]) for extreme in (np.min, np.max))
    scale = 2**21 / max(float((high - low).max()), 1e-300)  # not 0, and its inverse is finite
    codes = np.zeros(len(points), dtype=np.uint64)
    for part in row_slices(len(points), CACHED):
        for axis in range(3):
            cells = np.minimum((points[part, axis] - low[axis]) * scale, 2**21 - 1).astype(np.uint64)
            for shift, mask in zip(_SHIFTS, _MASKS, strict=True):
                cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
            codes[part] |= cells << np.uint64(axis)
    return codes.astype(np.int64)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill_boxes(positions, triangles, normals, boxes):  # type: ignore[no-untyped-def]
    """Fill boxes from the leaves up to the root."""
    first_leaf, down, up = len(boxes) // 2, np.float32(-np.inf), np.float32(np.inf)
    for leaf in range(first_leaf + 1):
        box, begin, end = boxes[first_leaf + leaf], leaf * _LEAF_SIZE, min((leaf + 1) * _LEAF_SIZE, len(triangles))
        for i in range(3):
            low, high, least, most = np.inf, -np.inf, 1.0, -1.0
            for t in range(begin, end):
                for k in range(3):
                    x = positions[triangles[t, k], i]
                    low, high = min(low, x), max(high, x)
                least, most = min(least, normals[t, i]), max(most, normals[t, i])
            box[i], box[3 + i] = np.nextafter(np.float32(low), down), np.nextafter(np.float32(high), up)
            box[6 + i], box[9 + i] = np.nextafter(np.float32(least), down), np.nextafter(np.float32(most), up)
    for node in range(first_leaf - 1, -1, -1):
        for first in (0, 6):
            for i in range(first, first + 3):
                boxes[node, i] = min(boxes[2 * node + 1, i], boxes[2 * node + 2, i])
                boxes[node, 3 + i] = max(boxes[2 * node + 1, 3 + i], boxes[2 * node + 2, 3 + i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _search(tree, asked, options, sequence, answers):  # type: ignore[no-untyped-def]
    """Branch and bound over the tree, the nearer child first."""
    boxes, positions, corners, normals = tree
    queries, directions, limits, start = asked
    weight2, minimum_cosine = options
    nearest, barycentric, squared = answers
    n_triangles, first_leaf = len(corners), (len(boxes) - 1) // 2
    nodes, bounds = np.empty(_STACK_SIZE, dtype=np.int64), np.empty(_STACK_SIZE)
    last = np.int64(-1)
    for i in sequence:
        x, y, z = queries[i, 0], queries[i, 1], queries[i, 2]
        nx, ny, nz = directions[i, 0], directions[i, 1], directions[i, 2]
        best = limits[i]
        best_v, best_w, best_squared = 0.0, 0.0, np.inf
        best_t = np.int64(-1)
        t = start[i] if start[i] >= 0 else last
        if t >= 0:
            cosine = nx * normals[t, 0] + ny * normals[t, 1] + nz * normals[t, 2]
            if cosine >= minimum_cosine:
                v, w, d2 = _closest_in_triangle(positions, corners, t, x, y, z)
                cost = d2 + weight2 * 2.0 * (1.0 - cosine)
                if cost < best:
                    best = cost
                    best_t, best_v, best_w, best_squared = t, v, w, d2
        # Search from that triangle's leaf towards the root: most sibling boxes are excluded by their bound.
        climb = first_leaf + max(t, 0) // _LEAF_SIZE
        nodes[0], bounds[0] = climb, 0.0
        size = 1
        while size > 0 or climb > 0:
            if size == 0:
                node = climb + 1 if climb % 2 == 1 else climb - 1
                climb = (climb - 1) // 2
                bound = _box_cost(boxes, node, x, y, z, nx, ny, nz, weight2)
            else:
                size -= 1
                node, bound = nodes[size], bounds[size]
            if bound >= best:
                continue
            while node < first_leaf:
                node, sibling = 2 * node + 1, 2 * node + 2
                bound = _box_cost(boxes, node, x, y, z, nx, ny, nz, weight2)
                farther = _box_cost(boxes, sibling, x, y, z, nx, ny, nz, weight2)
                if farther <= bound:
                    node, sibling, bound, farther = sibling, node, farther, bound
                if farther < best:
                    nodes[size], bounds[size] = sibling, farther
                    size += 1
                if bound >= best:
                    break
            if bound >= best:
                continue
            begin = (node - first_leaf) * _LEAF_SIZE
            for j in range(begin, min(begin + _LEAF_SIZE, n_triangles)):
                t = np.int64(j)
                cosine = nx * normals[t, 0] + ny * normals[t, 1] + nz * normals[t, 2]
                penalty = weight2 * 2.0 * (1.0 - cosine)
                if cosine < minimum_cosine or penalty >= best:
                    continue
                v, w, d2 = _closest_in_triangle(positions, corners, t, x, y, z)
                if d2 + penalty < best:
                    best = d2 + penalty
                    best_t, best_v, best_w, best_squared = t, v, w, d2
        last = best_t if best_t >= 0 else last
        nearest[i], squared[i] = best_t, best_squared
        if best_t >= 0:
            barycentric[i, 0], barycentric[i, 1], barycentric[i, 2] = 1.0 - best_v - best_w, best_v, best_w


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _search_among(positions, corners, starts, candidates, points, triangle, barycentric):  # type: ignore[no-untyped-def]
    """Find the nearest of each query's candidate triangles."""
    for i in range(len(points)):
        best, best_v, best_w, best_t = np.inf, 0.0, 0.0, candidates[starts[i, 0]]
        for j in range(starts[i, 0], starts[i, 1]):
            t = candidates[j]
            v, w, d2 = _closest_in_triangle(positions, corners, t, points[i, 0], points[i, 1], points[i, 2])
            if d2 < best:
                best, best_t = d2, t
                best_v = min(max(v, 0.0), 1.0)  # against rounding, and for triangles without area
                best_w = min(max(w, 0.0), 1.0 - best_v)
        triangle[i] = best_t
        barycentric[i, 0], barycentric[i, 1], barycentric[i, 2] = 1.0 - best_v - best_w, best_v, best_w


@numba.njit(cache=True, error_model="numpy")
def _box_cost(boxes, node, x, y, z, nx, ny, nz, weight2):  # type: ignore[no-untyped-def]
    """Lower bound of the cost in a box: squared distances to its positions and normals (2 - 2 cos = |n_q - n_p|^2)."""
    dx = max(boxes[node, 0] - x, 0.0, x - boxes[node, 3])
    dy = max(boxes[node, 1] - y, 0.0, y - boxes[node, 4])
    dz = max(boxes[node, 2] - z, 0.0, z - boxes[node, 5])
    ex = max(boxes[node, 6] - nx, 0.0, nx - boxes[node, 9])
    ey = max(boxes[node, 7] - ny, 0.0, ny - boxes[node, 10])
    ez = max(boxes[node, 8] - nz, 0.0, nz - boxes[node, 11])
    return dx * dx + dy * dy + dz * dz + weight2 * (ex * ex + ey * ey + ez * ez)


@numba.njit(cache=True, error_model="numpy")
def _closest_in_triangle(positions, corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """Barycentric coordinates of corners 1 and 2, squared distance (Ericson, Real-Time Collision Detection 5.1.5)."""
    a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
    ax, ay, az = positions[a, 0], positions[a, 1], positions[a, 2]
    abx, aby, abz = positions[b, 0] - ax, positions[b, 1] - ay, positions[b, 2] - az
    acx, acy, acz = positions[c, 0] - ax, positions[c, 1] - ay, positions[c, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    d1 = abx * px + aby * py + abz * pz
    d2 = acx * px + acy * py + acz * pz
    bx, by, bz = px - abx, py - aby, pz - abz
    d3 = abx * bx + aby * by + abz * bz
    d4 = acx * bx + acy * by + acz * bz
    cx, cy, cz = px - acx, py - acy, pz - acz
    d5 = abx * cx + aby * cy + abz * cz
    d6 = acx * cx + acy * cy + acz * cz
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    ex = px - v * abx - w * acx
    ey = py - v * aby - w * acy
    ez = pz - v * abz - w * acz
    return v, w, ex * ex + ey * ey + ez * ez
