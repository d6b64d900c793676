"""Accessors of glTF as arrays: strided, sparse, normalised; nothing outside its buffer is read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.gltf.document import Document, view_bytes
from cagemap.numerics.arrays import shown

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def accessor_count(document: Document, number: object, where: str) -> int:
    """Number of elements of an accessor, as stated."""
    return document.whole(document.entry("accessors", number, where).get("count"), f"accessors {number}: count", 1)


def read_accessor(
    document: Document, number: object, where: str, shapes: tuple[str, ...], count: int | None = None
) -> NDArray[Any]:
    """Elements of an accessor: (n,) of scalars, (n, q) of others; int64, or float64 where they have fractions.

    Parameters
    ----------
    document : Document
    number : int
    where : str
        What names it, for messages.
    shapes : tuple of str
        Types that are taken, such as ``"VEC3"``.
    count : int, optional
        How many elements there must be. An accessor without data, all zero, is read only where this is given: its own
        count could be anything.

    Raises
    ------
    FormatError
        If it is not there, has another type or count, reads outside its buffer view, or holds numbers that are not
        finite.
    """
    entry = document.entry("accessors", number, where)
    place = f"accessors {number} ({where})"
    shape = entry.get("type")
    if shape not in shapes:
        document.refuse(place, f"expected {' or '.join(shapes)}, got {shown(shape)}")
    stated = accessor_count(document, number, where)
    if count is not None and stated != count:
        document.refuse(place, f"expected {count} elements, got {stated}")
    dtype, columns = _component(document, entry, place), _SHAPES[str(shape)]
    if entry.get("bufferView") is not None:
        values = _elements(document, entry, place, dtype, columns, stated)
    elif count is not None:
        values = np.zeros((count, columns), dtype=dtype)
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
    if not isinstance(kind, int) or kind not in _COMPONENTS:
        document.refuse(place, f"expected a componentType of {', '.join(map(str, _COMPONENTS))}, got {shown(kind)}")
    return np.dtype(_COMPONENTS[kind])


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
    """Values with the rows replaced that a sparse accessor lists."""
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
