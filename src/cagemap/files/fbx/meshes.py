"""Meshes of FBX scenes as control meshes, with weights and blend shapes; access to objects of ufbx.

ufbx 0.0.5 counts too few references to its Python objects: an object that is asked for twice is freed while in use.
So all objects are kept until the process ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import ufbx
from numpy.typing import ArrayLike
from scipy import sparse

from cagemap.character.values import Part
from cagemap.errors import FormatError
from cagemap.files.gltf.nodes import is_invertible
from cagemap.files.gltf.parts import transform_normals
from cagemap.files.text import make_distinct
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import reversed_corners
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray, IndexArray, decode_srgb, joined_runs

_EVERYTHING: list[Any] = []


def keep_alive(value: Any) -> Any:
    """The value itself, kept alive until the process ends."""
    _EVERYTHING.append(value)
    return value


def get(value: Any, *names: str) -> Any:
    """A nested attribute: of ``value``, then of the result, and so on."""
    for name in names:
        value = keep_alive(getattr(value, name))
    return value


def list_attribute(value: Any, *names: str) -> list[Any]:
    """A nested attribute as a Python list."""
    listed: list[Any] = keep_alive(list(get(value, *names)))
    return listed


def finite_array(values: ArrayLike, where: str) -> FloatArray:
    """Numbers as an array; refused if single precision cannot hold them."""
    array = np.array(values, dtype=np.float64)
    if not (np.abs(array) <= np.finfo(np.float32).max).all():
        raise FormatError(f"{where} with numbers that are too large or not finite")
    return array


def vector_attribute(value: Any, *names: str, columns: int) -> FloatArray:
    """A nested attribute that lists vectors, as an array (n, columns)."""
    return np.array(get(value, *names), dtype=np.float64).reshape(-1, columns)


def index_attribute(value: Any, *names: str) -> IndexArray:
    """A nested attribute that lists whole numbers, as an array (n,)."""
    return np.array(get(value, *names), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class FbxMesh:
    """A mesh in the space of its node, with skinning weights and blend shapes."""

    # vertices are the control points of the file; ``material_names`` has a name for each material slot
    part: Part
    bones: tuple[int, ...] = ()  # ``typed_id`` of the node of each joint
    # (j, 4, 4) from the mesh's space to each joint's, for points as rows
    inverse_bind: FloatArray = field(default_factory=lambda: np.zeros((0, 4, 4)), repr=False)
    channels: tuple[Any, ...] = ()  # the blend channel of each shape


def node_name(node: Any) -> str:
    """Name of a node; a child that ufbx adds to hold the mesh (a scale helper) has the name instead of the node."""
    if get(node, "is_scale_helper"):
        node = get(node, "parent")
    elif get(node, "scale_helper") is not None and get(node, "scale_helper", "mesh") is not None:
        return ""
    return str(get(node, "name"))


def read_fbx_mesh(node: Any, note: Callable[[str], None]) -> FbxMesh | None:
    """The mesh of a node, in the node's space; None if it has no polygons."""
    mesh, name = get(node, "mesh"), node_name(node)
    placed = row_matrix(get(node, "geometry_to_node"))
    faces = index_attribute(mesh, "faces").reshape(-1, 2)
    kept = faces[:, 1] >= 3
    if not kept.any():
        return None
    begins, sizes = faces[kept].T
    offsets, corners = joined_runs(begins, sizes)
    if np.linalg.det(placed[:3, :3]) < 0.0:
        corners = corners[reversed_corners(offsets)]
    points = index_attribute(mesh, "vertex_indices")
    control = ControlMesh(
        finite_array(
            vector_attribute(mesh, "vertices", columns=3) @ placed[:3, :3] + placed[3, :3], f"mesh {name}: positions"
        ),
        offsets,
        points[corners],
        scheme=Plain(),
        name=name,
    )
    slots = index_attribute(mesh, "face_material")
    if len(slots) and list_attribute(mesh, "materials"):
        names = tuple(f"slot {slot}" for slot in range(int(slots[kept].max()) + 1))
        control = replace(control, face_materials=slots[kept], material_names=names)
    if loose := control.n_vertices - len(np.unique(control.face_indices)):
        vertices = count_noun(loose, "vertex")
        note(f"{name}: {vertices} of no face left out; later vertices have other numbers than in the file")
    sets = []
    for uv_set in list_attribute(mesh, "uv_sets"):
        uvs, title = get(uv_set, "vertex_uv"), get(uv_set, "name")
        values = finite_array(vector_attribute(uvs, "values", columns=2), f"mesh {name}: UVs {title}")
        sets.append(UvSet(title, values, index_attribute(uvs, "indices")[corners]))
    control = control.with_uv_sets(sets)
    creased = [get(mesh, "edge_crease"), get(mesh, "vertex_crease", "values")]
    if any(np.any(np.array(one, dtype=np.float64) > 0.0) for one in creased if len(one)):
        note(f"{name}: creases are left out; OBJ and USD files keep them")
    shapes = _shapes(mesh, control, placed[:3, :3], note)
    normals, colors = (_corner_values(get(mesh, what), corners) for what in ("vertex_normal", "vertex_color"))
    if normals is not None:
        bad = ~np.isfinite(normals.sum(axis=1))
        if bad.any():
            note(f"{name}: {bad.sum()} normals are not finite and are computed from the faces")
        normals = transform_normals(np.where(bad[:, None], 0.0, normals), placed[:3, :3])
    if colors is not None:
        colors = finite_array(colors, f"mesh {name}: colors").clip(0.0, 1.0)
        colors[:, :3] = decode_srgb(colors[:, :3])
    offsets_of_shapes = {word: offsets for word, (offsets, _) in shapes.items()}
    stated = finite_array([get(channel, "weight") for _, channel in shapes.values()], f"mesh {name}: amounts of shapes")
    weights = dict(zip(shapes, stated.tolist(), strict=True)) if stated.any() else {}
    part = Part(name, control, shapes=offsets_of_shapes, normals=normals, colors=colors, shape_weights=weights)
    return _with_skin(mesh, FbxMesh(part, channels=tuple(channel for _, channel in shapes.values())), note)


