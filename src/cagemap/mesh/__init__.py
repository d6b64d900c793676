"""Control meshes: the value, its checks, and small named shapes."""

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.schemes import Bilinear, CatmullClark, Loop, Plain, Scheme, SubdivisionOptions
from cagemap.mesh.shapes import (
    bipyramid,
    creature,
    cube,
    disk,
    grid,
    icosahedron,
    poles,
    pyramid,
    tetrahedron,
    torus,
    triangulated,
    voxels,
)

__all__ = [
    "Bilinear",
    "CatmullClark",
    "ControlMesh",
    "Loop",
    "Plain",
    "Scheme",
    "SubdivisionOptions",
    "bipyramid",
    "creature",
    "cube",
    "disk",
    "grid",
    "icosahedron",
    "poles",
    "pyramid",
    "tetrahedron",
    "torus",
    "triangulated",
    "voxels",
]
