"""Integrated Laplacian and vertex areas of one polygon surface (paper, section 2.1.1).

Sign convention: the stiffness matrix W is positive semi-definite, W 1 = 0, and the eigenproblem reads W phi = lambda M phi.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import sparse

from cagemap.mesh import FloatArray, IndexArray

# A triangle whose doubled area is below this fraction of its longest squared edge is treated as if it had that area:
# its cotangents stay finite, and its energy only shrinks, so W stays positive semi-definite.
SLIVER = 1e-5
# The triangles of both triangulations of a quad.
QUAD_SPLITS = ([0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3])


def triangle_cotangents(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """Cotangents of the three angles of every triangle.

    Parameters
    ----------
    positions : (n, 3) array, length
    triangles : (t, 3) array

    Returns
    -------
    (t, 3) array
        Column i belongs to the angle at corner i. Unitless.
    """
    corners = [positions[triangles[:, i]] for i in range(3)]
    cotangents = np.empty((len(triangles), 3))
    edges = [corners[(i + 2) % 3] - corners[(i + 1) % 3] for i in range(3)]  # edge i is opposite to corner i
    doubled_area = np.linalg.norm(np.cross(edges[0], edges[1]), axis=1)
    longest = np.max([np.einsum("ij,ij->i", edge, edge) for edge in edges], axis=0)
    doubled_area = np.maximum(doubled_area, SLIVER * longest)
    doubled_area[doubled_area == 0.0] = 1.0  # a triangle shrunk to a point carries no energy
    for i in range(3):
        cotangents[:, i] = -np.einsum("ij,ij->i", edges[(i + 1) % 3], edges[(i + 2) % 3]) / doubled_area
    return cotangents


def triangle_areas(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t,) areas of triangles; unit length squared."""
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def stiffness(positions: FloatArray, faces: IndexArray) -> sparse.csr_array:
    """Integrated Laplacian W of a refined surface: cotangents, mean of both triangulations of each quad.

    Parameters
    ----------
    positions : (n, 3) array, length
    faces : (m, 4) or (m, 3) array

    Returns
    -------
    (n, n) CSR array
        Symmetric, positive semi-definite, rows sum to 0. Unitless (invariant to scale).
    """
    n = len(positions)
    corners = faces.shape[1]
    pairs = QUAD_PAIRS if corners == 4 else TRIANGLE_PAIRS
    weights = pair_weights(positions, faces)  # (m, 6) or (m, 3)
    first, second = (faces[:, [pair[end] for pair in pairs]].astype(np.int32).ravel() for end in (0, 1))
    upper = sparse.coo_array((weights.ravel(), (np.minimum(first, second), np.maximum(first, second))), shape=(n, n))
    adjacency = sparse.csr_array(upper)
    adjacency = adjacency + adjacency.T
    return sparse.csr_array(sparse.diags_array(adjacency.sum(axis=1)) - adjacency)


# Corner pairs of a face that its triangulations use as edges: the sides, then both diagonals of a quad.
TRIANGLE_PAIRS = ((1, 2), (2, 0), (0, 1))
QUAD_PAIRS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))


def pair_weights(positions: FloatArray, faces: IndexArray) -> FloatArray:
    """Half cotangent sums of every corner pair of every face, in the order of `QUAD_PAIRS` or `TRIANGLE_PAIRS`.

    Returns
    -------
    (m, 6) or (m, 3) array
        Unitless.
    """
    if faces.shape[1] == 3:
        return 0.5 * triangle_cotangents(positions, faces)
    return np.asarray(_quad_weights(positions, faces))


def pair_weights_reference(positions: FloatArray, faces: IndexArray) -> FloatArray:
    """NumPy twin of the quad kernel of `pair_weights`, which defines it."""
    weights = np.zeros((len(faces), len(QUAD_PAIRS)))
    for split in QUAD_SPLITS:
        cotangents = triangle_cotangents(positions, faces[:, split])
        for i in range(3):  # the angle at corner i faces the edge between the other two
            edge = (split[(i + 1) % 3], split[(i + 2) % 3])
            column = next(c for c, pair in enumerate(QUAD_PAIRS) if set(pair) == set(edge))
            weights[:, column] += 0.25 * cotangents[:, i]
    return weights


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _add_triangle(positions, a, b, c, weights, m, bc, ca, ab):  # type: ignore[no-untyped-def]
    """Add a quarter of the cotangents of one triangle to the pairs facing its corners."""
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
    area = max(np.sqrt(nx * nx + ny * ny + nz * nz), SLIVER * max(uu, vv, uu + vv - 2.0 * uv))
    if area > 0.0:
        weights[m, bc] += 0.25 * uv / area
        weights[m, ca] += 0.25 * (uu - uv) / area
        weights[m, ab] += 0.25 * (vv - uv) / area


@njit(cache=True, error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
def _quad_weights(positions, faces):  # type: ignore[no-untyped-def]
    weights = np.zeros((len(faces), 6))
    for m in range(len(faces)):
        a, b, c, d = faces[m, 0], faces[m, 1], faces[m, 2], faces[m, 3]
        _add_triangle(positions, a, b, c, weights, m, 1, 4, 0)
        _add_triangle(positions, a, c, d, weights, m, 2, 3, 4)
        _add_triangle(positions, a, b, d, weights, m, 5, 3, 0)
        _add_triangle(positions, b, c, d, weights, m, 2, 5, 1)
    return weights


def vertex_areas(positions: FloatArray, faces: IndexArray) -> FloatArray:
    """Diagonal of the mass matrix: a third of the areas of the triangles around each vertex.

    Parameters
    ----------
    positions : (n, 3) array, length
    faces : (m, 4) or (m, 3) array

    Returns
    -------
    (n,) array
        Sums to the surface's area (mean over both triangulations). Unit length squared.
    """
    n = len(positions)
    areas = np.zeros(n)
    for split in QUAD_SPLITS if faces.shape[1] == 4 else ([0, 1, 2],):
        corners = faces[:, split]
        thirds = triangle_areas(positions, corners) / (6.0 if faces.shape[1] == 4 else 3.0)
        for i in range(3):
            areas += np.bincount(corners[:, i], weights=thirds, minlength=n)
    return areas
