"""Search a fine level block by block, so that the dense n_f x k embedding never exists.

A fine row of the basis is a short combination of coarse rows; a block's rows are formed when its turn comes. Memory is
that of the coarse rows and of one block, whatever the finest level's size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.products import multiply
from cagemap.spectral.nearest import Embedding, nearest_candidates
from cagemap.spectral.surface import Surface
from cagemap.spectral.vertex_to_point import vertex_to_point, vertex_triangles

# Target vertices of one block: at 300 functions some 40 MB of rows on either side.
BLOCK = 32_768


@dataclass(frozen=True, eq=False)
class SpectralRows:
    """Rows of a spectral embedding at one level, formed on demand.

    Attributes
    ----------
    prolongation : (n, n_b) CSR array or None
        S^{l,b} from the finest level b that has a band; None where the rows are those of the level itself.
    values : (n_b, k) array
        The embedding at level b.
    """

    prolongation: sparse.csr_array | None
    values: FloatArray

    def at(self, vertices: IndexArray) -> Embedding:
        """(q, k) float32 rows of some vertices."""
        if self.prolongation is None:
            return self.values[vertices].astype(np.float32)
        return multiply(sparse.csr_array(self.prolongation[vertices]), self.values).astype(np.float32)


def spectral_rows(surface: Surface, level: int, functions: int, mixing: FloatArray | None = None) -> SpectralRows:
    """Embedding rows of a level: Phi~(x, :) of the leading functions, times `mixing` (such as C12^T) if given."""
    base = min(level, max(i for i, count in enumerate(surface.basis.schedule) if count > 0))
    values = functions_at(surface, base, functions)
    values = values if mixing is None else values @ mixing
    return SpectralRows(surface.hierarchy.product(level, base) if level > base else None, np.ascontiguousarray(values))


def functions_at(surface: Surface, level: int, functions: int) -> FloatArray:
    """Phi~(x, :) of the leading functions at all vertices of a level; (n_level, functions).

    Where the level does not have as many, they are taken at its vertices on the last level that adds some.
    """
    basis = surface.basis
    if functions <= basis.size(level):
        return basis.at(level)[:, :functions]
    return basis.rows(basis.last_level, surface.hierarchy.vertices_on(basis.last_level, level))[:, :functions]


def blocks(surface: Surface, level: int) -> Iterator[IndexArray]:
    """Vertices of a level in blocks that are coherent on the surface: ordered by control face."""
    mesh = surface.hierarchy.levels[level]
    if mesh.faces is None:
        order = np.arange(mesh.n_vertices)
    else:
        control_face = np.empty(mesh.n_vertices, dtype=np.int64)
        control_face[mesh.faces] = mesh.face_parents[:, None]
        order = np.argsort(control_face, kind="stable")
    for start in range(0, len(order), BLOCK):
        yield order[start : start + BLOCK]


def search_candidates(
    target: SpectralRows,
    source: SpectralRows,
    order: Iterator[IndexArray],
    parents: sparse.csr_array,
    children: sparse.csc_array,
    coarse_match: IndexArray,
) -> IndexArray:
    """`nearest_candidates` for a whole level, block by block; (n1,) source vertices."""
    match = np.empty(parents.shape[0], dtype=np.int64)
    local = np.full(children.shape[0], -1, dtype=children.indices.dtype)
    for block in order:
        of_block = sparse.csr_array(parents[block])
        coarse = np.unique(coarse_match[of_block.indices])
        candidates = np.unique(children[:, coarse].indices).astype(np.int64)
        local[candidates] = np.arange(len(candidates))
        renamed = sparse.csc_array((children.data, local[children.indices], children.indptr), shape=children.shape)
        nearest = nearest_candidates(target.at(block), source.at(candidates), of_block, renamed, coarse_match)
        match[block] = candidates[nearest]
    return match


def recover_in_blocks(
    target: SpectralRows,
    source: SpectralRows,
    order: Iterator[IndexArray],
    source_triangles: IndexArray,
    match: IndexArray,
) -> tuple[IndexArray, FloatArray]:
    """`vertex_to_point` for a whole level, block by block: triangles (n1,) and barycentric coordinates (n1, 3)."""
    triangle = np.empty(len(match), dtype=np.int64)
    barycentric = np.empty((len(match), 3))
    starts, around = vertex_triangles(source_triangles, int(source_triangles.max()) + 1)
    local = np.full(len(starts) - 1, -1, dtype=np.int64)
    for block in order:
        centres = np.unique(match[block])
        counts = starts[centres + 1] - starts[centres]
        offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        near = np.unique(around[np.repeat(starts[centres], counts) + offsets])
        corners = np.unique(source_triangles[near])
        local[corners] = np.arange(len(corners))
        faces = local[source_triangles[near]]
        fans = vertex_triangles(faces, len(corners))
        found = vertex_to_point(target.at(block), source.at(corners), faces, fans, local[match[block]])
        triangle[block], barycentric[block] = near[found[0]], found[1]
    return triangle, barycentric
