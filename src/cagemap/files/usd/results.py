"""Results in USD layers: textures of a mesh as a UsdPreviewSurface; results of earlier transfers are kept."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.ownership import MARKED
from cagemap.files.text import text_name
from cagemap.files.usd.stages import pxr

# Inputs of UsdPreviewSurface: type, output of the texture, whether values are display colours, and usual names of maps
# in small letters without spaces, "_" and "-".
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
    """Inputs of UsdPreviewSurface by map name; case, spaces, ``_`` and ``-`` are ignored.

    Maps without a known input are left out; of several maps for one input the first is used.

    Examples
    --------
    >>> preview_inputs(["Base_Color", "AO", "gloss", "albedo"])
    {'Base_Color': 'diffuseColor', 'AO': 'occlusion'}
    """
    bound: dict[str, str] = {}
    for role in roles:
        plain = re.sub(r"[\s_-]", "", role.lower())
        name = next((name for name, (*_, usual) in _INPUTS.items() if plain in usual), None)
        if name is not None and name not in bound.values():
            bound[role] = name
    return bound


def unbound_maps(roles: Iterable[str]) -> list[str]:
    """Sentences about maps that `bind_textures` leaves out."""
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
    """Make a material of the images that `preview_inputs` knows, and bind it to a mesh.

    ``stage``, ``prim``: the mesh's prim, on the layer that is written.
    ``textures``: image by map name; paths relative to the layer, ``<UDIM>`` for a set.
    ``uv_name``: primvar of the texture coordinates.
    """
    root = prim.GetPath().GetPrefixes()[0]
    material, surface = define_material(stage, root.AppendChild(MATERIAL))
    # Named by its UV set: textures of an earlier transfer may use another one.
    reader = uv_reader(stage, material.GetPath().AppendChild(pxr.Tf.MakeValidIdentifier(f"uv_{uv_name}")), uv_name)
    for role, name in preview_inputs(textures).items():
        connect_texture(stage, surface, name, textures[role], reader)
    # Materials of subsets of the mesh would hide it.
    pxr.UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, pxr.UsdShade.Tokens.strongerThanDescendants)


def define_material(stage: Any, path: Any) -> tuple[Any, Any]:
    """Define a material with a UsdPreviewSurface; returns both."""
    material = pxr.UsdShade.Material.Define(stage, path)
    surface = pxr.UsdShade.Shader.Define(stage, material.GetPath().AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    return material, surface


def uv_reader(stage: Any, path: Any, uv_name: str) -> Any:
    """Define the shader that reads texture coordinates from a primvar."""
    reader = pxr.UsdShade.Shader.Define(stage, path)
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", pxr.Sdf.ValueTypeNames.String).Set(uv_name)
    reader.CreateOutput("result", pxr.Sdf.ValueTypeNames.Float2)
    return reader


def connect_texture(
    stage: Any,
    surface: Any,
    name: str,
    image: str,
    st: Any,
    *,
    output: str | None = None,
    settings: Mapping[str, object] | None = None,
) -> None:
    """Connect an input of a UsdPreviewSurface to an image.

    ``st``: shader of the texture coordinates.
    ``output``: channels of the image; default: the usual ones of the input.
    ``settings``: of the texture shader, such as ``scale``.
    """
    types = pxr.Sdf.ValueTypeNames
    kind, usual_output, is_color, _ = _INPUTS[name]
    output = output or usual_output
    texture = pxr.UsdShade.Shader.Define(stage, surface.GetPath().GetParentPath().AppendChild(f"{name}_texture"))
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", types.Asset).Set(image)
    texture.CreateInput("sourceColorSpace", types.Token).Set("auto" if is_color else "raw")
    texture.CreateInput("st", types.Float2).ConnectToSource(st.ConnectableAPI(), "result")
    stated: dict[str, object] = {"scale": (2, 2, 2, 1), "bias": (-1, -1, -1, 0)} if name == "normal" else {}
    for setting, value in {**stated, **(settings or {})}.items():
        texture.CreateInput(setting, types.Token if isinstance(value, str) else types.Float4).Set(value)
    texture.CreateOutput(output, types.Float3 if output == "rgb" else types.Float)
    surface.CreateInput(name, getattr(types, kind)).ConnectToSource(texture.ConnectableAPI(), output)


_SKINNING = ("skel:joints", "skel:skeleton", "skel:geomBindTransform")
_SHAPES, _SHAPE_TARGETS = "skel:blendShapes", "skel:blendShapeTargets"


def add_earlier(layer: Any, file: Path, prim_paths: Sequence[str], *, force: bool) -> bool:
    """Add earlier results in a file to the new layer for it; new values replace earlier ones of the same name.

    ``layer``: the new layer, with its final sublayers.
    ``file``: the layer's output. A file that cagemap did not write adds nothing.
    ``prim_paths``: the meshes of the results. Returns whether earlier results were added.
    """
    try:
        earlier = pxr.Sdf.Layer.OpenAsAnonymous(text_name(file)) if file.is_file() else None
    except pxr.Tf.ErrorException:  # not USD: replaced with ``force``, otherwise refused
        earlier = None
    # A .usdc is compressed and has no checksum: its comment is trusted, and only ``force`` replaces it.
    if earlier is None or not earlier.comment.startswith(MARKED):
        return False
    if _subject(earlier, prim_paths) != _subject(layer, prim_paths):
        if force:
            return False
        raise FormatError(
            f"{file}: holds results about another mesh, which would be lost. Give another name, or allow it "
            "(`force=True`)."
        )
    for path in prim_paths:
        new, old = layer.GetPrimAtPath(path), earlier.GetPrimAtPath(path)
        if old and new:
            _join_shapes(new, old)
            if "primvars:skel:jointIndices" in new.properties:  # they number other joints than the earlier ones
                _remove(old, _SKINNING)
    # Values in both layers are removed from the earlier one, since stitching would mix them.
    layer.Traverse("/", lambda path: _remove_replaced(layer, earlier, path))
    pxr.UsdUtils.StitchLayers(layer, earlier)
    return True


def _subject(layer: Any, prim_paths: Sequence[str]) -> tuple[object, ...]:
    """The mesh of the results: the file in the sublayer, or the layer's own arrays."""
    if layer.subLayerPaths:
        return tuple(layer.subLayerPaths)
    names = ("points", "faceVertexCounts", "faceVertexIndices")
    attributes = (layer.GetAttributeAtPath(f"{path}.{name}") for path in prim_paths for name in names)
    return tuple(attribute and attribute.default for attribute in attributes)


