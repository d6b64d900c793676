"""Control meshes: the class, its checks and its subdivision schemes."""

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.schemes import Bilinear, CatmullClark, Loop, Plain, Scheme, SubdivisionOptions

__all__ = ["Bilinear", "CatmullClark", "ControlMesh", "Loop", "Plain", "Scheme", "SubdivisionOptions"]
