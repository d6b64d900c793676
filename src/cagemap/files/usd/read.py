"""USD meshes: topology, subdivision, creases, UV sets, materials and attributes of `UsdGeom`.

References, variants and layers are resolved by USD itself.
"""

from __future__ import annotations

import itertools
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.usd.prims import (
    BLEND_SHAPE,
    blend_shapes,
    corner_values,
    display_colors,
    face_sets,
    index_array,
    is_uv_set,
    primvar_arrays,
    read_value,
    skinning_attribute,
    transform_points,
    uv_primvars,
    value_primvars,
)
from cagemap.files.usd.shader_inputs import bound_material, color_uv_name
from cagemap.files.usd.stages import damage_as_error, open_stage, pxr
from cagemap.files.usd.transforms import drop_flattened, is_mirrored, is_similarity, local_to_world
from cagemap.mesh import ControlMesh, Scheme
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import reversed_corners
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import join_meshes
from cagemap.mesh.schemes import SCHEMES, scheme_name
from cagemap.mesh.weld import COLOR_STEP
from cagemap.numerics.arrays import FloatArray, encode_srgb, grouped_sums, offsets_of
from cagemap.subdivision import default_scheme
from cagemap.surface.alignment import Y_UP, Z_UP

logger = logging.getLogger(__name__)

# Allowed values of USD's attributes; those of cagemap's schemes are the same in snake_case.
_WORDS = {
    "subdivisionScheme": ("catmullClark", "loop", "bilinear", "none"),
    "interpolateBoundary": ("none", "edgeOnly", "edgeAndCorner"),
    "faceVaryingLinearInterpolation": ("none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all"),
    "triangleSubdivisionRule": ("catmullClark", "smooth"),
}
# Purposes of meshes that replace others in previews.
_STAND_INS = ("guide", "proxy")


@dataclass(frozen=True, eq=False)
class UsdMesh:
    """A mesh prim of a USD file."""

    path: str  # of the prim
    control: ControlMesh  # in the prim's local space
    # other primvars, with a row for each control vertex, face or face corner; skinning as ``skel:jointWeights`` with a
    # column for each joint, blend shapes as ``blendShape:NAME``
    attributes: dict[str, Any]
    to_world: FloatArray  # (4, 4) from local to world space, for positions as rows with 1 appended
    world_upright: FloatArray  # (3, 3) rotation of rows from world space to +Y up
    shape_normals: dict[str, FloatArray] = field(default_factory=dict)  # offsets (n, 3) of normals by blend shape
    colors: FloatArray | None = None  # (c, 4) linear with opacity, of face corners; None if ``control`` has them all


def read_usd_meshes(path: str | Path) -> tuple[UsdMesh, ...]:
    """All active mesh prims of a stage with points, instances included, at the first time sample.

    Invisible meshes, prototypes of instancers and previews (purpose guide or proxy) are left out if there are others,
    and meshes that their transform flattens (as animators hide them), with a warning.
    """
    file = Path(path)
    stage = open_stage(file)
    with damage_as_error(file):
        prims = prims_of(stage, pxr.UsdGeom.Mesh)
        others = [*prims_of(stage, pxr.UsdGeom.Gprim), *prims_of(stage, pxr.UsdGeom.PointInstancer)]
        others = [prim for prim in others if not prim.IsA(pxr.UsdGeom.Mesh) and _is_final(prim)]
        left_out = [f"{prim.GetPath()} ({prim.GetTypeName()})" for prim in others]
        if prims and left_out:
            text = "%s: left out what is no mesh: %s; convert it to meshes to keep it"
            logger.warning(text, file, first_few(left_out))
        are_final = list(map(_is_final, prims))
        final = list(itertools.compress(prims, are_final))
        if hidden := [str(prim.GetPath()) for prim, kept in zip(prims, are_final, strict=True) if final and not kept]:
            text = "%s: left out invisible meshes, previews and prototypes: %s; %s"
            logger.warning(text, file, first_few(hidden), "make them visible, of purpose default, to keep them")
        labels = material_labels(stage)
        meshes = tuple(_read_prim(file, prim, labels) for prim in drop_flattened(file, meshes_with_points(stage)))
    if not meshes:
        what = f"got {len(prims)} without points" if prims else "got none"
        sets = [(prim, prim.GetVariantSets()) for prim in stage.Traverse()]
        names = [(prim, of_prim, name) for prim, of_prim in sets for name in of_prim.GetNames()]
        open_sets = [f"{prim.GetPath()} ({n})" for prim, of_prim, n in names if not of_prim.GetVariantSelection(n)]
        remedy = (
            f"Choose one of the variants of {', '.join(open_sets)}."
            if open_sets and not prims
            else "Export the control mesh with its points."
        )
        raise FormatError(f"{file}: expected at least one mesh prim, {what}. {remedy}")
    return meshes


