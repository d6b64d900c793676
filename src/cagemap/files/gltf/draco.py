"""Meshes that Draco compressed (KHR_draco_mesh_compression), as plain accessors; by the extra ``cagemap[draco]``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.gltf.binary import COMPONENTS, INDICES, VERTICES, Binary
from cagemap.files.gltf.entries import Document, view_bytes

DRACO = "KHR_draco_mesh_compression"


def without_draco(document: Document) -> Document:
    """The document with its compressed meshes as plain ones, in a further buffer; as it is where there are none."""
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
        self._binary = Binary(document)

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
        listed = given.table(packed, "attributes", where).items()
        named = {name: arrays.get(unique) for name, unique in listed if not isinstance(unique, list | dict)}
        named |= _normalised({name: values for name, values in named.items() if name.startswith("WEIGHTS_")})
        changed = {name: self._accessor(attributes.get(name), values, where) for name, values in named.items()}
        indices = self._accessor(
            primitive.get("indices"), np.asarray(decoded.faces, np.uint32).reshape(-1), where, INDICES
        )
        kept = {name: value for name, value in extensions.items() if name != DRACO}
        plain = {name: value for name, value in primitive.items() if name != "extensions"}
        plain |= {"attributes": attributes | changed, "indices": indices, "mode": 4}
        primitives = list(mesh["primitives"])
        primitives[place] = plain | ({"extensions": kept} if kept else {})
        self._meshes[number] = mesh | {"primitives": primitives}

    def document(self) -> Document:
        """What came out."""
        given = self._given
        top = given.json | {"meshes": self._meshes}
        for name in ("extensionsUsed", "extensionsRequired"):
            if left := [one for one in given.entries(name) if one != DRACO]:
                top[name] = left
            else:
                top.pop(name, None)
        return self._binary.document(top)

    def _accessor(self, number: object, array: NDArray[Any] | None, where: str, target: int = VERTICES) -> int:
        """Number of an accessor for decompressed values: that of the file with data."""
        entry = self._given.entry("accessors", number, where)
        kind = "" if array is None else f"{array.dtype.kind}{array.dtype.itemsize}"
        if array is None or kind not in COMPONENTS or not array.size:
            self._given.refuse(where, "its Draco data lacks an attribute that it lists")
        columns = array.size // len(array)
        if columns > 4:
            self._given.refuse(where, "its Draco data has attributes of more than four columns")
        kept: dict[str, Any] = {name: entry[name] for name in ("name", "normalized", "extras") if name in entry}
        if {"min", "max"} <= set(entry) and kind == "f4":
            kept |= {end: getattr(array, end)(axis=0).tolist() for end in ("min", "max")}
        return self._binary.accessor(array.reshape(-1) if columns == 1 else array.reshape(-1, columns), target, **kept)


def _normalised(weights: dict[str, NDArray[Any] | None]) -> dict[str, NDArray[Any] | None]:
    """Weights whose sums the compression has moved away from 1."""
    known = [values for values in weights.values() if values is not None]
    if not known or any(values.dtype.kind != "f" or values.shape != (len(known[0]), 4) for values in known):
        return weights
    sums = np.asarray(np.sum(known, axis=(0, 2), dtype=np.float64, keepdims=True))[0]
    return {
        name: None if values is None else (values / np.where(sums > 0.0, sums, 1.0)).astype(np.float32)
        for name, values in weights.items()
    }


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
