"""Integrated Laplacian and vertex areas of one polygon surface (paper, section 2.1.1).

Sign convention: the stiffness matrix W is positive semi-definite, W 1 = 0, and the eigenproblem reads W phi = lambda M phi.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.mesh import FloatArray, IndexArray

# A triangle whose doubled area is below this fraction of its longest squared edge is treated as if it had that area:
# its cotangents stay finite, and its energy only shrinks, so W stays positive semi-definite.
SLIVER = 1e-5


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


def both_triangulations(faces: IndexArray) -> tuple[IndexArray, float]:
    """Triangles whose mean stands for a face, and the weight of each.

    A quad is the mean of its two triangulations, so that neither diagonal is preferred: four triangles of weight 1/2.

    Parameters
    ----------
    faces : (m, 4) or (m, 3) array

    Returns
    -------
    triangles : (4 m, 3) or (m, 3) array
    weight : float
    """
    if faces.shape[1] == 3:
        return faces, 1.0
    splits = ([0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3])
    return np.concatenate([faces[:, split] for split in splits]), 0.5


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
    triangles, weight = both_triangulations(faces)
    halves = 0.5 * weight * triangle_cotangents(positions, triangles)  # (t, 3)
    first = np.concatenate([triangles[:, 1], triangles[:, 2], triangles[:, 0]])
    second = np.concatenate([triangles[:, 2], triangles[:, 0], triangles[:, 1]])
    values = halves.T.ravel()  # weight of the edge opposite to corner 0, 1, 2
    low = np.minimum(first, second).astype(np.int32)
    high = np.maximum(first, second).astype(np.int32)
    upper = sparse.coo_array((values, (low, high)), shape=(n, n)).tocsr()
    adjacency = upper + upper.T
    return sparse.csr_array(sparse.diags_array(adjacency.sum(axis=1)) - adjacency)


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
    triangles, weight = both_triangulations(faces)
    thirds = np.repeat(weight / 3.0 * triangle_areas(positions, triangles), 3)
    return np.bincount(triangles.ravel(), weights=thirds, minlength=len(positions))
