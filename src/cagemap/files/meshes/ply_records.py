"""Read the header of a PLY file, and its elements as columns, from a text or binary body.

A text body is first packed as a binary one of float64 numbers, so that the rules for lists, counts and the end of the
file exist once.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.text import at_line, is_number
from cagemap.numerics.arrays import IndexArray

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_REMEDY = "Export the mesh again as PLY or OBJ."
END_LINE = re.compile(rb"(?<=[\r\n])end_header")  # a comment may have the word as well


@dataclass(frozen=True)
class Property:
    """A property of an element; a list if it has a ``count_type``. Types are NumPy's, with byte order."""

    name: str
    type: str
    count_type: str = ""


@dataclass(frozen=True)
class Element:
    """An element of the header, such as ``vertex``."""

    name: str
    count: int
    properties: tuple[Property, ...]


@dataclass(frozen=True, eq=False)
class Column:
    """Concatenated values of a property for all records: ``lengths[i]`` values of record i (1 for a scalar).

    ``stated`` is the type in the header; values of a text file are float64.
    """

    lengths: IndexArray
    values: NDArray[Any]
    stated: str = ""


def read_columns(path: Path, content: bytes) -> dict[str, dict[str, Column]]:
    """Columns of a PLY file by element and property name."""
    order, elements, start = _read_header(path, content)
    body = content[start:] if order else _pack_text(path, content[start:])
    columns, position = {}, 0
    for element in elements:
        properties, position = _read_element(
            path, body, position, element if order else _with_types(element, lambda _: "<f8")
        )
        columns[element.name] = {p.name: replace(properties[p.name], stated=p.type) for p in element.properties}
    return columns


def header_of(content: bytes) -> bytes:
    """Lines before ``end_header``, which may end in a carriage return alone, with line feeds."""
    end = END_LINE.search(content)
    return content[: end.start() if end else None].replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _read_header(path: Path, content: bytes) -> tuple[str, list[Element], int]:
    """Parse the header; returns the byte order ('' for text), the elements and the start of the body."""
    if not content.startswith(b"ply"):
        raise FormatError(f"{path}: expected a PLY file, which begins with 'ply', got {content[:16]!r}. {_REMEDY}")
    end_line = END_LINE.search(content)
    if end_line is None:
        raise FormatError(f"{path}: expected a PLY header that ends with 'end_header', found no end. {_REMEDY}")
    start = end_line.end()
    # If lines end in a carriage return alone, a following line feed is the first byte of the body.
    alone = content.startswith(b"ply\r") and not content.startswith(b"ply\r\n")
    for line_end in (b"\r",) if alone else (b"\r\n", b"\n", b"\r"):
        if content.startswith(line_end, start):
            start += len(line_end)
            break
    order: str | None = None
    elements: list[Element] = []
    for number, line in enumerate(header_of(content).decode("latin-1").split("\n"), start=1):
        words = line.split()
        try:
            match words:
                case ["format", form, _]:
                    order = _ORDERS[form]
                case ["element", name, count]:
                    elements.append(Element(name, _count(count), ()))
                case ["property", "list", count_type, item_type, name]:
                    types = _TYPES[item_type], _TYPES[count_type]
                    elements[-1] = _with_property(elements[-1], Property(name, *types))
                case ["property", item_type, name]:
                    elements[-1] = _with_property(elements[-1], Property(name, _TYPES[item_type]))
                case [] | ["ply"] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise KeyError
        except (KeyError, IndexError, ValueError):
            raise FormatError(at_line(path, number, "a line of a PLY header", line, _REMEDY)) from None
    if order is None:
        raise FormatError(f"{path}: expected a 'format' line in the PLY header, found none. {_REMEDY}")
    known = order or "<"
    return order, [_with_types(element, lambda kind: known + kind) for element in elements], start


def _count(word: str) -> int:
    count = int(word)
    if count < 0:
        raise ValueError(word)
    return count


def _with_property(element: Element, added: Property) -> Element:
    if added.count_type.startswith("f") or any(added.name == known.name for known in element.properties):
        raise ValueError(added.name)
    return replace(element, properties=(*element.properties, added))


