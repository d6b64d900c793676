"""What a glTF file holds: its JSON, looked up with checks, its buffers and images."""

from __future__ import annotations

import base64
import binascii
import posixpath
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.text import read_bytes, whole_characters
from cagemap.numerics.arrays import FloatArray, shown

_DATA_URI = re.compile(r"data:([^,;]*)((?:;[^,;]*)*),")
REMEDY = "Export it again."
_LARGEST = 1e100  # of numbers that are squared and multiplied


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF file.

    Attributes
    ----------
    json : dict
        As in the file.
    buffers : tuple of bytes
        One for each entry of the JSON's ``buffers``.
    file : Path
        Where it was read, for messages; images beside it are found from here.
    """

    json: dict[str, Any]
    buffers: tuple[bytes, ...] = field(repr=False)
    file: Path

    def refuse(self, where: str, problem: str, remedy: str = REMEDY) -> NoReturn:
        """Raise a FormatError that names the file and the place."""
        raise FormatError(f"{self.file}: {where}: {problem}. {remedy}")

    def entries(self, kind: str, of: dict[str, Any] | None = None, where: str = "glTF") -> list[Any]:
        """A list of the JSON, of its top or of an entry; empty where there is none."""
        found = (self.json if of is None else of).get(kind, [])
        if not isinstance(found, list):
            self.refuse(where, f"expected a list of {kind}, got {shown(found)}")
        return found

    def table(self, of: dict[str, Any], name: str, where: str) -> dict[str, Any]:
        """An object of the JSON inside an entry; empty where there is none."""
        found = of.get(name, {})
        if not isinstance(found, dict):
            self.refuse(where, f"expected an object as {name}, got {shown(found)}")
        return found

    def entry(self, kind: str, number: object, where: str = "glTF") -> dict[str, Any]:
        """One of the JSON's lists' entries, by number.

        Raises
        ------
        FormatError
            If there is none.
        """
        entries = self.entries(kind)
        found = entries[self.whole(number, f"{where}: number of {kind}", 0, len(entries) - 1)]
        if not isinstance(found, dict):
            self.refuse(f"{kind} {number}", f"expected an object, got {shown(found)}")
        return found

    def whole(self, value: object, where: str, low: int = 0, high: int = 2**53) -> int:
        """A value of the JSON as a whole number from ``low`` to ``high``, both included."""
        right = isinstance(value, int | float) and not isinstance(value, bool) and value == value // 1
        if not right or not low <= value <= high:  # type: ignore[operator]
            limits = f" from {low} to {high}" if high >= low else ", there are none"
            self.refuse(where, f"expected a whole number{limits}, got {shown(value)}")
        return int(value)  # type: ignore[call-overload]

    def numbers(self, value: object, where: str, count: int) -> FloatArray:
        """A list of the JSON as (count,) finite numbers."""
        right = isinstance(value, list) and len(value) == count and all(isinstance(one, int | float) for one in value)
        if not right or not all(abs(one) < _LARGEST for one in value):  # type: ignore[attr-defined]
            self.refuse(where, f"expected {count} finite numbers, got {shown(value)}")
        return np.array(value, dtype=np.float64)

    def name(self, kind: str, number: int) -> str:
        """The name of an entry, '' where it has none."""
        stated = self.entry(kind, number).get("name")
        return whole_characters(stated) if isinstance(stated, str) else ""


def resource(document: Document, uri: object, where: str) -> bytes:
    """What a URI names: data in the JSON, or a file in the folder of the document."""
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
    return read_bytes(document.file.parent / inside, f"a file that {document.file.name} names")


def view_bytes(document: Document, number: object, where: str) -> memoryview:
    """Bytes of a buffer view.

    Raises
    ------
    FormatError
        If it does not lie inside its buffer.
    """
    view = document.entry("bufferViews", number, where)
    where = f"bufferViews {number}"
    buffer = document.buffers[document.whole(view.get("buffer"), where, 0, len(document.buffers) - 1)]
    offset = document.whole(view.get("byteOffset", 0), f"{where}: byteOffset", 0, len(buffer))
    length = document.whole(view.get("byteLength"), f"{where}: byteLength", 1, len(buffer) - offset)
    return memoryview(buffer)[offset : offset + length]


def image_bytes(document: Document, number: object) -> tuple[bytes, str]:
    """An image as it is stored, and its suffix, such as ``.png``.

    Raises
    ------
    FormatError
        If it is not there, or is neither PNG, JPEG nor WebP.
    """
    entry, where = document.entry("images", number), f"images {number}"
    uri = entry.get("uri")
    data = (
        bytes(view_bytes(document, entry.get("bufferView"), where)) if uri is None else resource(document, uri, where)
    )
    suffix = image_suffix(data)
    if suffix is None:
        document.refuse(where, "expected a PNG or JPEG image, got other data", "Export it with PNG textures.")
    return data, suffix


def image_suffix(data: bytes) -> str | None:
    """Suffix of an image's file by its first bytes; None for other data."""
    signatures = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp"}
    return next((suffix for start, suffix in signatures.items() if data.startswith(start)), None)
