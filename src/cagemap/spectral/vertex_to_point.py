"""From a matched vertex to a point: projection onto the triangles around it, in the embedding (paper, 5.4)."""

from __future__ import annotations

import numpy as np
from numba import njit

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, parts
from cagemap.spectral.nearest import REORDERED, ROWS, Embedding, require_found


def vertex_triangles(triangles: IndexArray, n_vertices: int) -> tuple[IndexArray, IndexArray]:
    """Triangles around every vertex.

    Returns
    -------
    starts : (n + 1,) array
    around : (3 t,) array
        Triangles of vertex v: ``around[starts[v]:starts[v + 1]]``.
    """
    corners = triangles.ravel()
    around = np.argsort(corners, kind="stable") // 3
    starts = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=n_vertices))])
    return starts, around


def vertex_to_point(
    target_rows: Embedding,
    source_rows: Embedding,
    source_triangles: IndexArray,
    around: tuple[IndexArray, IndexArray],
    match: IndexArray,
) -> tuple[IndexArray, FloatArray]:
    """Nearest point of the embedded triangles around every vertex's match.

    Parameters
    ----------
    target_rows : (n1, k) float32 array
    source_rows : (n2, k) float32 array
    source_triangles : (t2, 3) array
    around : tuple of arrays
        From `vertex_triangles`.
    match : (n1,) array
        Source vertex of every target vertex.

    Returns
    -------
    triangle, barycentric : (n1,), (n1, 3) arrays

    Raises
    ------
    ParameterError
        If no triangle around a match is at a finite distance.
    """
    triangle, barycentric = np.empty(len(match), dtype=np.int64), np.empty((len(match), 3))

    def project(part: slice) -> None:
        _vertex_to_point(
            (target_rows, source_rows),
            (source_triangles, *around),
            match,
            (part.start, part.stop),
            (triangle, barycentric),
        )

    in_threads(project, parts(len(match), ROWS))
    require_found(triangle)
    return triangle, barycentric


@njit(cache=True)
def _closest_uv(aa, ab, bb, pa, pb):  # type: ignore[no-untyped-def]
    """(u, v, squared distance less the constant) of the point of a triangle nearest to a point."""
    determinant = aa * bb - ab * ab
    if determinant > 1e-12 * aa * bb:
        u = (bb * pa - ab * pb) / determinant
        v = (aa * pb - ab * pa) / determinant
        if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
            return u, v, u * u * aa + 2.0 * u * v * ab + v * v * bb - 2.0 * (u * pa + v * pb)
    u = min(max(pa / max(aa, 1e-300), 0.0), 1.0)
    best_u, best_v, best = u, 0.0, u * u * aa - 2.0 * u * pa
    v = min(max(pb / max(bb, 1e-300), 0.0), 1.0)
    value = v * v * bb - 2.0 * v * pb
    if value < best:
        best_u, best_v, best = 0.0, v, value
    s = min(max((aa - ab - pa + pb) / max(aa - 2.0 * ab + bb, 1e-300), 0.0), 1.0)
    u = 1.0 - s
    value = u * u * aa + 2.0 * u * s * ab + s * s * bb - 2.0 * (u * pa + s * pb)
    if value < best:
        best_u, best_v, best = u, s, value
    return best_u, best_v, best


@njit(cache=True, fastmath=REORDERED, nogil=True)
def _vertex_to_point(embeddings, mesh, match, part, answers):  # type: ignore[no-untyped-def]
    """Fill rows part[0] .. part[1] of the answers."""
    target_rows, source_rows = embeddings
    triangles, starts, around = mesh
    triangle, barycentric = answers
    k = target_rows.shape[1]
    for x in range(part[0], part[1]):
        best = np.inf
        triangle[x] = -1
        y = match[x]
        for t in range(starts[y], starts[y + 1]):
            i = around[t]
            corner = 0
            for c in range(3):
                if triangles[i, c] == y:
                    corner = c
            a = triangles[i, (corner + 1) % 3]
            b = triangles[i, (corner + 2) % 3]
            aa, ab, bb, pa, pb = 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(k):  # all triangles share the corner y, so squared distances compare without the constant
                origin = source_rows[y, j]
                ea = source_rows[a, j] - origin
                eb = source_rows[b, j] - origin
                ep = target_rows[x, j] - origin
                aa += ea * ea
                ab += ea * eb
                bb += eb * eb
                pa += ea * ep
                pb += eb * ep
            u, v, value = _closest_uv(aa, ab, bb, pa, pb)
            if value < best:
                best = value
                triangle[x] = i
                barycentric[x, corner] = 1.0 - u - v
                barycentric[x, (corner + 1) % 3] = u
                barycentric[x, (corner + 2) % 3] = v