def _join_shapes(new: Any, old: Any) -> None:
    """Put the earlier blend shapes of a prim before its new ones, without those that these replace."""
    if not all(name in prim.properties for prim in (new, old) for name in (_SHAPES, _SHAPE_TARGETS)):
        return
    given, kept = (
        dict(zip(prim.properties[_SHAPES].default, _targets(prim).explicitItems, strict=False)) for prim in (new, old)
    )
    kept = {name: path for name, path in kept.items() if name in given or path not in given.values()} | given
    new.properties[_SHAPES].default = pxr.Vt.TokenArray(list(kept))
    _targets(new).explicitItems = list(kept.values())


def _targets(prim: Any) -> Any:
    return prim.properties[_SHAPE_TARGETS].targetPathList


def _remove_replaced(layer: Any, earlier: Any, path: Any) -> None:
    """Remove properties of the new layer's prim from the earlier one; keep the type `SkelRoot`."""
    new, old = layer.GetPrimAtPath(path), earlier.GetPrimAtPath(path)
    if path.IsPrimPath() and new and old:
        _remove(old, new.properties.keys())
        if old.typeName == "SkelRoot":
            new.typeName = old.typeName


def _remove(prim: Any, names: Any) -> None:
    for name in names:
        if name in prim.properties:
            prim.RemoveProperty(prim.properties[name])
