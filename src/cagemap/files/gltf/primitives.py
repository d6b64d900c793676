"""Meshes of glTF as arrays: faces of all primitives, with weights, shapes and normals of vertices."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cagemap.files.gltf.binary import NGONS, STARTS, corners_from
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.text import make_distinct, whole_characters
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import join_meshes
from cagemap.numerics.arrays import FloatArray, IndexArray, encode_srgb, offsets_of, shown

_log = logging.getLogger(__name__)

TRIANGLES, STRIP, FAN = 4, 5, 6
_LINES = (0, 1, 2, 3)  # points and lines
# Sets of four influences of a vertex; files have one or two.
_MOST_SETS = 8


@dataclass(frozen=True, eq=False)
class VertexArrays:
    """A mesh as stored: in object space, vertices split at seams."""

    control: ControlMesh  # triangles, or polygons, with materials, UV sets and colours
    # (n, q) numbers in the skin's list of joints; no columns without skinning
    joints: IndexArray = field(repr=False)
    weights: FloatArray = field(repr=False)  # (n, q)
    shapes: dict[str, FloatArray] = field(repr=False)  # offsets (n, 3) by name
    normals: FloatArray | None = field(default=None, repr=False)  # (n, 3)
    shape_normals: dict[str, FloatArray] = field(default_factory=dict, repr=False)  # offsets (n, 3) by name of a shape
    colors: FloatArray | None = field(default=None, repr=False)  # (n, 4) linear, with opacity
    shape_weights: dict[str, float] = field(default_factory=dict, repr=False)  # at rest, by name


def material_names(document: Document) -> tuple[str, ...]:
    """Unique names of all materials; unnamed ones are called by their number."""
    return document.unique_names("materials", "material")


def node_shapes(document: Document, node: int) -> tuple[str, ...]:
    """`shape_names` of all morph targets of a node's mesh; a primitive without them does not move."""
    number = int(document.entry("nodes", node)["mesh"])
    primitives = document.entries("primitives", document.entry("meshes", number))
    return shape_names(document, number, max(len(document.entries("targets", one)) for one in primitives))


def shape_names(document: Document, number: int, count: int) -> tuple[str, ...]:
    """Unique names of a mesh's morph targets, or numbers.

    They are ``targetNames`` of the mesh's extras, else those of its first primitive (early VRM), else names of
    accessors.
    """
    mesh = document.entry("meshes", number)
    first = next((one for one in document.entries("primitives", mesh) if isinstance(one, dict)), {})
    named = next(filter(None, (_stated_names(entry, count) for entry in (mesh, first))), ())
    return make_distinct(named or _accessor_names(document, first, count) or [f"shape {n}" for n in range(count)])


def _stated_names(entry: dict[str, Any], count: int) -> list[str]:
    """``targetNames`` of the extras of a mesh or primitive; none if they are not names of all targets."""
    extras = entry.get("extras")
    stated = extras.get("targetNames") if isinstance(extras, dict) else None
    words = [word for word in stated[:count] if isinstance(word, str)] if isinstance(stated, list) else []
    return [whole_characters(word) for word in words] if len(words) == count else []


def _accessor_names(document: Document, primitive: dict[str, Any], count: int) -> list[str]:
    """Names of the accessors of a primitive's morph targets; none if they are not all different."""
    targets = document.entries("targets", primitive)
    words = [document.name("accessors", target["POSITION"]) for target in targets if "POSITION" in target]
    return words if all(words) and len(set(words)) == count else []


