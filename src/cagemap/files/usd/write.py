"""Writer of USD: a mesh as a file of its own, or results as a layer over the target's file."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.character.joints import Skeleton
from cagemap.errors import FormatError, ParameterError
from cagemap.files.atomic import atomic_path
from cagemap.files.gltf.geometry import is_z_up
from cagemap.files.ownership import mark
from cagemap.files.text import require_suffix, text_name
from cagemap.files.usd.prims import BLEND_SHAPE, JOINT_WEIGHTS, transform_points
from cagemap.files.usd.results import add_earlier, bind_textures
from cagemap.files.usd.skeleton import write_usd_skeleton
from cagemap.files.usd.space import StageSpace
from cagemap.files.usd.stages import identifiers, open_stage, pxr
from cagemap.files.usd.transforms import is_mirrored, local_to_world
from cagemap.files.usd.write_mesh import (
    CORNERS,
    interpolation,
    write_blend_shapes,
    write_primvar,
    write_subsets,
    write_topology,
    write_uvs,
    write_weights,
)
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import reversed_corners
from cagemap.numerics.arrays import FloatArray, IndexArray

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class UsdResults:
    """Transferred results for a mesh prim."""

    # image by map name, such as ``albedo`` or ``roughness``, with ``<UDIM>`` for a set; relative to the layer
    textures: Mapping[str, str] = field(default_factory=dict)
    # values by name, with a row for each vertex, face or face corner; ``skel:jointWeights`` and ``blendShape:NAME``
    # become skinning and blend shapes
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    # "vertices", "faces" or "corners" by name of an attribute, for its rows; by default their number decides
    places: Mapping[str, str] = field(default_factory=dict)
    points: FloatArray | None = None  # (n, 3) new positions of the vertices
    uvs: tuple[str, FloatArray, IndexArray] | None = None  # name, values and indices of a new UV set
    skeleton: Skeleton | None = None  # joints of the weights, in the order of their columns

    def with_reversed_corners(self, mesh: ControlMesh) -> UsdResults:
        """The results for a mesh whose faces were reversed when it was read."""
        order = reversed_corners(mesh.face_offsets)
        attributes = {
            name: values[order] if interpolation(mesh, len(values), self.places.get(name)) == CORNERS else values
            for name, values in self.attributes.items()
        }
        uvs = None if self.uvs is None else (*self.uvs[:2], self.uvs[2][order])
        return replace(self, attributes=attributes, uvs=uvs)

    def through(self, matrix: FloatArray) -> UsdResults:
        """The results with positions and directions transformed by a (4, 4) matrix of USD."""
        turn = matrix[:3, :3]
        attributes = {n: v @ turn if n.startswith(BLEND_SHAPE) else v for n, v in self.attributes.items()}
        skeleton = None if self.skeleton is None else self.skeleton.transformed(matrix)
        points = None if self.points is None else transform_points(self.points, matrix)
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
    states metres, and the mesh's up axis. With ``add``, earlier results of cagemap in the file are kept; returns
    whether there were any.
    """
    file = Path(path)
    check_usd_path(file)
    stage = new_stage(
        space or StageSpace("Z" if is_z_up(mesh) else "Y", 1.0), "SkelRoot" if _needs_skeleton(results) else "Xform"
    )
    prim = pxr.UsdGeom.Mesh.Define(stage, "/Asset/mesh")
    if mesh.scheme is not None and mesh.scheme.creasing != "uniform":
        text = "%s: creasing %s has no place in USD and is left out: creases of uneven sharpness come out otherwise"
        _log.warning(text, file, mesh.scheme.creasing)
    write_topology(prim, mesh)
    if mesh.uvs is not None:
        names = identifiers((uv_set.name or "st" for uv_set in mesh.all_uv_sets), ("displayColor", "normals"))
        sets = [replace(uv_set, name=name) for uv_set, name in zip(mesh.all_uv_sets, names, strict=True)]
        mesh = mesh.with_uv_sets(sets)
        for uv_set in sets:
            write_uvs(prim, uv_set.name, uv_set.uvs, uv_set.uv_indices)
    write_subsets(stage, prim, mesh)
    _write_results(stage, prim.GetPrim(), mesh, results)
    return _save(stage.GetRootLayer(), file, ("/Asset/mesh",) if add else (), force=force)


def new_stage(space: StageSpace, kind: str) -> Any:
    """A stage in memory with the default prim ``/Asset`` of a type."""
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
    above_first = map(target_stage.GetPrimAtPath, prims[0].GetPath().GetPrefixes())
    if _needs_skeleton(results) and not any(prim.IsA(pxr.UsdSkel.Root) for prim in above_first):
        if prims[0].GetPath() == top:
            text = "%s: %s is the topmost prim; USD poses only meshes below a SkelRoot: put it below such a prim"
            _log.warning(text, target, top)
        else:
            stage.OverridePrim(top).SetTypeName("SkelRoot")
    for prim, prim_path in zip(prims, prim_paths, strict=True):
        for above in map(target_stage.GetPrimAtPath, prim.GetPath().GetPrefixes()):
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


def check_usd_path(file: Path, *, package: bool = False) -> None:
    """Refuse a name without a suffix of USD layers (or packages), or one that is not UTF-8."""
    text_name(file.absolute())
    remedy = "Give another name." if package else "Packages (.usdz) are made from those."
    require_suffix(file, (".usda", ".usdc", *([".usdz"] if package else []), ".usd"), remedy=remedy)


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
    except pxr.Tf.ErrorException:
        written = False
    if not written:
        raise FormatError(f"{file}: cannot be written. Check the folder and the space left on the disk.")


def _write_results(
    stage: Any, prim: Any, mesh: ControlMesh, results: UsdResults, to_root: FloatArray | None = None
) -> None:
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
            write_primvar(prim, mesh, label, np.asarray(values), results.places.get(name))
    if results.skeleton is not None:
        write_usd_skeleton(stage, prim, results.skeleton, np.eye(4) if to_root is None else to_root)
    if shapes:
        write_blend_shapes(stage, prim, shapes)
    if results.textures:
        bind_textures(stage, prim, results.textures, uv_name)


def _needs_skeleton(results: UsdResults) -> bool:
    return any(name == JOINT_WEIGHTS or name.startswith(BLEND_SHAPE) for name in results.attributes)
