"""Subdivision: refined levels, the matrices between them, and limit positions and normals."""

from cagemap.mesh.schemes import Bilinear, CatmullClark, Loop, Scheme
from cagemap.subdivision.level_meshes import finest_mesh
from cagemap.subdivision.limit import limit_matrix, limit_normals, limit_positions
from cagemap.subdivision.refinement import (
    Level,
    Refinement,
    default_scheme,
    level_triangles,
    refine,
    triangles,
    with_options,
)

__all__ = [
    "Bilinear",
    "CatmullClark",
    "Level",
    "Loop",
    "Refinement",
    "Scheme",
    "default_scheme",
    "finest_mesh",
    "level_triangles",
    "limit_matrix",
    "limit_normals",
    "limit_positions",
    "refine",
    "triangles",
    "with_options",
]
