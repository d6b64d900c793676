"""Writer of a USD mesh prim: topology, UV sets, subsets, primvars, weights and blend shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.usd.prims import INTERPOLATIONS, faces_by_name
from cagemap.files.usd.results import define_material
from cagemap.files.usd.stages import identifiers, pxr
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import place_counts, place_of_rows
from cagemap.mesh.schemes import scheme_name
from cagemap.numerics.arrays import FloatArray, IndexArray, decode_srgb

# Interpolation of values at face corners.
CORNERS = "faceVarying"


def write_topology(prim: Any, mesh: ControlMesh, colors: FloatArray | None = None) -> None:
    """Write points, faces, subdivision, creases and vertex colours of a mesh.

    ``colors``: linear, with opacity (c, 4), of the face corners; in place of those of vertices.
    """
    points = pxr.Vt.Vec3fArray.FromNumpy(mesh.positions.astype(np.float32))
    prim.CreatePointsAttr(points)
    prim.CreateExtentAttr(pxr.UsdGeom.PointBased.ComputeExtent(points))
    prim.CreateFaceVertexCountsAttr(_ints(mesh.face_sizes))
    prim.CreateFaceVertexIndicesAttr(_ints(mesh.face_indices))
    scheme = mesh.scheme
    prim.CreateSubdivisionSchemeAttr("none" if scheme is None else _camel_case(scheme_name(scheme)))
    if scheme is not None:
        prim.CreateInterpolateBoundaryAttr(_camel_case(scheme.boundary))
        prim.CreateFaceVaryingLinearInterpolationAttr(_camel_case(scheme.uv_interpolation))
        prim.CreateTriangleSubdivisionRuleAttr(_camel_case(scheme.triangles))
    if mesh.crease_edges is not None and mesh.crease_sharpness is not None and len(mesh.crease_edges):
        prim.CreateCreaseIndicesAttr(_ints(mesh.crease_edges.ravel()))
        prim.CreateCreaseLengthsAttr(_ints(np.full(len(mesh.crease_edges), 2)))
        prim.CreateCreaseSharpnessesAttr(_floats(mesh.crease_sharpness))
    if mesh.corner_vertices is not None and mesh.corner_sharpness is not None and len(mesh.corner_vertices):
        prim.CreateCornerIndicesAttr(_ints(mesh.corner_vertices))
        prim.CreateCornerSharpnessesAttr(_floats(mesh.corner_sharpness))
    if mesh.hole_faces is not None and len(mesh.hole_faces):
        prim.CreateHoleIndicesAttr(_ints(mesh.hole_faces))
    if colors is not None:
        of_corners = np.ascontiguousarray(colors[:, :3], dtype=np.float32)
        prim.CreateDisplayColorPrimvar(CORNERS).Set(pxr.Vt.Vec3fArray.FromNumpy(of_corners))
        if (colors[:, 3] < 1.0).any():
            prim.CreateDisplayOpacityPrimvar(CORNERS).Set(_floats(colors[:, 3]))
    elif mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        color = prim.CreateDisplayColorPrimvar("vertex")
        linear = decode_srgb(np.clip(mesh.vertex_colors, 0.0, 1.0))
        color.Set(pxr.Vt.Vec3fArray.FromNumpy(linear.astype(np.float32)))


def _camel_case(word: str) -> str:
    """A word of cagemap's schemes, such as "edge_and_corner", as USD writes it."""
    first, *following = re.split("[_-]", word)
    return first + "".join(part.capitalize() for part in following)


def write_uvs(prim: Any, name: str, uvs: FloatArray, indices: IndexArray) -> None:
    """Write a UV set as a primvar."""
    api = pxr.UsdGeom.PrimvarsAPI(prim)
    primvar = api.CreatePrimvar(name, pxr.Sdf.ValueTypeNames.TexCoord2fArray, CORNERS)
    primvar.Set(pxr.Vt.Vec2fArray.FromNumpy(uvs.astype(np.float32)))
    primvar.SetIndices(_ints(indices))


def write_subsets(stage: Any, prim: Any, mesh: ControlMesh, materials: Mapping[str, Any] | None = None) -> None:
    """Write materials as face subsets with material bindings, and groups as face subsets.

    ``materials``: materials of the stage by name; one on all faces is bound to the mesh, without a subset. Default: new
        materials with the mesh's colours.
    """
    named = faces_by_name(mesh)
    labels = identifiers(name for name, _, _ in named)
    for label, (name, faces, color) in zip(labels, named, strict=True):
        if color is None or materials is None or len(faces) < mesh.n_faces:
            family = "materialBind" if color is not None else "groups"
            subset = pxr.UsdGeom.Subset.CreateUniqueGeomSubset(prim, label, "face", _ints(faces), family)
            bound = subset.GetPrim()
            bound.SetDisplayName(name)
        else:
            bound = prim.GetPrim()
        if color is None:
            continue
        if materials is None:
            material, surface = define_material(stage, f"/Asset/materials/{label}")
            material.GetPrim().SetDisplayName(name)
            if np.isfinite(color).all():
                value = pxr.Gf.Vec3f(*map(float, color))
                surface.CreateInput("diffuseColor", pxr.Sdf.ValueTypeNames.Color3f).Set(value)
        else:
            material = materials[name]
        pxr.UsdShade.MaterialBindingAPI.Apply(bound).Bind(material)
    if mesh.face_materials is not None:
        pxr.UsdGeom.Subset.SetFamilyType(prim, "materialBind", "nonOverlapping")
        pxr.UsdGeom.Scope.Define(stage, "/Asset/materials")


