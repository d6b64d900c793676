"""Slow twins of the compiled searches of `cagemap.maps.spectral`, which define them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.maps.spectral.search import Embedding
from cagemap.maps.spectral.vertex_to_point import closest_on_triangle
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
