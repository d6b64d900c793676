"""Control meshes: the value, its checks, and small named shapes."""

from cagemap.mesh.control_mesh import ControlMesh, FloatArray, IndexArray

__all__ = ["ControlMesh", "FloatArray", "IndexArray"]
