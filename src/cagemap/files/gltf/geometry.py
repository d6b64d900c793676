"""Control meshes as meshes of glTF: fans of triangles, a primitive for each material, vertices split at seams.

Seams are those of UVs and of hard edges. Polygons are marked (FB_ngon_encoding) for programs that support it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from cagemap.character.normals import normal_groups
from cagemap.character.values import Part
from cagemap.files.gltf.binary import NGONS, STARTS, VERTICES, Binary, corners_from
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.numerics.arrays import IndexArray, decode_srgb
from cagemap.surface.alignment import Z_UP, nearest_axis_rotation
from cagemap.surface.triangles import fan_triangles, normalize_rows, vertex_normals


def mesh_entry(binary: Binary, part: Part, materials: Sequence[int | None]) -> dict[str, Any]:
    """Entry of ``meshes`` for a part; adds its arrays to ``binary``.

    Creases and colours that are not finite are not written; glTF has no place for them. All influences of joints are
    written, in sets of four. Without normals of its own, the part gets vertex normals.

    ``materials``: number in the document of each material of the mesh.
    """
    mesh, normals, colors = part.mesh, part.normals, part.colors
    sets = uv_sets_in_order(mesh)
    hard = [] if normals is None else [normal_groups(mesh, normals)]
    for of_corners in (colors, *part.shape_normals.values()):
        if of_corners is not None:  # the number of each row's value among the distinct rows
            hard.append(np.unique(of_corners, axis=0, return_inverse=True)[1].ravel().astype(np.int64))
    first, numbers = _split([mesh.face_indices, *(uv_set.uv_indices for uv_set in sets), *hard])
    numbers_of = np.zeros(mesh.n_faces, dtype=np.int64) if mesh.face_materials is None else mesh.face_materials
    polygons = bool((mesh.face_sizes != 3).any())
    starts = np.zeros(mesh.n_faces, dtype=np.int64)
    if polygons:
        starts = _fan_starts(mesh, numbers, np.argsort(numbers_of, kind="stable"))
        binary.extensions.add(NGONS)
    corners, corner_faces = fan_triangles(mesh.face_offsets, corners_from(mesh.face_offsets, starts))
    triangles, vertices = numbers[corners], mesh.face_indices[first]
    smooth = vertex_normals(mesh.positions, mesh.face_indices[corners])[vertices]
    stated = smooth if normals is None else normalize_rows(normals[first])
    written = np.where(np.any(stated != 0.0, axis=1, keepdims=True), stated, smooth)
    written[~written.any(axis=1)] = [0.0, 0.0, 1.0]
    attributes = {
        "POSITION": binary.accessor(mesh.positions[vertices].astype("<f4"), VERTICES, bounds=True),
        "NORMAL": binary.accessor(written.astype("<f4"), VERTICES),
    }
    for number, uv_set in enumerate(sets):
        # glTF counts v from the top.
        uvs = uv_set.uvs[uv_set.uv_indices[first]] * [1.0, -1.0] + [0.0, 1.0]
        attributes[f"TEXCOORD_{number}"] = binary.accessor(uvs.astype("<f4"), VERTICES)
    if colors is not None:
        columns = 3 if (colors[:, 3] == 1.0).all() else 4
        attributes["COLOR_0"] = binary.accessor(colors[first, :columns].astype("<f4"), VERTICES)
    elif mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        of_vertices = decode_srgb(np.clip(mesh.vertex_colors[vertices], 0.0, 1.0))
        attributes["COLOR_0"] = binary.accessor(of_vertices.astype("<f4"), VERTICES)
    if part.weights is not None:
        attributes |= _skinning(binary, part.weights[vertices])
    common: dict[str, Any] = {"attributes": attributes} | ({"extensions": {NGONS: {}}} if polygons else {})
    if part.shapes:
        common["targets"] = [{"POSITION": binary.offsets(offsets[vertices])} for offsets in part.shapes.values()]
        for name, target in zip(part.shapes, common["targets"], strict=True):
            if name in part.shape_normals:
                target["NORMAL"] = binary.offsets(part.shape_normals[name][first])
    primitives = []
    for number in np.unique(numbers_of[corner_faces]).tolist():
        chosen = triangles[numbers_of[corner_faces] == number].ravel()
        primitive = common | {"indices": binary.indices(chosen)}
        own_starts = starts[numbers_of == number]
        if own_starts.any():
            turned = np.flatnonzero(own_starts)
            primitive["extras"] = {STARTS: np.column_stack([turned, own_starts[turned]]).tolist()}
        material = materials[number] if mesh.face_materials is not None else None
        primitives.append(primitive if material is None else primitive | {"material": material})
    entry: dict[str, Any] = {"primitives": primitives}
    if part.shapes:
        entry["extras"] = {"targetNames": list(part.shapes)}
    if part.shapes and part.shape_weights:
        entry["weights"] = [part.shape_weights.get(name, 0.0) for name in part.shapes]
    return entry


def _fan_starts(mesh: ControlMesh, numbers: IndexArray, order: IndexArray) -> IndexArray:
    """(m,) corner at which each face's fan begins: consecutive fans have different first vertices."""
    first = mesh.face_offsets[:-1]
    moved = order[1::2]
    heads = np.append(numbers[first[order[::2]]], -1)
    choice = numbers[first[moved][:, None] + np.arange(3)]
    free = (choice != heads[: len(moved), None]) & (choice != heads[1 : len(moved) + 1, None])
    starts = np.zeros(mesh.n_faces, dtype=np.int64)
    starts[moved] = free.argmax(axis=1)
    return starts


