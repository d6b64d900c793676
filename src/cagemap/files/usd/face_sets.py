"""Subsets of USD meshes: materials and groups of faces."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.files.usd.primvars import integers, stated
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray


def face_sets(prim: Any, n_faces: int) -> dict[str, Any]:
    """Material of every face, by the mesh's binding and those of its subsets; other subsets become groups.

    Faces in several of those belong to a group of all their names, as OBJ's ``g one two`` says it.
    """
    from pxr import UsdGeom, UsdShade

    materials = np.full(n_faces, -1, dtype=np.int64)
    names: list[str] = []
    paths: list[str] = []
    groups: list[tuple[str, IndexArray]] = []
    colors: list[FloatArray] = []

    def number(material: Any) -> int:
        path = material.GetPath()
        if path.pathString not in paths:
            paths.append(path.pathString)
            names.append(path.name if path.name not in names else path.pathString)  # of another scope
            colors.append(_diffuse_color(material))
        return paths.index(path.pathString)

    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    if bound:
        materials[:] = number(bound)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        faces = integers(stated(subset.GetIndicesAttr()))
        if subset.GetElementTypeAttr().Get() != "face" or not len(faces) or faces.min() < 0 or faces.max() >= n_faces:
            continue
        own = UsdShade.MaterialBindingAPI(subset.GetPrim()).GetDirectBinding().GetMaterial()
        if own:
            materials[faces] = number(own)
        elif subset.GetFamilyNameAttr().Get() != "materialBind":
            groups.append((subset.GetPrim().GetName(), faces))
    result: dict[str, Any] = {}
    if names:
        unbound = materials < 0
        if unbound.any():
            materials[unbound] = len(names)
            names.append("")
            colors.append(np.full(3, np.nan))
        result |= {"face_materials": materials, "material_names": tuple(names), "material_colors": np.array(colors)}
    if groups:
        result |= _joined_groups(groups, n_faces)
    return result


def _joined_groups(groups: list[tuple[str, IndexArray]], n_faces: int) -> dict[str, Any]:
    """Groups that may overlap as groups that do not: the given ones first, then the others that faces are in."""
    names, inside = [name for name, _ in groups], np.zeros((n_faces, len(groups)), dtype=np.bool_)
    for group, (_, faces) in enumerate(groups):
        inside[faces, group] = True
    _, first, which = np.unique(np.packbits(inside, axis=1), axis=0, return_index=True, return_inverse=True)
    titles = [" ".join(names[group] for group in np.flatnonzero(inside[face])) for face in first.tolist()]
    in_order = [titles[k] for k in np.argsort(first)]  # by the first face of each
    every = {title: number for number, title in enumerate(dict.fromkeys([*names, *in_order]))}
    numbers = np.array([every[title] for title in titles], dtype=np.int64)
    return {"face_groups": numbers[which.ravel()], "group_names": tuple(every)}


def _diffuse_color(material: Any) -> FloatArray:
    """Constant diffuse colour of a UsdPreviewSurface, NaN where there is none."""
    surface = material.ComputeSurfaceSource()[0]
    color = surface.GetInput("diffuseColor") if surface else None
    value = color.Get() if color and not color.HasConnectedSource() else None
    return np.full(3, np.nan) if value is None else np.array(value, dtype=np.float64)


def named_faces(mesh: ControlMesh) -> list[tuple[str, IndexArray, FloatArray | None]]:
    """Name and faces of every material, with its colour, and of every group."""
    found: list[tuple[str, IndexArray, FloatArray | None]] = []
    if mesh.face_materials is not None:
        for number, name in enumerate(mesh.material_names):
            color = np.full(3, np.nan) if mesh.material_colors is None else mesh.material_colors[number]
            found.append((name, np.flatnonzero(mesh.face_materials == number), color))
    if mesh.face_groups is not None:
        found += [(n, np.flatnonzero(mesh.face_groups == i), None) for i, n in enumerate(mesh.group_names)]
    return [(name, faces, color) for name, faces, color in found if name and len(faces)]
