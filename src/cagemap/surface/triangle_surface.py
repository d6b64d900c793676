"""A triangulated surface at unit area, with its normals, areas, neighbours and search tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, mask_of, read_only
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import TriangleTree, build_tree
from cagemap.surface.triangles import (
    corner_sums,
    mesh_arrays,
    normalize_rows,
    surface_area,
    triangle_areas,
    triangle_neighbors,
    triangle_normals,
    triangles,
    vertex_normals,
)

ON_EDGE = 1e-9  # barycentric coordinates up to this count as 0: the point is on an edge


@dataclass(frozen=True, eq=False, repr=False)
class TriangleSurface:
    """A triangulated surface, scaled to unit area.

    Arrays are read-only. Derived arrays (`areas`, `normals`, `tree`, ...) are computed when first read, and cached.
    """

    positions: FloatArray  #: (n, 3) in units of sqrt(area) of the whole; coarse levels keep the finest one's unit
    triangles: IndexArray  #: (t, 3) vertices of every triangle, counter-clockwise seen from outside
    scale: float = 1.0  #: factor from the file's own lengths to those of ``positions``

    def __post_init__(self) -> None:
        positions, triangles = mesh_arrays(self.positions, self.triangles, corners=(3,))
        object.__setattr__(self, "positions", read_only(positions))
        object.__setattr__(self, "triangles", read_only(triangles))

    @classmethod
    def from_faces(cls, positions: FloatArray, faces: IndexArray) -> TriangleSurface:
        """Surface of faces (m, 4) or (m, 3) in any unit, scaled to unit area and split by `triangles`.

        ParameterError if the arrays are no mesh, the surface has no area, or a position is not finite.
        """
        positions, faces = mesh_arrays(positions, faces)
        area = surface_area(positions, faces)
        if not 0.0 < area < np.inf:
            raise ParameterError(f"expected a surface of finite, positive area, got {area}: check its positions")
        scale = 1.0 / float(np.sqrt(area))
        return cls(scale * positions, triangles(faces), scale)

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.positions)

    def equals(self, other: TriangleSurface) -> bool:
        """Whether another surface has the same triangles at the same positions, as copies and pickles of it have."""
        if self is other or self.n != other.n or not np.array_equal(self.triangles, other.triangles):
            return self is other
        return np.allclose(self.positions, other.positions)

    @kept
    def areas(self) -> FloatArray:
        """(t,) areas of the triangles."""
        return read_only(triangle_areas(self.positions, self.triangles))

    @kept
    def normals(self) -> FloatArray:
        """(t, 3) unit normals of the triangles, zero where degenerate."""
        return read_only(normalize_rows(triangle_normals(self.positions, self.triangles)))

    def normals_of(self, triangles: IndexArray) -> FloatArray:
        """(m, 3) unit normals of some triangles (m,); unlike `normals` nothing is kept for all."""
        return normalize_rows(triangle_normals(self.positions, self.triangles.take(triangles, axis=0)))

    @kept
    def vertex_normals(self) -> FloatArray:
        """(n, 3) unit normals of the vertices, area-weighted means of their triangles'."""
        return read_only(vertex_normals(self.positions, self.triangles))

    @kept
    def vertex_areas(self) -> FloatArray:
        """(n,) a third of the areas of the triangles around every vertex; sum 1."""
        # Summed in the order of `cagemap.operators.vertex_areas`: the same numbers to the last bit.
        x, y, z = triangle_normals(self.positions, self.triangles).T
        areas = corner_sums(self.triangles, (np.sqrt(x * x + y * y + z * z) / 6.0)[:, None], self.n)[:, 0]
        return read_only(areas / areas.sum())

    @kept
    def neighbors(self) -> NDArray[np.int32]:
        """(t, 3) triangle across the edge opposite to every corner, -1 on the boundary."""
        return read_only(triangle_neighbors(self.triangles))

    @kept
    def boundary_vertices(self) -> NDArray[np.bool_]:
        """(n,) whether a vertex is on the boundary."""
        triangle, corner = np.nonzero(self.neighbors < 0)
        ends = [self.triangles[triangle, (corner + step) % 3] for step in (1, 2)]
        return read_only(mask_of(np.concatenate(ends), self.n))

    @property
    def is_open(self) -> bool:
        """Whether the surface has a boundary."""
        return bool(self.boundary_vertices.any())

    def at_boundary(self, triangle: IndexArray, barycentric: FloatArray) -> NDArray[np.bool_]:
        """(m,) whether a point is on the boundary; closest points there have no counterpart (Turk and Levoy 1994)."""
        if not self.is_open:
            return np.zeros(len(triangle), dtype=np.bool_)
        on_edge = (barycentric <= ON_EDGE) & (self.neighbors[triangle] < 0)
        at_vertex = (barycentric >= 1.0 - ON_EDGE) & self.boundary_vertices[self.triangles[triangle]]
        return np.asarray((on_edge | at_vertex).any(axis=1))

    @kept
    def vertex_triangles(self) -> IndexArray:
        """(n,) the last triangle around every vertex; -1 without triangles."""
        last = np.full(self.n, -1, dtype=np.int64)
        last[self.triangles.ravel()] = np.arange(self.triangles.size) // 3  # of repeated indices the last one counts
        return read_only(last)

    @kept
    def tree(self) -> TriangleTree:
        """Search tree for closest points."""
        return build_tree(self.positions, self.triangles)

    def __repr__(self) -> str:
        return f"TriangleSurface({self.n} vertices, {len(self.triangles)} triangles)"