def meshes_with_points(stage: Any) -> list[Any]:
    """Mesh prims with points that are visible and no previews; without such, all with points."""
    prims = prims_of(stage, pxr.UsdGeom.Mesh)
    shown = list(filter(_is_final, prims)) or prims
    return [prim for prim in shown if read_value(pxr.UsdGeom.Mesh(prim).GetPointsAttr())]


def _is_final(prim: Any) -> bool:
    """Whether a prim is visible, not a preview by its purpose, and not a prototype of a point instancer."""
    above = map(prim.GetStage().GetPrimAtPath, prim.GetPath().GetParentPath().GetPrefixes())
    imageable = pxr.UsdGeom.Imageable(prim)
    if any(one.IsA(pxr.UsdGeom.PointInstancer) for one in above):
        return False
    return str(imageable.ComputePurpose()) not in _STAND_INS and str(imageable.ComputeVisibility()) != "invisible"


def prims_of(stage: Any, kind: Any) -> list[Any]:
    """All active prims of a type, those in instances included."""
    every = pxr.Usd.PrimRange.Stage(stage, pxr.Usd.TraverseInstanceProxies())
    return [prim for prim in every if prim.IsA(kind)]


def material_labels(stage: Any) -> dict[str, str]:
    """Names of all materials by path: as displayed, or the path if another material has it; one for all instances."""
    label_of: dict[Any, str] = {}
    labels, taken = dict[str, str](), set[str]()
    for prim in prims_of(stage, pxr.UsdShade.Material):
        source, path = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim, str(prim.GetPath())
        name = prim.GetDisplayName() or prim.GetName()
        label_of.setdefault(source, path if name in taken else name)
        labels[path] = label_of[source]
        taken.add(labels[path])
    return labels


def read_usd(path: str | Path, *, mixed: bool = False) -> ControlMesh:
    """Read a control mesh from a USD file; several prims become objects of one mesh in world space.

    With ``mixed``, meshes of different subdivision schemes are joined with their ``object_schemes``, to extract parts.
    """
    return join_usd_meshes(path, read_usd_meshes(path), mixed=mixed)


