"""Slow twins of the compiled searches of `cagemap.maps.spectral`, which define them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.maps.spectral.search import Embedding
from cagemap.numerics.arrays import FloatArray, IndexArray


def nearest_candidates_reference(
    target_rows: Embedding,
    source_rows: Embedding,
    parents: sparse.csr_array,
    children: sparse.csc_array,
    coarse_match: IndexArray,
) -> IndexArray:
    """Slow twin of `nearest_candidates`, which defines it."""
    nearest = np.empty(len(target_rows), dtype=np.int64)
    for x, row in enumerate(target_rows):
        coarse = coarse_match[parents.indices[parents.indptr[x] : parents.indptr[x + 1]]]
        candidates = np.unique(
            np.concatenate([children.indices[children.indptr[y] : children.indptr[y + 1]] for y in coarse])
        )
        distances = np.sum((source_rows[candidates].astype(np.float64) - row.astype(np.float64)) ** 2, axis=1)
        nearest[x] = candidates[np.argmin(distances)]
    return nearest


def vertex_to_point_reference(
    target_rows: NDArray[np.floating],
    source_rows: NDArray[np.floating],
    source_triangles: IndexArray,
    around: tuple[IndexArray, IndexArray],
    match: IndexArray,
) -> tuple[IndexArray, FloatArray]:
    """Slow twin of `vertex_to_point`, which defines it."""
    starts, triangle_list = around
    triangle = np.empty(len(match), dtype=np.int64)
    barycentric = np.empty((len(match), 3))
    for x, y in enumerate(match):
        best = np.inf
        for i in triangle_list[starts[y] : starts[y + 1]]:
            corners = source_rows[source_triangles[i]].astype(np.float64)
            edges = corners[1:] - corners[0]
            weights = closest_on_triangle(edges @ edges.T, edges @ (target_rows[x] - corners[0]))
            distance = float(np.sum((weights @ corners - target_rows[x]) ** 2))
            if distance < best:
                best, triangle[x], barycentric[x] = distance, i, weights
    return triangle, barycentric


def closest_on_triangle(gram: FloatArray, offset: FloatArray) -> FloatArray:
    """Barycentric coordinates of the nearest point of a triangle, in any dimension (slow twin of the kernel).

    Parameters
    ----------
    gram : (2, 2) array
        Inner products of the edge vectors from corner 0.
    offset : (2,) array
        Inner products of these edges with the vector from corner 0 to the point.

    Returns
    -------
    (3,) array
    """
    best, best_value = np.zeros(3), np.inf
    determinant = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    candidates = []
    if determinant > 0.0:
        u, v = np.linalg.solve(gram, offset)
        if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
            candidates.append((u, v))
    candidates.append((np.clip(offset[0] / max(gram[0, 0], 1e-300), 0.0, 1.0), 0.0))
    candidates.append((0.0, np.clip(offset[1] / max(gram[1, 1], 1e-300), 0.0, 1.0)))
    across = gram[0, 0] - 2.0 * gram[0, 1] + gram[1, 1]
    s = np.clip((gram[0, 0] - gram[0, 1] - offset[0] + offset[1]) / max(across, 1e-300), 0.0, 1.0)
    candidates.append((1.0 - s, s))
    for u, v in candidates:
        uv = np.array([u, v])
        value = uv @ gram @ uv - 2.0 * uv @ offset
        if value < best_value:
            best, best_value = np.array([1.0 - u - v, u, v]), value
    return best
