"""A model in the view: its refined surface, and points under the mouse."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal
from cagemap.numerics.threads import kept
from cagemap.pictures import UP_AXES
from cagemap.subdivision import Refinement, level_triangles, triangles
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_frames, vertex_normals

SLACK = 1e-9  # relative rounding: without it a ray through a vertex may miss all of its triangles


@dataclass(frozen=True, eq=False)
class OriginalMesh:
    """The file's mesh, if the control mesh is welded, cleaned or a part of it."""

    mesh: ControlMesh
    vertex_of: IndexArray  # (n,) control vertex of each of the file's vertices, -1 for those left out


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one subdivision level."""

    control: ControlMesh
    positions: FloatArray  # (n, 3) in file units; the first rows are the control vertices' points
    normals: FloatArray  # (n, 3) unit normals
    triangles: IndexArray  # (t, 3) numbered as in point maps
    uvs: FloatArray | None  # (p, 2)
    uv_triangles: IndexArray | None  # (t, 3)
    faces: IndexArray  # (t,) control face of every triangle
    original: OriginalMesh | None = None  # None if the control mesh is the file's mesh
    # (3, 3) from file coordinates to the view, where y is up; multiplies rows from the right
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))

    @property
    def file_mesh(self) -> ControlMesh:
        """The mesh of the file."""
        return self.control if self.original is None else self.original.mesh

    def to_control_vertices(self, vertices: IndexArray) -> IndexArray:
        """Control vertices of vertices of the file, -1 for those left out."""
        return vertices if self.original is None else self.original.vertex_of[vertices]

    def to_file_vertices(self, vertices: IndexArray) -> IndexArray:
        """Vertices of the file of control vertices."""
        numbers = None if self.original is None else self.control.file_vertices
        return vertices if numbers is None else numbers[vertices]

    @kept
    def edges(self) -> FloatArray:
        """(e, 2, 3) ends of the control mesh's edges, in file units."""
        return np.asarray(self.control.positions[mesh_topology(self.control).edge_vertices])

    @kept
    def surface(self) -> TriangleSurface:
        """The same triangles as a surface of unit area."""
        scale = 1.0 / float(np.sqrt(triangle_areas(self.positions, self.triangles).sum()))
        return TriangleSurface(scale * self.positions, self.triangles, scale)

    @kept
    def cage(self) -> TriangleSurface:
        """Control mesh with its vertices on the refined surface, in the units of `surface`."""
        return TriangleSurface(
            self.surface.positions[: self.control.n_vertices], cage_triangles(self.control)[0], self.surface.scale
        )

    @kept
    def frames(self) -> FloatArray:
        """(t, 3, 3) first corner of each triangle and gradients of its barycentric coordinates (`triangle_frames`)."""
        return triangle_frames(self.positions, self.triangles)

    @kept
    def uv_jacobians(self) -> FloatArray:
        """(t, 2, 3) derivatives of the texture coordinates by position on each triangle."""
        assert self.uvs is not None
        assert self.uv_triangles is not None
        uvs = self.uvs[self.uv_triangles]
        return np.asarray(np.einsum("tki,tkj->tij", uvs[:, 1:] - uvs[:, :1], self.frames[:, 1:]))

    @kept
    def centre(self) -> FloatArray:
        """Middle of the bounding box."""
        return np.asarray(0.5 * (self.positions.min(0) + self.positions.max(0)))

    @kept
    def radius(self) -> float:
        """Half the diagonal of the bounding box."""
        return 0.5 * box_diagonal(self.positions)

    def with_up(self, up: str | None) -> Shape:
        """The same shape with an axis of its file up in the view, "y" or "z"; None: as it is."""
        return self if up is None else replace(self, rotation=UP_AXES[up])

    def to_view(self, points: FloatArray) -> FloatArray:
        """Transform points from file units to the view (centre 0, radius 1)."""
        return self.directions_to_view((points - self.centre) / self.radius)

    def directions_to_view(self, directions: FloatArray) -> FloatArray:
        """Rotate directions from file coordinates to the view."""
        return np.asarray(directions @ self.rotation)

    def to_file(self, points: FloatArray) -> FloatArray:
        """Transform points from the view to file units."""
        return np.asarray(points @ self.rotation.T * self.radius + self.centre)


