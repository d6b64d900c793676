"""USD files as characters, and as glTF documents: with skeleton, animations, weights, shapes and materials."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from cagemap.character.poses import parent_transforms
from cagemap.character.values import Animation, Channel, Character, Part, Rig, ShapeTrack, Track
from cagemap.errors import FormatError
from cagemap.files.gltf.character import to_rig_space
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.geometry import uv_sets_in_order
from cagemap.files.gltf.nodes import is_invertible
from cagemap.files.gltf.parts import transform_part
from cagemap.files.gltf.write import character_glb
from cagemap.files.text import make_distinct
from cagemap.files.usd.prims import (
    BLEND_SHAPE,
    JOINT_WEIGHTS,
    bind_transform,
    corner_rows,
    primvar_values,
    read_value,
)
from cagemap.files.usd.read import UsdMesh, prims_of, read_usd_meshes
from cagemap.files.usd.shader_inputs import color_uv_name
from cagemap.files.usd.shaders import with_materials
from cagemap.files.usd.skeleton import joint_names, joint_parents, joints_of, remove_scale
from cagemap.files.usd.space import stage_units, to_metres
from cagemap.files.usd.stages import damage_as_error, open_each_once, open_stage, pxr
from cagemap.files.usd.transforms import is_similarity, local_to_world
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.faces import reversed_corners
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.alignment import Y_UP

_log = logging.getLogger(__name__)

# Attributes that say how a mesh is shown, apart from transforms.
_SHOWN = ("points", "visibility")


def usd_document(path: str | Path, meshes: Sequence[UsdMesh] | None = None) -> Document:
    """Read a USD file as a glTF document in metres with Y up, in the bind pose.

    Subdivision schemes are left out, since glTF has none. Materials are those of `cagemap.files.usd.shaders`.

    ``meshes``: the file's, if they are read already.
    """
    return document_and_character(path, meshes)[0]


def document_and_character(path: str | Path, meshes: Sequence[UsdMesh] | None = None) -> tuple[Document, Character]:
    """A USD file as by `usd_document`, and as a character whose parts have the vertices of its meshes in their order.

    Names are the same in both.
    """
    file = Path(path)
    with damage_as_error(file), open_each_once():
        stage, meshes = open_stage(file), read_usd_meshes(file) if meshes is None else meshes
        character = _read(file, stage, meshes)
        plain = replace(character_glb(character), file=file)
        uv_sets, double_sided = dict[str, list[tuple[str, ...]]](), set[str]()
        for part, mesh in zip(character.parts, meshes, strict=True):
            if pxr.UsdGeom.Mesh(stage.GetPrimAtPath(mesh.path)).GetDoubleSidedAttr().Get():
                double_sided |= set(part.mesh.material_names) - uv_sets.keys()  # by the first mesh of a material
            for name in part.mesh.material_names:
                uv_sets.setdefault(name, []).append(tuple(one.name for one in uv_sets_in_order(part.mesh)))
        document = with_materials(plain, stage, uv_sets, double_sided)
    return document, character


def _read(file: Path, stage: Any, meshes: Sequence[UsdMesh]) -> Character:
    prims = [stage.GetPrimAtPath(mesh.path) for mesh in meshes]
    bound = [pxr.UsdSkel.BindingAPI(prim).GetInheritedSkeleton() for prim in prims]
    skeletons = {str(one.GetPath()): one for one in bound if one}
    if len(skeletons) > 1:
        raise FormatError(f"{file}: expected one skeleton, got {', '.join(skeletons)}. Export one character alone.")
    to_world, rig = to_metres(stage_units(file)), None
    rig_to_world = to_world
    for skeleton in skeletons.values():
        rig_to_world = local_to_world(skeleton.GetPrim()) @ to_world
        rig = _rig(file, skeleton, rig_to_world)
    animated = [one for one in (*prims, *(one.GetPrim() for one in skeletons.values())) if _is_animated(one)]
    if animated:
        text = "%s: the animation of %s is left out: only that of joints and weights of blend shapes is kept"
        _log.warning(text, file, first_few(str(one.GetPath()) for one in animated))
    joints = () if rig is None else rig.names
    names = make_distinct([*joints, *(prim.GetDisplayName() or prim.GetName() for prim in prims)])[len(joints) :]
    parts = []
    for name, mesh, prim, skeleton in zip(names, meshes, prims, bound, strict=True):
        if len(thin := np.flatnonzero(mesh.control.face_sizes < 3)):
            raise FormatError(
                f"{file}: {mesh.path}: expected faces of at least three corners, got {len(thin)} of fewer, faces: "
                f"{first_few(thin)}. Delete them."
            )
        table = mesh.attributes.get(JOINT_WEIGHTS) if skeleton else None
        mesh_to_world = mesh.to_world @ to_world
        if table is not None:
            mesh_to_world = bind_transform(prim) @ rig_to_world
            if not np.isfinite(table).all():
                raise FormatError(f"{file}: {mesh.path}: expected finite weights, got others. Export it again.")
            table = np.maximum(table, 0.0)
            table[~table.any(axis=1), 0] = 1.0
            table = sparse.csr_array(table / table.sum(axis=1, keepdims=True))
        control = replace(mesh.control, name=name, upright=Y_UP)
        shapes = {
            label.removeprefix(BLEND_SHAPE): offsets
            for label, offsets in mesh.attributes.items()
            if label.startswith(BLEND_SHAPE)
        }
        normals, shape_normals = _normals(f"{file}: {mesh.path}", prim, control), {}
        if normals is not None:
            shape_normals = {label: offsets[control.face_indices] for label, offsets in mesh.shape_normals.items()}
        if control.vertex_colors is not None and color_uv_name(prim):
            text = "%s: %s: USD shows the image of its material without the display colours, glTF multiplies both"
            _log.warning(text, file, mesh.path)
        part = Part(name, control, table, shapes, normals, shape_normals, mesh.colors)
        parts.append(transform_part(part, mesh_to_world))
    if rig is None:
        return Character(tuple(parts))
    (skeleton,) = skeletons.values()
    animations, rest = _animations(file, stage, skeleton, rig, rig_to_world, parts)
    if animations and not is_similarity(rig_to_world):
        text = "%s: %s: its transform scales unevenly, so that joints move otherwise than in USD; apply its scale"
        _log.warning(text, file, skeleton.GetPath())
    at_rest = ({name: rest[name] for name in part.shapes if name in rest} for part in parts)
    parts = [replace(part, shape_weights=weights) for part, weights in zip(parts, at_rest, strict=True)]
    return Character(tuple(parts), *remove_scale(rig, animations))


def _is_animated(prim: Any) -> bool:
    """Whether the points, visibility or transform of a prim, or of one above it, change with time."""
    prims = map(prim.GetStage().GetPrimAtPath, prim.GetPath().GetPrefixes())
    for attribute in (attribute for one in prims for attribute in one.GetAttributes()):
        if attribute.GetName().startswith("xformOp:") or attribute.GetName() in _SHOWN:
            values = [attribute.Get(code) for code in attribute.GetTimeSamples()]
            if any(value != values[0] for value in values):
                return True
    return False


def _normals(where: str, prim: Any, control: ControlMesh) -> FloatArray | None:
    """Normals (c, 3), as stored, of the corners of a plain mesh; None for other meshes and without any."""
    geometry, primvar = pxr.UsdGeom.Mesh(prim), pxr.UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar.HasValue():
        values, numbers, kind = primvar_values(where, primvar)
    else:
        values, kind = np.array(read_value(geometry.GetNormalsAttr()) or []), str(geometry.GetNormalsInterpolation())
        numbers = np.arange(len(values))
    if not len(values) or not isinstance(control.scheme, Plain):
        return None
    rows = corner_rows(control, kind)
    if kind == "faceVarying" and geometry.GetOrientationAttr().Get() == "leftHanded":
        rows = reversed_corners(control.face_offsets)
    if rows is None or len(numbers) <= rows.max() or values.shape[1:] != (3,) or not np.isfinite(values).all():
        text = "%s: its normals are left out, others are computed: expected finite ones, got %d of interpolation %s"
        _log.warning(text, where, len(numbers), kind)
        return None
    return values[numbers[rows]].astype(np.float64)


def _rig(file: Path, skeleton: Any, rig_to_world: FloatArray) -> Rig:
    joints, binds = joints_of(file, skeleton)
    parents = joint_parents(joints)
    if (parents >= np.arange(len(joints))).any():
        raise FormatError(f"{file}: {skeleton.GetPath()}: expected parents before children. Export the skeleton again.")
    rests = np.array(skeleton.GetRestTransformsAttr().Get() or [], dtype=np.float64).reshape(-1, 4, 4)
    local = rests if len(rests) == len(joints) else parent_transforms(binds, parents)
    local[parents < 0] = local[parents < 0] @ rig_to_world
    if not np.isfinite(local).all() or not is_invertible(binds @ rig_to_world).all():
        raise FormatError(f"{file}: {skeleton.GetPath()}: expected transforms with an inverse. Export it again.")
    names = [str(name) for name in skeleton.GetJointNamesAttr().Get() or []]
    if len(set(names)) != len(joints) or len(names) != len(joints):
        names = joint_names(joints)
    return Rig(tuple(names), parents, local, binds @ rig_to_world)


def _animations(
    file: Path, stage: Any, skeleton: Any, rig: Rig, rig_to_world: FloatArray, parts: Sequence[Part]
) -> tuple[tuple[Animation, ...], dict[str, float]]:
    """Animations of a skeleton, the bound one first, and weights of blend shapes that are the same in all of them."""
    bound = pxr.UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource()
    prims = [*([bound] if bound else []), *prims_of(stage, pxr.UsdSkel.Animation)]
    prims = [pxr.UsdSkel.Animation(prim) for prim in dict.fromkeys(prims)]
    joints = [str(joint) for joint in skeleton.GetJointsAttr().Get()]
    found = []
    given = [attribute for one in prims for attribute in (*_channels(one).values(), one.GetBlendShapeWeightsAttr())]
    rate = stage.GetTimeCodesPerSecond()
    if any(one.GetNumTimeSamples() > 1 for one in given) and not 0.0 < rate < np.inf:
        raise FormatError(f"{file}: expected timeCodesPerSecond above 0, got {rate:g}. Export it again.")
    start = min(0.0, stage.GetStartTimeCode(), *(code for one in given for code in one.GetTimeSamples()[:1]))
    names = make_distinct([one.GetPrim().GetDisplayName() or one.GetPrim().GetName() for one in prims])
    for name, animation in zip(names, prims, strict=True):
        listed = [str(joint) for joint in animation.GetJointsAttr().Get() or []]
        tracks = []
        for channel, attribute in _channels(animation).items():
            times, values = _samples(attribute, len(listed), start, rate)
            for column, joint in enumerate(listed):
                if joint in joints and len(times):
                    keys = values[:, column]
                    if rig.parents[joints.index(joint)] < 0:
                        keys = to_rig_space(keys, channel, rig_to_world)
                    kept = slice(None) if np.ptp(keys, axis=0).any() else slice(1)
                    tracks.append(Track(joints.index(joint), channel, times[kept], keys[kept]))
        shapes = tuple(str(shape) for shape in animation.GetBlendShapesAttr().Get() or [])
        times, values = _samples(animation.GetBlendShapeWeightsAttr(), len(shapes), start, rate)
        moved = [part.name for part in parts if len(times) and part.shapes.keys() & set(shapes)]
        shape_tracks = [ShapeTrack(name_of_part, shapes, times, values) for name_of_part in moved]
        found.append(Animation(name, tuple(tracks), tuple(shape_tracks)))
    rest = _common_weights(found) if len(prims) > 1 or bound else {}
    is_at_rest = [all(rest.keys() >= set(track.shapes) for track in one.shape_tracks) for one in found]
    found = [replace(one, shape_tracks=()) if still else one for one, still in zip(found, is_at_rest, strict=True)]
    return tuple(one for one in found if one.tracks or one.shape_tracks), rest


def _common_weights(animations: Sequence[Animation]) -> dict[str, float]:
    """Weights of blend shapes that are constant, and equal in all animations."""
    constant = [
        {
            (name, float(row[0]))
            for track in one.shape_tracks
            for name, row in zip(track.shapes, track.values.T, strict=True)
            if not np.ptp(row)
        }
        for one in animations
    ]
    return dict(sorted(set.intersection(*constant)))


def _channels(animation: Any) -> dict[Channel, Any]:
    """USD attributes that store the translations, rotations and scales of joints in a `SkelAnimation`."""
    return {
        "translation": animation.GetTranslationsAttr(),
        "rotation": animation.GetRotationsAttr(),
        "scale": animation.GetScalesAttr(),
    }


def _samples(attribute: Any, rows: int, start: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """Times in seconds since a time code, and values (k, rows, ...) of an attribute; none if it has no such values."""
    codes = attribute.GetTimeSamples() or [pxr.Usd.TimeCode.Default()]
    values = [attribute.Get(code) for code in codes]
    if not rows or any(value is None or len(value) != rows for value in values):
        return np.zeros(0), np.zeros((0, rows))
    times = np.array([0.0 if len(codes) == 1 else (code - start) / rate for code in codes])
    return times, np.array([np.array(value) for value in values], dtype=np.float64)