def read_vertex_arrays(document: Document, number: int, name: str) -> VertexArrays | None:
    """A mesh of a document; None if it has no triangles.

    Primitives with the same attributes share vertices.
    """
    where = f"meshes {number}"
    primitives = document.entries("primitives", document.entry("meshes", number), where)
    groups: dict[str, list[dict[str, Any]]] = {}
    for primitive in primitives:
        if primitive.get("mode", TRIANGLES) in _LINES:
            _log.warning("%s: points and lines of %s are left out", document.file, name)
            continue
        groups.setdefault(repr((primitive.get("attributes"), primitive.get("targets"))), []).append(primitive)
    read = [_group(document, where, number, group, name) for group in groups.values()]
    read = [arrays for arrays in read if arrays.control.n_faces]
    if not read:
        return None
    if len(read) == 1:
        return read[0]
    width = max(arrays.joints.shape[1] for arrays in read)
    sizes = [arrays.control.n_vertices for arrays in read]
    normals = [arrays.normals for arrays in read if arrays.normals is not None]
    colored = any(arrays.colors is not None for arrays in read)
    white = (
        np.ones((size, 4)) if arrays.colors is None else arrays.colors for arrays, size in zip(read, sizes, strict=True)
    )
    return VertexArrays(
        join_meshes([arrays.control for arrays in read]),
        np.concatenate([np.pad(arrays.joints, ((0, 0), (0, width - arrays.joints.shape[1]))) for arrays in read]),
        np.concatenate([np.pad(arrays.weights, ((0, 0), (0, width - arrays.weights.shape[1]))) for arrays in read]),
        join_offsets([arrays.shapes for arrays in read], sizes),
        np.concatenate(normals) if len(normals) == len(read) else None,
        join_offsets([arrays.shape_normals for arrays in read], sizes) if len(normals) == len(read) else {},
        np.concatenate(list(white)) if colored else None,
    )


def join_offsets(offsets: Sequence[Mapping[str, FloatArray]], sizes: Sequence[int]) -> dict[str, FloatArray]:
    """Offsets by name of several groups of vertices as one; 0 where a group has none."""
    names = dict.fromkeys(name for of_group in offsets for name in of_group)
    return {
        name: np.concatenate(
            [of_group.get(name, np.zeros((size, 3))) for of_group, size in zip(offsets, sizes, strict=True)]
        )
        for name in names
    }


def _group(document: Document, where: str, number: int, group: list[dict[str, Any]], name: str) -> VertexArrays:
    """Arrays of primitives that have the same attributes."""
    attributes = document.table(group[0], "attributes", where)
    if "POSITION" not in attributes:
        document.refuse(where, "has a primitive without positions")
    positions = read_accessor(document, attributes["POSITION"], f"{where}: POSITION", ("VEC3",)).astype(np.float64)
    count = len(positions)

    def read(attribute: str, *shapes: str) -> Any:
        place = f"{where}: {attribute}"
        return read_accessor(document, attributes[attribute], place, shapes, count).astype(np.float64)

    sizes, corners = zip(*(_faces(document, where, primitive, count) for primitive in group), strict=True)
    offsets = offsets_of(np.concatenate(sizes))
    control = ControlMesh(positions, offsets, np.concatenate(corners), scheme=Plain(), name=name)
    counts = [len(primitive_sizes) for primitive_sizes in sizes]
    control = _with_materials(document, where, control, [primitive.get("material") for primitive in group], counts)
    sets = sorted(attribute for attribute in attributes if attribute.startswith("TEXCOORD_"))
    # glTF counts v from the top.
    uvs = (read(attribute, "VEC2") * [1.0, -1.0] + [0.0, 1.0] for attribute in sets)
    indices = control.face_indices
    control = control.with_uv_sets([UvSet(name, one, indices) for name, one in zip(sets, uvs, strict=True)])
    colors = read("COLOR_0", "VEC3", "VEC4") if "COLOR_0" in attributes else None
    if colors is not None:
        control = replace(control, vertex_colors=encode_srgb(colors[:, :3]))
        colors = np.column_stack([colors, np.ones((count, 4 - colors.shape[1]))])
    joints, weights = [np.zeros((count, 0))], [np.zeros((count, 0))]
    for set_number in range(_MOST_SETS):
        if {f"JOINTS_{set_number}", f"WEIGHTS_{set_number}"} <= set(attributes):
            joints.append(read(f"JOINTS_{set_number}", "VEC4"))
            weights.append(read(f"WEIGHTS_{set_number}", "VEC4"))
    return VertexArrays(
        control,
        np.concatenate(joints, axis=1).astype(np.int64),
        np.concatenate(weights, axis=1),
        _shapes(document, where, number, group[0], count, "POSITION"),
        read("NORMAL", "VEC3") if "NORMAL" in attributes else None,
        _shapes(document, where, number, group[0], count, "NORMAL") if "NORMAL" in attributes else {},
        colors,
    )


