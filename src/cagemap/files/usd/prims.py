"""Content of USD mesh prims: UV sets and other primvars as arrays, face subsets, blend shapes."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.usd.shader_inputs import bound_material, color_uv_name, setting_of
from cagemap.files.usd.stages import pxr
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import merged_corners, place_counts
from cagemap.numerics.arrays import FloatArray, IndexArray

logger = logging.getLogger(__name__)

# Names of attributes that hold skinning weights and blend shapes.
JOINT_WEIGHTS = "skel:jointWeights"
BLEND_SHAPE = "blendShape:"
# Interpolations of values by their place on a control mesh, see `place_counts`.
INTERPOLATIONS = {"vertices": "vertex", "faces": "uniform", "corners": "faceVarying"}
_PLACES = {"varying": "vertices"} | {interpolation: place for place, interpolation in INTERPOLATIONS.items()}
_LEFT_OUT = "%s: primvar %s of %s is left out: there are as many vertices; export it at vertices%s"


def read_value(attribute: Any) -> Any:
    """Value of an attribute or primvar: the default one, else that of its first time sample."""
    value = attribute.Get()
    return attribute.Get(pxr.Usd.TimeCode.EarliestTime()) if value is None else value


def bind_transform(prim: Any) -> FloatArray:
    """(4, 4) transform from a mesh's space to its skeleton's in the bind pose."""
    attribute = skinning_attribute(prim, "primvars:skel:geomBindTransform")
    return np.array(np.eye(4) if attribute is None else read_value(attribute), dtype=np.float64)


def skinning_attribute(prim: Any, name: str) -> Any:
    """The attribute of a prim or of the nearest prim above it that states one, as UsdSkel inherits; None without."""
    while prim:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            return attribute
        prim = prim.GetParent()
    return None


def index_array(values: Any) -> IndexArray:
    """An array of USD as indices; empty if absent."""
    return np.array([] if values is None else values, dtype=np.int64)


def uv_primvars(where: str, prim: Any) -> list[Any]:
    """Primvars with texture coordinates: those whose type says so, and pairs of floats that are named like a UV set.

    Such names are the usual ones and `color_uv_name`. The first one is ``st``, else the UV set of the material's colour
    image, else the first as listed.
    """
    color, primvars = color_uv_name(prim), []
    for primvar in pxr.UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        if is_uv_set(primvar, color):
            primvars.append(primvar)
        elif str(primvar.GetTypeName()).startswith("texCoord3"):
            text = "%s: texture coordinates %s have three components and are no UV set"
            logger.warning(text, where, primvar.GetPrimvarName())
    ranks = {color: 1, "st": 0}
    return sorted(primvars, key=lambda primvar: ranks.get(primvar.GetPrimvarName(), 2))


def is_uv_set(primvar: Any, color: str) -> bool:
    """Whether a primvar is a UV set; ``color``: the name of that of the material's colour image."""
    kind, name = str(primvar.GetTypeName()).removesuffix("[]"), primvar.GetPrimvarName()
    plain = kind in ("float2", "double2", "half2") and name in ("st", "uv", "UVMap", color)
    return (kind.startswith("texCoord2") or plain) and bool(primvar.HasValue())


def corner_values(where: str, control: ControlMesh, primvar: Any) -> tuple[FloatArray, IndexArray]:
    """Values of a primvar, and the row of values of each face corner, for any interpolation.

    If a file has a value for every corner, as Blender writes them, equal ones at a vertex are merged. Otherwise every
    face would be a UV island.
    """
    values, rows = _at_corners(where, control, primvar)
    if primvar.GetInterpolation() == "faceVarying" and not primvar.IsIndexed():
        return merged_corners(control.face_indices, values[rows])
    return values, rows


def _at_corners(where: str, control: ControlMesh, primvar: Any) -> tuple[FloatArray, IndexArray]:
    """Values of a primvar as stored, and the row of each face corner."""
    values, numbers, interpolation = primvar_values(where, primvar)
    values, owners = values.astype(np.float64), corner_rows(control, interpolation)
    if owners is None or len(numbers) <= owners.max():
        _refuse(where, primvar, f"got {len(numbers)} values of interpolation {interpolation!r}")
    if not np.isfinite(values).all():
        _refuse(where, primvar, "got values that are not numbers")
    return values, numbers[owners]


