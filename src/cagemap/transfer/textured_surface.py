"""A refined surface as triangles with UVs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision import Level, triangles


@dataclass(frozen=True, eq=False)
class TexturedSurface:
    """The triangles of one level of a refinement, in the numbering that point maps use."""

    positions: FloatArray  # (n, 3)
    triangles: IndexArray  # (t, 3) vertices of every triangle
    uvs: FloatArray | None  # (p, 2) texture coordinates, v up
    uv_triangles: IndexArray | None  # (t, 3) UV of every triangle corner
    triangle_faces: IndexArray  # (t,) refined face that each triangle is a part of
    face_parents: IndexArray  # (m,) control face that each refined face came from
    # (t,) triangles that shape the surface but are no part of it: nothing is baked there
    holes: NDArray[np.bool_] | None = None

    @classmethod
    def from_level(cls, level: Level, holes: NDArray[np.bool_] | None = None) -> TexturedSurface:
        """Split the faces of a refined level into triangles; ``holes`` (m,) are faces that are no part of it."""
        if level.faces is None:
            raise ParameterError("expected quads or triangles, got a control mesh of mixed polygons: refine it once")
        split = triangles(level.faces)
        per_face = len(split) // len(level.faces)
        uv_split = None if level.uv_indices is None else triangles(level.uv_indices)
        faces = np.repeat(np.arange(len(level.faces)), per_face)
        hollow = None if holes is None or not holes.any() else holes[faces]
        return cls(level.positions, split, level.uvs, uv_split, faces, level.face_parents, hollow)

    def layout(self) -> tuple[FloatArray, IndexArray]:
        """Texture coordinates (p, 2), and those of every triangle corner (t, 3)."""
        if self.uvs is None or self.uv_triangles is None:
            raise ParameterError(
                "expected a surface with texture coordinates, got none: unwrap its control mesh first (`unwrap`)"
            )
        return self.uvs, self.uv_triangles

    def corner_uvs(self) -> FloatArray:
        """(t, 3, 2) texture coordinates of every triangle corner."""
        uvs, corners = self.layout()
        return uvs[corners]