def _corner_values(values: Any, corners: IndexArray) -> FloatArray | None:
    """An attribute of the face corners as an array (c, columns); None if the mesh lacks it."""
    if not get(values, "exists"):
        return None
    table: FloatArray = np.array(get(values, "values"), dtype=np.float64)
    return table[index_attribute(values, "indices")[corners]]


def _shapes(
    mesh: Any, control: ControlMesh, linear: FloatArray, note: Callable[[str], None]
) -> dict[str, tuple[FloatArray, Any]]:
    """Offsets at full weight, and the channel, of every blend shape by name."""
    channels = [
        one for deformer in list_attribute(mesh, "blend_deformers") for one in list_attribute(deformer, "channels")
    ]
    channels = [one for one in channels if list_attribute(one, "keyframes")]
    shapes = {}
    for name, channel in zip(make_distinct([get(one, "name") or "shape" for one in channels]), channels, strict=True):
        *between, full = list_attribute(channel, "keyframes")
        if between:
            note(f"{control.name}: shape {name} has {len(between)} shapes in between, which are left out")
        shape, amount = get(full, "shape"), float(get(full, "target_weight")) or 1.0
        offsets = np.zeros((control.n_vertices, 3))
        moved = vector_attribute(shape, "position_offsets", columns=3) @ linear / amount
        moved = finite_array(moved, f"mesh {control.name}: shape {name}")
        offsets[_vertices(shape, "offset_vertices", control)] = moved
        shapes[name] = offsets, channel
    return shapes


def _with_skin(mesh: Any, made: FbxMesh, note: Callable[[str], None]) -> FbxMesh:
    skins = [skin for skin in list_attribute(mesh, "skin_deformers") if list_attribute(skin, "clusters")]
    if not skins:
        return made
    name, control = made.part.name, made.part.mesh
    if len(skins) > 1:
        note(f"{name}: has {len(skins)} skins, the first is used")
    if get(skins[0], "skinning_method") >= ufbx.SkinningMethod.DUAL_QUATERNION:
        note(f"{name}: is skinned by dual quaternions, which become linear")
    clusters = [cluster for cluster in list_attribute(skins[0], "clusters") if get(cluster, "bone_node") is not None]
    if not clusters:
        return made
    stated, matrices = [], {}
    for cluster in clusters:
        bone, matrix = get(cluster, "bone_node"), row_matrix(get(cluster, "mesh_node_to_bone"))
        if get(bone, "is_scale_helper"):  # ufbx gives a joint a child for scales that its children do not inherit
            bone, matrix = get(bone, "parent"), matrix @ row_matrix(get(bone, "node_to_parent"))
        stated.append(get(bone, "typed_id"))
        matrices[stated[-1]] = matrix
    bones = tuple(dict.fromkeys(stated))
    vertices = [_vertices(cluster, "vertices", control) for cluster in clusters]
    columns = np.repeat([bones.index(bone) for bone in stated], [len(listed) for listed in vertices])
    stated_weights = [get(cluster, "weights") for cluster in clusters]
    values = finite_array(np.concatenate(stated_weights), f"mesh {name}: skinning weights")
    shape = control.n_vertices, len(bones)
    weights = sparse.csr_array((np.maximum(values, 0.0), (np.concatenate(vertices), columns)), shape=shape)
    weights.sum_duplicates()
    weights.eliminate_zeros()
    inverse = finite_array([matrices[bone] for bone in bones], f"mesh {name}: bind pose of the skin")
    kept = is_invertible(inverse) | (weights.sum(axis=0) > 0.0)
    if not kept.all():
        left = count_noun(int((~kept).sum()), "joint")
        note(f"{name}: {left} without weights left out of its skin; their bind matrices have no inverse")
    joints = np.flatnonzero(kept)
    if not len(joints):
        return made
    of_joints = tuple(bones[joint] for joint in joints)
    part = replace(made.part, weights=weights[:, joints])
    return replace(made, part=part, bones=of_joints, inverse_bind=inverse[joints])


def _vertices(value: Any, name: str, control: ControlMesh) -> IndexArray:
    """Vertices that a skin or shape lists, checked, since ufbx does not."""
    vertices = index_attribute(value, name)
    if vertices.size and (vertices.min() < 0 or vertices.max() >= control.n_vertices):
        raise FormatError(f"{control.name}: a skin or shape of {control.n_vertices} vertices lists {vertices.max()}")
    return vertices


def row_matrix(matrix: Any) -> FloatArray:
    """A matrix of ufbx as (4, 4), for points as rows."""
    return np.column_stack([np.array(list(matrix), dtype=np.float64), [0.0, 0.0, 0.0, 1.0]])
