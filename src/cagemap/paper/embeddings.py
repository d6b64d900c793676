"""Nearest rows of two embeddings on fine levels, block by block (paper, section 5.4).

A fine basis row is a sparse combination of coarse rows and is computed block by block: the dense n x k embedding is
never stored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, joined_runs
from cagemap.numerics.sparse_algebra import multiply
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import Embedding

TARGET_BLOCK = 1024  # target vertices per block: about 40 candidates of 150 functions each take 25 MB
PARENT_SHARE = 0.5  # least weight of a parent in S_1^l, relative to the row's largest
MIN_DETERMINANT = 1e-12  # triangles with a squared area below this share of their squared sides are degenerate

Rows = Callable[[IndexArray], Embedding]  # gives rows (q, k) of an embedding at vertices (q,)


def spectral_rows(surface: Surface, level: int, functions: int, mixing: FloatArray | None = None) -> Rows:
    """Function for rows of a level: Phi~(x, :) of leading functions, times ``mixing`` (such as C12^T)."""
    base = min(level, surface.basis.last_level)
    values = functions_at(surface, base, functions)
    values = np.ascontiguousarray(values if mixing is None else values @ mixing)
    if level == base:
        return lambda vertices: values[vertices].astype(np.float32)
    return lambda vertices: multiply(surface.hierarchy.rows(vertices, level, base), values).astype(np.float32)


def functions_at(surface: Surface, level: int, functions: int) -> FloatArray:
    """(n_level, functions) Phi~ at all vertices of a level; functions of finer bands are sampled there."""
    basis = surface.basis
    if functions <= basis.size(level):
        return basis.at(level)[:, :functions]
    return surface.basis_rows(slice(None), level)[:, :functions]


def vertex_blocks(surface: Surface, level: int) -> list[IndexArray]:
    """Blocks of a level's vertices, ordered by control face to be near each other."""
    mesh = surface.hierarchy.levels[level]
    control_face = np.zeros(mesh.n_vertices, dtype=np.int64)
    if mesh.faces is not None:
        control_face[mesh.faces] = mesh.face_parents[:, None]
    order = np.argsort(control_face, kind="stable")
    return [order[part] for part in row_slices(len(order), TARGET_BLOCK)]


def strongest_parents(subdivision: sparse.csr_array) -> sparse.csr_array:
    """(n_{l+1}, n_l) entries of S_1^l of at least `PARENT_SHARE` of their row's largest."""
    largest = subdivision.max(axis=1).toarray().ravel()
    rows = np.repeat(np.arange(subdivision.shape[0]), np.diff(subdivision.indptr))
    kept = subdivision.data >= PARENT_SHARE * largest[rows]
    places = rows[kept], subdivision.indices[kept]
    return sparse.csr_array(sparse.coo_array((subdivision.data[kept], places), shape=subdivision.shape))


def nearest_candidates(
    target: Rows,
    source: Rows,
    in_blocks: Sequence[IndexArray],
    parents: sparse.csr_array,
    children: sparse.csr_array,
    coarse_match: IndexArray,
) -> IndexArray:
    """(n1,) nearest of every target vertex's candidate source vertices (paper, Fig. 9).

    Candidates are nonzeros of ``children`` (n2, n2_l), usually S_2^l, in the columns of the matches (n1_l,) of the
    vertex's ``parents`` (n1, n1_l), see `strongest_parents`. ParameterError if a vertex has no candidate at a finite
    distance.
    """
    match = np.empty(parents.shape[0], dtype=np.int64)
    matched = sparse.csr_array(
        (np.ones(len(coarse_match)), coarse_match, np.arange(len(coarse_match) + 1)),
        shape=(len(coarse_match), children.shape[1]),
    )
    offered = sparse.csr_array(matched @ _pattern(children).T)

    def search(block: IndexArray) -> None:
        near = sparse.csr_array(_pattern(parents[block]) @ offered)
        near.sort_indices()
        vertices, local = np.unique(near.indices.astype(np.int64), return_inverse=True)
        row = np.repeat(np.arange(len(block)), np.diff(near.indptr))
        difference: Embedding = target(block)[row] - source(vertices)[local]
        distances = np.einsum("ck,ck->c", difference, difference, dtype=np.float64)
        match[block] = near.indices[_least(distances, near.indptr.astype(np.int64))]

    in_threads(search, in_blocks)
    return match