def _shapes(
    document: Document, where: str, number: int, primitive: dict[str, Any], count: int, attribute: str
) -> dict[str, FloatArray]:
    """Offsets (n, 3) of an attribute, by name of a morph target that has positions."""
    targets = document.entries("targets", primitive, where)
    shapes = {}
    for name, target in zip(shape_names(document, number, len(targets)), targets, strict=True):
        if {"POSITION", attribute} <= set(target):
            offsets = read_accessor(document, target[attribute], f"{where}: shape {name}", ("VEC3",), count)
            shapes[name] = offsets.astype(np.float64)
    return shapes


def _with_materials(
    document: Document, where: str, control: ControlMesh, stated: list[Any], counts: list[int]
) -> ControlMesh:
    if all(material is None for material in stated):
        return control
    names, used = material_names(document), list(dict.fromkeys(stated))
    return replace(
        control,
        face_materials=np.repeat([used.index(material) for material in stated], counts),
        material_names=tuple("" if material is None else names[material] for material in used),
        material_colors=np.array([_color(document, material, where) for material in used]),
    )


def _color(document: Document, material: int | None, where: str) -> list[float]:
    """Linear colour of a material; NaN if it states none."""
    entry = {} if material is None else document.entry("materials", material, where)
    factor = document.table(entry, "pbrMetallicRoughness", where).get("baseColorFactor")
    return [np.nan] * 3 if factor is None else document.numbers(factor, f"{where}: color", 4)[:3].tolist()


def _faces(document: Document, where: str, primitive: dict[str, Any], count: int) -> tuple[IndexArray, IndexArray]:
    """Sizes (m,) of a primitive's faces, and vertices (c,) of their corners; polygons if the primitive marks them."""
    triangles = _triangles(document, where, primitive, count)
    begins = np.ones(len(triangles), dtype=bool)
    polygons = NGONS in document.table(primitive, "extensions", where)
    if polygons:
        begins[1:] = (triangles[1:, 0] != triangles[:-1, 0]) | (triangles[1:, 1] != triangles[:-1, 2])
    sizes = 2 + np.diff(np.append(np.flatnonzero(begins), len(triangles)))
    corners = triangles[np.column_stack([begins, begins, np.ones(len(triangles), dtype=bool)])]
    extras = primitive.get("extras")
    stated = extras.get(STARTS) if polygons and isinstance(extras, dict) else None
    if stated is None:
        return sizes, corners
    try:
        rows = np.asarray(stated)
    except ValueError:  # lists of different lengths
        rows = np.zeros(0)
    whole = rows.dtype.kind == "i" and rows.ndim == 2 and rows.shape[1] == 2 and rows.min() >= 0
    if not whole or rows[:, 0].max() >= len(sizes) or (rows[:, 1] >= sizes[rows[:, 0]]).any():
        document.refuse(where, f"expected faces and their corners as {STARTS}, got {shown(stated)}")
    starts = np.zeros(len(sizes), dtype=np.int64)
    starts[rows[:, 0]] = -rows[:, 1]
    return sizes, corners[corners_from(offsets_of(sizes), starts)]


def _triangles(document: Document, where: str, primitive: dict[str, Any], count: int) -> IndexArray:
    """(t, 3) vertices; strips and fans as separate triangles, without degenerate ones of strips."""
    stated = primitive.get("indices")
    if stated is None:
        indices = np.arange(count)
    else:
        indices = read_accessor(document, stated, f"{where}: indices", ("SCALAR",))
        if indices.dtype.kind != "i" or indices.min() < 0 or indices.max() >= count:
            document.refuse(where, f"expected indices of its {count} vertices, got {indices.min()} to {indices.max()}")
    mode = document.whole(primitive.get("mode", TRIANGLES), f"{where}: mode", TRIANGLES, FAN)
    if mode == TRIANGLES:
        if len(indices) % 3:
            document.refuse(where, f"expected three indices a triangle, got {len(indices)}")
        return indices.reshape(-1, 3)
    if mode == FAN:
        faces = np.column_stack([np.full(max(len(indices) - 2, 0), indices[0]), indices[1:-1], indices[2:]])
    else:
        faces = np.column_stack([indices[:-2], indices[1:-1], indices[2:]])
        faces[1::2, :2] = faces[1::2, 1::-1]
    apart = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return np.asarray(faces[apart])