def join_usd_meshes(path: str | Path, meshes: Sequence[UsdMesh], *, mixed: bool = False) -> ControlMesh:
    """The control mesh of `read_usd` from the meshes of its file."""
    file = Path(path)
    if len(meshes) == 1:
        change = "mirrors" if is_mirrored(meshes[0].to_world) else "distorts"
        if change == "mirrors" or not is_similarity(meshes[0].to_world):
            text = "%s: the transform of %s %s it, but the points are taken as they are; apply it to them"
            logger.warning(text, file, meshes[0].path, change)
        # The nearest rotation; of a map that mirrors, left and right are exchanged.
        left, _, right = np.linalg.svd(meshes[0].to_world[:3, :3] @ meshes[0].world_upright)
        upright = left @ right @ np.diag([np.linalg.det(left @ right), 1.0, 1.0])
        return replace(meshes[0].control, upright=upright, name=file.name)
    schemes = {mesh.control.scheme: mesh.path for mesh in meshes}
    whole = replace(join_meshes([place_in_world(mesh).control for mesh in meshes]), name=file.name)
    if len(schemes) > 1 and mixed:
        return replace(whole, object_schemes=tuple(default_scheme(mesh.control) for mesh in meshes))
    if len(schemes) > 1:
        words = {scheme_name(scheme): path for scheme, path in schemes.items() if scheme is not None}
        words = words if len(words) == len(schemes) else {str(scheme): path for scheme, path in schemes.items()}
        raise FormatError(
            f"{file}: expected meshes that are all subdivided alike, got {' and '.join(words)} (of "
            f"{', '.join(words.values())}). Match the one that is meant (`find_part` NAME)."
        )
    return whole


def one_mesh(path: str | Path, meshes: tuple[UsdMesh, ...], control: ControlMesh | None) -> UsdMesh:
    """The mesh that a control mesh was read from: the only one of a file, or the one of all its faces."""
    if len(meshes) == 1:
        return meshes[0]
    words = [] if control is None else objects_of(control)
    chosen = [mesh for mesh in meshes if mesh.path in words]
    if len(chosen) != 1:
        raise FormatError(
            f"{path}: expected one mesh, got {', '.join(mesh.path for mesh in meshes)}. Match one of them "
            "(`find_part` NAME), or make what is meant a file of its own."
        )
    return chosen[0]


def objects_of(control: ControlMesh) -> list[str]:
    """Names of the objects of a mesh's faces."""
    numbers = [] if control.face_objects is None else np.unique(control.face_objects).tolist()
    return [control.object_names[number] for number in numbers]


def place_in_world(mesh: UsdMesh) -> UsdMesh:
    """The mesh and its blend shapes in world space, as an object named by its path; faces reversed if mirrored."""
    if is_mirrored(mesh.to_world):
        mesh = _reverse_orientation(mesh)
    control, turn = mesh.control, mesh.to_world[:3, :3]
    control = replace(
        control,
        positions=transform_points(control.positions, mesh.to_world),
        face_objects=np.zeros(control.n_faces, dtype=np.int64),
        object_names=(mesh.path,),
        upright=mesh.world_upright,
    )
    shapes = {name: array @ turn for name, array in mesh.attributes.items() if name.startswith(BLEND_SHAPE)}
    return replace(mesh, control=control, attributes=mesh.attributes | shapes)


