"""A refined surface as triangles with UVs, and its tangent frames as MikkTSpace defines them.

Most programs read and write normal maps in such frames. Every triangle corner has a normal, a tangent along u and a
sign. Corners of one vertex whose triangles are connected in the layout, with one handedness, share their tangent: the
mean over their triangles of the direction of u, projected into the plane of the normal and weighted by the corner's
angle (Mikkelsen 2008). Inside a triangle, normal and tangent are interpolated linearly and not normalised; the
bitangent is ``sign (n x t)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, label_components
from cagemap.subdivision import Level, triangles
from cagemap.surface.triangles import fan_triangles, normalize_rows, vertex_normals


@dataclass(frozen=True, eq=False)
class TexturedSurface:
    """The triangles of one level of a refinement, in the numbering that point maps use."""

    positions: FloatArray  # (n, 3)
    triangles: IndexArray  # (t, 3) vertices of every triangle
    uvs: FloatArray | None  # (p, 2) texture coordinates, v up
    uv_triangles: IndexArray | None  # (t, 3) UV of every triangle corner
    triangle_faces: IndexArray  # (t,) refined face that each triangle is a part of
    face_parents: IndexArray  # (m,) control face that each refined face came from
    # (t,) whether a triangle shapes the surface but belongs to a hole: it is not baked
    holes: NDArray[np.bool_] | None = None

    @classmethod
    def from_level(cls, level: Level, holes: NDArray[np.bool_] | None = None) -> TexturedSurface:
        """Triangles of a refined level; ``holes`` (m,) marks faces that are holes."""
        if level.faces is None:
            raise ParameterError("expected quads or triangles, got a control mesh of mixed polygons: refine it once")
        split = triangles(level.faces)
        per_face = len(split) // len(level.faces)
        uv_split = None if level.uv_indices is None else triangles(level.uv_indices)
        faces = np.repeat(np.arange(len(level.faces)), per_face)
        hollow = None if holes is None or not holes.any() else holes[faces]
        return cls(level.positions, split, level.uvs, uv_split, faces, level.face_parents, hollow)

    @classmethod
    def of_mesh(cls, mesh: ControlMesh) -> TexturedSurface:
        """Triangles of a control mesh as it is; polygons become fans."""
        corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
        uvs = None if mesh.uv_indices is None else mesh.uv_indices[corners]
        return cls(mesh.positions, mesh.face_indices[corners], mesh.uvs, uvs, np.arange(len(faces)), faces)

    def layout(self) -> tuple[FloatArray, IndexArray]:
        """Texture coordinates (p, 2), and their index (t, 3) for every triangle corner."""
        if self.uvs is None or self.uv_triangles is None:
            raise ParameterError(
                "expected a surface with texture coordinates, got none: unwrap its control mesh first (`unwrap`)"
            )
        return self.uvs, self.uv_triangles

    def corner_uvs(self) -> FloatArray:
        """(t, 3, 2) texture coordinates of every triangle corner."""
        uvs, corners = self.layout()
        return uvs[corners]


@dataclass(frozen=True, eq=False)
class TangentFrames:
    """Tangent frames at triangle corners."""

    vertex_normals: FloatArray  # (n, 3) unit length
    triangles: IndexArray  # (t, 3)
    tangents: FloatArray  # (g, 3) unit length, of groups of corners
    groups: IndexArray  # (t, 3) group of every corner
    signs: FloatArray  # (t,) 1, or -1 where the layout is mirrored

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
    """Frames of a refined surface with texture coordinates."""
    uvs, uv_triangles = surface.layout()
    triangles = surface.triangles
    normals = vertex_normals(surface.positions, triangles)
    a, b, c = (surface.positions[triangles[:, k]] for k in range(3))
    (u1, v1), (u2, v2) = (uvs[uv_triangles[:, k]].T - uvs[uv_triangles[:, 0]].T for k in (1, 2))
    area = u1 * v2 - u2 * v1
    signs = np.where(area < 0, -1.0, 1.0)
    along = normalize_rows(signs[:, None] * (v2[:, None] * (b - a) - v1[:, None] * (c - a)))
    groups = _groups(triangles, uvs, uv_triangles, area < 0)
    sums = np.zeros((int(groups.max()) + 1, 3))
    group_normals = np.zeros((len(sums), 3))
    corners = (a, b, c)
    for k in range(3):
        normal = normals[triangles[:, k]]
        group_normals[groups[:, k]] = normal
        in_plane = _project_to_planes(along, normal)
        first = _project_to_planes(corners[(k + 1) % 3] - corners[k], normal)
        second = _project_to_planes(corners[(k + 2) % 3] - corners[k], normal)
        angle = np.arccos(np.clip(np.einsum("td,td->t", first, second), -1.0, 1.0))
        weighted = np.where(area != 0, angle, 0.0)[:, None] * in_plane
        sums += grouped_sums(groups[:, k], weighted, len(sums))
    tangents = normalize_rows(sums)
    undefined = np.linalg.norm(tangents, axis=1) < 0.5
    tangents[undefined] = _any_tangent(group_normals[undefined])
    return TangentFrames(normals, triangles, tangents, groups, signs)


def _groups(
    triangles: IndexArray, uvs: FloatArray, uv_triangles: IndexArray, mirrored: NDArray[np.bool_]
) -> IndexArray:
    """(t, 3) group of every corner: corners of one vertex, joined across edges that are not seams.

    Edges across which the layout is mirrored are seams too. Texture coordinates are compared by value, since a layout
    may have one place twice. Two fans around a vertex without a common edge keep their own tangents.
    """
    _, places = np.unique(uvs @ np.array([1.0, 1.0j]), return_inverse=True)
    places = places.ravel().astype(np.int64)
    _, corner = np.unique(triangles * (int(places.max()) + 1) + places[uv_triangles], return_inverse=True)
    corner = 2 * corner.reshape(-1, 3).astype(np.int64) + mirrored[:, None]
    following = np.roll(corner, -1, axis=1)
    low, high = np.minimum(corner, following).ravel(), np.maximum(corner, following).ravel()
    edges = low * (int(corner.max()) + 1) + high
    order = np.argsort(edges, kind="stable")
    joined = np.flatnonzero(edges[order[1:]] == edges[order[:-1]])
    first_half, second_half = order[joined], order[joined + 1]  # half edges: 3 * triangle + first corner
    ends = [(3 * (half // 3) + (half % 3 + 1) % 3) for half in (first_half, second_half)]
    # Neighbours run along their edge in opposite directions, unless one of them is flipped.
    opposite = corner.ravel()[first_half] != corner.ravel()[second_half]
    pairs = [
        (first_half, np.where(opposite, ends[1], second_half)),
        (ends[0], np.where(opposite, second_half, ends[1])),
    ]
    heads, tails = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    return label_components(heads, tails, corner.size).reshape(-1, 3)


def _project_to_planes(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Vectors (k, 3) projected into the planes of unit normals, at unit length."""
    return normalize_rows(vectors - np.einsum("kd,kd->k", vectors, normals)[:, None] * normals)


def _any_tangent(normals: FloatArray) -> FloatArray:
    """(k, 3) arbitrary unit vectors perpendicular to unit normals."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)] if len(normals) else np.zeros((0, 3))
    return normalize_rows(np.cross(normals, axis))


def plane_basis(normals: FloatArray, along: FloatArray) -> FloatArray:
    """(k, 3, 2) orthonormal bases of the planes perpendicular to normals; the first vector is towards ``along``."""
    unit = normalize_rows(normals)
    first = _project_to_planes(along, unit)
    flat = np.linalg.norm(first, axis=1) < 0.5
    first[flat] = _any_tangent(unit[flat])
    return np.stack([first, np.cross(unit, first)], axis=2)
