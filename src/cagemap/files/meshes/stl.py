"""Reader of STL: triangles without shared vertices, binary or text."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.text import read_bytes
from cagemap.mesh import ControlMesh, Plain
from cagemap.numerics.arrays import FloatArray, as_float64
from cagemap.surface.alignment import Z_UP

_REMEDY = "Export the mesh again as STL, PLY or OBJ."
_TRIANGLE = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84
_NUMBER = rb"[-+.0-9eEinfaINFA]+"
_VERTEX = re.compile(rb"(?i)\bvertex\s+(%s)\s+(%s)\s+(%s)" % (_NUMBER, _NUMBER, _NUMBER))
_VERTICES = re.compile(rb"(?i)\bvertex\b")
# The name of a solid, up to the line's end or the first facet, may contain "vertex"; statements may share lines.
_NAME = re.compile(rb"(?i)\b(?:end)?solid\b(?:(?!\bfacet\s+normal\b)[^\n])*")


def read_stl(path: str | Path) -> ControlMesh:
    """Read a triangle mesh from an STL file; corners at exactly the same position are one vertex.

    Vertices are numbered by first appearance; normals and attributes are ignored. Most STL files have +Z up, and none
    is a cage of a subdivision surface.
    """
    file = Path(path)
    content = read_bytes(file, "an STL file")
    corners = _binary(content)
    if corners is None:
        corners = _text(file, content)
    if not len(corners) or not np.isfinite(corners).all():
        raise FormatError(f"{file}: expected triangles with finite corners, got {len(corners) // 3}. {_REMEDY}")
    places = corners + 0.0  # -0.0 becomes 0.0
    order = np.lexsort(places.T)  # stable: of equal corners the first in the file comes first
    fresh = np.concatenate([[True], np.any(places[order][1:] != places[order][:-1], axis=1)])
    first = order[fresh]
    number = np.empty(len(corners), dtype=np.int64)
    number[order] = np.argsort(np.argsort(first))[np.cumsum(fresh) - 1]
    offsets = np.arange(0, len(corners) + 1, 3)
    return ControlMesh(places[np.sort(first)], offsets, number, upright=Z_UP, scheme=Plain(), name=file.name)


def _binary(content: bytes) -> FloatArray | None:
    """(3 t, 3) corners of a binary file, which may be padded; None if the length does not fit its count."""
    if len(content) < _HEAD:
        return None
    count = int.from_bytes(content[_HEAD - 4 : _HEAD], "little")
    if not 0 <= len(content) - (_HEAD + count * _TRIANGLE.itemsize) < _TRIANGLE.itemsize:
        return None
    return as_float64(np.frombuffer(content, _TRIANGLE, count, _HEAD)["corners"].reshape(-1, 3))


def _text(file: Path, content: bytes) -> FloatArray:
    """(3 t, 3) corners of a text file."""
    content = content.removeprefix(codecs.BOM_UTF8).replace(b"\r", b"\n")
    if not content.lstrip()[:5].lower() == b"solid" or b"endsolid" not in content.lower():
        raise FormatError(f"{file}: expected an STL file, got something else, or one that is cut short. {_REMEDY}")
    content = _NAME.sub(b"", content)
    vertices = _VERTEX.findall(content)
    if len(vertices) % 3 or len(vertices) != len(_VERTICES.findall(content)):
        raise FormatError(
            f"{file}: expected three vertices of three numbers a triangle, got {len(vertices)}. {_REMEDY}"
        )
    try:
        return np.array(vertices, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise FormatError(f"{file}: expected numbers, got others ({error}). {_REMEDY}") from None
