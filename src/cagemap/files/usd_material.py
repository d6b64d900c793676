"""Textures of a mesh in USD: a UsdPreviewSurface with one texture for each map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Input of UsdPreviewSurface, its type, the texture's output, and whether values are colours to be seen.
_INPUTS = {
    "albedo": ("diffuseColor", "Color3f", "rgb", True),
    "basecolor": ("diffuseColor", "Color3f", "rgb", True),
    "color": ("diffuseColor", "Color3f", "rgb", True),
    "diffuse": ("diffuseColor", "Color3f", "rgb", True),
    "texture": ("diffuseColor", "Color3f", "rgb", True),
    "emission": ("emissiveColor", "Color3f", "rgb", True),
    "roughness": ("roughness", "Float", "r", False),
    "metallic": ("metallic", "Float", "r", False),
    "occlusion": ("occlusion", "Float", "r", False),
    "opacity": ("opacity", "Float", "r", False),
    "displacement": ("displacement", "Float", "r", False),
    "normal": ("normal", "Normal3f", "rgb", False),
}
MATERIAL = "cagemap_material"


def bind_textures(stage: Any, prim: Any, textures: Mapping[str, str], uv_name: str) -> None:
    """Make a material of some images and bind it to a mesh; maps that UsdPreviewSurface has no input for are left out.

    Parameters
    ----------
    stage, prim
        The mesh's prim, on the layer that is written.
    textures : dict of str to str
        Image by what it is for; paths relative to the layer, ``<UDIM>`` for a set.
    uv_name : str
        Primvar of the texture coordinates.
    """
    from pxr import Sdf, UsdShade

    root = prim.GetPath().GetPrefixes()[0]
    material = UsdShade.Material.Define(stage, root.AppendChild(MATERIAL))
    surface = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("uv"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(uv_name)
    for role, image in textures.items():
        entry = _INPUTS.get(role.lower().replace("_", ""))
        if entry is None:
            continue
        name, kind, output, is_color = entry
        texture = UsdShade.Shader.Define(stage, material.GetPath().AppendChild(f"{name}_texture"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(image)
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("auto" if is_color else "raw")
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        if name == "normal":
            texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set((2, 2, 2, 1))
            texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set((-1, -1, -1, 0))
        value_kind = Sdf.ValueTypeNames.Float3 if output == "rgb" else Sdf.ValueTypeNames.Float
        texture.CreateOutput(output, value_kind)
        made = surface.CreateInput(name, getattr(Sdf.ValueTypeNames, kind))
        made.ConnectToSource(texture.ConnectableAPI(), output)
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
