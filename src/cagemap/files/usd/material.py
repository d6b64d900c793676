"""Textures of a mesh in USD: a UsdPreviewSurface with one texture for each map."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

# Input of UsdPreviewSurface: its type, the texture's output, whether values are colours to be seen, and the usual names
# of maps for it, in small letters without spaces, "_" and "-".
_INPUTS = {
    "diffuseColor": ("Color3f", "rgb", True, ("albedo", "basecolor", "color", "diffuse", "diffusecolor", "texture")),
    "emissiveColor": ("Color3f", "rgb", True, ("emission", "emissive", "emissivecolor")),
    "roughness": ("Float", "r", False, ("roughness",)),
    "metallic": ("Float", "r", False, ("metallic", "metalness")),
    "occlusion": ("Float", "r", False, ("occlusion", "ao", "ambientocclusion")),
    "opacity": ("Float", "r", False, ("opacity", "alpha")),
    "displacement": ("Float", "r", False, ("displacement", "height")),
    "normal": ("Normal3f", "rgb", False, ("normal",)),
}
MATERIAL = "cagemap_material"


def preview_inputs(roles: Iterable[str]) -> dict[str, str]:
    """Inputs of UsdPreviewSurface that maps are for, by map; case, spaces, ``_`` and ``-`` do not count.

    Maps that no input is known for are left out, and of several for one input all but the first.

    Examples
    --------
    >>> preview_inputs(["Base_Color", "AO", "gloss", "albedo"])
    {'Base_Color': 'diffuseColor', 'AO': 'occlusion'}
    """
    found: dict[str, str] = {}
    for role in roles:
        plain = re.sub(r"[\s_-]", "", role.lower())
        name = next((name for name, (*_, usual) in _INPUTS.items() if plain in usual), None)
        if name is not None and name not in found.values():
            found[role] = name
    return found


def unbound_maps(roles: Iterable[str]) -> list[str]:
    """A sentence for each map that `bind_textures` leaves out."""
    given = list(roles)
    bound = preview_inputs(given)
    usual = ", ".join(names[0] for *_, names in _INPUTS.values())
    return [
        f"{role}: the map is written but not bound in the USD material, which binds one map each for {usual} (and "
        "other usual names of these). Give it another name, or bind it yourself"
        for role in given
        if role not in bound
    ]


def bind_textures(stage: Any, prim: Any, textures: Mapping[str, str], uv_name: str) -> None:
    """Make a material of some images and bind it to a mesh, those of `preview_inputs`.

    ``stage``, ``prim``: the mesh's prim, on the layer that is written. ``textures``: image by what it is for; paths
    relative to the layer, ``<UDIM>`` for a set. ``uv_name``: primvar of the texture coordinates.
    """
    from pxr import Sdf, Tf, UsdShade

    root = prim.GetPath().GetPrefixes()[0]
    material = UsdShade.Material.Define(stage, root.AppendChild(MATERIAL))
    surface = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    # By its UV set: textures of an earlier transfer may lie over another one.
    label = Tf.MakeValidIdentifier(f"uv_{uv_name}")
    reader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild(label))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(uv_name)
    for role, name in preview_inputs(textures).items():
        kind, output, is_color, _ = _INPUTS[name]
        texture = UsdShade.Shader.Define(stage, material.GetPath().AppendChild(f"{name}_texture"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(textures[role])
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
