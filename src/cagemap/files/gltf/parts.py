"""Mesh nodes of a glTF scene as parts of a character: in the bind pose, in world space, welded at seams."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from cagemap.character.values import Part
from cagemap.errors import FormatError
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.nodes import (
    Joints,
    Nodes,
    Skin,
    is_invertible,
    nearest_joint,
    read_joints,
    read_nodes,
    read_skin,
    snap_to_exact,
)
from cagemap.files.gltf.primitives import VertexArrays, node_shapes, read_vertex_arrays
from cagemap.files.text import make_distinct
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import merged_corners, reversed_corners
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import extract_faces
from cagemap.mesh.plain import turn_faces
from cagemap.mesh.weld import weld_mesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import normalize_rows

_log = logging.getLogger(__name__)

_INSTANCES = "EXT_mesh_gpu_instancing"


@dataclass(frozen=True, eq=False)
class ReadPart:
    """A mesh node as a part of a character."""

    part: Part
    node: int  # its number in the document
    stored: int  # number of vertices in the file
    notes: tuple[str, ...] = field(repr=False)  # notes on welded vertices


@dataclass(frozen=True, eq=False)
class Scene:
    """Nodes, joints and parts of a document."""

    document: Document
    nodes: Nodes
    joints: Joints | None
    parts: tuple[ReadPart, ...]


def read_scene(document: Document, *, props: bool = False) -> Scene:
    """Mesh nodes of the displayed scene as parts, and the joints of all skins.

    Skinned meshes are in their bind pose; as glTF demands, their node's transform is ignored. A joint that a
    later skin binds in another pose gets a joint below it. A mesh below a joint follows that joint.
    ``props``: nodes of meshes that move by themselves are joints, also without a skin.
    """
    nodes = read_nodes(document)
    skins = tuple(read_skin(document, nodes, number) for number in range(len(document.entries("skins"))))
    joints = read_joints(document, nodes, skins, props=props)
    parts = []
    with_mesh = [node for node in nodes.order if document.entry("nodes", node).get("mesh") is not None]
    if hidden := [nodes.names[node] for node in with_mesh if node not in nodes.in_scene]:
        text = "%s: left out meshes that its scene %d does not show: %s; export them in one scene to keep them"
        _log.warning(text, document.file, document.json.get("scene", 0), first_few(hidden))
    for node in with_mesh:
        entry = document.entry("nodes", node)
        if node not in nodes.in_scene:
            continue
        name = nodes.names[node] if entry.get("name") else document.name("meshes", int(entry["mesh"]))
        arrays = read_vertex_arrays(document, int(entry["mesh"]), name or nodes.names[node])
        if _INSTANCES in document.table(entry, "extensions", f"nodes {node}"):
            text = "%s: the copies of %s by %s are left out; export each copy as a node of its own to keep it"
            _log.warning(text, document.file, name or nodes.names[node], _INSTANCES)
        if arrays is not None:
            arrays = replace(arrays, shape_weights=_shape_weights(document, node))
            part = _part_in_world(document, nodes, skins, joints, node, arrays)
            parts += [] if part is None else [part]
    if not parts:
        raise FormatError(f"{document.file}: expected triangles in the scene, got none. Export it with its meshes.")
    names = make_distinct([read_part.part.name for read_part in parts])
    for number, (name, one) in enumerate(zip(names, parts, strict=True)):
        parts[number] = replace(one, part=replace(one.part, name=name, mesh=replace(one.part.mesh, name=name)))
    return Scene(document, nodes, joints, tuple(parts))


def _shape_weights(document: Document, node: int) -> dict[str, float]:
    """Stated weights of a node's blend shapes; none if they are not those of all shapes."""
    entry, names = document.entry("nodes", node), node_shapes(document, node)
    stated = entry.get("weights", document.entry("meshes", entry["mesh"]).get("weights"))
    if not names or not isinstance(stated, list) or len(stated) != len(names):
        return {}
    return dict(zip(names, document.numbers(stated, f"nodes {node}: weights", len(names)).tolist(), strict=True))