def _read_prim(file: Path, prim: Any, labels: Mapping[str, str]) -> UsdMesh:
    mesh = pxr.UsdGeom.Mesh(prim)
    where = f"{file}: {prim.GetPath()}"
    positions = np.array(read_value(mesh.GetPointsAttr()), dtype=np.float64).reshape(-1, 3)
    if len(bad := np.flatnonzero(~np.isfinite(positions).all(axis=1))):
        raise FormatError(
            f"{where}: expected finite positions, got NaN or infinity at {len(bad)} vertices (0-based): "
            f"{first_few(bad)}. Repair them in the modelling program and export again."
        )
    sizes = index_array(read_value(mesh.GetFaceVertexCountsAttr()))
    indices = index_array(read_value(mesh.GetFaceVertexIndicesAttr()))
    if not len(sizes) or sizes.min() < 1 or sizes.sum() != len(indices):
        raise FormatError(
            f"{where}: expected face counts that sum to the {len(indices)} face vertex indices, got "
            f"{len(sizes)} faces of {int(sizes.sum())} corners. Export the mesh again."
        )
    if indices.min() < 0 or indices.max() >= len(positions):
        raise FormatError(
            f"{where}: expected vertex numbers from 0 to {len(positions) - 1}, got {indices.min()} to {indices.max()}. "
            "Export the mesh again."
        )
    offsets = offsets_of(sizes)
    control = ControlMesh(positions, offsets, indices, name=str(prim.GetPath()), scheme=_scheme(where, mesh))
    control = replace(control, **_sharpness(where, mesh))
    primvars = uv_primvars(where, prim)
    sets = [UvSet(primvar.GetPrimvarName(), *corner_values(where, control, primvar)) for primvar in primvars]
    control = control.with_uv_sets(sets)
    control = replace(control, **face_sets(where, prim, control.n_faces, labels))
    shapes, shape_normals = blend_shapes(where, control, prim)
    attributes = primvar_arrays(where, control, prim)
    attributes |= {f"{BLEND_SHAPE}{name}": offsets for name, offsets in shapes.items()}
    interpolation, colors = display_colors(where, control, prim)
    at_vertices = attributes.get("displayColor") if interpolation in ("vertex", "varying") else None
    if colors is not None and at_vertices is not None:
        control = replace(control, vertex_colors=encode_srgb(at_vertices.astype(np.float64)))
        colors = None if (colors[:, 3] == 1.0).all() else colors
    elif colors is not None:
        control = replace(control, vertex_colors=_mean_colors(where, control, encode_srgb(colors[:, :3])))
    path = str(prim.GetPath())
    upright = Z_UP if str(pxr.UsdGeom.GetStageUpAxis(prim.GetStage())) == "Z" else Y_UP
    read = UsdMesh(path, control, attributes, local_to_world(prim), upright, shape_normals, colors)
    return _reverse_orientation(read) if mesh.GetOrientationAttr().Get() == "leftHanded" else read


def _mean_colors(where: str, control: ControlMesh, of_corners: FloatArray) -> FloatArray:
    """(n, 3) mean colour of the corners of every vertex; NaN at vertices of no face."""
    counts = np.bincount(control.face_indices, minlength=control.n_vertices)
    with np.errstate(invalid="ignore"):
        mean = grouped_sums(control.face_indices, of_corners, control.n_vertices) / counts[:, None]
    if differ := int(np.sum(np.abs(of_corners - mean[control.face_indices]).max(axis=1) > COLOR_STEP)):
        logger.info("%s: colours of %d corners differ from the mean at their vertex", where, differ)
    return mean


def _scheme(where: str, mesh: Any) -> Scheme:
    words = []
    for name, known in _WORDS.items():
        word = read_value(mesh.GetPrim().GetAttribute(name))
        if str(word) not in known:
            raise FormatError(
                f"{where}: expected {name} to be one of {', '.join(known)}, got {word!r}. Repair the file."
            )
        words.append(re.sub("[A-Z]", lambda letter: f"_{letter[0].lower()}", str(word)))
    kind, boundary, uvs, triangles = words
    return SCHEMES[kind.replace("_", "-")](boundary, uvs, triangles=triangles)  # type: ignore[arg-type]


def _sharpness(where: str, mesh: Any) -> dict[str, Any]:
    """Creases, corners and holes as fields of a control mesh."""
    result: dict[str, Any] = {}
    chain = index_array(read_value(mesh.GetCreaseIndicesAttr()))
    lengths = index_array(read_value(mesh.GetCreaseLengthsAttr()))
    values = np.array(read_value(mesh.GetCreaseSharpnessesAttr()) or [], dtype=np.float64)
    if len(chain):
        n_edges = lengths - 1
        if (
            lengths.sum() != len(chain)
            or (len(lengths) and lengths.min() < 2)
            or len(values) not in (len(lengths), int(n_edges.sum()))
        ):
            raise FormatError(
                f"{where}: expected creases of two vertices or more with one sharpness each or one an edge, got "
                f"{len(chain)} indices, lengths that sum to {int(lengths.sum())}, {len(values)} sharpnesses. "
                "Export the creases again."
            )
        last = np.cumsum(lengths) - 1
        starts = np.delete(np.arange(len(chain)), last)
        result["crease_edges"] = np.column_stack([chain[starts], chain[starts + 1]])
        per_edge = values if len(values) == n_edges.sum() else np.repeat(values, n_edges)
        result["crease_sharpness"] = np.clip(per_edge, 0.0, None)
    corners = index_array(read_value(mesh.GetCornerIndicesAttr()))
    sharpness = np.array(read_value(mesh.GetCornerSharpnessesAttr()) or [], dtype=np.float64)
    if len(corners) != len(sharpness):
        raise FormatError(
            f"{where}: expected one sharpness a corner, got {len(corners)} corners and {len(sharpness)} sharpnesses. "
            "Export them again."
        )
    if len(corners):
        result |= {"corner_vertices": corners, "corner_sharpness": np.clip(sharpness, 0.0, None)}
    holes = index_array(read_value(mesh.GetHoleIndicesAttr()))
    return result | ({"hole_faces": np.unique(holes)} if len(holes) else {})


