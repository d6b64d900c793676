"""Unwraps a modelled creature: cut into islands along given seams, flatten each, pack them into the unit square."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from cagemap.mesh import ControlMesh, FloatArray, IndexArray

ARAP_ITERATIONS = 30


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
    members = []
    for island in range(len(names)):
        corners = np.flatnonzero(island_of_face[mesh.corner_faces] == island)
        used, local = np.unique(uv_of_corner[corners], return_inverse=True)
        points = np.zeros((len(used), 3))
        points[local] = mesh.positions[mesh.face_indices[corners]]
        sizes = mesh.face_sizes[island_of_face == island]
        flat[used] = _upright(flatten(points, _fan(local, sizes)))
        members.append(used)
    return mesh.with_uvs(_pack(flat, members, padding), uv_of_corner)


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


def _fan(indices: IndexArray, sizes: IndexArray) -> IndexArray:
    """(t, 3) fan triangles of polygons stored one after the other."""
    start = np.repeat(np.cumsum(sizes) - sizes, sizes - 2)
    rank = np.arange(len(start)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return indices[np.stack([start, start + rank + 1, start + rank + 2], axis=1)]


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
    laplacian = sparse.coo_array((weight.ravel(), (i, j)), shape=(n, n)).tocsr()
    laplacian = laplacian + laplacian.T
    laplacian = sparse.csc_array(sparse.diags_array(laplacian.sum(axis=1)) - laplacian)
    factor = splu(sparse.csc_matrix(laplacian[1:, 1:]))
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
    graph = sparse.csr_array((length, (i, j)), shape=(n, n))
    start = int(np.argmax(sparse.csgraph.dijkstra(graph, directed=False, indices=int(triangles[0, 0]))))
    return start, int(np.argmax(sparse.csgraph.dijkstra(graph, directed=False, indices=start)))


def _upright(flat: FloatArray) -> FloatArray:
    """Turn an island so that its bounding box is smallest, and taller than wide; corner at the origin."""
    angles = np.radians(np.arange(0, 180, 2))
    turns = np.stack([np.stack([np.cos(angles), -np.sin(angles)], 1), np.stack([np.sin(angles), np.cos(angles)], 1)], 1)
    turned = np.einsum("kab,nb->kna", turns, flat)
    size = np.ptp(turned, axis=1)
    # Rounded, so that a mirrored pair of islands does not turn on the last digit.
    best = np.lexsort([size[:, 0] > size[:, 1], np.round(size.prod(axis=1), 6)])[0]
    return np.asarray(turned[best] - turned[best].min(axis=0))


def _pack(flat: FloatArray, members: Sequence[IndexArray], padding: float) -> FloatArray:
    """Place the islands' boxes into the unit square at the largest common scale that a skyline packing reaches."""
    sizes = np.array([np.ptp(flat[used], axis=0) for used in members])
    low, high = 0.0, 1.0 / float(np.sqrt(sizes.prod(axis=1).sum()))
    for _ in range(30):
        scale = (low + high) / 2
        low, high = (scale, high) if _skyline(sizes * scale + padding, 1 - padding) is not None else (low, scale)
    places = _skyline(sizes * low + padding, 1 - padding)
    if places is None:
        raise AssertionError("the islands fit at scale zero")
    uvs = np.zeros_like(flat)
    for used, place in zip(members, places, strict=True):
        uvs[used] = flat[used] * low + place + padding
    return uvs


def _skyline(sizes: FloatArray, width: float) -> FloatArray | None:
    """Bottom-left skyline packing of boxes into a square, tallest first; None if they do not fit."""
    places = np.zeros_like(sizes)
    line = [(0.0, width, 0.0)]  # pieces: from, to, height
    for box in np.lexsort([-sizes[:, 0], -np.round(sizes[:, 1], 6)]):
        wide, tall = sizes[box]
        starts = [left for left, _, _ in line if left + wide <= width]
        heights = [max(h for a, b, h in line if a < left + wide and b > left) for left in starts]
        if not heights or min(heights) + tall > width:
            return None
        left, base = min(zip(starts, heights, strict=True), key=lambda place: (place[1], place[0]))
        places[box] = left, base
        pieces = [(a, min(b, left), h) for a, b, h in line if a < left]
        pieces += [(left, left + wide, base + tall)]
        pieces += [(max(a, left + wide), b, h) for a, b, h in line if b > left + wide]
        line = pieces
    return places