def display_colors(where: str, control: ControlMesh, prim: Any) -> tuple[str, FloatArray | None]:
    """Interpolation and linear colour and opacity (c, 4) of the face corners; None without, or with one for all."""
    api = pxr.UsdGeom.PrimvarsAPI(prim)
    color, opacity = map(api.FindPrimvarWithInheritance, ("displayColor", "displayOpacity"))
    interpolation = str(color.GetInterpolation()) if color.HasValue() and len(read_value(color)) else "constant"
    if interpolation == "constant":
        return interpolation, None
    values, rows = _at_corners(where, control, color)
    shares, share_rows = np.ones(1), np.zeros_like(rows)
    if opacity.HasValue() and len(read_value(opacity)):
        shares, share_rows = _at_corners(where, control, opacity)
    if values.shape[1:] != (3,) or shares.ndim != 1:
        _refuse(where, color, f"got colours of shape {values.shape} and opacities of shape {shares.shape}")
    return interpolation, np.column_stack([values[rows], shares[share_rows]])


def corner_rows(control: ControlMesh, interpolation: str) -> IndexArray | None:
    """(c,) row of every face corner in values of an interpolation; None if USD has no such interpolation."""
    rows = {
        "constant": np.zeros(len(control.face_indices), dtype=np.int64),
        "uniform": control.corner_faces,
        "varying": control.face_indices,
        "vertex": control.face_indices,
        "faceVarying": np.arange(len(control.face_indices)),
    }
    return rows.get(interpolation)


def primvar_arrays(where: str, control: ControlMesh, prim: Any) -> dict[str, NDArray[Any]]:
    """All numeric primvars but the mesh's UV sets, by name: a row for each control vertex, face or face corner.

    Constant primvars are left out, since they are no function on the mesh. Skinning weights have a column for each
    joint. With as many vertices as faces or corners, rows are taken for those of vertices: values of the corners of
    faces that share no vertex become that, others are left out with a warning.
    """
    taken = {uv_set.name for uv_set in control.all_uv_sets}
    counts = place_counts(control)
    arrays: dict[str, NDArray[Any]] = {}
    corners = _corners_of_vertices(control)
    for primvar, place in value_primvars(prim, taken):
        name, expected = primvar.GetPrimvarName(), counts[place]
        order = corners if place == "corners" else None
        if place != "vertices" and expected == control.n_vertices and order is None:
            logger.warning(_LEFT_OUT, where, name, place, " or corners" if place == "faces" else "")
            continue
        values, numbers, _ = primvar_values(where, primvar)
        if len(numbers) != expected:
            _refuse(where, primvar, f"got {len(numbers)} values where {expected} belong")
        arrays[name] = values[numbers if order is None else numbers[order]]
    return arrays | _weights(where, control, prim)


def value_primvars(prim: Any, taken: Collection[str]) -> Iterator[tuple[Any, str]]:
    """Numeric primvars of a prim that are not ``taken``, and the place of their values, see `place_counts`."""
    for primvar in pxr.UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        name, place = primvar.GetPrimvarName(), _PLACES.get(str(primvar.GetInterpolation()))
        if place is None or name in taken or name.startswith("skel:") or not primvar.HasValue():
            continue
        values = np.asarray(read_value(primvar))
        if values.dtype.kind in "iuf" and values.size and values.ndim <= 2:
            yield primvar, place


def _corners_of_vertices(control: ControlMesh) -> IndexArray | None:
    """(n,) the corner at each vertex if every vertex has one, else None."""
    if len(control.face_indices) != control.n_vertices:
        return None
    corners = np.argsort(control.face_indices, kind="stable")
    return corners if np.array_equal(control.face_indices[corners], np.arange(control.n_vertices)) else None


