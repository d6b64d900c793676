"""Better triangles between the same vertices: edges are flipped until the triangulation is nearly Delaunay's."""

from __future__ import annotations

import numpy as np

from cagemap.geometry.triangles import normalized, triangle_neighbors, triangle_normals
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys

# Rounds of flips; each takes at most one edge of a triangle.
ROUNDS = 20
# Triangles whose normals make a smaller cosine are no plane: their edge is a feature and stays.
FLAT = 0.8


def delaunay(positions: FloatArray, triangles: IndexArray) -> IndexArray:
    """Flip edges whose two opposite angles sum to more than a half turn, where the surface is nearly flat.

    Cotangent weights of such edges are negative; without them the Laplacian of a simplified mesh is one of positive
    weights, as graphs and their energies want it.

    Parameters
    ----------
    positions : (n, 3) float64
    triangles : (t, 3) int64

    Returns
    -------
    (t, 3) int64
        On the same vertices, with the same border.
    """
    triangles = triangles.copy()
    for _ in range(ROUNDS):
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
    """Edges to flip at once, none of a triangle twice: both triangles, and their corners opposite to the edge."""
    neighbors = triangle_neighbors(triangles).astype(np.int64)
    first, corner = np.nonzero(neighbors > np.arange(len(triangles))[:, None])
    second = neighbors[first, corner]
    other = np.argmax(neighbors[second] == first[:, None], axis=1)
    apex, left = triangles[first, corner], triangles[first, (corner + 1) % 3]
    right, top = triangles[first, (corner + 2) % 3], triangles[second, other]
    # Neighbours that run along their edge in opposite senses: the others are no surface.
    sound = triangles[second, (other + 1) % 3] == right
    cotangents = _cotangent(positions, apex, left, right) + _cotangent(positions, top, left, right)
    normals = normalized(triangle_normals(positions, triangles))
    flat = np.einsum("ed,ed->e", normals[first], normals[second]) > FLAT
    count = len(positions)
    known = pair_keys(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), count)
    keys = pair_keys(np.column_stack([apex, top]), count)
    fresh = ~np.isin(keys, known)
    new = np.column_stack([apex, left, top]), np.column_stack([top, right, apex])
    upright = np.all([np.einsum("ed,ed->e", triangle_normals(positions, t), normals[first]) > 0 for t in new], axis=0)
    wanted = np.flatnonzero(sound & flat & fresh & upright & (cotangents < -1e-9))
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
    return np.einsum("ed,ed->e", u, v) / np.maximum(area, 1e-12 * np.einsum("ed,ed->e", u, u) + 1e-300)
