"""Integrated Laplacian and vertex areas of one polygon surface (paper, section 2.1.1).

Sign convention: the stiffness matrix W is positive semi-definite, W 1 = 0, and the eigenproblem reads
W phi = lambda M phi.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import sparse

from cagemap.numerics.arrays import FloatArray, IndexArray, read_only

# Least doubled area of a triangle, as a share of its longest squared edge: smaller ones get this area, so that
# cotangents stay finite. Their energy only shrinks, so that W stays positive semi-definite.
SLIVER = 1e-5


def stiffness(positions: FloatArray, faces: IndexArray) -> sparse.csr_array:
    """Integrated Laplacian W (n, n): cotangents, mean of both triangulations of each quad (m, 4).

    Symmetric, positive semi-definite, rows sum to 0. Unitless (invariant to scale).
    """
    return gathered(face_terms(positions, faces)[0], faces, len(positions))


def vertex_areas(positions: FloatArray, faces: IndexArray) -> FloatArray:
    """(n,) diagonal of the mass matrix: a third of the areas of the triangles around each vertex.

    Sums to the area of faces (m, 4) or (m, 3), for quads the mean over both triangulations. Unit length squared.
    """
    return face_terms(positions, faces)[1]


def gathered(weights: FloatArray, faces: IndexArray, n: int) -> sparse.csr_array:
    """Stiffness matrix (n, n) from the weights of every face's pairs of corners (`face_terms`)."""
    size = faces.shape[1]
    pairs = QUAD_PAIRS if size == 4 else TRIANGLE_PAIRS
    rows, columns = (faces[:, side].ravel().astype(np.int32) for side in np.transpose(pairs))
    sums = sparse.csr_array(sparse.coo_array((weights.ravel(), (rows, columns)), shape=(n, n)))
    of_corner = [[k for j in range(size) for k, pair in enumerate(pairs) if {i, j} == {*pair}] for i in range(size)]
    diagonal = np.bincount(np.repeat(faces.ravel(), size - 1), weights[:, of_corner].ravel(), minlength=n)
    return sparse.csr_array(sparse.diags_array(diagonal) - sparse.csr_array(sums + sums.T))


# Corner pairs that are edges of a face's triangulations: sides, then both diagonals of a quad.
TRIANGLE_PAIRS = ((1, 2), (2, 0), (0, 1))
QUAD_PAIRS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))


def face_terms(positions: FloatArray, faces: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Half cotangent sums of every face's corner pairs, (m, 6) or (m, 3), and `vertex_areas`.

    Pairs stand in the order of `QUAD_PAIRS` or `TRIANGLE_PAIRS`; weights are means of both triangulations of a quad.
    """
    quads = faces.shape[1] == 4
    weights, areas = np.zeros((len(faces), 6 if quads else 3)), np.zeros(len(positions))
    table, share = (QUAD_TABLE, 0.5) if quads else (TRIANGLE_TABLE, 1.0)
    contiguous = read_only(np.ascontiguousarray(positions, dtype=np.float64)), read_only(np.ascontiguousarray(faces))
    _face_terms(*contiguous, table, share, weights, areas)
    return weights, areas


# Of every triangle of a face's triangulations: its corners a, b, c, and the columns of the pairs bc, ca, ab.
TRIANGLE_TABLE = np.array([[0, 1, 2, 0, 1, 2]])
QUAD_TABLE = np.array([[0, 1, 2, 1, 4, 0], [0, 2, 3, 2, 3, 4], [0, 1, 3, 5, 3, 0], [1, 2, 3, 2, 5, 1]])


@njit(cache=True, error_model="numpy", nogil=True)
def _face_terms(positions, faces, table, share, weights, areas):  # type: ignore[no-untyped-def]
    """Add the half cotangents of every triangle to the pairs facing its corners, its area to the corners."""
    for m in range(len(faces)):
        for t in range(len(table)):
            a, b, c = faces[m, table[t, 0]], faces[m, table[t, 1]], faces[m, table[t, 2]]
            ux = positions[b, 0] - positions[a, 0]
            uy = positions[b, 1] - positions[a, 1]
            uz = positions[b, 2] - positions[a, 2]
            vx = positions[c, 0] - positions[a, 0]
            vy = positions[c, 1] - positions[a, 1]
            vz = positions[c, 2] - positions[a, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            uu = ux * ux + uy * uy + uz * uz
            vv = vx * vx + vy * vy + vz * vz
            uv = ux * vx + uy * vy + uz * vz
            doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
            third = share * doubled / 6.0
            areas[a] += third
            areas[b] += third
            areas[c] += third
            doubled = max(doubled, SLIVER * max(uu, vv, uu + vv - 2.0 * uv))
            if doubled > 0.0:
                half = 0.5 * share / doubled
                weights[m, table[t, 3]] += half * uv
                weights[m, table[t, 4]] += half * (uu - uv)
                weights[m, table[t, 5]] += half * (vv - uv)