def primvar_values(where: str, primvar: Any) -> tuple[NDArray[Any], IndexArray, str]:
    """Values, the row of each element, and the interpolation; elements of several values become rows."""
    values = np.asarray(read_value(primvar))
    size = primvar.GetElementSize()
    if size > 1 and len(values) % size == 0:
        values = values.reshape(len(values) // size, -1)
    if values.dtype == np.float16:
        values = values.astype(np.float32)
    numbers = np.arange(len(values))
    if primvar.IsIndexed():
        numbers = index_array(primvar.GetIndices() or primvar.GetIndices(pxr.Usd.TimeCode.EarliestTime()))
        if len(numbers) and (numbers.min() < 0 or numbers.max() >= len(values)):
            _refuse(where, primvar, f"got indices from {numbers.min()} to {numbers.max()} into {len(values)} values")
    return values, numbers, str(primvar.GetInterpolation())


def _refuse(where: str, primvar: Any, found: str) -> None:
    raise FormatError(
        f"{where}: primvar {primvar.GetPrimvarName()}: expected a finite value for each element of its interpolation, "
        f"{found}. Export it again."
    )


def _weights(where: str, control: ControlMesh, prim: Any) -> dict[str, NDArray[Any]]:
    """``skel:jointWeights`` as a dense table (n, joints), in the order of the skeleton's joints if there is one."""
    stated_by = [skinning_attribute(prim, f"primvars:skel:{name}") for name in ("jointIndices", "jointWeights")]
    if None in stated_by:
        return {}
    indices, weights = map(pxr.UsdGeom.Primvar, stated_by)
    joints, rows, _ = primvar_values(where, indices)
    values, weight_rows, interpolation = primvar_values(where, weights)
    joints, values = joints.reshape(len(joints), -1)[rows], values.reshape(len(values), -1)[weight_rows]
    if interpolation == "constant":
        joints, values = (np.repeat(table[:1], control.n_vertices, axis=0) for table in (joints, values))
    if joints.shape != values.shape or len(joints) != control.n_vertices or (joints.size and joints.min() < 0):
        _refuse(where, weights, f"got tables of {joints.shape} joints and {values.shape} weights")
    joints, count = _skeleton_joint_numbers(where, weights, joints, prim)
    table = np.zeros((control.n_vertices, count))
    np.add.at(table, (np.arange(len(joints))[:, None], joints), values)
    return {JOINT_WEIGHTS: table}


def _skeleton_joint_numbers(where: str, weights: Any, joints: NDArray[Any], prim: Any) -> tuple[NDArray[Any], int]:
    """Joint numbers in the order of the bound skeleton, and its number of joints."""
    skeleton = pxr.UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
    joints_of_skeleton = list(skeleton.GetJointsAttr().Get() or []) if skeleton else []
    order = skinning_attribute(prim, "skel:joints")
    joints_of_mesh = list((order and order.Get()) or joints_of_skeleton)
    highest = int(joints.max(initial=0))
    if not joints_of_skeleton:
        return joints, highest + 1
    if highest >= len(joints_of_mesh) or any(joint not in joints_of_skeleton for joint in joints_of_mesh):
        _refuse(where, weights, f"got joint {highest} of {len(joints_of_mesh)}, or joints that the skeleton has not")
    return np.array([joints_of_skeleton.index(joint) for joint in joints_of_mesh], dtype=np.int64)[joints], len(
        joints_of_skeleton
    )


def blend_shapes(where: str, control: ControlMesh, prim: Any) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Offsets (n, 3) of all vertices by name of a blend shape, and offsets of normals of shapes that state them."""
    binding = pxr.UsdSkel.BindingAPI(prim)
    names = binding.GetBlendShapesAttr().Get() or []
    targets = binding.GetBlendShapeTargetsRel().GetTargets() if len(names) else []
    if len(names) != len(targets):
        raise FormatError(
            f"{where}: expected a target for each blend shape, got {len(names)} names and {len(targets)} targets. "
            "Export it again."
        )
    shapes, shape_normals = dict[str, FloatArray](), dict[str, FloatArray]()
    for name, target in zip(names, targets, strict=True):
        shape = pxr.UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(target))
        if not shape:
            raise FormatError(f"{where}: blend shape {name}: {target} is no blend shape. Export it again.")
        if shape.GetInbetweens():
            logger.warning("%s: blend shape %s: its in-betweens are left out", where, name)
        points = index_array(shape.GetPointIndicesAttr().Get())
        shapes[name] = _sparse_offsets(f"{where}: blend shape {name}", control, shape.GetOffsetsAttr().Get(), points)
        if normal_offsets := shape.GetNormalOffsetsAttr().Get():
            place = f"{where}: normals of blend shape {name}"
            shape_normals[name] = _sparse_offsets(place, control, normal_offsets, points)
    return shapes, shape_normals


def _sparse_offsets(where: str, control: ControlMesh, stored: Any, points: IndexArray) -> FloatArray:
    """(n, 3) offsets of all vertices from those of points; of all in order if ``points`` is empty."""
    offsets = np.asarray(stored or np.zeros((0, 3)), dtype=np.float64).reshape(-1, 3)
    numbers = points if len(points) else np.arange(len(offsets))
    in_range = not len(numbers) or 0 <= numbers.min() <= numbers.max() < control.n_vertices
    if len(numbers) != len(offsets) or not in_range or not np.isfinite(offsets).all():
        raise FormatError(
            f"{where}: expected one finite offset a point, got {len(offsets)} for {len(numbers)} points of "
            f"{control.n_vertices}. Export it again."
        )
    table = np.zeros((control.n_vertices, 3))
    table[numbers] = offsets
    return table


def face_sets(where: str, prim: Any, n_faces: int, labels: Mapping[str, str]) -> dict[str, Any]:
    """Materials of faces by bindings of the mesh and its subsets; other subsets become groups.

    A face in several groups gets one group with all their names, as in OBJ's ``g one two``.

    ``labels``: names of materials by path.
    """
    materials = np.full(n_faces, -1, dtype=np.int64)
    names: list[str] = []
    groups: list[tuple[str, IndexArray]] = []
    colors: list[FloatArray] = []

    def number(material: Any) -> int:
        path = material.GetPath().pathString
        name = labels.get(path, path)
        if name not in names:
            names.append(name)
            surface = material.ComputeSurfaceSource()[0]
            color = setting_of(surface, "diffuseColor", None) if surface else None
            colors.append(np.full(3, np.nan) if color is None else np.array(color, dtype=np.float64))
        return names.index(name)

    bound = bound_material(prim)
    if bound:
        materials[:] = number(bound)
    for subset in pxr.UsdGeom.Subset.GetAllGeomSubsets(pxr.UsdGeom.Imageable(prim)):
        faces = index_array(read_value(subset.GetIndicesAttr()))
        if subset.GetElementTypeAttr().Get() != "face" or not len(faces):
            continue
        if faces.min() < 0 or faces.max() >= n_faces:
            text = "%s: subset %s is left out: expected faces from 0 to %d, got %d to %d; export the mesh again"
            logger.warning(text, where, subset.GetPrim().GetName(), n_faces - 1, faces.min(), faces.max())
            continue
        material_of_subset = bound_material(subset.GetPrim())
        if material_of_subset and (not bound or material_of_subset.GetPath() != bound.GetPath()):
            materials[faces] = number(material_of_subset)
        elif subset.GetFamilyNameAttr().Get() != "materialBind":
            title = str(subset.GetPrim().GetDisplayName())
            is_word = title.split() == [title]  # one with blanks would be several groups
            groups.append((title if is_word else str(subset.GetPrim().GetName()), faces))
    result: dict[str, Any] = {}
    if names:
        unbound = materials < 0
        if unbound.any():
            materials[unbound] = len(names)
            names.append("")
            colors.append(np.full(3, np.nan))
        result |= {"face_materials": materials, "material_names": tuple(names), "material_colors": np.array(colors)}
    if groups:
        result |= _make_groups_disjoint(groups, n_faces)
    return result


def _make_groups_disjoint(groups: list[tuple[str, IndexArray]], n_faces: int) -> dict[str, Any]:
    """Disjoint groups from overlapping ones: the given names first, then combinations."""
    names, inside = [name for name, _ in groups], np.zeros((n_faces, len(groups)), dtype=np.bool_)
    for group, (_, faces) in enumerate(groups):
        inside[faces, group] = True
    _, first, which = np.unique(np.packbits(inside, axis=1), axis=0, return_index=True, return_inverse=True)
    titles = [" ".join(names[group] for group in np.flatnonzero(inside[face])) for face in first.tolist()]
    in_order = [titles[k] for k in np.argsort(first)]  # by the first face of each combination
    number_of = {title: number for number, title in enumerate(dict.fromkeys([*names, *in_order]))}
    numbers = np.array([number_of[title] for title in titles], dtype=np.int64)
    return {"face_groups": numbers[which.ravel()], "group_names": tuple(number_of)}


def faces_by_name(mesh: ControlMesh) -> list[tuple[str, IndexArray, FloatArray | None]]:
    """Name, faces and colour of every material; name and faces of every group.

    A face in a group of several words is in the group of each word, as in OBJ's ``g one two``.
    """
    listed: list[tuple[str, IndexArray, FloatArray | None]] = []
    if mesh.face_materials is not None:
        for number, name in enumerate(mesh.material_names):
            color = np.full(3, np.nan) if mesh.material_colors is None else mesh.material_colors[number]
            listed.append((name, np.flatnonzero(mesh.face_materials == number), color))
    if mesh.face_groups is not None:
        words = [name.split() for name in mesh.group_names]
        for word in dict.fromkeys(one for of_group in words for one in of_group):
            inside = np.array([word in of_group for of_group in words])
            listed.append((word, np.flatnonzero(inside[mesh.face_groups]), None))
    return [(name, faces, color) for name, faces, color in listed if name and len(faces)]


def transform_points(points: FloatArray, matrix: FloatArray) -> FloatArray:
    """(n, 3) points transformed by a (4, 4) matrix of USD, for points as rows."""
    return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])
