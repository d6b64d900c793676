"""The structure of a glTF document: objects and lists where they belong, and numbers that name what is there."""

from __future__ import annotations

from typing import Any

from cagemap.files.gltf.entries import Document
from cagemap.numerics.arrays import shown

# An object of named entries, a list of one entry, or the name of a list that a number is of; with "!" it must be there.
# "*" stands for every name. "+" is a positive whole number.
_VIEW = {"bufferView": "bufferViews"}
_STRUCTURE: dict[str, Any] = {
    "scene": "scenes",
    "scenes": [{"nodes": ["nodes"]}],
    "nodes": [{"children": ["nodes"], "mesh": "meshes", "skin": "skins", "camera": "cameras"}],
    "meshes": [
        {
            "primitives": [
                {
                    "attributes": {"*": "!accessors"},
                    "indices": "accessors",
                    "material": "materials",
                    "targets": [{"*": "!accessors"}],
                }
            ]
        }
    ],
    "skins": [{"joints": ["!nodes"], "inverseBindMatrices": "accessors"}],
    "animations": [
        {
            "channels": [{"sampler": "!+", "target": {"node": "nodes"}}],
            "samplers": [{"input": "!accessors", "output": "!accessors"}],
        }
    ],
    "accessors": [{"count": "!+", "sparse": {"indices": _VIEW, "values": _VIEW}} | _VIEW],
    "bufferViews": [{"buffer": "!buffers", "byteLength": "!+"}],
    "buffers": [{"byteLength": "!+"}],
    "images": [_VIEW],
    "textures": [{"source": "images", "sampler": "samplers"}],
    "materials": [{"pbrMetallicRoughness": {}, "extensions": {}}],
}


def require_structure(document: Document) -> None:
    """Refuse a document whose objects, lists and numbers are not what the standard says.

    Raises
    ------
    FormatError
        That names the place.
    """
    _require(document, document.json, _STRUCTURE, "glTF")
    for number, animation in enumerate(document.entries("animations")):
        count = len(animation.get("samplers", ()))
        for channel in animation.get("channels", ()):
            document.whole(channel["sampler"], f"animations {number}: sampler", 0, count - 1)


def _require(document: Document, value: Any, wanted: Any, where: str) -> None:
    if isinstance(wanted, dict):
        if not isinstance(value, dict):
            document.refuse(where, f"expected an object, got {shown(value)}")
        for name in value if "*" in wanted else wanted:
            below = wanted.get(name, wanted.get("*"))
            if value.get(name) is not None or str(below).startswith("!"):
                _require(document, value.get(name), below, f"{where}: {name}" if where != "glTF" else name)
    elif isinstance(wanted, list):
        if not isinstance(value, list):
            document.refuse(where, f"expected a list, got {shown(value)}")
        for number, one in enumerate(value):
            _require(document, one, wanted[0], f"{where} {number}")
    elif isinstance(wanted, str):
        kind = wanted.removeprefix("!")
        count = 2**53 if kind == "+" else len(document.entries(kind))
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
            of = "a whole number" if kind == "+" else f"the number of one of {count} {kind}"
            document.refuse(where, f"expected {of}, got {shown(value)}")
