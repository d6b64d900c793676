"""Edge flips towards a Delaunay triangulation on the same vertices."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys
from cagemap.surface.triangles import normalized, triangle_neighbors, triangle_normals

# Rounds of flips; each flips at most one edge of a triangle.
MAX_ROUNDS = 20
# Least cosine between the normals beside an edge that is flipped; sharper edges are features.
MIN_NORMAL_COSINE = 0.8
# Least doubled area of a triangle, as a share of a squared edge: keeps cotangents finite.
MIN_AREA = 1e-12
# Largest sum of the cotangents opposite to an edge that is flipped: below 0 by rounding.
MAX_COTANGENT_SUM = -1e-9


def delaunay(positions: FloatArray, triangles: IndexArray) -> IndexArray:
    """Triangles (t, 3) after flips of edges with negative cotangent weights, where the surface is nearly flat.

    Vertices (n, 3) and the boundary stay. A graph's energy needs positive weights.
    """
    triangles = triangles.copy()
    for _ in range(MAX_ROUNDS):
        first, corner, second, other = _to_flip(positions, triangles)
        if not len(first):
            break
        # Edge (a, b) between the apexes p and q becomes (p, q); directions stay.
        p, a = triangles[first, corner], triangles[first, (corner + 1) % 3]
        q, b = triangles[second, other], triangles[second, (other + 1) % 3]
        triangles[first] = np.column_stack([p, a, q])
        triangles[second] = np.column_stack([q, b, p])
    return triangles


def _to_flip(positions: FloatArray, triangles: IndexArray) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """Edges to flip at once, one of a triangle: both triangles, and their corners opposite to the edge."""
    neighbors = triangle_neighbors(triangles).astype(np.int64)
    first, corner = np.nonzero(neighbors > np.arange(len(triangles))[:, None])
    second = neighbors[first, corner]
    other = np.argmax(neighbors[second] == first[:, None], axis=1)
    apex, left = triangles[first, corner], triangles[first, (corner + 1) % 3]
    right, top = triangles[first, (corner + 2) % 3], triangles[second, other]
    # Both triangles have the same orientation.
    oriented = triangles[second, (other + 1) % 3] == right
    cotangents = _cotangent(positions, apex, left, right) + _cotangent(positions, top, left, right)
    normals = normalized(triangle_normals(positions, triangles))
    flat = np.einsum("ed,ed->e", normals[first], normals[second]) > MIN_NORMAL_COSINE
    count = len(positions)
    known = pair_keys(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), count)
    keys = pair_keys(np.column_stack([apex, top]), count)
    fresh = ~np.isin(keys, known)
    new = np.column_stack([apex, left, top]), np.column_stack([top, right, apex])
    upright = np.all([np.einsum("ed,ed->e", triangle_normals(positions, t), normals[first]) > 0 for t in new], axis=0)
    wanted = np.flatnonzero(oriented & flat & fresh & upright & (cotangents < MAX_COTANGENT_SUM))
    worst = np.full(len(triangles), np.inf)
    for side in (first, second):
        np.minimum.at(worst, side[wanted], cotangents[wanted])
    alone = wanted[(cotangents[wanted] == worst[first[wanted]]) & (cotangents[wanted] == worst[second[wanted]])]
    # New edges that would coincide, or ties in one triangle, wait for the next round.
    alone = alone[np.unique(keys[alone], return_index=True)[1]]
    taken = np.bincount(np.concatenate([first[alone], second[alone]]), minlength=len(triangles))
    alone = alone[(taken[first[alone]] == 1) & (taken[second[alone]] == 1)]
    return first[alone], corner[alone], second[alone], other[alone]


def _cotangent(positions: FloatArray, apex: IndexArray, left: IndexArray, right: IndexArray) -> FloatArray:
    """(e,) cotangents of the angles at apexes, towards the ends of edges."""
    u, v = positions[left] - positions[apex], positions[right] - positions[apex]
    area = np.linalg.norm(np.cross(u, v), axis=1)
    return np.einsum("ed,ed->e", u, v) / np.maximum(area, MIN_AREA * np.einsum("ed,ed->e", u, u) + 1e-300)