def _part_in_world(
    document: Document, nodes: Nodes, skins: tuple[Skin, ...], joints: Joints | None, node: int, arrays: VertexArrays
) -> ReadPart | None:
    """A mesh node as a part in world space; None if it is scaled to nothing."""
    skin_number = document.entry("nodes", node).get("skin")
    weights, to_world = None, nodes.world[node]
    if skin_number is not None and joints is not None:
        skin, rig_joints = skins[skin_number], joints.of_skins[skin_number]
        if arrays.joints.shape[1]:  # a skinned node without joint attributes stays where it is
            weights = _weights(document, arrays, rig_joints, joints, node)
            to_world = skin.to_world
    elif joints is not None and (above := nearest_joint(nodes, joints.joint_of, node)) >= 0:
        count = arrays.control.n_vertices
        weights = sparse.csr_array(
            (np.ones(count), (np.arange(count), np.full(count, above))), shape=(count, len(joints.rig.names))
        )
        rest = nodes.world[np.flatnonzero(joints.joint_of == above)[0]]
        if is_invertible(rest[None]).all():  # the joint in the bind pose instead of the file's
            in_bind_pose = to_world @ np.linalg.inv(rest) @ joints.rig.bind[above]
            to_world = snap_to_exact(in_bind_pose, to_world, _homogeneous_rows(arrays))
    if abs(np.linalg.det(to_world[:3, :3])) < 1e-12 * max(np.abs(to_world[:3, :3]).max(), 1e-30) ** 3:
        _log.warning("%s: %s is scaled to nothing and left out", document.file, arrays.control.name)
        return None
    return _weld_part(_vertices_in_world(arrays, to_world), weights, node)


def _weights(document: Document, arrays: VertexArrays, of: IndexArray, joints: Joints, node: int) -> sparse.csr_array:
    """(n, j) weights of the rig's joints, from the skin's joints ``of``; vertices without any follow the first one."""
    used = arrays.weights > 0.0
    numbers = np.where(used, arrays.joints, 0)
    if numbers.max(initial=0) >= len(of) or numbers.min(initial=0) < 0:
        document.refuse(f"nodes {node}", f"expected weights of the {len(of)} joints of its skin, got others")
    values = np.where(used, arrays.weights, 0.0)
    sums = values.sum(axis=1)
    loose = sums <= 0.0
    values[loose, 0] = 1.0
    values /= np.where(loose, 1.0, sums)[:, None]
    if loose.any():
        _log.warning(
            "%s: %d vertices of %s have no weights and follow %s",
            *(document.file, int(loose.sum()), arrays.control.name, joints.rig.names[of[0]]),
        )
    rows = np.repeat(np.arange(len(values)), values.shape[1])
    columns = of[numbers.ravel()]
    table = sparse.csr_array((values.ravel(), (rows, columns)), shape=(len(values), len(joints.rig.names)))
    table.sum_duplicates()
    table.eliminate_zeros()
    return table


def _homogeneous_rows(arrays: VertexArrays) -> FloatArray:
    return np.column_stack([arrays.control.positions, np.ones(arrays.control.n_vertices)])


def _vertices_in_world(arrays: VertexArrays, to_world: FloatArray) -> VertexArrays:
    if np.array_equal(to_world, np.eye(4)):
        return arrays
    placed, linear = _homogeneous_rows(arrays) @ to_world, to_world[:3, :3]
    shapes = {name: offsets @ linear for name, offsets in arrays.shapes.items()}
    if not np.isfinite(placed).all() or np.abs(placed).max() > 1e100:
        raise FormatError(f"{arrays.control.name}: expected places of a moderate size, got others. Export it again.")
    normals, shape_normals = arrays.normals, arrays.shape_normals
    if normals is not None:
        shape_normals = {name: transform_offsets(offsets, normals, linear) for name, offsets in shape_normals.items()}
        normals = transform_normals(normals, linear)
    control = arrays.control.with_positions(placed[:, :3])
    if np.linalg.det(linear) < 0.0:
        control = turn_faces(control, np.ones(control.n_faces, dtype=bool))
    return replace(arrays, control=control, shapes=shapes, normals=normals, shape_normals=shape_normals)


