"""Entries of glTF documents, checked when looked up; buffers, images, and accessors as arrays."""

from __future__ import annotations

import base64
import binascii
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.text import file_in, make_distinct, read_bytes, whole_characters
from cagemap.numerics.arrays import FloatArray, shown

_DATA_URI = re.compile(r"data:([^,;]*)((?:;[^,;]*)*),")
REMEDY = "Export it again."
_LARGEST = 1e100  # of numbers, so that their products stay finite


@dataclass(frozen=True, eq=False)
class Document:
    """JSON and buffers of a glTF file."""

    json: dict[str, Any]  # as in the file
    buffers: tuple[bytes, ...] = field(repr=False)  # one for each entry of the JSON's ``buffers``
    file: Path  # the file that was read, for messages; images are searched beside it
    # by material of a USD file: UV set of the colour image
    uv_names: Mapping[str, str] = field(default_factory=dict, repr=False)

    def refuse(self, where: str, problem: str, remedy: str = REMEDY) -> NoReturn:
        """Raise a FormatError that names the file and the entry."""
        raise FormatError(f"{self.file}: {where}: {problem}. {remedy}")

    def entries(self, kind: str, of: dict[str, Any] | None = None, where: str = "glTF") -> list[Any]:
        """A list of the JSON or of the entry ``of``; empty if absent."""
        entries = (self.json if of is None else of).get(kind, [])
        if not isinstance(entries, list):
            self.refuse(where, f"expected a list of {kind}, got {shown(entries)}")
        return entries

    def table(self, of: dict[str, Any], name: str, where: str) -> dict[str, Any]:
        """An object inside an entry of the JSON; empty if absent."""
        table = of.get(name, {})
        if not isinstance(table, dict):
            self.refuse(where, f"expected an object as {name}, got {shown(table)}")
        return table

    def entry(self, kind: str, number: object, where: str = "glTF") -> dict[str, Any]:
        """An entry of one of the JSON's lists, by number."""
        entries = self.entries(kind)
        entry = entries[self.whole(number, f"{where}: number of {kind}", 0, len(entries) - 1)]
        if not isinstance(entry, dict):
            self.refuse(f"{kind} {number}", f"expected an object, got {shown(entry)}")
        return entry

    def whole(self, value: object, where: str, low: int = 0, high: int = 2**53) -> int:
        """A value of the JSON as a whole number from ``low`` to ``high``, both included."""
        right = isinstance(value, int | float) and not isinstance(value, bool) and value == value // 1
        if not right or not low <= value <= high:  # type: ignore[operator]
            limits = f" from {low} to {high}" if high >= low else ", there are none"
            self.refuse(where, f"expected a whole number{limits}, got {shown(value)}")
        return int(value)  # type: ignore[call-overload]

    def numbers(self, value: object, where: str, count: int) -> FloatArray:
        """A list of the JSON as (count,) finite numbers."""
        right = (
            isinstance(value, list) and len(value) == count and all(isinstance(number, int | float) for number in value)
        )
        if not right or not all(abs(number) < _LARGEST for number in value):  # type: ignore[attr-defined]
            self.refuse(where, f"expected {count} finite numbers, got {shown(value)}")
        return np.array(value, dtype=np.float64)

    def name(self, kind: str, number: int) -> str:
        """The name of an entry, '' without one."""
        stated = self.entry(kind, number).get("name")
        return whole_characters(stated) if isinstance(stated, str) else ""

    def unique_names(self, kind: str, word: str) -> tuple[str, ...]:
        """Unique names of all entries; unnamed ones are called by a word and their number."""
        count = len(self.entries(kind))
        return make_distinct([self.name(kind, number) or f"{word} {number}" for number in range(count)])


def resource(document: Document, uri: object, where: str) -> bytes:
    """Bytes that a URI refers to: data in the URI, or a file in the document's folder."""
    if not isinstance(uri, str):
        document.refuse(where, f"expected a URI, got {shown(uri)}")
    head = _DATA_URI.match(uri)
    if head:
        body = uri[head.end() :]
        try:
            return base64.b64decode(body, validate=True) if ";base64" in head[2] else unquote_to_bytes(body)
        except (binascii.Error, ValueError) as error:
            document.refuse(where, f"its data URI is damaged ({error})")
    name = unquote(uri)
    inside = posixpath.normpath(name.replace("\\", "/"))
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name) or inside.startswith(("/", "..")) or "\0" in name:
        document.refuse(
            where, f"names {shown(uri)}, expected a file in the folder of the document", "Pack it into one .glb."
        )
    return read_bytes(file_in(document.file.parent, inside), f"a file that {document.file.name} names")


def view_bytes(document: Document, number: object, where: str) -> memoryview:
    """Bytes of a buffer view."""
    view = document.entry("bufferViews", number, where)
    where = f"bufferViews {number}"
    buffer = document.buffers[document.whole(view.get("buffer"), where, 0, len(document.buffers) - 1)]
    offset = document.whole(view.get("byteOffset", 0), f"{where}: byteOffset", 0, len(buffer))
    length = document.whole(view.get("byteLength"), f"{where}: byteLength", 1, len(buffer) - offset)
    return memoryview(buffer)[offset : offset + length]


