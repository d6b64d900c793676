"""Faces of a control mesh: triangles, areas, centres, subsets, and degenerate or duplicate faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.control_mesh import ControlMesh, UvSet
from cagemap.numerics.arrays import FloatArray, IndexArray, joined_runs, pair_keys
from cagemap.surface.triangles import fan_triangles, row_lengths

TINY_EDGE = 0.01  # an edge shorter than this share of its faces' longest joins vertices that should be one
SLIT_AREA = 0.004  # a boundary loop of less area, in its squared length, is a slit; a square has 1/16


def place_counts(mesh: ControlMesh) -> dict[str, int]:
    """Numbers of control vertices, control faces and face corners, which values can have one row each for."""
    return {"vertices": mesh.n_vertices, "faces": mesh.n_faces, "corners": len(mesh.face_indices)}


def place_of_rows(mesh: ControlMesh, count: int) -> str:
    """First of "vertices", "faces" and "corners" with as many places as rows; "" for other numbers."""
    return next((place for place, number in place_counts(mesh).items() if number == count), "")


def faces_of_one_size(mesh: ControlMesh) -> IndexArray | None:
    """(m, 3) or (m, 4) vertices of faces that are all triangles or all quads; None for others."""
    size = int(mesh.face_sizes[0]) if mesh.n_faces else 0
    alike = size in (3, 4) and bool(np.all(mesh.face_sizes == size))
    return mesh.face_indices.reshape(-1, size) if alike else None


def keep_faces(mesh: ControlMesh, faces: IndexArray) -> ControlMesh:
    """Return the mesh with only the given faces; vertices and texture coordinates are unchanged."""
    return with_corners_of(mesh, faces, *joined_runs(mesh.face_offsets[faces], mesh.face_sizes[faces]))


def with_corners_of(mesh: ControlMesh, faces: IndexArray, offsets: IndexArray, corners: IndexArray) -> ControlMesh:
    """Return the mesh with other faces, made of its own face corners.

    New face i has the corners ``corners[offsets[i]:offsets[i + 1]]`` of the mesh and comes from its face ``faces[i]``.
    ``faces`` must ascend if the mesh has hole faces.
    """
    indices = mesh.face_indices[corners]
    creases, sharpness = mesh.crease_edges, mesh.crease_sharpness
    if creases is not None and sharpness is not None:
        following = ControlMesh(mesh.positions, offsets, indices).next_corners
        edges = pair_keys(np.column_stack([indices, indices[following]]), mesh.n_vertices)
        kept = np.isin(pair_keys(creases, mesh.n_vertices), edges)
        creases, sharpness = creases[kept], sharpness[kept]
    return replace(
        mesh,
        face_offsets=offsets,
        face_indices=indices,
        uv_indices=None if mesh.uv_indices is None else mesh.uv_indices[corners],
        uv_sets=tuple(UvSet(uv_set.name, uv_set.uvs, uv_set.uv_indices[corners]) for uv_set in mesh.uv_sets),
        **labels_of(mesh, faces),
        file_faces=None if mesh.file_faces is None else mesh.file_faces[faces],
        hole_faces=None if mesh.hole_faces is None else np.flatnonzero(np.isin(faces, mesh.hole_faces)),
        crease_edges=creases,
        crease_sharpness=sharpness,
    )


def split_into_fans(mesh: ControlMesh) -> ControlMesh:
    """Return the mesh with all faces split by `fan_triangles`; triangles have the file numbers of their faces."""
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    vertex_numbers, face_numbers = mesh.file_numbers
    numbered = replace(mesh, file_vertices=vertex_numbers, file_faces=face_numbers)
    return with_corners_of(numbered, faces, 3 * np.arange(len(faces) + 1), corners.ravel())


def labels_of(mesh: ControlMesh, faces: IndexArray) -> dict[str, Any]:
    """Materials, objects and groups of some faces (k,), as arguments of `ControlMesh`."""
    return {f"face_{kind}s": None if numbers is None else numbers[faces] for kind, numbers, _ in mesh.partitions}


def degenerate_faces(mesh: ControlMesh) -> IndexArray:
    """Faces of fewer than three corners, or that visit a vertex twice."""
    faces = mesh.corner_faces
    order = np.lexsort([mesh.face_indices, faces])
    repeated = (np.diff(mesh.face_indices[order]) == 0) & (np.diff(faces[order]) == 0)
    return np.union1d(np.flatnonzero(mesh.face_sizes < 3), faces[order][1:][repeated])


def duplicate_faces(mesh: ControlMesh) -> IndexArray:
    """Faces with the same vertices, in any order, as a face of a lower number."""
    copies = []
    for size in np.unique(mesh.face_sizes):
        faces = np.flatnonzero(mesh.face_sizes == size)
        corners = np.sort(mesh.face_indices[mesh.face_offsets[faces][:, None] + np.arange(size)], axis=1)
        order = np.lexsort(corners.T)  # stable: of equal faces the lowest number comes first
        repeated = np.all(corners[order][1:] == corners[order][:-1], axis=1)
        copies.append(faces[order][1:][repeated])
    return np.sort(np.concatenate(copies))


def reversed_corners(face_offsets: IndexArray) -> IndexArray:
    """(c,) corners of all faces in reversed order; the first corner of each face stays first."""
    first, sizes = face_offsets[:-1], np.diff(face_offsets)
    starts, size = np.repeat(first, sizes), np.repeat(sizes, sizes)
    within = np.arange(len(starts)) - starts
    return np.asarray(starts + (size - within) % size)


def merged_corners(vertices: IndexArray, values: NDArray[Any]) -> tuple[NDArray[Any], IndexArray]:
    """Merge equal values (c,) or (c, q) of face corners at one vertex (c,): merged values, and their index (c,)."""
    pairs = values.dtype.kind == "f" and values.shape[1:] == (2,)  # as numbers, which are sorted faster than rows
    _, equal = np.unique(values[:, 0] + 1j * values[:, 1] if pairs else values, axis=0, return_inverse=True)
    _, first, numbers = np.unique(vertices * len(values) + equal.ravel(), return_index=True, return_inverse=True)
    return values[first], numbers


def cage_triangles(mesh: ControlMesh) -> tuple[IndexArray, IndexArray]:
    """Triangles (t, 3) of all faces, and the face (t,) of each; see `fan_triangles`."""
    return fan_triangles(mesh.face_offsets, mesh.face_indices)


def face_areas(mesh: ControlMesh) -> FloatArray:
    """(m,) area of every face: the sum over its fan, in squared file units."""
    triangles, faces = cage_triangles(mesh)
    a, b, c = (mesh.positions[triangles[:, i]] for i in range(3))
    areas = 0.5 * row_lengths(np.cross(b - a, c - a))  # no compiled kernel: cages are small
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


def is_slit(loop: FloatArray, usual_edge: float) -> bool:
    """Whether a boundary loop (k, 3) is an error of modelling: thin, or tiny beside the median edge of the mesh."""
    points = loop - loop.mean(axis=0)
    following = np.roll(points, -1, axis=0)
    length = np.linalg.norm(following - points, axis=1).sum()
    area = np.linalg.norm(np.cross(points, following).sum(axis=0)) / 2
    return bool(area <= SLIT_AREA * length**2 or length <= TINY_EDGE * len(points) * usual_edge)


def with_openings_closed(mesh: ControlMesh, loops: Sequence[IndexArray]) -> ControlMesh:
    """Close every boundary loop with triangles to its centroid."""
    if not loops:
        return mesh
    centres = np.array([mesh.positions[loop].mean(axis=0) for loop in loops])
    cones = [
        np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), mesh.n_vertices + i)])
        for i, loop in enumerate(loops)
    ]
    caps = np.concatenate(cones)
    return ControlMesh(
        np.concatenate([mesh.positions, centres]),
        np.concatenate([mesh.face_offsets, mesh.face_offsets[-1] + 3 * np.arange(1, len(caps) + 1)]),
        np.concatenate([mesh.face_indices, caps.ravel()]),
    )
