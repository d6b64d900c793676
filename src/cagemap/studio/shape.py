"""A model as the page shows it: the smooth surface of one level, scaled to the view, and clicks on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Refinement, level_triangles, limit_normals, limit_positions, triangles
from cagemap.studio.landmarks import Place


@dataclass(frozen=True, eq=False)
class Shape:
    """The triangles of one level, at their limit positions.

    Attributes
    ----------
    name : str
    positions, normals : (n, 3) float64
        Limit positions in file units, unit normals; the first rows are the control vertices' points.
    triangles : (t, 3) int64
        In the numbering that point maps use.
    uvs : (p, 2) float64 or None
    uv_triangles : (t, 3) int64 or None
    faces : (t,) int64
        Control face of every triangle.
    edges : (e, 2, 3) float64
        Of the control mesh, in file units.
    n_control : int
    parts : tuple of str
        Names of materials.
    face_parts : (m,) int64 or None
        Material of every control face.
    """

    name: str
    positions: FloatArray
    normals: FloatArray
    triangles: IndexArray
    uvs: FloatArray | None
    uv_triangles: IndexArray | None
    faces: IndexArray
    edges: FloatArray
    n_control: int
    parts: tuple[str, ...] = ()
    face_parts: IndexArray | None = None

    @property
    def centre(self) -> FloatArray:
        """Middle of the bounding box."""
        return 0.5 * (self.positions.min(0) + self.positions.max(0))

    @property
    def radius(self) -> float:
        """Half the diagonal of the bounding box."""
        return float(0.5 * np.linalg.norm(np.ptp(self.positions, axis=0)))

    def to_view(self, points: FloatArray) -> FloatArray:
        """Take points from file units to the view, where every model has its centre at 0 and radius 1."""
        return np.asarray((points - self.centre) / self.radius)

    def to_file(self, points: FloatArray) -> FloatArray:
        """Take points from the view to file units."""
        return np.asarray(points * self.radius + self.centre)


def shape_of(refinement: Refinement) -> Shape:
    """Shape of a refinement's finest level."""
    level, finest = refinement.n_levels, refinement.finest
    control = refinement.control
    split = level_triangles(refinement, level)
    per_face = len(split) // len(finest.face_parents)
    return Shape(
        name=control.name,
        positions=limit_positions(refinement, level),
        normals=limit_normals(refinement, level),
        triangles=split,
        uvs=finest.uvs,
        uv_triangles=None if finest.uv_indices is None else triangles(finest.uv_indices),
        faces=np.repeat(finest.face_parents, per_face),
        edges=control.positions[control_edges(control)],
        n_control=control.n_vertices,
        parts=control.material_names,
        face_parts=control.face_materials,
    )


def control_edges(control: ControlMesh) -> IndexArray:
    """(e, 2) control vertices of every edge, once."""
    ends = np.column_stack([control.face_indices, control.face_indices[control.next_corners]])
    return np.unique(np.sort(ends, axis=1), axis=0)


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
    """First point of a shape on a ray (Moeller and Trumbore 1997, all triangles at once).

    Parameters
    ----------
    origin, direction : (3,) float64
        In the view's coordinates.
    """
    start = shape.to_file(np.asarray(origin, dtype=np.float64))
    ray = np.asarray(direction, dtype=np.float64)
    a, b, c = (shape.positions[shape.triangles[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    across = np.cross(ray, ac)
    determinant = np.einsum("td,td->t", ab, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - a
        u = np.einsum("td,td->t", offset, across) / determinant
        turned = np.cross(offset, ab)
        v = turned @ ray / determinant
        distance = np.einsum("td,td->t", ac, turned) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    if not inside.any():
        return None
    hits = np.flatnonzero(inside)
    first = int(hits[np.argmin(distance[hits])])
    weights = np.array([1 - u[first] - v[first], u[first], v[first]])
    return Hit(first, weights, weights @ shape.positions[shape.triangles[first]])


def place_of(shape: Shape, hit: Hit) -> Place:
    """Place of a hit: the point of the nearest control vertex, which is what landmark files hold."""
    return vertex_place(shape, nearest_vertex(shape, hit.position, shape.n_control))


def vertex_place(shape: Shape, vertex: int) -> Place:
    """Place of a control vertex: its point of the smooth surface."""
    x, y, z = shape.positions[vertex].tolist()
    return Place((x, y, z), vertex)


def nearest_vertex(shape: Shape, position: FloatArray, count: int | None = None) -> int:
    """Vertex nearest to a position in file units, among the first ``count``."""
    return int(np.argmin(np.linalg.norm(shape.positions[:count] - np.asarray(position), axis=1)))