def image_bytes(document: Document, number: object) -> tuple[bytes, str]:
    """An image in its stored format, and its suffix, such as ``.png``."""
    entry, where = document.entry("images", number), f"images {number}"
    uri = entry.get("uri")
    data = (
        bytes(view_bytes(document, entry.get("bufferView"), where)) if uri is None else resource(document, uri, where)
    )
    suffix = image_suffix(data)
    if suffix is None:
        document.refuse(where, "expected a PNG or JPEG image, got other data", "Export it with PNG textures.")
    return data, suffix


def image_type(suffix: str) -> str:
    """Media type of an image by its suffix, such as ``.png``."""
    return f"image/{suffix[1:].replace('jpg', 'jpeg')}"


def image_suffix(data: bytes) -> str | None:
    """Suffix of an image's format by its first bytes; None for other data."""
    signatures = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp"}
    return next((suffix for start, suffix in signatures.items() if data.startswith(start)), None)


# Dictionaries are objects with these entries, lists are lists of such an entry. A string is the list that a number
# refers to. With "!" the entry is required, "*" stands for every name, "+" is a positive whole number.
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
    """Refuse a document whose objects, lists and numbers do not follow the standard."""
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
        for number, item in enumerate(value):
            _require(document, item, wanted[0], f"{where} {number}")
    elif isinstance(wanted, str):
        kind = wanted.removeprefix("!")
        count = 2**53 if kind == "+" else len(document.entries(kind))
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
            of = "a whole number" if kind == "+" else f"the number of one of {count} {kind}"
            document.refuse(where, f"expected {of}, got {shown(value)}")


# NumPy's type of each componentType of glTF, and the number of columns of each type of an accessor.
COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def read_accessor(
    document: Document, number: object, where: str, shapes: tuple[str, ...], count: int | None = None
) -> NDArray[Any]:
    """Elements of an accessor: (n,) for scalars, else (n, q); int64, or float64 if fractional.

    ``where``: the entry that refers to it, for messages.
    ``shapes``: accepted types, such as ``"VEC3"``.
    ``count``: required number of elements. An accessor without data (all zero) is read only if this is given, or if it
        is sparse and the document has as many bytes, since its own count could be anything.
    """
    entry = document.entry("accessors", number, where)
    place = f"accessors {number} ({where})"
    shape = entry.get("type")
    if shape not in shapes:
        document.refuse(place, f"expected {' or '.join(shapes)}, got {shown(shape)}")
    stated = document.whole(entry.get("count"), f"accessors {number}: count", 1)
    if count is not None and stated != count:
        document.refuse(place, f"expected {count} elements, got {stated}")
    dtype, columns = _component(document, entry, place), COLUMNS[str(shape)]
    if entry.get("bufferView") is not None:
        values = _elements(document, entry, place, dtype, columns, stated)
    elif count is not None or ("sparse" in entry and stated <= sum(map(len, document.buffers))):
        values = np.zeros((stated, columns), dtype=dtype)
    else:
        document.refuse(place, "has no data")
    if "sparse" in entry:
        values = _with_sparse(document, document.table(entry, "sparse", place), place, values)
    if dtype.kind == "f" and not np.isfinite(values).all():
        document.refuse(place, "expected finite numbers, got others")
    normalised = entry.get("normalized") is True and dtype.kind != "f"
    values = values.astype(np.float64 if dtype.kind == "f" or normalised else np.int64)
    if normalised:
        values = np.maximum(values / np.iinfo(dtype).max, -1.0)
    return values[:, 0] if columns == 1 else values


def _component(document: Document, entry: dict[str, Any], place: str) -> np.dtype[Any]:
    kind = entry.get("componentType")
    if not isinstance(kind, int) or kind not in COMPONENT_TYPES:
        document.refuse(place, f"expected a componentType of {', '.join(map(str, COMPONENT_TYPES))}, got {shown(kind)}")
    return np.dtype(COMPONENT_TYPES[kind])


def _elements(
    document: Document, entry: dict[str, Any], place: str, dtype: np.dtype[Any], columns: int, count: int
) -> NDArray[Any]:
    """(count, columns) elements, a view of the buffer."""
    data = view_bytes(document, entry.get("bufferView"), place)
    size = dtype.itemsize * columns
    view = document.entry("bufferViews", entry.get("bufferView"), place)
    stride = document.whole(view.get("byteStride", size), f"{place}: byteStride", size, 255)
    offset = document.whole(entry.get("byteOffset", 0), f"{place}: byteOffset", 0, len(data))
    if offset + (count - 1) * stride + size > len(data):
        document.refuse(place, f"expected {count} elements, its buffer view of {len(data)} bytes ends before")
    return np.ndarray((count, columns), dtype, data, offset, (stride, dtype.itemsize))


def _with_sparse(document: Document, sparse: dict[str, Any], place: str, values: NDArray[Any]) -> NDArray[Any]:
    """Values, with the rows replaced that a sparse accessor lists."""
    place = f"{place}: sparse"
    count = document.whole(sparse.get("count"), f"{place}: count", 1, len(values))
    rows, given = (document.table(sparse, name, place) for name in ("indices", "values"))
    kind = _component(document, rows, place)
    if kind.kind != "u":
        document.refuse(place, f"expected unsigned indices, got {kind}")
    numbers = _elements(document, rows, place, kind, 1, count)[:, 0].astype(np.int64)
    if np.any(np.diff(numbers) <= 0) or numbers[-1] >= len(values):
        document.refuse(place, f"expected rising indices below {len(values)}")
    changed = np.array(values)
    changed[numbers] = _elements(document, given, place, values.dtype, values.shape[1], count)
    return changed
