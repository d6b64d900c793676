"""Writer of USD: a mesh as a file of its own, or results as a layer over the target's file."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.character.joints import Skeleton
from cagemap.errors import FormatError, ParameterError
from cagemap.files.atomic import atomic_path
from cagemap.files.ownership import mark
from cagemap.files.text import text_name
from cagemap.files.usd.prims import BLEND_SHAPE, JOINT_WEIGHTS, is_mirrored, local_to_world, moved, named_faces
from cagemap.files.usd.read import identifiers, open_stage, usd_modules
from cagemap.files.usd.results import add_earlier, bind_textures, define_material
from cagemap.files.usd.skeleton import write_usd_skeleton
from cagemap.files.usd.space import StageSpace
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import reversed_corners
from cagemap.mesh.schemes import scheme_name
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.srgb import decode_srgb

_CORNERS = "faceVarying"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class UsdResults:
    """Transferred results for a mesh prim."""

    # image by map name, such as ``albedo`` or ``roughness``, with ``<UDIM>`` for a set; relative to the layer
    textures: Mapping[str, str] = field(default_factory=dict)
    # values by name, with a row for each vertex, face or face corner; ``skel:jointWeights`` and ``blendShape:NAME``
    # become skinning and blend shapes
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    points: FloatArray | None = None  # (n, 3) new positions of the vertices
    uvs: tuple[str, FloatArray, IndexArray] | None = None  # name, values and indices of a new UV set
    skeleton: Skeleton | None = None  # joints of the weights, in the order of their columns

    def with_reversed_corners(self, mesh: ControlMesh) -> UsdResults:
        """The results for a mesh whose faces were reversed when it was read."""
        order = reversed_corners(mesh.face_offsets)
        attributes = {n: v[order] if _rows(mesh).get(len(v)) == _CORNERS else v for n, v in self.attributes.items()}
        uvs = None if self.uvs is None else (*self.uvs[:2], self.uvs[2][order])
        return replace(self, attributes=attributes, uvs=uvs)

    def through(self, matrix: FloatArray) -> UsdResults:
        """The results with positions and directions transformed by a (4, 4) matrix of USD."""
        turn = matrix[:3, :3]
        attributes = {n: v @ turn if n.startswith(BLEND_SHAPE) else v for n, v in self.attributes.items()}
        skeleton = self.skeleton
        if skeleton is not None:
            axes = None if skeleton.axes is None else skeleton.axes @ turn
            heads, tails = (moved(ends, matrix) for ends in (skeleton.heads, skeleton.tails))
            skeleton = replace(skeleton, heads=heads, tails=tails, axes=axes)
        points = None if self.points is None else moved(self.points, matrix)
        return replace(self, attributes=attributes, points=points, skeleton=skeleton)


def write_usd(
    path: str | Path,
    mesh: ControlMesh,
    results: UsdResults = UsdResults(),
    *,
    space: StageSpace | None = None,
    force: bool = False,
    add: bool = False,
) -> bool:
    """Write a control mesh, or a refined one, as a USD file of its own: ``/Asset/mesh``.

    A mesh with a scheme is a subdivision surface, one without is polygons (``none``). Without a ``space`` the file
    states metres with Y up. With ``add``, earlier results of cagemap in the file are kept; returns whether there were
    any.
    """
    file = Path(path)
    check_usd_path(file)
    pxr = usd_modules()
    stage = new_stage(space or StageSpace("Y", 1.0), "SkelRoot" if _needs_skeleton(results) else "Xform")
    prim = pxr.UsdGeom.Mesh.Define(stage, "/Asset/mesh")
    if mesh.scheme is not None and mesh.scheme.creasing != "uniform":
        text = "%s: creasing %s has no place in USD and is left out: creases of uneven sharpness come out otherwise"
        _log.warning(text, file, mesh.scheme.creasing)
    write_topology(prim, mesh)
    if mesh.uvs is not None:
        names = identifiers((uv_set.name or "st" for uv_set in mesh.all_uv_sets), ("displayColor", "normals"))
        sets = [replace(uv_set, name=name) for uv_set, name in zip(mesh.all_uv_sets, names, strict=True)]
        mesh = replace(mesh, uv_name=names[0], uv_sets=tuple(sets[1:]))
        for uv_set in sets:
            write_uvs(prim, uv_set.name, uv_set.uvs, uv_set.uv_indices)
    write_subsets(stage, prim, mesh)
    _write_results(stage, prim.GetPrim(), mesh, results)
    return _save(stage.GetRootLayer(), file, ("/Asset/mesh",) if add else (), force=force)


def new_stage(space: StageSpace, kind: str) -> Any:
    """A stage in memory with the default prim ``/Asset`` of a type."""
    pxr = usd_modules()
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageUpAxis(stage, space.up_axis)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, space.meters_per_unit)
    root = stage.DefinePrim("/Asset", kind)
    stage.SetDefaultPrim(root)
    if not np.array_equal(space.to_world, np.eye(4)):
        pxr.UsdGeom.Xformable(root).AddTransformOp().Set(pxr.Gf.Matrix4d(*space.to_world.ravel().tolist()))
    return stage


def write_usd_over(
    path: str | Path,
    target: str | Path,
    prim_paths: Sequence[str],
    mesh: ControlMesh,
    results: UsdResults,
    *,
    world: bool = False,
    force: bool = False,
) -> bool:
    """Write results as a layer over the target's file, which is not changed; pipelines compose the two.

    Earlier results of cagemap for this target in the layer are kept; returns whether there were any.

    ``path``: the layer to write; it refers to the target by a relative path.
    ``target``: USD file of the mesh.
    ``prim_paths``: the mesh's prim in it; textures are bound to each of several.
    ``world``: whether the mesh was read in world space instead of the prim's local space.
    """
    file = Path(path)
    check_usd_path(file)
    pxr = usd_modules()
    target_stage = open_stage(target)
    prims = [target_stage.GetPrimAtPath(prim_path) for prim_path in prim_paths]
    for prim, prim_path in zip(prims, prim_paths, strict=True):
        if not prim or not prim.IsA(pxr.UsdGeom.Mesh):
            raise FormatError(f"{target}: expected a mesh prim {prim_path}, there is none. Match again with this file.")
    # Relative paths of an unsaved layer have no folder: meanwhile the sublayer is named by its absolute path.
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths.append(str(Path(target).resolve()))
    stage = pxr.Usd.Stage.Open(layer)
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.GetStageUpAxis(target_stage))
    pxr.UsdGeom.SetStageMetersPerUnit(stage, pxr.UsdGeom.GetStageMetersPerUnit(target_stage))
    for name in ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond"):  # of animations
        if target_stage.HasAuthoredMetadata(name):
            stage.SetMetadata(name, target_stage.GetMetadata(name))
    top = prims[0].GetPath().GetPrefixes()[0]
    layer.defaultPrim = (target_stage.GetDefaultPrim() or target_stage.GetPrimAtPath(top)).GetName()
    if _needs_skeleton(results) and not any(p.IsA(pxr.UsdSkel.Root) for p in _ancestors(prims[0])):
        if prims[0].GetPath() == top:
            text = "%s: %s is the topmost prim; USD poses only meshes below a SkelRoot: put it below such a prim"
            _log.warning(text, target, top)
        else:
            stage.OverridePrim(top).SetTypeName("SkelRoot")
    for prim, prim_path in zip(prims, prim_paths, strict=True):
        for above in _ancestors(prim):
            if above.IsInstance():  # prims below an instance cannot be overridden
                stage.OverridePrim(above.GetPath()).SetInstanceable(False)
        to_world = local_to_world(prim)
        local_results = (
            results.through(np.asarray(np.linalg.inv(to_world), dtype=np.float64))
            if world and len(prim_paths) == 1
            else results
        )
        left_handed = pxr.UsdGeom.Mesh(prim).GetOrientationAttr().Get() == "leftHanded"
        if len(prim_paths) == 1 and left_handed != (world and is_mirrored(to_world)):
            local_results = local_results.with_reversed_corners(mesh)
        to_root = to_world @ np.linalg.inv(local_to_world(target_stage.GetPrimAtPath(top)))
        _write_results(stage, stage.OverridePrim(prim_path), mesh, local_results, to_root)
    del stage  # otherwise it searches the sublayer relative to the unsaved layer, and warns
    layer.subLayerPaths = [Path(os.path.relpath(Path(target).resolve(), file.resolve().parent)).as_posix()]
    return _save(layer, file, prim_paths, force=force)


def _ancestors(prim: Any) -> list[Any]:
    ancestors = []
    while prim and not prim.IsPseudoRoot():
        ancestors.append(prim)
        prim = prim.GetParent()
    return ancestors


def check_usd_path(file: Path, *, package: bool = False) -> None:
    """Refuse a name without a suffix of USD layers (or packages), or one that is not UTF-8."""
    text_name(file.absolute())
    if file.suffix.lower() not in (".usd", ".usda", ".usdc", *((".usdz",) if package else ())):
        remedy = "Give such a name." if package else "Packages (.usdz) are made from those."
        raise FormatError(f"{file}: expected a name ending in .usda, .usdc{', .usdz' * package} or .usd. {remedy}")


def _save(layer: Any, file: Path, added_to: Sequence[str], *, force: bool) -> bool:
    """Write a layer, with earlier results for the meshes ``added_to``; returns whether there were any."""
    kept = bool(added_to) and add_earlier(layer, file, added_to, force=force)
    with atomic_path(file, force=force) as temporary:
        export_layer(layer, file, temporary)
    return kept


def export_layer(layer: Any, file: Path, temporary: Path) -> None:
    """Write a layer with cagemap's mark under the temporary name of a file; ``.usd`` as text."""
    layer.comment = mark()
    arguments = {"format": "usda"} if file.suffix.lower() == ".usd" else {}
    try:
        written = layer.Export(str(temporary), args=arguments)
    except usd_modules().Tf.ErrorException:
        written = False
    if not written:
        raise FormatError(f"{file}: cannot be written. Check the folder and the space left on the disk.")


