"""The statements of an OBJ file, from a control mesh."""

from __future__ import annotations

import numpy as np

from cagemap.files.meshes.obj_tags import format_tags
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray


def obj_statements(mesh: ControlMesh) -> list[str]:
    """Vertices, texture vertices, faces with their objects, groups and materials, and subdivision tags."""
    parts = [_format_vertices(mesh)]
    if mesh.uvs is not None:
        parts.append(_format_lines("vt %r %r\n", mesh.uvs))
    parts.extend(_format_faces(mesh))
    parts.append(format_tags(mesh))
    return parts


def _format_lines(pattern: str, table: FloatArray) -> str:
    return (pattern * len(table)) % tuple(np.asarray(table, dtype=np.float64).ravel().tolist())


def _format_vertices(mesh: ControlMesh) -> str:
    if mesh.vertex_colors is None:
        return _format_lines("v %r %r %r\n", mesh.positions)
    colored = np.asarray(np.isfinite(mesh.vertex_colors).all(axis=1))
    if colored.all():
        return _format_lines("v %r %r %r %r %r %r\n", np.column_stack([mesh.positions, mesh.vertex_colors]))
    rows = zip(mesh.positions.tolist(), mesh.vertex_colors.tolist(), colored.tolist(), strict=True)
    lines = (position + color if known else position for position, color, known in rows)
    return "".join("v " + " ".join(map(repr, line)) + "\n" for line in lines)


def _format_faces(mesh: ControlMesh) -> list[str]:
    """Format the faces in order, with an ``o``, ``g`` or ``usemtl`` wherever the name changes."""
    indices = mesh.face_indices[:, None] + 1
    corner = " %d"
    if mesh.uv_indices is not None:
        indices = np.column_stack([indices, mesh.uv_indices + 1])
        corner = " %d/%d"
    named = [
        ("o", mesh.face_objects, mesh.object_names),
        ("g", mesh.face_groups, mesh.group_names),
        ("usemtl", mesh.face_materials, mesh.material_names),
    ]
    labels = [(keyword, numbers, names) for keyword, numbers, names in named if numbers is not None and mesh.n_faces]
    changes = [np.flatnonzero(np.diff(numbers)) + 1 for _, numbers, _ in labels]
    runs = np.unique(np.concatenate([[0, mesh.n_faces], *changes])).astype(np.int64)
    patterns = {size: "f" + corner * size + "\n" for size in np.unique(mesh.face_sizes).tolist()}
    sizes = mesh.face_sizes.tolist()
    parts = []
    for first, last in zip(runs[:-1].tolist(), runs[1:].tolist(), strict=True):
        for keyword, numbers, names in labels:
            name = names[numbers[first]]
            changed = not first or numbers[first] != numbers[first - 1]
            # Faces above the first statement are those without a name.
            if changed and (first or name or len(names) == 1):
                parts.append(f"{keyword} {name}\n")
        pattern = "".join([patterns[size] for size in sizes[first:last]])
        numbers_here = indices[mesh.face_offsets[first] : mesh.face_offsets[last]]
        parts.append(pattern % tuple(numbers_here.ravel().tolist()))
    return parts