def transform_part(part: Part, matrix: FloatArray) -> Part:
    """The part transformed by a (4, 4) matrix for points as rows; its faces are reversed if this mirrors it."""
    linear = matrix[:3, :3]
    mesh, normals, colors = part.mesh.with_positions(part.mesh.positions @ linear + matrix[3, :3]), None, part.colors
    shape_normals = part.shape_normals
    if part.normals is not None:
        normals = transform_normals(part.normals, linear)
        shape_normals = {n: transform_offsets(one, part.normals, linear) for n, one in shape_normals.items()}
    if np.linalg.det(linear) < 0.0:
        corners = reversed_corners(mesh.face_offsets)
        mesh = turn_faces(mesh, np.ones(mesh.n_faces, dtype=bool))
        normals, colors = (None if one is None else one[corners] for one in (normals, colors))
        shape_normals = {name: offsets[corners] for name, offsets in shape_normals.items()}
    shapes = {name: offsets @ linear for name, offsets in part.shapes.items()}
    return replace(part, mesh=mesh, shapes=shapes, normals=normals, shape_normals=shape_normals, colors=colors)


def transform_normals(normals: FloatArray, linear: FloatArray) -> FloatArray:
    """Normals (n, 3) of a surface after its points, as rows, are multiplied by (3, 3) or (n, 3, 3)."""
    return normalize_rows(_multiply_by_cofactors(normals, linear))


def transform_offsets(offsets: FloatArray, normals: FloatArray, linear: FloatArray) -> FloatArray:
    """Offsets (n, 3) of normals (n, 3), divided by the lengths that `transform_normals` divides the normals by."""
    lengths = np.linalg.norm(_multiply_by_cofactors(normals, linear), axis=1, keepdims=True)
    return _multiply_by_cofactors(offsets, linear) / np.where(lengths > 0.0, lengths, 1.0)


def _multiply_by_cofactors(vectors: FloatArray, linear: FloatArray) -> FloatArray:
    """Vectors (n, 3), as rows, times |det| and the inverse transpose: normals of a surface under uneven scales."""
    cofactors = np.cross(linear[..., [1, 2, 0], :], linear[..., [2, 0, 1], :])
    signs = np.sign(np.linalg.det(linear))[..., None, None]
    rows = "na,ab->nb" if linear.ndim == 2 else "na,nab->nb"
    return np.asarray(np.einsum(rows, vectors, signs * cofactors))


def _weld_part(arrays: VertexArrays, weights: sparse.csr_array | None, node: int) -> ReadPart:
    """The part with copies of a vertex welded; weights and offsets are those of the first copy."""
    given = arrays.control
    offsets = np.column_stack(list(arrays.shapes.values())) if arrays.shapes else None
    # Welding keeps UVs: another set has the stored vertex of every corner.
    numbers = np.column_stack([np.arange(given.n_vertices, dtype=np.float64), np.zeros(given.n_vertices)])
    sets = (*given.all_uv_sets, UvSet("", numbers, given.face_indices))
    welded = weld_mesh(given.with_uv_sets(sets), offsets=offsets)
    mesh = welded.mesh
    if mesh.file_vertices is None:
        mesh = extract_faces(mesh, np.arange(mesh.n_faces))
    kept = mesh.file_vertices
    assert kept is not None
    *others, last = mesh.all_uv_sets
    stored = last.uvs[last.uv_indices, 0].astype(np.int64)
    # Equal texture coordinates of a vertex are merged, so that a hard edge alone makes no UV seam.
    merged = ((one.name, merged_corners(mesh.face_indices, one.uvs[one.uv_indices])) for one in others)
    mesh = mesh.with_uv_sets([UvSet(name, *uvs) for name, uvs in merged])
    part = Part(
        given.name,
        mesh,
        None if weights is None else weights[kept],
        {name: shape[kept] for name, shape in arrays.shapes.items()},
        None if arrays.normals is None else arrays.normals[stored],
        {name: offsets[stored] for name, offsets in arrays.shape_normals.items()},
        None if arrays.colors is None else arrays.colors[stored],
        arrays.shape_weights,
    )
    return ReadPart(part, node, given.n_vertices, welded.notes if mesh.file_copies is not None else ())