def write_topology(prim: Any, mesh: ControlMesh) -> None:
    """Write points, faces, subdivision, creases and vertex colours of a mesh."""
    pxr = usd_modules()
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
    if mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        color = prim.CreateDisplayColorPrimvar("vertex")
        linear = decode_srgb(np.clip(mesh.vertex_colors, 0.0, 1.0))
        color.Set(pxr.Vt.Vec3fArray.FromNumpy(linear.astype(np.float32)))


def _camel_case(word: str) -> str:
    """A word of cagemap's schemes, such as "edge_and_corner", as USD writes it."""
    first, *following = re.split("[_-]", word)
    return first + "".join(part.capitalize() for part in following)


def write_uvs(prim: Any, name: str, uvs: FloatArray, indices: IndexArray) -> None:
    """Write a UV set as a primvar."""
    pxr = usd_modules()
    api = pxr.UsdGeom.PrimvarsAPI(prim)
    primvar = api.CreatePrimvar(name, pxr.Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    primvar.Set(pxr.Vt.Vec2fArray.FromNumpy(uvs.astype(np.float32)))
    primvar.SetIndices(_ints(indices))


def write_subsets(stage: Any, prim: Any, mesh: ControlMesh, materials: Mapping[str, Any] | None = None) -> None:
    """Write materials as subsets with bindings, and groups as plain subsets.

    ``materials``: materials of the stage by name, of which one on all faces needs no subset; default: new ones with the
        mesh's colours.
    """
    pxr = usd_modules()
    named = named_faces(mesh)
    labels = identifiers(name for name, _, _ in named)
    for label, (name, faces, color) in zip(labels, named, strict=True):
        if color is None or materials is None or len(faces) < mesh.n_faces:
            family = "materialBind" if color is not None else "groups"
            subset = pxr.UsdGeom.Subset.CreateUniqueGeomSubset(prim, label, "face", _ints(faces), family)
            bound = subset.GetPrim()
        else:
            bound = prim.GetPrim()
        if color is None:
            continue
        path = f"/Asset/materials/{label}"
        material = _colored_material(stage, path, color) if materials is None else materials[name]
        pxr.UsdShade.MaterialBindingAPI.Apply(bound).Bind(material)
    if mesh.face_materials is not None:
        pxr.UsdGeom.Subset.SetFamilyType(prim, "materialBind", "nonOverlapping")
        pxr.UsdGeom.Scope.Define(stage, "/Asset/materials")


def _colored_material(stage: Any, path: str, color: FloatArray) -> Any:
    pxr = usd_modules()
    material, surface = define_material(stage, path)
    if np.isfinite(color).all():
        value = pxr.Gf.Vec3f(*map(float, color))
        surface.CreateInput("diffuseColor", pxr.Sdf.ValueTypeNames.Color3f).Set(value)
    return material


def _write_results(
    stage: Any, prim: Any, mesh: ControlMesh, results: UsdResults, to_root: FloatArray | None = None
) -> None:
    pxr = usd_modules()
    geometry = pxr.UsdGeom.Mesh(prim)
    if results.points is not None:
        if results.points.shape != (mesh.n_vertices, 3):
            raise ParameterError(
                f"points: expected ({mesh.n_vertices}, 3), got {results.points.shape}. Give a position for each vertex."
            )
        points = pxr.Vt.Vec3fArray.FromNumpy(results.points.astype(np.float32))
        geometry.CreatePointsAttr().Set(points)
        geometry.CreateExtentAttr().Set(pxr.UsdGeom.PointBased.ComputeExtent(points))
        for normals in (geometry.GetNormalsAttr(), prim.GetAttribute("primvars:normals")):
            if normals and normals.HasAuthoredValue():  # those of the target's shape: programs compute new ones
                normals.Block()
    uv_name = mesh.uv_name or "st"
    if results.uvs is not None:
        uv_name = results.uvs[0]
        write_uvs(prim, *results.uvs)
    # Names must stay unique after conversion, also among primvars of texture coordinates.
    taken = {primvar.GetPrimvarName() for primvar in pxr.UsdGeom.PrimvarsAPI(prim).GetPrimvars()} - set(
        results.attributes
    )
    labels = identifiers(results.attributes, {*taken, uv_name, *(uv_set.name for uv_set in mesh.uv_sets)})
    shapes = {}
    for label, (name, values) in zip(labels, results.attributes.items(), strict=True):
        if name == JOINT_WEIGHTS:
            write_weights(prim, np.asarray(values, dtype=np.float64))
        elif name.startswith(BLEND_SHAPE):
            shapes[name.removeprefix(BLEND_SHAPE)] = np.asarray(values, dtype=np.float64)
        else:
            _write_primvar(prim, mesh, label, np.asarray(values))
    if results.skeleton is not None:
        write_usd_skeleton(stage, prim, results.skeleton, np.eye(4) if to_root is None else to_root)
    if shapes:
        write_blend_shapes(stage, prim, shapes)
    if results.textures:
        bind_textures(stage, prim, results.textures, uv_name)


def _rows(mesh: ControlMesh) -> dict[int, str]:
    """Interpolation by number of rows; vertices have priority if numbers are equal."""
    return {len(mesh.face_indices): _CORNERS, mesh.n_faces: "uniform", mesh.n_vertices: "vertex"}


def _write_primvar(prim: Any, mesh: ControlMesh, name: str, values: NDArray[Any]) -> None:
    pxr = usd_modules()
    rows = _rows(mesh)
    if len(values) not in rows:
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
    primvar = pxr.UsdGeom.PrimvarsAPI(prim).CreatePrimvar(name, kind, rows[len(values)], size)
    primvar.Set(array.FromNumpy(np.ascontiguousarray(flat)))


def write_weights(prim: Any, table: FloatArray) -> None:
    """Write weights (n, joints), normalised to sum to 1; vertices without any follow the first joint.

    Without weights they would be skinned to the skeleton's origin.
    """
    pxr = usd_modules()
    table = np.where(table.any(axis=1, keepdims=True), table, np.eye(1, table.shape[1]))
    kept = int((table > 0).sum(axis=1).max(initial=1))
    joints = np.argsort(-table, axis=1, kind="stable")[:, :kept]
    weights = np.take_along_axis(table, joints, axis=1)
    weights = weights / weights.sum(axis=1, keepdims=True)
    binding = pxr.UsdSkel.BindingAPI.Apply(prim)
    binding.CreateJointIndicesPrimvar(False, kept).Set(_ints(joints.ravel()))
    binding.CreateJointWeightsPrimvar(False, kept).Set(_floats(weights.ravel()))


def write_blend_shapes(stage: Any, prim: Any, shapes: Mapping[str, FloatArray]) -> None:
    """Define blend shapes below a mesh, with the offsets that are not 0."""
    pxr = usd_modules()
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


def _needs_skeleton(results: UsdResults) -> bool:
    return any(name == JOINT_WEIGHTS or name.startswith(BLEND_SHAPE) for name in results.attributes)


def _ints(values: Any) -> Any:
    return usd_modules().Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def _floats(values: Any) -> Any:
    return usd_modules().Vt.FloatArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))
