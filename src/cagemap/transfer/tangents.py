"""Tangent frames as MikkTSpace defines them: what most programs read and write normal maps in.

Every triangle corner has a normal, a tangent along u and a sign. Corners of one vertex with one texture coordinate and
one handedness share their tangent: the mean over their triangles of the direction of u, laid into the plane of the
normal and weighted by the triangle's angle there (Mikkelsen 2008). Inside a triangle, normal and tangent are
interpolated linearly and not normalised; the bitangent is ``sign (n x t)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.geometry.triangles import normalized, vertex_normals
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.transfer.surface import TexturedSurface


@dataclass(frozen=True, eq=False)
class TangentFrames:
    """Frames at triangle corners.

    Attributes
    ----------
    vertex_normals : (n, 3) float64
        Unit length.
    triangles : (t, 3) int64
    tangents : (g, 3) float64
        Unit length, of groups of corners.
    groups : (t, 3) int64
        Group of every corner.
    signs : (t,) float64
        1, or -1 where the layout is mirrored.
    """

    vertex_normals: FloatArray
    triangles: IndexArray
    tangents: FloatArray
    groups: IndexArray
    signs: FloatArray

    def normals_at(self, triangle: IndexArray, barycentric: FloatArray) -> FloatArray:
        """(k, 3) interpolated normals at points, not of unit length."""
        return np.asarray(np.einsum("kc,kcd->kd", barycentric, self.vertex_normals[self.triangles[triangle]]))

    def at(self, triangle: IndexArray, barycentric: FloatArray) -> FloatArray:
        """(k, 3, 3) frames at points: columns tangent, bitangent, normal."""
        normal = self.normals_at(triangle, barycentric)
        tangent = np.einsum("kc,kcd->kd", barycentric, self.tangents[self.groups[triangle]])
        bitangent = self.signs[triangle][:, None] * np.cross(normal, tangent)
        return np.stack([tangent, bitangent, normal], axis=2)


def tangent_frames(surface: TexturedSurface) -> TangentFrames:
    """Frames of a refined surface with texture coordinates.

    Raises
    ------
    ParameterError
        If it has none.
    """
    uvs, uv_triangles = surface.layout()
    triangles = surface.triangles
    normals = vertex_normals(surface.positions, triangles)
    a, b, c = (surface.positions[triangles[:, k]] for k in range(3))
    (u1, v1), (u2, v2) = (uvs[uv_triangles[:, k]].T - uvs[uv_triangles[:, 0]].T for k in (1, 2))
    area = u1 * v2 - u2 * v1
    signs = np.where(area < 0, -1.0, 1.0)
    along = normalized(signs[:, None] * (v2[:, None] * (b - a) - v1[:, None] * (c - a)))
    keys = np.stack([triangles, uv_triangles, np.repeat((area < 0)[:, None], 3, axis=1)], axis=2).reshape(-1, 3)
    _, groups = np.unique(keys, axis=0, return_inverse=True)
    groups = groups.reshape(-1, 3)
    sums = np.zeros((int(groups.max()) + 1, 3))
    own = np.zeros((len(sums), 3))
    corners = (a, b, c)
    for k in range(3):
        normal = normals[triangles[:, k]]
        own[groups[:, k]] = normal
        in_plane = _projected(along, normal)
        first = _projected(corners[(k + 1) % 3] - corners[k], normal)
        second = _projected(corners[(k + 2) % 3] - corners[k], normal)
        angle = np.arccos(np.clip(np.einsum("td,td->t", first, second), -1.0, 1.0))
        weighted = np.where(area != 0, angle, 0.0)[:, None] * in_plane
        for d in range(3):
            sums[:, d] += np.bincount(groups[:, k], weighted[:, d], minlength=len(sums))
    tangents = normalized(sums)
    lost = np.linalg.norm(tangents, axis=1) < 0.5
    tangents[lost] = _any_tangent(own[lost])
    return TangentFrames(normals, triangles, tangents, groups, signs)


def _projected(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Vectors (k, 3) laid into the planes of unit normals, at unit length."""
    return normalized(vectors - np.einsum("kd,kd->k", vectors, normals)[:, None] * normals)


def _any_tangent(normals: FloatArray) -> FloatArray:
    """(k, 3) some unit vectors perpendicular to unit normals."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)] if len(normals) else np.zeros((0, 3))
    return normalized(np.cross(normals, axis))


def plane_basis(normals: FloatArray, along: FloatArray) -> FloatArray:
    """(k, 3, 2) orthonormal bases of the planes across normals, the first vector towards ``along``."""
    unit = normalized(normals)
    first = _projected(along, unit)
    flat = np.linalg.norm(first, axis=1) < 0.5
    first[flat] = _any_tangent(unit[flat])
    return np.stack([first, np.cross(unit, first)], axis=2)
