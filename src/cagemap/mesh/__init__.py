"""Control meshes: the class, its checks and its subdivision schemes."""

from cagemap.mesh.control_mesh import ControlMesh as ControlMesh
from cagemap.mesh.schemes import Bilinear as Bilinear
from cagemap.mesh.schemes import CatmullClark as CatmullClark
from cagemap.mesh.schemes import Loop as Loop
from cagemap.mesh.schemes import Plain as Plain
from cagemap.mesh.schemes import Scheme as Scheme
from cagemap.mesh.schemes import SubdivisionOptions as SubdivisionOptions
