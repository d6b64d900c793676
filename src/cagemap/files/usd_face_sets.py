"""Subsets of USD meshes: materials and groups of faces."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.files.usd_primvars import integers, stated
from cagemap.numerics.arrays import FloatArray, IndexArray


def face_sets(prim: Any, n_faces: int) -> dict[str, Any]:
    """Material of every face, by the mesh's binding and those of its subsets; other subsets become groups.

    Faces in several of those belong to a group of all their names, as OBJ's ``g one two`` says it.
    """
    from pxr import UsdGeom, UsdShade

    materials = np.full(n_faces, -1, dtype=np.int64)
    names: list[str] = []
    groups: list[tuple[str, IndexArray]] = []
    colors: list[FloatArray] = []

    def number(material: Any) -> int:
        name = material.GetPath().name
        if name not in names:
            names.append(name)
            colors.append(_diffuse_color(material))
        return names.index(name)

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
        words: list[list[str]] = [[] for _ in range(n_faces)]
        for name, faces in groups:
            for face in np.unique(faces).tolist():
                words[face].append(name)
        titles = [" ".join(own) for own in words]
        every = {title: number for number, title in enumerate(dict.fromkeys([*(name for name, _ in groups), *titles]))}
        numbers = np.array([every[title] for title in titles], dtype=np.int64)
        result |= {"face_groups": numbers, "group_names": tuple(every)}
    return result


def _diffuse_color(material: Any) -> FloatArray:
    """Constant diffuse colour of a UsdPreviewSurface, NaN where there is none."""
    surface = material.ComputeSurfaceSource()[0]
    color = surface.GetInput("diffuseColor") if surface else None
    value = color.Get() if color and not color.HasConnectedSource() else None
    return np.full(3, np.nan) if value is None else np.array(value, dtype=np.float64)
