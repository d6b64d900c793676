"""Keep the results of earlier transfers in a USD layer to which another one is written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.ownership import MARKED
from cagemap.files.text import text_name
from cagemap.files.usd.read import usd_modules

_SKINNING = ("skel:joints", "skel:skeleton", "skel:geomBindTransform")
_SHAPES, _SHAPE_TARGETS = "skel:blendShapes", "skel:blendShapeTargets"


def add_earlier(layer: Any, file: Path, prim_paths: Sequence[str], *, force: bool) -> bool:
    """Add to a new layer what cagemap wrote to its file before; of two values of one name the new one counts.

    ``layer``: the new one, with its final sublayers. ``file``: where it will be written. A file that cagemap did not
    write adds nothing. ``prim_paths``: the meshes that the results are about. Returns whether there was something to
    add.
    """
    pxr = usd_modules()
    try:
        earlier = pxr.Sdf.Layer.OpenAsAnonymous(text_name(file)) if file.is_file() else None
    except pxr.Tf.ErrorException:  # no USD: it is replaced with force, or refused
        earlier = None
    # A .usdc is compressed and has no checksum: it is replaced with force alone, and its words are believed.
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
            if "primvars:skel:jointIndices" in new.properties:  # numbers of other joints than the earlier ones
                _remove(old, _SKINNING)
    # What both say is the new layer's alone: the parts of two values do not mix.
    layer.Traverse("/", lambda path: _replaced(layer, earlier, path))
    pxr.UsdUtils.StitchLayers(layer, earlier)
    return True


def _subject(layer: Any, prim_paths: Sequence[str]) -> tuple[object, ...]:
    """What results are about: the file below, or the mesh that the layer holds itself."""
    if layer.subLayerPaths:
        return tuple(layer.subLayerPaths)
    names = ("points", "faceVertexCounts", "faceVertexIndices")
    found = (layer.GetAttributeAtPath(f"{path}.{name}") for path in prim_paths for name in names)
    return tuple(attribute and attribute.default for attribute in found)


def _join_shapes(new: Any, old: Any) -> None:
    """Put the earlier blend shapes of a prim before its new ones, but for those that these replace."""
    if not all(name in prim.properties for prim in (new, old) for name in (_SHAPES, _SHAPE_TARGETS)):
        return
    given, kept = (
        dict(zip(prim.properties[_SHAPES].default, _targets(prim).explicitItems, strict=False)) for prim in (new, old)
    )
    kept = {name: path for name, path in kept.items() if name in given or path not in given.values()} | given
    new.properties[_SHAPES].default = usd_modules().Vt.TokenArray(list(kept))
    _targets(new).explicitItems = list(kept.values())


def _targets(prim: Any) -> Any:
    return prim.properties[_SHAPE_TARGETS].targetPathList


def _replaced(layer: Any, earlier: Any, path: Any) -> None:
    """Remove from an earlier prim the properties that the new layer's has, and keep the type of a `SkelRoot`."""
    new, old = layer.GetPrimAtPath(path), earlier.GetPrimAtPath(path)
    if path.IsPrimPath() and new and old:
        _remove(old, new.properties.keys())
        if old.typeName == "SkelRoot":
            new.typeName = old.typeName


def _remove(prim: Any, names: Any) -> None:
    for name in names:
        if name in prim.properties:
            prim.RemoveProperty(prim.properties[name])
