"""A model as the page shows it: the smooth surface of one level, scaled to the view, and clicks on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept
from cagemap.subdivision import Refinement, level_triangles, limit_normals, limit_positions, triangles
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas


@dataclass(frozen=True, eq=False)
class Original:
    """A mesh as its file has it, where it was made ready to be taken as it is.

    Attributes
    ----------
    mesh : ControlMesh
    vertex_of : (n,) int64
        Vertex of the mesh made ready that each of the file's became, -1 where it was set aside.
    """

    mesh: ControlMesh
    vertex_of: IndexArray


@dataclass(frozen=True, eq=False)
class Shape:
    """The triangles of one level, at their limit positions.

    Attributes
    ----------
    control : ControlMesh
    positions, normals : (n, 3) float64
        Limit positions in file units, unit normals; the first rows are the control vertices' points.
    triangles : (t, 3) int64
        In the numbering that point maps use.
    uvs : (p, 2) float64 or None
    uv_triangles : (t, 3) int64 or None
    faces : (t,) int64
        Control face of every triangle.
    original : Original or None
        None where the control mesh is the file's.
    turn : (3, 3) float64
        Rotation from the file's space to the view, where y is up, for rows.
    """

    control: ControlMesh
    positions: FloatArray
    normals: FloatArray
    triangles: IndexArray
    uvs: FloatArray | None
    uv_triangles: IndexArray | None
    faces: IndexArray
    original: Original | None = None
    turn: FloatArray = field(default_factory=lambda: np.eye(3))

    @property
    def file_mesh(self) -> ControlMesh:
        """The mesh as its file has it."""
        return self.control if self.original is None else self.original.mesh

    def from_file(self, vertices: IndexArray) -> IndexArray:
        """Control vertices that the file's became, -1 for those set aside."""
        return vertices if self.original is None else self.original.vertex_of[vertices]

    def in_file(self, vertices: IndexArray) -> IndexArray:
        """Vertices of the file that control vertices are."""
        numbers = None if self.original is None else self.control.file_vertices
        return vertices if numbers is None else numbers[vertices]

    @property
    def name(self) -> str:
        """The mesh's file name."""
        return self.control.name

    @property
    def leaves_any(self) -> bool:
        """Whether its file has parts that are not this one."""
        return self.original is not None and self.original.mesh.n_faces > self.control.n_faces

    @property
    def n_control(self) -> int:
        """Number of control vertices."""
        return self.control.n_vertices

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
        """Triangles of the control mesh between its vertices' points of the smooth surface, in the surface's unit."""
        return TriangleSurface(
            self.surface.positions[: self.n_control], cage_triangles(self.control)[0], self.surface.scale
        )

    @kept
    def centre(self) -> FloatArray:
        """Middle of the bounding box."""
        return np.asarray(0.5 * (self.positions.min(0) + self.positions.max(0)))

    @kept
    def radius(self) -> float:
        """Half the diagonal of the bounding box."""
        return float(0.5 * np.linalg.norm(np.ptp(self.positions, axis=0)))

    def to_view(self, points: FloatArray) -> FloatArray:
        """Take points from file units to the view, where every model has its centre at 0 and radius 1."""
        return self.turned((points - self.centre) / self.radius)

    def turned(self, directions: FloatArray) -> FloatArray:
        """Take directions from the file's space to the view."""
        return np.asarray(directions @ self.turn)

    def to_file(self, points: FloatArray) -> FloatArray:
        """Take points from the view to file units."""
        return np.asarray(points @ self.turn.T * self.radius + self.centre)


def shape_of(refinement: Refinement, original: Original | None = None, turn: FloatArray | None = None) -> Shape:
    """Shape of a refinement's finest level; without a turn the file's y is up."""
    level, finest = refinement.n_levels, refinement.finest
    split = level_triangles(refinement, level)
    per_face = len(split) // len(finest.face_parents)
    return Shape(
        control=refinement.control,
        positions=limit_positions(refinement, level),
        normals=limit_normals(refinement, level),
        triangles=split,
        uvs=finest.uvs,
        uv_triangles=None if finest.uv_indices is None else triangles(finest.uv_indices),
        faces=np.repeat(finest.face_parents, per_face),
        original=original,
        turn=np.eye(3) if turn is None else turn,
    )


@dataclass(frozen=True, eq=False)
class Hit:
    """Where a ray meets a shape.

    Attributes
    ----------
    triangle : int
    barycentric : (3,) float64
    position : (3,) float64
        In file units.
    """

    triangle: int
    barycentric: FloatArray
    position: FloatArray


def pick(shape: Shape, origin: FloatArray, direction: FloatArray) -> Hit | None:
    """First point of a shape on a ray.

    Parameters
    ----------
    origin, direction : (3,) float64
        In the view's coordinates.
    """
    start = shape.to_file(np.asarray(origin, dtype=np.float64))
    triangles, weights, along = line_hits(
        shape.positions, shape.triangles, start, np.asarray(direction, dtype=np.float64) @ shape.turn.T
    )
    ahead = np.flatnonzero(along > 0)
    if not len(ahead):
        return None
    first = ahead[np.argmin(along[ahead])]
    triangle = int(triangles[first])
    return Hit(triangle, weights[first], weights[first] @ shape.positions[shape.triangles[triangle]])


def line_hits(
    positions: FloatArray, triangles: IndexArray, start: FloatArray, line: FloatArray
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Where a line meets triangles (Moeller and Trumbore 1997, all triangles around the line at once).

    Returns
    -------
    triangle : (h,) int64
    barycentric : (h, 3) float64
    along : (h,) float64
        From the start, in lengths of ``line``.
    """
    near = _around(positions, triangles, start, line)
    a, b, c = (positions[triangles[near, k]] for k in range(3))
    ab, ac = b - a, c - a
    across = np.cross(line, ac)
    determinant = np.einsum("td,td->t", ab, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - a
        u = np.einsum("td,td->t", offset, across) / determinant
        turned = np.cross(offset, ab)
        v = turned @ line / determinant
        along = np.einsum("td,td->t", ac, turned) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & np.isfinite(along)
    weights = np.column_stack([1 - u - v, u, v])
    return near[inside], weights[inside], along[inside]


def _around(positions: FloatArray, triangles: IndexArray, start: FloatArray, line: FloatArray) -> IndexArray:
    """Triangles that a line may meet: seen along it, corners lie on both sides of it, right and left, up and down.

    Leaves a few of a million triangles for the exact test.
    """
    one = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
    plane = np.column_stack([one, np.cross(line, one)])
    seen = (positions - start) @ plane
    slack = 1e-9 * np.abs(seen).max(axis=0, initial=0.0)
    sides = ((seen >= -slack) @ np.array([1, 2]) + (seen <= slack) @ np.array([4, 8])).astype(np.uint8)
    a, b, c = (sides[triangles[:, k]] for k in range(3))
    return np.flatnonzero((a | b | c) == 15)
