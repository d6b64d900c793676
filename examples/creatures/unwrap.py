"""Unwraps a modelled creature: cut into islands along given seams, flatten each, pack them into the unit square."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

ARAP_ITERATIONS = 30
STEPS = 8
"""Samples along a control edge when packing: closer than the columns are wide."""


def unwrap(mesh: ControlMesh, islands: Sequence[str], seams: IndexArray, *, padding: float) -> ControlMesh:
    """Return the mesh with texture coordinates.

    Parameters
    ----------
    mesh : ControlMesh
        Closed and consistently oriented.
    islands : sequence of str, one per face
        Faces of different names never share a UV edge.
    seams : (s, 2) int64
        Further edges to cut, as vertex pairs.
    padding : float
        Least distance between islands, and to the border, in units of the texture's side.
    """
    names, island_of_face = np.unique(np.array(islands), return_inverse=True)
    uv_of_corner = _uv_vertices(mesh, island_of_face, seams)
    flat = np.zeros((uv_of_corner.max() + 1, 2))
    members, ears = [], []
    for island in range(len(names)):
        corners = np.flatnonzero(island_of_face[mesh.corner_faces] == island)
        used, local = np.unique(uv_of_corner[corners], return_inverse=True)
        points = np.zeros((len(used), 3))
        points[local] = mesh.positions[mesh.face_indices[corners]]
        sizes = mesh.face_sizes[island_of_face == island]
        triangles = _ears(local, sizes)
        flat[used] = _upright(flatten(points, triangles))
        members.append(used)
        ears.append(triangles)
    return mesh.with_uvs(_pack(flat, members, ears, padding), uv_of_corner)


def _uv_vertices(mesh: ControlMesh, island_of_face: IndexArray, seams: IndexArray) -> IndexArray:
    """Number the UV vertex of every corner: corners are one where uncut edges of one island join them."""
    n, corners = mesh.n_vertices, len(mesh.face_indices)
    tail, head = mesh.face_indices, mesh.face_indices[mesh.next_corners]
    order = np.argsort(tail * n + head)
    keys = (tail * n + head)[order]
    twin = order[np.searchsorted(keys, head * n + tail)]  # the corner that runs the same edge backwards
    cut = np.isin(np.minimum(tail, head) * n + np.maximum(tail, head), seams.min(1) * n + seams.max(1))
    island = island_of_face[mesh.corner_faces]
    joined = np.flatnonzero(~cut & (island == island[twin]))
    here = np.concatenate([joined, mesh.next_corners[joined]])
    there = np.concatenate([mesh.next_corners[twin[joined]], twin[joined]])
    graph = sparse.coo_array((np.ones(len(here)), (here, there)), shape=(corners, corners))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _ears(indices: IndexArray, sizes: IndexArray) -> IndexArray:
    """(c, 3) triangle of every corner with its two neighbours: for a quad, both of its triangulations."""
    corner = np.arange(len(indices))
    first = np.repeat(np.cumsum(sizes) - sizes, sizes)
    before = first + (corner - first - 1) % np.repeat(sizes, sizes)
    after = first + (corner - first + 1) % np.repeat(sizes, sizes)
    return indices[np.stack([before, corner, after], axis=1)]


def flatten(points: FloatArray, triangles: IndexArray) -> FloatArray:
    """Flatten a patch that has a border: least-squares conformal, then as rigid as possible (local/global).

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (t, 3) int64
        Consistently oriented; the patch need not be simply connected.

    Returns
    -------
    (n, 2) float64
        Same orientation, in the length unit of ``points``.
    """
    rest = _in_plane(points, triangles)
    flat = _conformal(rest, triangles, len(points))
    edges = np.roll(rest, -1, axis=1) - rest  # (t,3,2), edge i from corner i to i + 1
    opposite = -np.roll(edges, -2, axis=1), np.roll(edges, -1, axis=1)  # from the corner opposite to edge i
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    # Positive weights only, so that no triangle is rewarded for turning over.
    weight = np.maximum(-np.sum(opposite[0] * opposite[1], axis=2) / area[:, None] / 2, 1e-2)
    i, j = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    n = len(points)
    one_way = sparse.coo_array((weight.ravel(), (i, j)), shape=(n, n)).tocsr()
    both_ways = one_way + one_way.T
    laplacian = sparse.diags_array(both_ways.sum(axis=1)) - both_ways
    factor = splu(sparse.csc_matrix(laplacian)[1:, 1:])  # the first vertex stays at the origin
    for _ in range(ARAP_ITERATIONS):
        now = np.roll(flat[triangles], -1, axis=1) - flat[triangles]
        moment = np.einsum("te,tea,teb->tab", weight, now, edges)
        turn = np.stack([moment[:, 0, 0] + moment[:, 1, 1], moment[:, 1, 0] - moment[:, 0, 1]], axis=1)
        cosine, sine = (turn / np.linalg.norm(turn, axis=1, keepdims=True)).T
        rotation = np.stack([np.stack([cosine, -sine], 1), np.stack([sine, cosine], 1)], axis=1)
        pull = weight[:, :, None] * np.einsum("tab,teb->tea", rotation, edges)
        right = np.zeros((n, 2))
        np.add.at(right, j, pull.reshape(-1, 2))
        np.add.at(right, i, -pull.reshape(-1, 2))
        flat = np.vstack([np.zeros((1, 2)), factor.solve(right[1:])])
    return flat


def _in_plane(points: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t, 3, 2) every triangle laid into the plane, isometrically and counter-clockwise."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    length = np.linalg.norm(b - a, axis=1)
    x = np.sum((c - a) * (b - a), axis=1) / length
    y = np.linalg.norm(np.cross(b - a, c - a), axis=1) / length
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, zero], 1), np.stack([length, zero], 1), np.stack([x, y], 1)], axis=1)


def _conformal(rest: FloatArray, triangles: IndexArray, n: int) -> FloatArray:
    """Least-squares conformal map (Levy et al. 2002), in complex numbers: sum_i w_i u_i = 0 in every triangle."""
    z = rest[:, :, 0] + 1j * rest[:, :, 1]
    area = (rest[:, 1, 0] * rest[:, 2, 1])[:, None]
    coefficient = (np.roll(z, -2, axis=1) - np.roll(z, -1, axis=1)) / np.sqrt(area)
    rows = np.repeat(np.arange(len(triangles)), 3)
    matrix = sparse.coo_array((coefficient.ravel(), (rows, triangles.ravel())), shape=(len(triangles), n)).tocsc()
    normal = (matrix.conj().T @ matrix).tocsc()
    # Pin a long edge chain's ends: the first vertex and the one farthest from it in the graph sense of the rest shape.
    first, last = _far_pair(rest, triangles, n)
    free = np.setdiff1d(np.arange(n), [first, last])
    pinned = normal[:, [last]].toarray()[free, 0]
    solution = np.zeros(n, dtype=complex)
    solution[last] = 1.0
    solution[free] = splu(sparse.csc_matrix(normal[free][:, free])).solve(-pinned)
    ratio = np.sqrt(area.sum() / np.abs(_signed_areas(solution, triangles).sum()))
    return np.stack([solution.real, solution.imag], axis=1) * ratio


def _signed_areas(z: np.ndarray, triangles: IndexArray) -> FloatArray:
    a, b, c = (z[triangles[:, k]] for k in range(3))
    return np.asarray(((b - a).conj() * (c - a)).imag)


def _far_pair(rest: FloatArray, triangles: IndexArray, n: int) -> tuple[int, int]:
    """Two vertices far apart along edges."""
    i, j = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    length = np.linalg.norm(np.roll(rest, -1, axis=1) - rest, axis=2).ravel()
    graph = sparse.csr_matrix((length, (i, j)), shape=(n, n))
    start = int(np.argmax(dijkstra(graph, directed=False, indices=[triangles[0, 0]])))
    return start, int(np.argmax(dijkstra(graph, directed=False, indices=[start])))


def _upright(flat: FloatArray) -> FloatArray:
    """Turn an island so that its bounding box is smallest, and taller than wide; corner at the origin."""
    angles = np.radians(np.arange(0, 180, 2))
    turns = np.stack([np.stack([np.cos(angles), -np.sin(angles)], 1), np.stack([np.sin(angles), np.cos(angles)], 1)], 1)
    turned = np.einsum("kab,nb->kna", turns, flat)
    size = np.ptp(turned, axis=1)
    # Rounded, so that a mirrored pair of islands does not turn on the last digit.
    best = np.lexsort([size[:, 0] > size[:, 1], np.round(size.prod(axis=1), 6)])[0]
    return np.asarray(turned[best] - turned[best].min(axis=0))


def _pack(
    flat: FloatArray, members: Sequence[IndexArray], triangles: Sequence[IndexArray], padding: float
) -> FloatArray:
    """Place the islands in the unit square at the largest common scale found by bisection."""
    turned = [[_quarter_turns(flat[used], turn) for turn in range(4)] for used in members]
    samples = [[_spread(points, part) for points in turns] for turns, part in zip(turned, triangles, strict=True)]
    low, high, best = 0.0, 1.0 / float(np.sqrt(sum(np.ptp(flat[used], axis=0).prod() for used in members)) / 2), None
    for _ in range(14):
        scale = (low + high) / 2
        places = _tetris([[points * scale for points in turns] for turns in samples], padding)
        if places is None:
            high = scale
        else:
            low, best = scale, places
    if best is None:
        raise AssertionError("some scale is small enough")
    uvs = np.zeros_like(flat)
    for used, turns, (turn, corner) in zip(members, turned, best, strict=True):
        uvs[used] = turns[turn] * low + corner
    return uvs


def _quarter_turns(flat: FloatArray, turns: int) -> FloatArray:
    """Turn points by multiples of 90 degrees and move them to the corner at the origin."""
    z = (flat[:, 0] + 1j * flat[:, 1]) * 1j**turns
    points = np.stack([z.real, z.imag], axis=1)
    return np.asarray(points - points.min(axis=0))


def _spread(points: FloatArray, triangles: IndexArray) -> FloatArray:
    """(s, 2) points spread evenly over triangles, borders included, for marking the columns that an island covers."""
    i, j = np.divmod(np.arange((STEPS + 1) ** 2), STEPS + 1)
    inside = i + j <= STEPS
    weights = np.stack([i, j, STEPS - i - j], axis=1)[inside] / STEPS
    return np.asarray(weights @ points[triangles]).reshape(-1, 2)


def _tetris(samples: Sequence[Sequence[FloatArray]], padding: float) -> list[tuple[int, FloatArray]] | None:
    """Drop the islands into the unit square, tallest first, each where its top ends lowest (Levy et al. 2002, sec. 5).

    Parameters
    ----------
    samples : for every island, for every quarter turn, (s, 2) points that cover it

    Returns
    -------
    list of (quarter turn, (2,) corner), or None if they do not fit.
    """
    columns = int(np.floor(1 / padding))
    horizon = np.zeros(columns)
    places: dict[int, tuple[int, FloatArray]] = {}
    heights = np.array([np.round(max(points[0].max(), points[1].max()), 6) for points in samples])
    for island in np.argsort(-heights, kind="stable"):
        options = []
        for turn, points in enumerate(samples[island]):
            bottom, top = _profile(points, padding)
            if len(bottom) > columns:
                continue
            windows = np.lib.stride_tricks.sliding_window_view(horizon, len(bottom))
            base = (windows - bottom).max(axis=1)
            lost = (base[:, None] + bottom - windows).sum(axis=1) * padding
            # Lowest top first; at equal height the place that wastes least.
            cost = np.round(base + top.max() + 0.2 * lost, 9)
            column = int(np.argmin(cost))
            options.append((float(cost[column]), turn, column, float(base[column]), bottom, top))
        if not options:
            return None
        _, turn, column, base_height, bottom, top = min(options, key=lambda option: option[:3])
        horizon[column : column + len(top)] = base_height + top
        if horizon.max() > 1:
            return None
        places[int(island)] = turn, np.array([(column + 1) * padding, base_height + padding])
    return [places[island] for island in range(len(samples))]


def _profile(points: FloatArray, padding: float) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest point in every column of width ``padding``, with a margin of ``padding`` all around."""
    column = (points[:, 0] / padding).astype(np.int64) + 1
    bottom, top = np.full(column.max() + 2, np.inf), np.full(column.max() + 2, -np.inf)
    np.minimum.at(bottom, column, points[:, 1])
    np.maximum.at(top, column, points[:, 1])
    bottom = np.minimum(bottom, np.minimum(np.append(bottom[1:], np.inf), np.append(np.inf, bottom[:-1])))
    top = np.maximum(top, np.maximum(np.append(top[1:], -np.inf), np.append(-np.inf, top[:-1])))
    return bottom, top + 2 * padding