def _reverse_orientation(mesh: UsdMesh) -> UsdMesh:
    """A mesh and its values with reversed face orientation, for left-handed meshes; see `primvar_arrays`."""
    control, attributes = mesh.control, mesh.attributes
    mirrored = reversed_corners(control.face_offsets)
    turned = replace(
        control,
        face_indices=control.face_indices[mirrored],
        uv_indices=None if control.uv_indices is None else control.uv_indices[mirrored],
        uv_sets=tuple(replace(uv_set, uv_indices=uv_set.uv_indices[mirrored]) for uv_set in control.uv_sets),
    )
    if len(mirrored) != control.n_vertices:
        attributes = {name: rows[mirrored] if len(rows) == len(mirrored) else rows for name, rows in attributes.items()}
    colors = None if mesh.colors is None else mesh.colors[mirrored]
    return replace(mesh, control=turned, attributes=attributes, colors=colors)


def left_out_of_usd(path: str | Path) -> list[str]:
    """What `read_usd` leaves out: primvars, weights, blend shapes, skeletons, animations, images of materials.

    Nothing is logged, since the file has been read before.
    """
    with damage_as_error(path):
        stage = open_stage(path, warn=False)
        prims = drop_flattened(Path(path), meshes_with_points(stage), warn=False)
        bindings = list(map(pxr.UsdSkel.BindingAPI, prims))
        has_skeleton = any(one.GetInheritedSkeleton() for one in bindings)
        tracks = (one for prim in prims_of(stage, pxr.UsdSkel.Animation) for one in prim.GetAttributes())
        held = {
            "skinning weights": any(skinning_attribute(prim, "primvars:skel:jointWeights") for prim in prims),
            "blend shapes": any(one.GetBlendShapesAttr().Get() for one in bindings),
            "skeleton": has_skeleton,
            "animations": has_skeleton and any(one.GetNumTimeSamples() > 1 for one in tracks),
            "images of materials": any(map(_has_images, prims)),
        }
        values = [(one, prim) for prim in prims for one, _ in value_primvars(prim, ("displayColor",))]
        primvars = {one.GetPrimvarName() for one, prim in values if not is_uv_set(one, color_uv_name(prim))}
    return [*sorted(primvars), *(name for name, is_there in held.items() if is_there)]


def _has_images(prim: Any) -> bool:
    """Whether a material of a mesh, or of a subset of its faces, has an image."""
    subsets = pxr.UsdGeom.Subset.GetAllGeomSubsets(pxr.UsdGeom.Imageable(prim))
    bound = (bound_material(one) for one in (prim, *(subset.GetPrim() for subset in subsets)))
    inside = pxr.Usd.TraverseInstanceProxies()
    shaders = (one for material in bound if material for one in pxr.Usd.PrimRange(material.GetPrim(), inside))
    return any(pxr.UsdShade.Shader(one).GetIdAttr().Get() == "UsdUVTexture" for one in shaders)
