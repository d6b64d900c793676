"""Subdivision: refined levels, the matrices between them, and limits."""

from cagemap.mesh.schemes import Bilinear, CatmullClark, Loop, Scheme
from cagemap.refinement.finest import finest_mesh
from cagemap.refinement.limit import limit_matrix, limit_normals, limit_positions
from cagemap.refinement.refinement import (
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
