"""Inputs of UsdPreviewSurface shaders: their values, the shaders connected to them, and the UV sets of images."""

from __future__ import annotations

from typing import Any

from cagemap.files.usd.stages import pxr


def source_of(shader: Any, name: str) -> Any:
    """The attribute that holds the value of an input: its own, or the output of a connected shader; else None."""
    shader_input = shader.GetInput(name)
    sources = shader_input.GetValueProducingAttributes() if shader_input else ()
    return sources[0] if sources else None


def setting_of(shader: Any, name: str, default: Any) -> Any:
    """The value of an input; the default if it has none."""
    source = source_of(shader, name)
    value = source.Get() if source else None
    return default if value is None else value


def shader_of(shader: Any, name: str, kind: str) -> Any:
    """The shader connected to an input if its id is ``kind``, else None."""
    source = source_of(shader, name)
    found = pxr.UsdShade.Shader(source.GetPrim()) if source else None
    return found if found and found.GetIdAttr().Get() == kind else None


def uv_transform(texture: Any) -> Any:
    """The shader that transforms the texture coordinates of an image; None without one."""
    return shader_of(texture, "st", "UsdTransform2d")


def uv_name(texture: Any) -> str:
    """Name of the UV set that the image of a texture shader is mapped with; '' if it states none."""
    transform = uv_transform(texture)
    reader = shader_of(transform or texture, "in" if transform else "st", "UsdPrimvarReader_float2")
    return str(setting_of(reader, "varname", "")) if reader else ""


def bound_material(prim: Any) -> Any:
    """The material of a prim in previews, else in final renderings; also one of a prim above it or of a collection."""
    api = pxr.UsdShade.MaterialBindingAPI(prim)
    return api.ComputeBoundMaterial("preview")[0] or api.ComputeBoundMaterial("full")[0]


def color_uv_name(prim: Any) -> str:
    """Name of the UV set of the colour image of a mesh's material, else of that of a child prim (a subset of faces).

    '' if no material has such an image, or if none states its UV set.
    """
    for bound in (prim, *prim.GetChildren()):
        material = bound_material(bound)
        surface = material.ComputeSurfaceSource()[0] if material else None
        texture = shader_of(surface, "diffuseColor", "UsdUVTexture") if surface else None
        if texture and (name := uv_name(texture)):
            return name
    return ""