def interpolation(mesh: ControlMesh, count: int, place: str | None = None) -> str | None:
    """USD interpolation of an array with a number of rows; None if it does not fit the mesh.

    ``place``: "vertices", "faces" or "corners"; by default the first with as many places as rows.
    """
    place = place_of_rows(mesh, count) if place is None else place
    return INTERPOLATIONS[place] if place_counts(mesh).get(place) == count else None


def write_primvar(prim: Any, mesh: ControlMesh, name: str, values: NDArray[Any], place: str | None = None) -> None:
    """Write values with a row for each vertex, face or face corner, see `interpolation`, as a primvar."""
    kind_of_rows = interpolation(mesh, len(values), place)
    if kind_of_rows is None:
        raise ParameterError(
            f"{name}: expected a row for each vertex, face or face corner, got {len(values)}. "
            "Give the values of this mesh."
        )
    table: NDArray[Any] = values.reshape(len(values), -1)
    names = pxr.Sdf.ValueTypeNames
    integral = table.dtype.kind in "iu"
    kinds = {2: (names.Float2Array, pxr.Vt.Vec2fArray), 3: (names.Float3Array, pxr.Vt.Vec3fArray)}
    dtype: Any = np.float32
    kind, array = names.FloatArray, pxr.Vt.FloatArray
    if integral:
        dtype = next(t for t in (np.int32, np.int64, np.uint64) if (table.astype(t) == table).all())
        word = {np.int32: "Int", np.int64: "Int64", np.uint64: "UInt64"}[dtype] + "Array"
        kind, array = getattr(names, word), getattr(pxr.Vt, word)
    size = table.shape[1]
    flat: NDArray[Any] = table.astype(dtype)
    if size in kinds and not integral:
        kind, array = kinds[size]
        kind = names.Color3fArray if name == "displayColor" and size == 3 else kind
        size = 1
    else:
        flat = flat.ravel()
    primvar = pxr.UsdGeom.PrimvarsAPI(prim).CreatePrimvar(name, kind, kind_of_rows, size)
    primvar.Set(array.FromNumpy(np.ascontiguousarray(flat)))


def write_weights(prim: Any, table: FloatArray) -> None:
    """Write weights (n, joints), normalised to sum to 1; vertices without any follow the first joint.

    Without weights they would be skinned to the skeleton's origin.
    """
    table = np.where(table.any(axis=1, keepdims=True), table, np.eye(1, table.shape[1]))
    kept = int((table > 0).sum(axis=1).max(initial=1))
    joints = np.argsort(-table, axis=1, kind="stable")[:, :kept]
    weights = np.take_along_axis(table, joints, axis=1)
    weights = weights / weights.sum(axis=1, keepdims=True)
    binding = pxr.UsdSkel.BindingAPI.Apply(prim)
    binding.CreateJointIndicesPrimvar(False, kept).Set(_ints(joints.ravel()))
    binding.CreateJointWeightsPrimvar(False, kept).Set(_floats(weights.ravel()))


def write_blend_shapes(stage: Any, prim: Any, shapes: Mapping[str, FloatArray]) -> None:
    """Define blend shapes as children of a mesh prim; offsets of 0 are left out."""
    binding = pxr.UsdSkel.BindingAPI.Apply(prim)
    taken = [child.GetName() for child in prim.GetChildren() if not child.IsA(pxr.UsdSkel.BlendShape)]
    paths = [prim.GetPath().AppendChild(label) for label in identifiers(shapes, taken)]
    for path, offsets in zip(paths, shapes.values(), strict=True):
        shape = pxr.UsdSkel.BlendShape.Define(stage, path)
        changed = np.flatnonzero(np.any(offsets != 0, axis=1))
        shape.CreateOffsetsAttr(pxr.Vt.Vec3fArray.FromNumpy(offsets[changed].astype(np.float32)))
        shape.CreatePointIndicesAttr(_ints(changed))
    binding.CreateBlendShapesAttr(list(shapes))
    binding.CreateBlendShapeTargetsRel().SetTargets(paths)


def _ints(values: Any) -> Any:
    return pxr.Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def _floats(values: Any) -> Any:
    return pxr.Vt.FloatArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))
