"""Meshes that Draco compressed (KHR_draco_mesh_compression), as plain accessors; by the extra ``cagemap[draco]``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.gltf.entries import Document, view_bytes

DRACO = "KHR_draco_mesh_compression"
_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def without_draco(document: Document) -> Document:
    """The same document with its compressed meshes as plain ones, in a further buffer; as it is where there are none.

    Raises
    ------
    FormatError
        If a mesh cannot be decompressed, or the library that does it is not installed.
    """
    found = [
        (number, place)
        for number in range(len(document.entries("meshes")))
        for place, primitive in enumerate(document.entries("primitives", document.entry("meshes", number)))
        if isinstance(primitive, dict) and DRACO in document.table(primitive, "extensions", f"meshes {number}")
    ]
    if not found:
        return document
    made = _Plain(document)
    for number, place in found:
        made.decompress(number, place)
    return made.document()


class _Plain:
    """A document whose primitives are decompressed one by one."""

    def __init__(self, document: Document) -> None:
        self._given = document
        self._meshes: list[Any] = list(document.entries("meshes"))
        self._accessors: list[Any] = list(document.entries("accessors"))
        self._views: list[Any] = list(document.entries("bufferViews"))
        self._chunks: list[bytes] = []
        self._length = 0

    def decompress(self, number: int, place: int) -> None:
        """Replace one primitive of a mesh."""
        given, where = self._given, f"meshes {number}, primitive {place}"
        mesh = self._meshes[number]
        primitive = mesh["primitives"][place]
        extensions = given.table(primitive, "extensions", where)
        packed = given.table(extensions, DRACO, where)
        decoded = _decoded(given, bytes(view_bytes(given, packed.get("bufferView"), where)), where)
        attributes = given.table(primitive, "attributes", where)
        arrays = {entry["unique_id"]: np.asarray(entry["data"]) for entry in decoded.attributes}
        changed = {
            name: self._accessor(attributes.get(name), arrays.get(unique), where)
            for name, unique in given.table(packed, "attributes", where).items()
            if not isinstance(unique, list | dict)
        }
        indices = self._accessor(primitive.get("indices"), np.asarray(decoded.faces, np.uint32).reshape(-1), where)
        kept = {name: value for name, value in extensions.items() if name != DRACO}
        plain = {name: value for name, value in primitive.items() if name != "extensions"}
        plain |= {"attributes": attributes | changed, "indices": indices, "mode": 4}
        primitives = list(mesh["primitives"])
        primitives[place] = plain | ({"extensions": kept} if kept else {})
        self._meshes[number] = mesh | {"primitives": primitives}

    def document(self) -> Document:
        """What came out."""
        given = self._given
        buffers = [*given.entries("buffers"), {"byteLength": self._length}]
        top = given.json | {"meshes": self._meshes, "accessors": self._accessors, "bufferViews": self._views}
        top["buffers"] = buffers
        for name in ("extensionsUsed", "extensionsRequired"):
            if left := [one for one in given.entries(name) if one != DRACO]:
                top[name] = left
            else:
                top.pop(name, None)
        return Document(top, (*given.buffers, b"".join(self._chunks)), given.file)

    def _accessor(self, number: object, array: NDArray[Any] | None, where: str) -> int:
        """Number of an accessor for decompressed values: that of the file with data."""
        entry = self._given.entry("accessors", number, where)
        kind = "" if array is None else f"{array.dtype.kind}{array.dtype.itemsize}"
        if array is None or kind not in _COMPONENTS or not array.size or array.size != len(array) * array[0].size:
            self._given.refuse(where, "its Draco data lacks an attribute that it lists")
        if array.size // len(array) not in _SHAPES:
            self._given.refuse(where, "its Draco data has attributes of more than four columns")
        data = np.ascontiguousarray(array).tobytes()
        view = {"buffer": len(self._given.buffers), "byteOffset": self._length, "byteLength": len(data)}
        self._views.append(view)
        self._chunks.append(data + b"\0" * (-len(data) % 4))
        self._length += len(self._chunks[-1])
        stated: dict[str, Any] = {
            "bufferView": len(self._views) - 1,
            "byteOffset": 0,
            "componentType": _COMPONENTS[kind],
        }
        stated |= {"count": len(array), "type": _SHAPES[array.size // len(array)]}
        if {"min", "max"} <= set(entry) and kind == "f4":
            stated |= {end: getattr(array, end)(axis=0).tolist() for end in ("min", "max")}
        self._accessors.append(entry | stated)
        return len(self._accessors) - 1


def _decoded(document: Document, data: bytes, where: str) -> Any:
    try:
        import DracoPy
    except ImportError:
        raise FormatError(
            f"{document.file}: is compressed with Draco ({DRACO}), which needs the package DracoPy. Install "
            "cagemap[draco], or write it without by `gltf-transform cp IN.glb OUT.glb` (npm package "
            "@gltf-transform/cli)."
        ) from None
    try:
        decoded = DracoPy.decode(data)
        if not len(decoded.faces):
            raise ValueError("no faces")
    except (DracoPy.FileTypeException, ValueError, AttributeError, TypeError) as error:
        document.refuse(where, f"its Draco data cannot be read ({error})")
    return decoded
