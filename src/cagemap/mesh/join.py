"""Join several control meshes into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cagemap.mesh.control_mesh import NO_UV, ControlMesh, UvSet
from cagemap.numerics.arrays import FloatArray, IndexArray

Values = TypeVar("Values", FloatArray, IndexArray)


def join_meshes(meshes: Sequence[ControlMesh]) -> ControlMesh:
    """One mesh of several pieces; vertices and faces of each in turn.

    Names that several meshes have, of materials, objects, groups or UV sets, become one. Where a mesh lacks a UV set,
    all its corners have `NO_UV`, so that nothing is baked onto it.
    """
    vertices = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])[:-1]
    faces = np.cumsum([0, *(mesh.n_faces for mesh in meshes)])[:-1]
    sizes = np.concatenate([mesh.face_sizes for mesh in meshes])
    uv_sets = _uv_sets(meshes)
    materials, material_names = _names([(m.face_materials, m.material_names, m.n_faces) for m in meshes])
    objects, object_names = _names([(m.face_objects, m.object_names, m.n_faces) for m in meshes])
    groups, group_names = _names([(m.face_groups, m.group_names, m.n_faces) for m in meshes])
    joined = ControlMesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        _shifted([mesh.face_indices for mesh in meshes], vertices),
        uv_sets=tuple(uv_sets[1:]),
        face_materials=materials,
        material_names=material_names,
        material_colors=_colors(meshes, material_names),
        vertex_colors=_vertex_colors(meshes),
        face_objects=objects,
        object_names=object_names,
        face_groups=groups,
        group_names=group_names,
        crease_edges=_known([mesh.crease_edges for mesh in meshes], vertices),
        crease_sharpness=_known([mesh.crease_sharpness for mesh in meshes]),
        corner_vertices=_known([mesh.corner_vertices for mesh in meshes], vertices),
        corner_sharpness=_known([mesh.corner_sharpness for mesh in meshes]),
        hole_faces=_known([mesh.hole_faces for mesh in meshes], faces),
        file_vertices=_file_numbers([mesh.file_vertices for mesh in meshes]),
        file_faces=_file_numbers([mesh.file_faces for mesh in meshes]),
        file_copies=_known([mesh.file_copies for mesh in meshes], np.column_stack([vertices, 0 * vertices])),
        scheme=meshes[0].scheme,
        name=meshes[0].name,
    )
    if not uv_sets:
        return joined
    return replace(joined, uvs=uv_sets[0].uvs, uv_indices=uv_sets[0].uv_indices, uv_name=uv_sets[0].name)


def _shifted(arrays: Sequence[IndexArray], starts: IndexArray) -> IndexArray:
    return np.concatenate([array + start for array, start in zip(arrays, starts, strict=True)])


def _known(arrays: Sequence[Values | None], shifts: IndexArray | None = None) -> Values | None:
    """Those that are there, joined; None if there is none."""
    shifts = np.zeros(len(arrays), dtype=np.int64) if shifts is None else shifts
    known = [array + shift for array, shift in zip(arrays, shifts, strict=True) if array is not None]
    return np.concatenate(known) if known else None


def _file_numbers(numbers: Sequence[IndexArray | None]) -> IndexArray | None:
    """Numbers in the file, if all meshes are parts of one."""
    return None if any(array is None for array in numbers) else _known(numbers)


def _uv_sets(meshes: Sequence[ControlMesh]) -> list[UvSet]:
    """All UV sets by name, the one in use first."""
    known = []
    for mesh in meshes:
        in_use = [] if mesh.uvs is None or mesh.uv_indices is None else [UvSet(mesh.uv_name, mesh.uvs, mesh.uv_indices)]
        known.append({uv_set.name: uv_set for uv_set in (*in_use, *mesh.uv_sets)})
    result = []
    for name in dict.fromkeys(name for own in known for name in own):
        bare = [UvSet(name, np.array([NO_UV]), np.zeros(len(mesh.face_indices), dtype=np.int64)) for mesh in meshes]
        sets = [own.get(name, other) for own, other in zip(known, bare, strict=True)]
        starts = np.cumsum([0, *(len(uv_set.uvs) for uv_set in sets)])[:-1]
        values = np.concatenate([uv_set.uvs for uv_set in sets])
        result.append(UvSet(name, values, _shifted([uv_set.uv_indices for uv_set in sets], starts)))
    return result


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
    return np.concatenate(
        [np.full((m.n_vertices, 3), np.nan) if m.vertex_colors is None else m.vertex_colors for m in meshes]
    )
