"""Corner normals from files (hard edges, edited normals) on a mesh whose vertices move."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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


def move_vertices(part: Part, positions: FloatArray, shapes: dict[str, FloatArray] | None = None) -> Part:
    """A part with other vertex positions (n, 3) and offsets of its shapes; corner normals rotate with their faces."""
    moved = replace(part, mesh=part.mesh.with_positions(positions), shapes=part.shapes if shapes is None else shapes)
    if part.normals is None or (shapes is None and np.array_equal(positions, part.mesh.positions)):
        return moved
    rotated = _rotated_normals(part.mesh, part.normals, [positions, *_shape_positions(moved, part.shape_normals)])
    offsets = dict(zip(part.shape_normals, (one - rotated[0] for one in rotated[1:]), strict=True))
    return replace(moved, normals=rotated[0], shape_normals=offsets)


def with_shape_normals(part: Part, names: Iterable[str]) -> Part:
    """A part with normals of the named shapes too: its own normals, rotated with their faces."""
    names, mesh = tuple(names), part.mesh
    if not names:
        return part
    normals = part.normals
    if normals is None:
        corners, _ = fan_triangles(mesh.face_offsets, mesh.face_indices)
        normals = vertex_normals(mesh.positions, corners)[mesh.face_indices]
    rotated = _rotated_normals(mesh, normals, _shape_positions(part, names))
    offsets = {name: one - normals for name, one in zip(names, rotated, strict=True)}
    return replace(part, normals=normals, shape_normals=part.shape_normals | offsets)


def _shape_positions(part: Part, names: Iterable[str]) -> list[FloatArray]:
    """Vertex positions in each of the named shapes."""
    return [part.mesh.positions + part.shapes[name] for name in names]


def _rotated_normals(mesh: ControlMesh, normals: FloatArray, places: Sequence[FloatArray]) -> list[FloatArray]:
    """Corner normals (c, 3), rotated with their faces, for each of several vertex positions (n, 3)."""
    groups = normal_groups(mesh, normals)
    old_normals = _group_normals(mesh, groups, mesh.positions)[groups]
    found = []
    for positions in places:
        new_normals = _group_normals(mesh, groups, positions)[groups]
        axis, cosine = np.cross(old_normals, new_normals), np.einsum("cd,cd->c", old_normals, new_normals)[:, None]
        axis_part = np.einsum("cd,cd->c", axis, normals)[:, None] * axis / (1.0 + np.maximum(cosine, MIN_TURN_COSINE))
        rotated = np.where(
            cosine > MIN_TURN_COSINE, cosine * normals + np.cross(axis, normals) + axis_part, new_normals
        )
        found.append(normalize_rows(rotated))
    return found


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
