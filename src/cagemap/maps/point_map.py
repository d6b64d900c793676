"""The point map T12: target vertices -> points of the source surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers, whole_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface


@dataclass(frozen=True, eq=False, repr=False)
class PointMap:
    """A point of the source for every target vertex."""

    target: TriangleSurface
    images: SurfacePoints  #: points of the source, one for each vertex of the target; else ParameterError

    def __post_init__(self) -> None:
        if len(self.images) != self.target.n:
            raise ParameterError(
                f"expected a map of {self.target.n} target vertices, got {len(self.images)} points: target and source "
                "may be exchanged, or the map belongs to another level"
            )

    @classmethod
    @kinds_checked
    def from_arrays(
        cls, target: TriangleSurface, source: TriangleSurface, triangle: ArrayLike, barycentric: ArrayLike
    ) -> PointMap:
        """A map given as a source triangle (n1,) and barycentric coordinates (n1, 3) for each target vertex."""
        copies = np.array(whole_numbers(triangle, "triangle")), np.array(real_numbers(barycentric, "barycentric"))
        return cls(target, SurfacePoints(source, *copies))

    @classmethod
    @kinds_checked
    def from_vertices(cls, target: TriangleSurface, source: TriangleSurface, vertices: ArrayLike) -> PointMap:
        """A map given as a source vertex (n1,) for each target vertex."""
        return cls(target, SurfacePoints.from_vertices(source, vertices))

    @classmethod
    @kinds_checked
    def from_matrix(cls, target: TriangleSurface, source: TriangleSurface, matrix: sparse.csr_array) -> PointMap:
        """A map given as P12 (n1, n2), each row the corner weights of one source triangle."""
        return cls(target, SurfacePoints.from_matrix(source, matrix))

    @property
    def source(self) -> TriangleSurface:
        """The surface that the images lie on."""
        return self.images.surface

    @property
    def triangle(self) -> IndexArray:
        """(n1,) source triangle of every target vertex."""
        return self.images.triangle

    @property
    def barycentric(self) -> FloatArray:
        """(n1, 3) weights of the triangle's corners, not negative, rows sum to 1."""
        return self.images.barycentric

    def pull_back(self, values: FloatArray) -> FloatArray:
        """Pull a function back from source to target, (P12 g2)(v) = g2(T12(v)).

        Values (n2,) or (n2, q) of the source's vertices give (n1,) or (n1, q); ParameterError for others.
        """
        return self.images.interpolate(values)

    def to_sparse(self) -> sparse.csr_array:
        """P12, the (n1, n2) matrix that pulls functions back; rows sum to 1."""
        return self.images.matrix()

    def nearest_vertices(self) -> IndexArray:
        """(n1,) nearest corner of the source triangle that contains the image."""
        corners = self.images.corners
        away = np.linalg.norm(self.source.positions[corners] - self.images.positions[:, None], axis=2)
        return np.asarray(corners[np.arange(len(corners)), away.argmin(axis=1)])

    def __repr__(self) -> str:
        return f"PointMap({self.target.n} vertices -> {self.source})"