def _with_types(element: Element, change: Callable[[str], str]) -> Element:
    """An element with converted types of values and list lengths."""
    changed = (Property(p.name, change(p.type), p.count_type and change(p.count_type)) for p in element.properties)
    return replace(element, properties=tuple(changed))


def _pack_text(path: Path, body: bytes) -> bytes:
    words = body.split()
    try:
        return np.array(list(map(float, words)), dtype="<f8").tobytes()
    except ValueError:
        bad = next(word for word in words if not is_number(word))
        line = body[: body.find(bad)].count(b"\n") + 1
        raise FormatError(
            f"{path}: expected numbers after the header, got {bad[:40]!r} in line {line} of the body. {_REMEDY}"
        ) from None


def _read_element(path: Path, body: bytes, position: int, element: Element) -> tuple[dict[str, Column], int]:
    """Read all records of an element: as one table if their lists have equal lengths, else one by one."""
    if element.count == 0 or not element.properties:
        return {p.name: Column(np.zeros(0, np.int64), np.zeros(0, p.type)) for p in element.properties}, position
    lengths, _ = _record_layout(path, body, position, element, 0)
    fields: list[Any] = []
    for i, (item, length) in enumerate(zip(element.properties, lengths, strict=True)):
        if item.count_type:
            fields.append((f"count{i}", item.count_type))
        fields.append((f"value{i}", item.type, (length,)))
    record = np.dtype(fields)
    if position + element.count * record.itemsize <= len(body):
        table = np.frombuffer(body, record, element.count, position)
        counts = [(table[f"count{i}"], lengths[i]) for i, item in enumerate(element.properties) if item.count_type]
        if all(bool(np.all(stated == length)) for stated, length in counts):
            columns = {
                item.name: Column(np.full(element.count, lengths[i]), table[f"value{i}"].ravel())
                for i, item in enumerate(element.properties)
            }
            return columns, position + element.count * record.itemsize
    return _read_records(path, body, position, element)


def _read_records(path: Path, body: bytes, position: int, element: Element) -> tuple[dict[str, Column], int]:
    """Read records of different lengths: find where their values are, then gather them all at once."""
    starts: list[list[int]] = []
    lengths: list[list[int]] = []
    for i in range(element.count):  # slow, but only for control meshes of mixed polygons
        record_lengths, record_starts = _record_layout(path, body, position, element, i)
        lengths.append(record_lengths)
        starts.append(record_starts[:-1])
        position = record_starts[-1]
    all_lengths, all_starts = np.array(lengths, dtype=np.int64), np.array(starts, dtype=np.int64)
    data = np.frombuffer(body, np.uint8)
    columns = {}
    for k, item in enumerate(element.properties):
        size, count, first = np.dtype(item.type).itemsize, all_lengths[:, k], all_starts[:, k]
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        places = (np.repeat(first, count) + size * within)[:, None] + np.arange(size)
        columns[item.name] = Column(count, np.ascontiguousarray(data[places]).view(item.type).ravel())
    return columns, position


def _record_layout(
    path: Path, body: bytes, position: int, element: Element, number: int
) -> tuple[list[int], list[int]]:
    """Lengths of a record's properties, and the byte where each one's values start; last the end of the record."""
    lengths, starts = [], []
    for item in element.properties:
        length = 1
        if item.count_type:
            code = item.count_type[0] + _STRUCT[item.count_type[1:]]
            width = struct.calcsize(code)
            if position + width > len(body):
                raise _cut_short(path, element, number)
            stated = struct.unpack_from(code, body, position)[0]
            if not 0 <= stated <= len(body) or stated != int(stated):
                raise FormatError(
                    f"{path}: {element.name} {number} (0-based): expected a length of the list "
                    f"'{item.name}', got {stated}. {_REMEDY}"
                )
            length = int(stated)
            position += width
        lengths.append(length)
        starts.append(position)
        position += length * int(item.type[2:])
    if position > len(body):
        raise _cut_short(path, element, number)
    return lengths, [*starts, position]


def _cut_short(path: Path, element: Element, number: int) -> FormatError:
    return FormatError(
        f"{path}: expected {element.count} records '{element.name}', the file ends within number "
        f"{number} (0-based). It is cut short; copy or export it again."
    )
