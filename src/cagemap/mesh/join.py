"""Several meshes as one, and parts of a mesh as meshes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cagemap.mesh.control_mesh import ControlMesh, UvSet
from cagemap.numerics.arrays import FloatArray, IndexArray


def join_meshes(meshes: Sequence[ControlMesh]) -> ControlMesh:
    """One mesh of several pieces; vertices and faces of each in turn.

    Names that several meshes have, of materials, objects, groups or UV sets, become one. Where a mesh lacks a UV set,
    all its corners lie in one point of it, so that nothing of it is baked there.
    """
    starts = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])
    faces = np.cumsum([0, *(mesh.n_faces for mesh in meshes)])
    sizes = np.concatenate([mesh.face_sizes for mesh in meshes])
    joined = ControlMesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        _shifted([mesh.face_indices for mesh in meshes], starts),
        name=meshes[0].name,
        scheme=meshes[0].scheme,
    )
    sets = _uv_sets(meshes)
    if sets:
        joined = replace(
            joined, uvs=sets[0].uvs, uv_indices=sets[0].uv_indices, uv_name=sets[0].name, uv_sets=tuple(sets[1:])
        )
    creased = [(mesh.crease_edges, mesh.crease_sharpness, start) for mesh, start in zip(meshes, starts, strict=False)]
    edges = [(e + start, s) for e, s, start in creased if e is not None and s is not None]
    if edges:
        joined = joined.with_creases(*(np.concatenate(arrays) for arrays in zip(*edges, strict=True)))
    cornered = [(m.corner_vertices, m.corner_sharpness, start) for m, start in zip(meshes, starts, strict=False)]
    corners = [(v + start, s) for v, s, start in cornered if v is not None and s is not None]
    if corners:
        joined = joined.with_corners(*(np.concatenate(arrays) for arrays in zip(*corners, strict=True)))
    holes = [mesh.hole_faces + start for mesh, start in zip(meshes, faces, strict=False) if mesh.hole_faces is not None]
    materials, material_names = _names([(m.face_materials, m.material_names, m.n_faces) for m in meshes])
    objects, object_names = _names([(m.face_objects, m.object_names, m.n_faces) for m in meshes])
    groups, group_names = _names([(m.face_groups, m.group_names, m.n_faces) for m in meshes])
    return replace(
        joined,
        hole_faces=np.concatenate(holes) if holes else None,
        face_materials=materials,
        material_names=material_names,
        material_colors=_colors(meshes, material_names),
        vertex_colors=_vertex_colors(meshes),
        face_objects=objects,
        object_names=object_names,
        face_groups=groups,
        group_names=group_names,
        file_vertices=_file_numbers([mesh.file_vertices for mesh in meshes]),
        file_faces=_file_numbers([mesh.file_faces for mesh in meshes]),
    )


def _file_numbers(numbers: Sequence[IndexArray | None]) -> IndexArray | None:
    """Numbers in the file, if all meshes are parts of one."""
    known = [array for array in numbers if array is not None]
    return np.concatenate(known) if len(known) == len(numbers) else None


def _uv_sets(meshes: Sequence[ControlMesh]) -> list[UvSet]:
    """All UV sets by name, the one in use first."""
    known = []
    for mesh in meshes:
        in_use = [] if mesh.uvs is None or mesh.uv_indices is None else [UvSet(mesh.uv_name, mesh.uvs, mesh.uv_indices)]
        known.append({uv_set.name: uv_set for uv_set in (*in_use, *mesh.uv_sets)})
    result = []
    for name in dict.fromkeys(name for own in known for name in own):
        bare = [UvSet(name, np.full((1, 2), 0.5), np.zeros(len(mesh.face_indices), dtype=np.int64)) for mesh in meshes]
        sets = [own.get(name, other) for own, other in zip(known, bare, strict=True)]
        starts = np.cumsum([0, *(len(uv_set.uvs) for uv_set in sets)])
        values = np.concatenate([uv_set.uvs for uv_set in sets])
        result.append(UvSet(name, values, _shifted([uv_set.uv_indices for uv_set in sets], starts)))
    return result


def _shifted(arrays: Sequence[IndexArray], starts: IndexArray) -> IndexArray:
    return np.concatenate([array + start for array, start in zip(arrays, starts, strict=False)])


def _names(
    partitions: Sequence[tuple[IndexArray | None, tuple[str, ...], int]],
) -> tuple[IndexArray | None, tuple[str, ...]]:
    """One partition of all faces by name; faces of a mesh without one get the name ''."""
    if all(numbers is None for numbers, _, _ in partitions):
        return None, ()
    names: dict[str, int] = {}
    parts = []
    for numbers, own, n_faces in partitions:
        if numbers is None:
            numbers, own = np.zeros(n_faces, dtype=np.int64), ("",)
        parts.append(np.array([names.setdefault(name, len(names)) for name in own], dtype=np.int64)[numbers])
    return np.concatenate(parts), tuple(names)


def _colors(meshes: Sequence[ControlMesh], names: tuple[str, ...]) -> FloatArray | None:
    if not names:
        return None
    known = {
        name: color
        for mesh in reversed(meshes)
        if mesh.material_colors is not None
        for name, color in zip(mesh.material_names, mesh.material_colors, strict=True)
    }
    return np.array([known.get(name, np.full(3, np.nan)) for name in names])


def _vertex_colors(meshes: Sequence[ControlMesh]) -> FloatArray | None:
    if all(mesh.vertex_colors is None for mesh in meshes):
        return None
    unknown = [np.full((mesh.n_vertices, 3), np.nan) for mesh in meshes]
    return np.concatenate(
        [
            blank if mesh.vertex_colors is None else mesh.vertex_colors
            for mesh, blank in zip(meshes, unknown, strict=True)
        ]
    )
