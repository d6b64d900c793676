"""The point map T12: target vertices -> points of the source surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class PointMap:
    """For every target vertex a point of the source: a triangle and barycentric coordinates in it.

    Attributes
    ----------
    triangle : (n1,) int64
        Source triangle, in the numbering of `cagemap.refinement.triangles`.
    barycentric : (n1, 3) float64
        Weights of the triangle's corners, not negative, rows sum to 1.
    """

    triangle: IndexArray
    barycentric: FloatArray

    def pull_back(self, source_triangles: IndexArray, values: FloatArray) -> FloatArray:
        """Pull a function back from source to target, (P12 g2)(v) = g2(T12(v)).

        Parameters
        ----------
        source_triangles : (t2, 3) array
        values : (n2,) or (n2, q) array
            One value, or a row of values, for every source vertex.

        Returns
        -------
        (n1,) or (n1, q) array

        Raises
        ------
        ParameterError
            If the values do not cover the triangles' vertices.
        """
        if len(values) <= source_triangles.max():
            raise ParameterError(
                f"expected a value for each source vertex (at least {source_triangles.max() + 1}), got {len(values)}; "
                "values are pulled back from source to target: are they those of the target?"
            )
        corners = source_triangles[self.triangle]
        result = self.barycentric[:, 0, *(None,) * (values.ndim - 1)] * values[corners[:, 0]]
        for i in (1, 2):
            result += self.barycentric[:, i, *(None,) * (values.ndim - 1)] * values[corners[:, i]]
        return np.asarray(result)

    def matrix(self, source_triangles: IndexArray, n_source: int) -> sparse.csr_array:
        """P12, the (n1, n2) matrix that pulls functions back; rows sum to 1."""
        n = len(self.triangle)
        indptr = np.arange(0, 3 * n + 1, 3)
        indices = source_triangles[self.triangle].ravel()
        return sparse.csr_array((self.barycentric.ravel(), indices, indptr), shape=(n, n_source))