def uv_sets_in_order(mesh: ControlMesh) -> list[UvSet]:
    """All UV sets, sorted by their names of glTF if all have such names."""
    sets = [] if mesh.uvs is None else list(mesh.all_uv_sets)
    named = all(one.name.startswith("TEXCOORD_") for one in sets)
    return sorted(sets, key=lambda one: (len(one.name), one.name)) if named else sets


# From Z up to Y up, for points as rows.
Z_TO_Y = np.block([[Z_UP, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]])


def is_z_up(mesh: ControlMesh) -> bool:
    """Whether +Z is the axis of a mesh nearest to its file's up axis."""
    return mesh.upright is not None and np.array_equal(nearest_axis_rotation(mesh.upright), Z_UP)


def _split(indices: Sequence[IndexArray]) -> tuple[IndexArray, IndexArray]:
    """A corner (n,) of each written vertex, and the vertex (c,) of each corner; split where any index differs."""
    keys = np.zeros(len(indices[0]), dtype=np.int64)
    for index in indices:
        keys = np.unique(keys * (int(index.max(initial=0)) + 1) + index, return_inverse=True)[1].astype(np.int64)
    _, first = np.unique(keys, return_index=True)
    return first, keys


def _skinning(binary: Binary, weights: sparse.csr_array) -> dict[str, int]:
    """Attributes of weights (n, j): the largest first, in sets of four."""
    counts = np.diff(weights.indptr)
    rows = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((-weights.data, rows))
    rank = np.arange(len(rows)) - weights.indptr[rows]
    columns = 4 * max(1, -(-int(counts.max(initial=1)) // 4))
    joints, values = np.zeros((len(counts), columns), dtype=np.int64), np.zeros((len(counts), columns))
    joints[rows, rank], values[rows, rank] = weights.indices[order], weights.data[order]
    values = (values / np.maximum(values.sum(axis=1, keepdims=True), 1e-30)).astype("<f4")
    joints[values == 0.0] = 0
    kind = "u1" if weights.shape[1] <= 256 else "<u2"
    attributes = {}
    for number in range(columns // 4):
        four = slice(4 * number, 4 * number + 4)
        attributes[f"JOINTS_{number}"] = binary.accessor(joints[:, four].astype(kind), VERTICES)
        attributes[f"WEIGHTS_{number}"] = binary.accessor(values[:, four], VERTICES)
    return attributes
