"""Convert user input to meshes and landmarks: arrays, meshes of trimesh or Open3D, pairs of vertices."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import array_of, real_numbers, whole_numbers
from cagemap.numerics.kinds import Conversion, kinds_checked

P = ParamSpec("P")
R = TypeVar("R")

# Annotations of parameters that `arrays_accepted` converts; the decorated functions get the class.
if TYPE_CHECKING:
    MeshLike = ControlMesh | Any
    LandmarksLike = Landmarks | Any
else:
    MeshLike, LandmarksLike = ControlMesh, Landmarks


def arrays_accepted(function: Callable[P, R]) -> Callable[P, R]:
    """Check arguments as `kinds_checked`, after conversion of meshes (`MeshLike`) and landmarks (`LandmarksLike`)."""
    return kinds_checked(function, _CONVERSIONS)


def is_mesh(value: object) -> bool:
    """Whether `control_mesh` accepts a value; other classes of cagemap with vertices and faces are not accepted."""
    if isinstance(value, ControlMesh):
        return True
    if type(value).__module__.startswith("cagemap."):
        return False
    pair = isinstance(value, tuple | list) and len(value) == 2
    return pair or (hasattr(value, "vertices") and (hasattr(value, "faces") or hasattr(value, "triangles")))


def control_mesh(mesh: Any, name: str = "mesh") -> ControlMesh:
    """Control mesh from arrays or from a mesh of another library; vertices and faces keep their numbers.

    The mesh is a `ControlMesh`, a pair of vertices (n, 3) and faces (m, 3), (m, 4) or a list of polygons, or an object
    with ``vertices`` and ``faces`` or ``triangles``: meshes of trimesh and Open3D come with their texture coordinates.
    Tensors are copied. ``name`` is for messages. ParameterError for other types, and arrays that are no mesh.
    """
    if isinstance(mesh, ControlMesh):
        return mesh
    if not is_mesh(mesh):
        raise ParameterError(
            f"{name}: expected a ControlMesh, a pair (vertices, faces), or an object with vertices and faces or "
            f"triangles, got {type(mesh).__name__}"
        )
    if isinstance(mesh, tuple | list):
        return ControlMesh.from_faces(*mesh, name=name)
    if hasattr(mesh, "faces"):  # trimesh: texture coordinates of vertices
        converted = ControlMesh.from_faces(mesh.vertices, mesh.faces, name=name)
        uvs = getattr(getattr(mesh, "visual", None), "uv", None)
        return converted if uvs is None or not len(uvs) else converted.with_uvs(uvs, converted.face_indices)
    # Open3D: texture coordinates of corners; its vectors must be converted to arrays.
    converted = ControlMesh.from_faces(array_of(mesh.vertices), array_of(mesh.triangles), name=name)
    corner_uvs = array_of(getattr(mesh, "triangle_uvs", ()))
    if not len(corner_uvs):
        return converted
    uvs, uv_indices = np.unique(real_numbers(corner_uvs, f"{name}: uvs"), axis=0, return_inverse=True)
    return converted.with_uvs(uvs, uv_indices.ravel())


def landmark_pairs(landmarks: Any) -> Landmarks:
    """Landmarks ``point 0``, ... from an array (p, 2) of pairs (target vertex, source vertex), 0-based.

    InvalidLandmarksError if the array has another shape; ParameterError if the vertices are no whole numbers.
    """
    if isinstance(landmarks, Landmarks):
        return landmarks
    pairs = whole_numbers(landmarks, "landmarks")
    if not pairs.size:
        return Landmarks.none()
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InvalidLandmarksError(
            f"landmarks: expected Landmarks or an array (p, 2) of pairs (target vertex, source vertex), got an array "
            f"{pairs.shape}{'. Transpose it.' if pairs.ndim == 2 and len(pairs) == 2 else '.'}"
        )
    return Landmarks(tuple(f"point {i}" for i in range(len(pairs))), pairs[:, 0], pairs[:, 1])


_CONVERSIONS: dict[type, Conversion] = {
    ControlMesh: lambda value, name: control_mesh(value, name) if is_mesh(value) else value,
    Landmarks: lambda value, _: (
        landmark_pairs(value) if isinstance(value, tuple | list) or hasattr(value, "__array__") else value
    ),
}
