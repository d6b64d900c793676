"""Normals of face corners, as files state them: hard edges and edited ones, on a mesh whose vertices move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.character.values import Part
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import fan_triangles, normalized, vertex_normals

# Of a unit normal: corners of a vertex that differ less share one normal.
_SAME = 1e-3
# Cosine below which a normal has turned over, and takes the new direction.
_OVER = -0.99


def moved(part: Part, positions: FloatArray) -> Part:
    """A part with its vertices (n, 3) at other places; its normals turn as the faces around them do."""
    if part.normals is None:
        return replace(part, mesh=part.mesh.with_positions(positions))
    groups = normal_groups(part.mesh, part.normals)
    before, after = (_means(part.mesh, groups, places)[groups] for places in (part.mesh.positions, positions))
    axis, cosine = np.cross(before, after), np.einsum("cd,cd->c", before, after)[:, None]
    along = np.einsum("cd,cd->c", axis, part.normals)[:, None] * axis / (1.0 + np.maximum(cosine, _OVER))
    turned = np.where(cosine > _OVER, cosine * part.normals + np.cross(axis, part.normals) + along, after)
    return replace(part, mesh=part.mesh.with_positions(positions), normals=normalized(turned))


def normal_groups(mesh: ControlMesh, normals: FloatArray) -> IndexArray:
    """(c,) number for every corner of a mesh; corners of one vertex with one normal (c, 3) have the same."""
    rows = np.column_stack([mesh.face_indices, np.rint(normals / _SAME)]).astype(np.int64)
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _means(mesh: ControlMesh, groups: IndexArray, positions: FloatArray) -> FloatArray:
    """(g, 3) unit normals of the faces of each group of corners."""
    corners, _ = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    # A group is a vertex of a mesh whose vertices are parted.
    places = np.zeros((int(groups.max(initial=-1)) + 1, 3))
    places[groups] = positions[mesh.face_indices]
    return vertex_normals(places, groups[corners])
