"""What the bake needs to know of a refined surface: triangles with their UVs, and who lies across each edge."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Level, triangles


@dataclass(frozen=True)
class TexturedSurface:
    """The triangles of one level of a refinement, in the numbering that point maps use.

    Attributes
    ----------
    positions : (n, 3) float64
    triangles : (t, 3) int64
        Vertices of every triangle.
    uvs : (p, 2) float64 or None
        Texture coordinates, v up.
    uv_triangles : (t, 3) int64 or None
        UV of every triangle corner.
    triangle_faces : (t,) int64
        Refined face that each triangle is a part of.
    face_parents : (m,) int64
        Control face that each refined face came from.
    """

    positions: FloatArray
    triangles: IndexArray
    uvs: FloatArray | None
    uv_triangles: IndexArray | None
    triangle_faces: IndexArray
    face_parents: IndexArray

    @classmethod
    def from_level(cls, level: Level) -> TexturedSurface:
        """Split the faces of a refined level into triangles.

        Raises
        ------
        ParameterError
            At level 0 of a mesh whose faces are not all quads or all triangles.
        """
        if level.faces is None:
            raise ParameterError("expected quads or triangles, got a control mesh of mixed polygons: refine it once")
        split = triangles(level.faces)
        per_face = len(split) // len(level.faces)
        uv_split = None if level.uv_indices is None else triangles(level.uv_indices)
        faces = np.repeat(np.arange(len(level.faces)), per_face)
        return cls(level.positions, split, level.uvs, uv_split, faces, level.face_parents)

    def layout(self) -> tuple[FloatArray, IndexArray]:
        """Texture coordinates (p, 2), and those of every triangle corner (t, 3).

        Raises
        ------
        ParameterError
            If the surface has none.
        """
        if self.uvs is None or self.uv_triangles is None:
            raise ParameterError(
                "expected a surface with texture coordinates, got none: unwrap its control mesh first "
                "(cagemap.transfer.unwrap, or --unwrap on the command line)"
            )
        return self.uvs, self.uv_triangles

    def corner_uvs(self) -> FloatArray:
        """(t, 3, 2) texture coordinates of every triangle corner."""
        uvs, corners = self.layout()
        return uvs[corners]


def triangle_areas(positions: FloatArray, corners: IndexArray) -> FloatArray:
    """(t,) areas of triangles with the given (t, 3) vertices; positions may be (n, 2) or (n, 3)."""
    a, b, c = (positions[corners[:, k]] for k in range(3))
    if positions.shape[1] == 2:
        return 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def triangle_neighbors(corners: IndexArray) -> NDArray[np.int32]:
    """(t, 3) triangle across the edge *opposite* to every corner, -1 on the boundary.

    Edges are matched by their unordered pair of vertices; where more than two triangles share one, they are paired
    in order, which is what a UV layout with faces laid over each other needs.
    """
    neighbors = np.full(corners.shape, -1, dtype=np.int32)
    head = np.full(int(corners.max(initial=-1)) + 1, -1, dtype=np.int32)
    rest = np.full(corners.size, -1, dtype=np.int32)
    _pair_edges(np.ascontiguousarray(corners), neighbors, head, rest)
    return neighbors


# Kernels of this room fill arrays that they are given: to allocate inside would double the time they take to compile.
@numba.njit(cache=True, nogil=True)
def _pair_edges(corners, neighbors, head, rest):  # type: ignore[no-untyped-def]
    """Match edges through a linked list of still unmatched ones at each edge's lower vertex."""
    for t in range(len(corners)):
        for k in range(3):
            a, b = corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
            low, high = (a, b) if a < b else (b, a)
            previous, edge = np.int32(-1), head[low]
            while edge >= 0:
                other, j = edge // 3, edge % 3
                if corners[other, (j + 1) % 3] == high or corners[other, (j + 2) % 3] == high:
                    break
                previous, edge = edge, rest[edge]
            if edge < 0:
                rest[3 * t + k] = head[low]
                head[low] = 3 * t + k
                continue
            neighbors[t, k], neighbors[edge // 3, edge % 3] = edge // 3, t
            if previous < 0:
                head[low] = rest[edge]
            else:
                rest[previous] = rest[edge]
