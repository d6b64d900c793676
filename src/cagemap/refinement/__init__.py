"""Subdivision: refined levels, the matrices between them, and limits."""

from cagemap.refinement.refinement import (
    Level,
    Refinement,
    default_scheme,
    refine,
    triangles,
    triangulate_control,
)
from cagemap.refinement.schemes import CatmullClark, Loop, Scheme

__all__ = [
    "CatmullClark",
    "Level",
    "Loop",
    "Refinement",
    "Scheme",
    "default_scheme",
    "refine",
    "triangles",
    "triangulate_control",
]
