"""Corner normals from files (hard edges, edited normals) on a mesh whose vertices move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.character.values import Part
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import fan_triangles, normalize_rows, vertex_normals

# Of a unit normal: corners of a vertex whose normals differ less share one normal.
NORMAL_TOLERANCE = 1e-3
# Below this cosine of old and new face normals the rotation is not unique: the corner takes the new face normal.
MIN_TURN_COSINE = -0.99


def move_vertices(part: Part, positions: FloatArray) -> Part:
    """A part with other vertex positions (n, 3); corner normals rotate with their faces."""
    if part.normals is None:
        return replace(part, mesh=part.mesh.with_positions(positions))
    groups = normal_groups(part.mesh, part.normals)
    old_normals, new_normals = (
        _group_normals(part.mesh, groups, places)[groups] for places in (part.mesh.positions, positions)
    )
    axis, cosine = np.cross(old_normals, new_normals), np.einsum("cd,cd->c", old_normals, new_normals)[:, None]
    axis_part = np.einsum("cd,cd->c", axis, part.normals)[:, None] * axis / (1.0 + np.maximum(cosine, MIN_TURN_COSINE))
    rotated = np.where(
        cosine > MIN_TURN_COSINE, cosine * part.normals + np.cross(axis, part.normals) + axis_part, new_normals
    )
    return replace(part, mesh=part.mesh.with_positions(positions), normals=normalize_rows(rotated))


def normal_groups(mesh: ControlMesh, normals: FloatArray) -> IndexArray:
    """(c,) group of every corner; corners of a vertex with the same normal (c, 3) share a group."""
    rows = np.column_stack([mesh.face_indices, np.rint(normals / NORMAL_TOLERANCE)]).astype(np.int64)
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _group_normals(mesh: ControlMesh, groups: IndexArray, positions: FloatArray) -> FloatArray:
    """(g, 3) unit mean normals of the faces of each group of corners."""
    corners, _ = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    # Each group becomes one vertex of a mesh that is split at hard edges.
    places = np.zeros((int(groups.max(initial=-1)) + 1, 3))
    places[groups] = positions[mesh.face_indices]
    return vertex_normals(places, groups[corners])
