"""A triangulated surface at unit area, with normals, areas, neighbours and search tree; and points on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of, mask_of, read_only, real_numbers, whole_numbers
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import TriangleTree, build_tree, closest_points
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
TOLERANCE = 1e-4  # of sums of barycentric coordinates and of negative ones: files may be in single precision


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
        # Not `neighbors`, which would be kept: on a closed surface they are rarely read again.
        triangle, corner = np.nonzero(triangle_neighbors(self.triangles) < 0)
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
    def vertex_triangles(self) -> NDArray[np.int32]:
        """(n,) the last triangle around every vertex; -1 without triangles."""
        last = np.full(self.n, -1, dtype=np.int32)
        # Of repeated indices the last one counts.
        last[self.triangles.ravel()] = np.repeat(np.arange(len(self.triangles), dtype=np.int32), 3)
        return read_only(last)

    @kept
    def tree(self) -> TriangleTree:
        """Search tree for closest points."""
        return build_tree(self.positions, self.triangles)

    def __repr__(self) -> str:
        return f"TriangleSurface({self.n} vertices, {len(self.triangles)} triangles)"


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePoints:
    """Points on one surface, as triangles and barycentric coordinates; ParameterError for invalid shapes or values."""

    surface: TriangleSurface
    triangle: IndexArray  #: (m,) triangle of each point
    barycentric: FloatArray  #: (m, 3) weights of its corners, not negative, rows sum to 1

    def __post_init__(self) -> None:
        triangle = np.ascontiguousarray(whole_numbers(self.triangle, "triangle"))
        barycentric = np.ascontiguousarray(real_numbers(self.barycentric, "barycentric"))
        if triangle.ndim != 1 or barycentric.shape != (len(triangle), 3):
            raise ParameterError(
                f"expected points as triangle (m,) and barycentric (m, 3), got {triangle.shape} and {barycentric.shape}"
            )
        count = len(self.surface.triangles)
        if len(triangle) and not 0 <= triangle.min() <= triangle.max() < count:
            outside = np.flatnonzero((triangle < 0) | (triangle >= count))[:5]
            raise ParameterError(
                f"expected triangles 0 to {count - 1} of the surface, got {triangle[outside]} at points {outside}: "
                "target and source may be exchanged, or the points belong to another level"
            )
        # Comparisons with NaN are false, so that NaN is refused too.
        if len(triangle) and not (
            barycentric.min() >= -TOLERANCE and np.abs(barycentric.sum(axis=1) - 1.0).max() <= TOLERANCE
        ):
            raise ParameterError(
                "expected barycentric coordinates that are finite, not negative and sum to 1 in every row, got numbers "
                f"from {barycentric.min():.4g} to {barycentric.max():.4g} and sums from "
                f"{barycentric.sum(axis=1).min():.4g} to {barycentric.sum(axis=1).max():.4g}"
            )
        object.__setattr__(self, "triangle", read_only(triangle))
        object.__setattr__(self, "barycentric", read_only(barycentric))

    @classmethod
    def from_vertices(cls, surface: TriangleSurface, vertices: ArrayLike) -> SurfacePoints:
        """Points at vertices (m,) of a surface; ParameterError for missing vertices, or vertices without triangle."""
        vertices = whole_numbers(vertices, "vertices")
        bad = vertices[(vertices < 0) | (vertices >= surface.n)]
        if not len(bad):
            triangle = surface.vertex_triangles[vertices].astype(np.int64)
            bad = vertices[triangle < 0]
        if len(bad):
            raise ParameterError(f"expected vertices 0 to {surface.n - 1} that have a triangle, got {bad[:5]}")
        return cls(surface, triangle, (surface.triangles[triangle] == vertices[:, None]).astype(np.float64))

    @classmethod
    def evenly_spread(cls, surface: TriangleSurface, count: int) -> SurfacePoints:
        """``count`` points of equal shares of the area: systematic sampling in the order of the search tree."""
        if count < 1:
            raise ParameterError(f"count: expected 1 point or more, got {count}")
        order = surface.tree.order
        ends = np.cumsum(triangle_areas(surface.positions, surface.triangles).take(order))
        targets = (np.arange(count) + 0.5) * (ends[-1] / count)
        place = np.minimum(np.searchsorted(ends, targets), len(order) - 1)
        triangle = order[place]
        # Position in the triangle: from the remaining area, and from the golden ratio's sequence, which is aperiodic.
        areas = triangle_areas(surface.positions, surface.triangles.take(triangle, axis=0))
        along = np.sqrt(np.clip((ends[place] - targets) / np.maximum(areas, 1e-300), 0.0, 1.0))
        across = np.arange(count) * 0.6180339887498949 % 1.0
        return cls(surface, triangle, np.column_stack([1.0 - along, along * (1.0 - across), along * across]))

    @classmethod
    def from_matrix(cls, surface: TriangleSurface, matrix: sparse.csr_array) -> SurfacePoints:
        """Points from weights (m, n) of up to three vertices of one triangle in every row; else ParameterError."""
        if not sparse.issparse(matrix) and np.ndim(matrix) != 2:
            raise ParameterError(f"matrix: expected one (m, {surface.n}), sparse or dense, got {type(matrix).__name__}")
        rows = sparse.csr_array(matrix, copy=True)
        rows.sum_duplicates()
        counts = np.diff(rows.indptr)
        if rows.shape[1] != surface.n or not np.all((counts >= 1) & (counts <= 3)):
            raise ParameterError(
                f"expected rows of 1 to 3 weights of {surface.n} vertices, got a matrix {rows.shape} with rows of "
                f"{counts.min(initial=0)} to {counts.max(initial=0)}"
            )
        # The vertices with weights in a row belong to one triangle, which contains the row's point.
        around = sparse.csr_array(
            (np.ones(surface.triangles.size), (surface.triangles.ravel(), np.arange(surface.triangles.size) // 3)),
            shape=(surface.n, len(surface.triangles)),
        )
        ones = sparse.csr_array((np.ones(rows.nnz), rows.indices, rows.indptr), shape=rows.shape)
        shared = sparse.csr_array(ones @ around)
        full = shared.data == np.repeat(counts, np.diff(shared.indptr))
        triangle = np.full(rows.shape[0], -1, dtype=np.int64)
        triangle[np.repeat(np.arange(rows.shape[0]), np.diff(shared.indptr))[full]] = shared.indices[full]
        if np.any(triangle < 0):
            bad = np.flatnonzero(triangle < 0)[:5]
            raise ParameterError(
                f"matrix: expected every row to have vertices of one triangle, not so in rows {bad}. "
                "Give a map to points of the surface."
            )
        weights = rows[np.arange(len(triangle))[:, None], surface.triangles[triangle]]
        return cls(surface, triangle, sparse.csr_array(weights).toarray())

    @classmethod
    def nearest(
        cls,
        surface: TriangleSurface,
        points: FloatArray,
        normals: FloatArray | None = None,
        *,
        normal_weight: float = 0.0,
        guess: IndexArray | None = None,
    ) -> SurfacePoints:
        """Closest surface points to points (m, 3) at unit area; options as `closest_points`.

        ParameterError if the points are not finite or not (m, 3), or normals or guess do not fit them.
        """
        points = real_numbers(points, "points")
        if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
            raise ParameterError(f"points: expected finite places (m, 3), got {points.shape}: {points.ravel()[:3]} ...")
        normals = None if normals is None else real_numbers(normals, "normals")
        guess = None if guess is None else whole_numbers(guess, "guess")
        for name, given, shape in (("normals", normals, points.shape), ("guess", guess, points.shape[:1])):
            if given is not None and given.shape != shape:
                raise ParameterError(f"{name}: expected one for each point, {shape}, got {given.shape}")
        count = len(surface.triangles)
        if guess is not None and guess.max(initial=-1) >= count:
            raise ParameterError(f"guess: expected triangles 0 to {count - 1} of the surface, got {guess.max()}")
        triangle, barycentric, _ = closest_points(
            surface.tree, points, normals, normal_weight=normal_weight, guess=guess
        )
        return cls(surface, triangle, barycentric)

    def __len__(self) -> int:
        return len(self.triangle)

    @property
    def corners(self) -> IndexArray:
        """(m, 3) vertices of every point's triangle."""
        return self.surface.triangles.take(self.triangle, axis=0)

    @property
    def heaviest_corners(self) -> IndexArray:
        """(m,) vertex of largest weight."""
        return np.take_along_axis(self.corners, self.barycentric.argmax(axis=1)[:, None], axis=1)[:, 0]

    @property
    def vertices(self) -> IndexArray:
        """(m,) vertex of every point, -1 for points between vertices."""
        return np.where(self.barycentric.max(axis=1) == 1.0, self.heaviest_corners, -1).astype(np.int64)

    @kept
    def positions(self) -> FloatArray:
        """(m, 3) positions in space, at unit area."""
        return read_only(self.interpolate(self.surface.positions))

    @kept
    def normals(self) -> FloatArray:
        """(m, 3) unit normals of every point's triangle."""
        return read_only(self.surface.normals_of(self.triangle))

    @property
    def at_boundary(self) -> NDArray[np.bool_]:
        """(m,) whether a point is on the boundary."""
        return self.surface.at_boundary(self.triangle, self.barycentric)

    def interpolate(self, values: FloatArray) -> FloatArray:
        """(m,) or (m, q) values at the points, linear between vertices' (n,) or (n, q); ParameterError for others."""
        values = array_of(values)
        values = values if values.dtype.kind in "biuf" else real_numbers(values, "values")
        if values.ndim == 0 or len(values) != self.surface.n:
            raise ParameterError(
                f"expected a value for each of the {self.surface.n} vertices of the surface that the points lie on, "
                f"got an array {values.shape}: do they belong to the other surface, or to another level?"
            )
        columns = values.reshape(len(values), -1).astype(np.float64, copy=False)
        return np.asarray(self.matrix() @ columns).reshape(len(self), *values.shape[1:])

    def matrix(self) -> sparse.csr_array:
        """(m, n) matrix of `interpolate`; rows sum to 1."""
        starts = np.arange(0, 3 * len(self) + 1, 3)
        weights = self.barycentric.flatten()
        return sparse.csr_array((weights, self.corners.ravel(), starts), shape=(len(self), self.surface.n))

    def at(self, rows: IndexArray | slice) -> SurfacePoints:
        """The points in the given rows."""
        return SurfacePoints(self.surface, self.triangle[rows], self.barycentric[rows])

    def replaced(self, rows: IndexArray, others: SurfacePoints) -> SurfacePoints:
        """The points with ``others`` in the given rows; ParameterError if those are on another surface."""
        if not self.surface.equals(others.surface):
            raise ParameterError(f"expected points of {self.surface}, got points of another surface, {others.surface}")
        triangle, barycentric = self.triangle.copy(), self.barycentric.copy()
        triangle[rows], barycentric[rows] = others.triangle, others.barycentric
        result = SurfacePoints(self.surface, triangle, barycentric)
        for name in vars(self).keys() & {"positions", "normals"}:  # cached already
            values = getattr(self, name).copy()
            values[rows] = getattr(others, name)
            vars(result)[name] = read_only(values)
        return result

    def __repr__(self) -> str:
        return f"SurfacePoints({len(self)} of {self.surface})"


def nearest_facing(
    surface: TriangleSurface, points: FloatArray, normals: FloatArray, within: float, guess: IndexArray | None = None
) -> tuple[SurfacePoints, FloatArray]:
    """Nearest points within a distance on triangles facing along normals, else of all triangles; distances (m,)."""
    triangle, barycentric, distance = closest_points(
        surface.tree, points, normals, minimum_cosine=0.0, guess=guess, within=within
    )
    rest = np.flatnonzero(triangle < 0)
    if len(rest):
        triangle[rest], barycentric[rest], distance[rest] = closest_points(surface.tree, points[rest])
    return SurfacePoints(surface, triangle, barycentric), distance