def vertex_to_point(
    target: Rows, source: Rows, in_blocks: Sequence[IndexArray], triangles: IndexArray, match: IndexArray
) -> tuple[IndexArray, FloatArray]:
    """Nearest point of the embedded source triangles (t2, 3) around every target vertex's match (n1,).

    Returns triangles (n1,) and barycentric coordinates (n1, 3). ParameterError if no triangle around a match is at a
    finite distance.
    """
    triangle, barycentric = np.empty(len(match), dtype=np.int64), np.empty((len(match), 3))
    order = np.argsort(triangles.ravel(), kind="stable")
    starts = np.searchsorted(triangles.ravel()[order], np.arange(int(triangles.max(initial=-1)) + 2))

    def project(block: IndexArray) -> None:
        counts = np.diff(starts)[match[block]]
        row = np.repeat(np.arange(len(block)), counts)
        ends, around = joined_runs(starts[match[block]], counts)
        corner = order[around]  # of each triangle, at the match
        turned = (corner[:, None] + np.arange(3)) % 3
        vertices, local = np.unique(np.take_along_axis(triangles[corner // 3], turned, 1), return_inverse=True)
        embedded = source(vertices)[local.reshape(-1, 3)]
        weights, value = _closest_in_triangles(embedded[:, 1:] - embedded[:, :1], target(block)[row] - embedded[:, 0])
        chosen = _least(value, ends)
        triangle[block] = corner[chosen] // 3
        coordinates = np.empty((len(block), 3))
        np.put_along_axis(coordinates, turned[chosen], weights[chosen], axis=1)
        barycentric[block] = coordinates

    in_threads(project, in_blocks)
    return triangle, barycentric


def _closest_in_triangles(edges: Embedding, point: Embedding) -> tuple[FloatArray, FloatArray]:
    """Barycentric coordinates (c, 3) of closest points of triangles, and squared distances minus |p|^2.

    Edges (c, 2, k) and points p (c, k) are relative to the first corner.
    """
    (aa, ab), (_, bb) = np.einsum("cik,cjk->ijc", edges, edges, dtype=np.float64)
    pa, pb = np.einsum("cik,ck->ic", edges, point, dtype=np.float64)
    determinant = aa * bb - ab * ab
    solid = determinant > MIN_DETERMINANT * aa * bb
    determinant = np.where(solid, determinant, 1.0)
    u, v = (bb * pa - ab * pb) / determinant, (aa * pb - ab * pa) / determinant
    inside = solid & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)

    def along(dot: FloatArray, square: FloatArray) -> FloatArray:
        return np.clip(dot / np.maximum(square, 1e-300), 0.0, 1.0)

    s, none = along(aa - ab - pa + pb, aa - 2.0 * ab + bb), np.zeros(len(aa))
    us, vs = np.stack([u, along(pa, aa), none, 1.0 - s]), np.stack([v, none, along(pb, bb), s])
    value = us**2 * aa + 2.0 * us * vs * ab + vs**2 * bb - 2.0 * (us * pa + vs * pb)
    best = np.where(inside, 0, 1 + np.argmin(value[1:], axis=0))[None]
    u, v, value = (np.take_along_axis(values, best, axis=0)[0] for values in (us, vs, value))
    return np.stack([np.maximum(1.0 - u - v, 0.0), u, v], axis=1), value


def _least(values: FloatArray, starts: IndexArray) -> IndexArray:
    """(q,) index of the least value of every run, given by ``starts`` (q + 1,); the first of equal ones."""
    row = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    order = np.lexsort((values, row))  # NaN comes last
    if np.any(np.diff(starts) == 0) or not np.isfinite(values[order[starts[:-1]]]).all():
        raise ParameterError(
            "point map: nothing was found for some target vertices: the basis functions or the functional map are not "
            "finite, or a source vertex belongs to no triangle. Check both meshes with `cagemap check`"
        )
    return np.asarray(order[starts[:-1]])


def _pattern(matrix: sparse.csr_array) -> sparse.csr_array:
    """The matrix with all entries 1."""
    return sparse.csr_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), shape=matrix.shape)
