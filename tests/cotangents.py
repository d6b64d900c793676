"""Cotangents of triangles in NumPy: a part of the slow twin of the operators' kernel."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.operators.laplacian import SLIVER


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