def refined_shape(
    refinement: Refinement, original: OriginalMesh | None = None, rotation: FloatArray | None = None
) -> Shape:
    """Shape of a refinement's finest level; without a rotation the file's y axis is up."""
    level, finest = refinement.finest_level, refinement.finest
    finest_triangles = level_triangles(refinement, level)
    per_face = len(finest_triangles) // len(finest.face_parents)
    return Shape(
        control=refinement.control,
        positions=finest.positions,
        normals=vertex_normals(finest.positions, finest_triangles),
        triangles=finest_triangles,
        uvs=finest.uvs,
        uv_triangles=None if finest.uv_indices is None else triangles(finest.uv_indices),
        faces=np.repeat(finest.face_parents, per_face),
        original=original,
        rotation=np.eye(3) if rotation is None else rotation,
    )


@dataclass(frozen=True, eq=False)
class Hit:
    """Intersection of a ray and a shape."""

    triangle: int
    barycentric: FloatArray  # (3,)
    position: FloatArray  # (3,) in file units


def pick(shape: Shape, origin: FloatArray, direction: FloatArray) -> Hit | None:
    """First intersection of a ray with a shape.

    ``origin``, ``direction``: (3,) in the view's coordinates.
    """
    start = shape.to_file(np.asarray(origin, dtype=np.float64))
    triangles, weights, distances = line_hits(
        shape.positions, shape.triangles, start, np.asarray(direction, dtype=np.float64) @ shape.rotation.T
    )
    in_front = np.flatnonzero(distances > 0)
    if not len(in_front):
        return None
    first = in_front[np.argmin(distances[in_front])]
    triangle = int(triangles[first])
    return Hit(triangle, weights[first], weights[first] @ shape.positions[shape.triangles[triangle]])


def line_hits(
    positions: FloatArray, triangles: IndexArray, start: FloatArray, line: FloatArray
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Intersections of a line with triangles (Moeller and Trumbore 1997, vectorised).

    Returns triangles (h,), barycentric coordinates (h, 3) of at least -`SLACK`, and signed distances (h,) from the
    start in lengths of ``line``.
    """
    candidates = _triangles_near_line(positions, triangles, start, line)
    a, b, c = (positions[triangles[candidates, k]] for k in range(3))
    ab, ac = b - a, c - a
    line_cross_ac = np.cross(line, ac)
    determinant = np.einsum("td,td->t", ab, line_cross_ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - a
        u = np.einsum("td,td->t", offset, line_cross_ac) / determinant
        offset_cross_ab = np.cross(offset, ab)
        v = offset_cross_ab @ line / determinant
        distance = np.einsum("td,td->t", ac, offset_cross_ab) / determinant
        weights = np.column_stack([1 - u - v, u, v])
        inside = (weights >= -SLACK).all(axis=1) & np.isfinite(distance)
    return candidates[inside], weights[inside], distance[inside]


def _triangles_near_line(
    positions: FloatArray, triangles: IndexArray, start: FloatArray, line: FloatArray
) -> IndexArray:
    """Triangles whose bounding rectangle, seen along a line, contains the line."""
    across = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
    plane = np.column_stack([across, np.cross(line, across)])
    projected = (positions - start) @ plane
    slack = SLACK * np.abs(projected).max(axis=0, initial=0.0)
    sides = ((projected >= -slack) @ np.array([1, 2]) + (projected <= slack) @ np.array([4, 8])).astype(np.uint8)
    a, b, c = (sides[triangles[:, k]] for k in range(3))
    return np.flatnonzero((a | b | c) == 15)
