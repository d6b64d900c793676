"""Areas and volume of a control mesh, its polygons split into fans."""

from __future__ import annotations

import numpy as np

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import fan_triangles, row_lengths


def cage_triangles(mesh: ControlMesh) -> tuple[IndexArray, IndexArray]:
    """Split every face (v0, v1, ..., vk) into the fan (v0, v1, v2), (v0, v2, v3), ...

    Returns
    -------
    triangles : (t, 3) int64
        Vertex numbers.
    faces : (t,) int64
        Face of every triangle. A face of fewer than three corners has none.
    """
    return fan_triangles(mesh.face_offsets, mesh.face_indices)


def face_areas(mesh: ControlMesh) -> FloatArray:
    """(m,) area of every face as the sum over its fan; in squared file units. A folded face counts both sides."""
    triangles, faces = cage_triangles(mesh)
    a, b, c = (mesh.positions[triangles[:, i]] for i in range(3))
    areas = 0.5 * row_lengths(np.cross(b - a, c - a))  # without a kernel: cages are small, and are checked first
    return np.bincount(faces, areas, minlength=mesh.n_faces).astype(np.float64)


def face_centres(mesh: ControlMesh) -> FloatArray:
    """(m, 3) mean of the corners of every face; in file units."""
    sums = np.add.reduceat(mesh.positions[mesh.face_indices], mesh.face_offsets[:-1])
    return np.asarray(sums / mesh.face_sizes[:, None])


def face_extents(mesh: ControlMesh) -> FloatArray:
    """(m,) longest side of every face's axis-aligned box; in file units."""
    corners = mesh.positions[mesh.face_indices]
    starts = mesh.face_offsets[:-1]
    return np.max(np.maximum.reduceat(corners, starts) - np.minimum.reduceat(corners, starts), axis=1)


def signed_volume(mesh: ControlMesh) -> float:
    """Volume enclosed by a closed mesh, positive where its faces run counter-clockwise seen from outside."""
    triangles, _ = cage_triangles(mesh)
    a, b, c = (mesh.positions[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
