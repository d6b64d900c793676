"""Nearest neighbours in the spectral embedding (paper, section 5.4).

A target vertex x has the embedding Phi~1(x, :), a source vertex y the embedding Phi~2(y, :) C12^T; the point map sends
x to the source vertex with the nearest embedding.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.threads import in_threads, parts

Embedding = NDArray[np.float32]

# Queries of one block of `nearest_rows`: its distances take 4 bytes times the number of points each.
BLOCK = 512
# Rows that a kernel works through at once.
ROWS = 4096
# Sums may be reordered, so that they are vectorised; infinity and NaN keep their meaning.
REORDERED = {"reassoc", "contract", "arcp", "nsz"}
# Weight of S_1^l from which a coarse vertex counts as a parent of a refined one, relative to the row's largest.
PARENT_SHARE = 0.5


def nearest_rows(queries: Embedding, points: Embedding) -> IndexArray:
    """Index of the nearest point for every query, by blocked matrix products; meant for the coarsest level.

    Parameters
    ----------
    queries : (b, k) array
    points : (n, k) array

    Returns
    -------
    (b,) array

    Notes
    -----
    O(b n k) work. A k-d tree is faster only where both embeddings already lie on each other: while a map is rough its
    search degenerates (6k vertices, 200 coordinates: 2 s against 0.3 s).
    """
    half_norms = 0.5 * np.einsum("ij,ij->i", points, points)
    transposed = np.ascontiguousarray(points.T)
    nearest = np.empty(len(queries), dtype=np.int64)

    def one_block(part: slice) -> None:
        scores = queries[part] @ transposed
        scores -= half_norms
        nearest[part] = np.argmax(scores, axis=1)

    in_threads(one_block, parts(len(queries), BLOCK))
    return nearest


def nearest_both_ways(queries: Embedding, points: Embedding) -> tuple[IndexArray, IndexArray]:
    """Nearest point of every query, and nearest query of every point, from one set of products.

    Parameters
    ----------
    queries : (b, k) array
    points : (n, k) array

    Returns
    -------
    forward, backward : (b,), (n,) arrays
    """
    query_norms, point_norms = (0.5 * np.einsum("ij,ij->i", rows, rows) for rows in (queries, points))
    transposed = np.ascontiguousarray(points.T)
    forward = np.empty(len(queries), dtype=np.int64)

    def one_block(part: slice) -> tuple[IndexArray, NDArray[np.float32]]:
        scores = queries[part] @ transposed
        forward[part] = np.argmax(scores - point_norms, axis=1)
        scores -= query_norms[part, None]
        nearest = np.argmax(scores, axis=0)
        return part.start + nearest, np.take_along_axis(scores, nearest[None], axis=0)[0]

    found = in_threads(one_block, parts(len(queries), BLOCK))
    best = np.argmax(np.stack([scores for _, scores in found]), axis=0)
    return forward, np.stack([nearest for nearest, _ in found])[best, np.arange(len(points))]


def strongest_parents(subdivision: sparse.csr_array) -> sparse.csr_array:
    """Entries of S_1^l that make a coarse vertex a parent: at least `PARENT_SHARE` of the row's largest.

    Returns
    -------
    (n_{l+1}, n_l) CSR array
        Same row order; the values are the weights kept.
    """
    largest = subdivision.max(axis=1).toarray().ravel()
    rows = np.repeat(np.arange(subdivision.shape[0]), np.diff(subdivision.indptr))
    kept = subdivision.data >= PARENT_SHARE * largest[rows]
    counts = np.bincount(rows[kept], minlength=subdivision.shape[0])
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return sparse.csr_array((subdivision.data[kept], subdivision.indices[kept], indptr), shape=subdivision.shape)


def nearest_candidates(
    target_rows: Embedding,
    source_rows: Embedding,
    parents: sparse.csr_array,
    children: sparse.csc_array,
    coarse_match: IndexArray,
) -> IndexArray:
    """Nearest source vertex among the candidates of every refined target vertex (paper, section 5.4, Fig. 9).

    The candidates are the refined source vertices influenced (nonzeros of the column of S_2^l) by the matches of the
    vertex's parents.

    Parameters
    ----------
    target_rows : (n1, k) float32 array
        Embedding of the target vertices of level l + 1.
    source_rows : (n2, k) float32 array
    parents : (n1, n1_l) CSR array
        See `strongest_parents`.
    children : (n2, n2_l) CSC array
        S_2^l.
    coarse_match : (n1_l,) array
        Source vertex of level l matched to every target vertex of level l.

    Returns
    -------
    (n1,) array

    Raises
    ------
    ParameterError
        If a vertex has no candidate at a finite distance.
    """
    nearest = np.empty(len(target_rows), dtype=np.int64)

    def search(part: slice) -> None:
        _nearest_candidates(
            (target_rows, source_rows),
            (parents.indptr, parents.indices, children.indptr, children.indices, coarse_match),
            (part.start, part.stop),
            nearest,
        )

    in_threads(search, parts(len(nearest), ROWS))
    require_found(nearest)
    return nearest


def require_found(found: IndexArray) -> None:
    """Refuse answers (n1,) of a search that are -1.

    Raises
    ------
    ParameterError
    """
    if found.min(initial=0) < 0:
        raise ParameterError(
            "point map: nothing was found for some target vertices: the basis functions or the functional map are not "
            "finite, or a source vertex belongs to no triangle. Check both meshes with `cagemap check`"
        )


@njit(cache=True, fastmath=REORDERED, nogil=True)
def _nearest_candidates(embeddings, candidates, part, nearest):  # type: ignore[no-untyped-def]
    """Fill rows part[0] .. part[1] of the answer."""
    target_rows, source_rows = embeddings
    parent_start, parents, child_start, children, coarse_match = candidates
    k = target_rows.shape[1]
    for x in range(part[0], part[1]):
        best = np.float32(np.inf)
        choice = -1
        for p in range(parent_start[x], parent_start[x + 1]):
            match = coarse_match[parents[p]]
            repeated = False
            for q in range(parent_start[x], p):
                repeated = repeated or coarse_match[parents[q]] == match
            if repeated:
                continue
            for c in range(child_start[match], child_start[match + 1]):
                y = children[c]
                distance = np.float32(0.0)
                for j in range(k):
                    difference = target_rows[x, j] - source_rows[y, j]
                    distance += difference * difference
                if distance < best:
                    best = distance
                    choice = y
        nearest[x] = choice
