"""Buffers of glTF documents: arrays and bytes are added, unused ones are removed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.gltf.entries import COLUMNS, COMPONENT_TYPES, Document, view_bytes
from cagemap.numerics.arrays import FloatArray, IndexArray

# Targets of buffer views.
VERTICES, INDICES = 34962, 34963
DRACO = "KHR_draco_mesh_compression"
# Extension that marks polygons: consecutive triangles with a common first vertex are the fan of one.
NGONS = "FB_ngon_encoding"
# Extra of a primitive: faces whose fan does not begin at their first corner, and the corner where it begins.
STARTS = "cagemap_fan_starts"
# glTF's numbers of component types, by kind and size: the letters of numpy's types differ between systems.
COMPONENTS = {kind.removeprefix("<"): number for number, kind in COMPONENT_TYPES.items()}
SHAPES = {columns: shape for shape, columns in COLUMNS.items()}
_KNOWN = {
    *(DRACO, NGONS, "KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", "KHR_lights_punctual", "VRM")
}
_KNOWN_FAMILIES = ("KHR_materials_", "VRMC_")


def is_known_extension(name: object) -> bool:
    """Whether an extension may be required, and refers to no accessors or buffer views (Draco's is decompressed)."""
    return isinstance(name, str) and (name in _KNOWN or name.startswith(_KNOWN_FAMILIES))


class Binary:
    """Buffer views and accessors of a document, to which more are added; ``extensions`` lists those used."""

    def __init__(self, document: Document | None = None) -> None:
        self._given = Document({}, (), Path("new.glb")) if document is None else document
        self._chunks: list[bytes] = []
        self._length = 0
        self._views: list[dict[str, Any]] = list(self._given.entries("bufferViews"))
        self._accessors: list[dict[str, Any]] = list(self._given.entries("accessors"))
        self.extensions: set[str] = set()

    def view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the number of their buffer view."""
        entry = {"buffer": len(self._given.buffers), "byteOffset": self._length, "byteLength": len(data)}
        self._views.append(entry if target is None else entry | {"target": target})
        self._chunks.append(data + b"\0" * (-len(data) % 4))
        self._length += len(self._chunks[-1])
        return len(self._views) - 1

    def accessor(self, array: NDArray[Any], target: int | None = None, *, bounds: bool = False, **extra: Any) -> int:
        """Add an array (n,) or (n, q) of single precision or whole numbers; returns its accessor's number.

        ``bounds``: state them, as glTF requires of positions and times.
        """
        data = np.ascontiguousarray(array)
        form = _form(data) | (_bounds(data) if bounds else {})
        return self._add({"bufferView": self.view(data.tobytes(), target)} | form | extra)

    def offsets(self, values: FloatArray) -> int:
        """Add offsets (n, 3) of a blend shape, sparse if that is shorter; returns the accessor's number."""
        table = values.astype("<f4")
        rows = np.flatnonzero(table.any(axis=1))
        if 16 * len(rows) > 12 * len(table):
            return self.accessor(table, VERTICES, bounds=True)
        rows = rows if len(rows) else np.zeros(1, dtype=np.int64)
        numbers = _shrink_indices(rows)
        sparse = {
            "count": len(rows),
            "indices": {"bufferView": self.view(numbers.tobytes()), "componentType": _form(numbers)["componentType"]},
            "values": {"bufferView": self.view(table[rows].tobytes())},
        }
        return self._add(_form(table) | _bounds(table) | {"sparse": sparse})

    def indices(self, corners: IndexArray) -> int:
        """Add vertex indices of triangles, (3 t,); returns the accessor's number."""
        return self.accessor(_shrink_indices(corners), INDICES)

    def document(self, top: dict[str, Any]) -> Document:
        """A document with the JSON ``top``, and with the accessors, views and buffer added so far."""
        buffers = list(self._given.entries("buffers"))
        data = b"".join(self._chunks)
        if data:
            buffers.append({"byteLength": len(data)})
        given = top.get("extensionsUsed", ())
        used = sorted({*(name for name in given if isinstance(name, str)), *self.extensions})
        lists = {"accessors": self._accessors, "bufferViews": self._views, "buffers": buffers, "extensionsUsed": used}
        blobs = (*self._given.buffers, data) if data else self._given.buffers
        return Document(top | {name: values for name, values in lists.items() if values}, blobs, self._given.file)

    def _add(self, entry: dict[str, Any]) -> int:
        self._accessors.append(entry)
        return len(self._accessors) - 1


def _form(array: NDArray[Any]) -> dict[str, Any]:
    columns = 1 if array.ndim == 1 else array.shape[1]
    kind = COMPONENTS[f"{array.dtype.kind}{array.dtype.itemsize}"]
    return {"componentType": kind, "count": len(array), "type": SHAPES[columns]}


def _bounds(table: NDArray[Any]) -> dict[str, Any]:
    return {end: np.atleast_1d(getattr(table, end)(axis=0)).tolist() for end in ("min", "max")}


def _shrink_indices(numbers: IndexArray) -> NDArray[Any]:
    """Numbers in two bytes where they fit; 65535 is reserved for primitive restart."""
    return numbers.astype("<u2" if numbers.max(initial=0) < 65535 else "<u4")


def add_channel(entry: dict[str, Any], node: int, path: str, sampler: dict[str, Any]) -> None:
    """Add a channel of a node, and its sampler, to an entry of ``animations``."""
    entry["channels"].append({"sampler": len(entry["samplers"]), "target": {"node": node, "path": path}})
    entry["samplers"].append(sampler)


def corners_from(offsets: IndexArray, starts: IndexArray) -> IndexArray:
    """(c,) corners of all faces, each face beginning at its corner ``starts``."""
    sizes = np.diff(offsets)
    place = np.arange(offsets[-1]) - np.repeat(offsets[:-1] - starts, sizes)
    return np.asarray(np.repeat(offsets[:-1], sizes) + place % np.repeat(sizes, sizes))


_Holder = tuple[dict[str, Any], str]


def remove_unused(document: Document) -> Document:
    """The document without unused accessors, buffer views and bytes; unchanged if it has unknown extensions.

    Meshes, textures and images stay, used or not, since extensions refer to them by number.
    """
    if not all(map(is_known_extension, document.entries("extensionsUsed"))):
        return document
    top = json.loads(json.dumps(document.json))
    top["accessors"] = _take_used_entries(top.get("accessors", []), list(_accessor_references(top)))
    views = [dict(view, number=number) for number, view in enumerate(top.get("bufferViews", []))]
    chunks, length = [], 0
    top["bufferViews"] = _take_used_entries(views, list(_view_references(top)))
    for view in top["bufferViews"]:
        data = bytes(view_bytes(document, view.pop("number"), "glTF"))
        view |= {"buffer": 0, "byteOffset": length}
        chunks += [data, b"\0" * (-len(data) % 4)]
        length += len(data) + -len(data) % 4
    top["buffers"] = [{"byteLength": length}] if length else []
    top = {name: value for name, value in top.items() if value != []}
    return Document(top, (b"".join(chunks),) if length else (), document.file)


def _take_used_entries(entries: list[Any], holders: list[_Holder]) -> list[Any]:
    """Entries that are referred to; renumbers the references."""
    used = sorted({holder[key] for holder, key in holders})
    number = {old: new for new, old in enumerate(used)}
    for holder, key in holders:
        holder[key] = number[holder[key]]
    return [entries[old] for old in used]


def _accessor_references(top: dict[str, Any]) -> Iterator[_Holder]:
    """All references to accessors in the JSON."""
    for mesh in top.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            for table in (primitive.get("attributes", {}), *primitive.get("targets", [])):
                yield from ((table, name) for name in table)
            yield from _reference(primitive, "indices")
    for skin in top.get("skins", []):
        yield from _reference(skin, "inverseBindMatrices")
    for animation in top.get("animations", []):
        for sampler in animation.get("samplers", []):
            yield from ((sampler, "input"), (sampler, "output"))


def _view_references(top: dict[str, Any]) -> Iterator[_Holder]:
    """All references to buffer views in the JSON."""
    for entry in (*top["accessors"], *top.get("images", [])):
        yield from _reference(entry, "bufferView")
        for part in entry.get("sparse", {}).values():
            if isinstance(part, dict):
                yield from _reference(part, "bufferView")


def _reference(entry: dict[str, Any], key: str) -> Iterator[_Holder]:
    if entry.get(key) is not None:
        yield entry, key
