"""What a control mesh leaves out of its USD file; only names and types are looked at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cagemap.files.usd.prims import is_uv_set, skinning_attribute, value_primvars
from cagemap.files.usd.read import meshes_with_points, prims_of
from cagemap.files.usd.shader_inputs import bound_material, color_uv_name
from cagemap.files.usd.stages import damage_as_error, open_stage, pxr
from cagemap.files.usd.transforms import drop_flattened


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
        primvars = {name for prim in prims for name in _primvar_names(prim)}
    return [*sorted(primvars), *(name for name, is_there in held.items() if is_there)]


def _primvar_names(prim: Any) -> Iterator[str]:
    """Names of a mesh's numeric primvars that are neither UV sets nor colours."""
    color_uvs = color_uv_name(prim)
    for primvar, _ in value_primvars(prim, ("displayColor",)):
        if not is_uv_set(primvar, color_uvs):
            yield primvar.GetPrimvarName()


def _has_images(prim: Any) -> bool:
    """Whether a material of a mesh, or of a subset of its faces, has an image."""
    subsets = pxr.UsdGeom.Subset.GetAllGeomSubsets(pxr.UsdGeom.Imageable(prim))
    bound = (bound_material(one) for one in (prim, *(subset.GetPrim() for subset in subsets)))
    inside = pxr.Usd.TraverseInstanceProxies()
    shaders = (one for material in bound if material for one in pxr.Usd.PrimRange(material.GetPrim(), inside))
    return any(pxr.UsdShade.Shader(one).GetIdAttr().Get() == "UsdUVTexture" for one in shaders)
