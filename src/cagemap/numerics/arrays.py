"""Array types, conversion of user input, read-only views, sums by group, connected components, rotations, sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cagemap.errors import ParameterError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

Array = TypeVar("Array", bound=NDArray)  # type: ignore[type-arg]


def array_of(values: object) -> NDArray[Any]:
    """Convert values to a NumPy array; torch tensors with gradients or on a device are copied."""
    if hasattr(values, "detach"):
        values = values.detach().cpu()
    return np.asarray(values)


def whole_numbers(values: ArrayLike, what: str) -> IndexArray:
    """Convert values to an int64 array; ParameterError if they are no whole numbers."""
    try:
        given = array_of(values)
    except ValueError:  # lists of different lengths
        raise ParameterError(f"{what}: expected whole numbers, got {shown(values)}") from None
    if not given.size:
        return np.zeros(given.shape, dtype=np.int64)
    if given.dtype.kind == "O" and all(isinstance(one, Real) and not isinstance(one, bool) for one in given.flat):
        given = np.array(given.tolist())
    whole = given.dtype.kind in "iu" or (given.dtype.kind == "f" and bool(np.all(given == np.floor(given))))
    if not whole or (given.dtype.kind in "uf" and not np.all(np.abs(given) < 2.0**63)):
        raise ParameterError(f"{what}: expected whole numbers, got {given.dtype} values such as {given.ravel()[:3]}")
    return np.ascontiguousarray(given, dtype=np.int64)


def real_numbers(values: ArrayLike, what: str) -> FloatArray:
    """Convert values to a float64 array; ParameterError if they are no real numbers."""
    try:
        given = array_of(values)
        if given.dtype.kind not in "biufO":
            raise ValueError
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ParameterError(f"{what}: expected an array of real numbers, got {shown(values)}") from None


def as_float64(values: NDArray[Any]) -> FloatArray:
    """Numbers as float64, without NumPy's warnings of signalling NaN and of values that become infinite."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(values, dtype=np.float64)


def finite_numbers(values: ArrayLike, what: str) -> FloatArray:
    """Convert values to a float64 array; ParameterError if they are no finite real numbers."""
    given = real_numbers(values, what)
    if not np.isfinite(given).all():
        raise ParameterError(f"{what}: expected finite numbers, got NaN or infinity among {given.size}")
    return given


def shown(value: object) -> str:
    """Text of a value for messages, at most 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def pair_keys(pairs: IndexArray, count: int) -> IndexArray:
    """(m,) unique keys of unordered pairs (m, 2) of numbers below ``count``."""
    return np.asarray(np.sort(pairs, axis=1) @ [count, 1])


def offsets_of(sizes: Sequence[int] | NDArray[np.integer]) -> IndexArray:
    """(m + 1,) starts of m consecutive runs of the given sizes, and the end of the last."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def joined_runs(starts: IndexArray, sizes: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Offsets (k + 1,) of k runs of numbers, one after the other, and the numbers: run i counts up from its start."""
    offsets = offsets_of(sizes)
    return offsets, np.repeat(starts - offsets[:-1], sizes) + np.arange(offsets[-1])


def places_of(numbers: NDArray[np.integer], count: int) -> IndexArray:
    """(count,) index of every number below ``count`` in an array without repeats; -1 for missing numbers."""
    places = np.full(count, -1, dtype=np.int64)
    places[numbers] = np.arange(len(numbers))
    return places


def mask_of(numbers: NDArray[np.integer], count: int) -> NDArray[np.bool_]:
    """(count,) whether a number below ``count`` occurs in an array of any shape."""
    mask = np.zeros(count, dtype=np.bool_)
    mask[numbers] = True
    return mask


def grouped_sums(groups: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """(count, d) sums of rows (m, d) in every group (m,)."""
    return np.column_stack([np.bincount(groups, column, minlength=count) for column in values.T]).astype(np.float64)


def read_only(array: Array) -> Array:
    """Read-only view of an array. Compiled kernels get no others, so that each is compiled only once."""
    if not array.flags.writeable:
        return array
    view: Array = array.view()
    view.flags.writeable = False
    return view


def label_components(heads: NDArray[np.integer], tails: NDArray[np.integer], count: int) -> IndexArray:
    """(count,) connected component of every node, numbered in the order of lowest nodes."""
    edges = sparse.coo_array((np.ones(len(heads), dtype=np.int8), (heads, tails)), shape=(count, count))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.int64)


def box_diagonal(points: FloatArray) -> float:
    """Length of the diagonal of the bounding box of points (n, d)."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def members_of(labels: NDArray[np.integer]) -> list[IndexArray]:
    """Ascending indices of every label that occurs, in the order of labels."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if len(labels) else []


def nearest_rotations(maps: FloatArray) -> FloatArray:
    """(n, 3, 3) rotations nearest to linear maps, by polar decomposition; a reflection's least axis is reversed."""
    left, _, right = np.linalg.svd(maps)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


def encode_srgb(linear: FloatArray) -> FloatArray:
    """Encode linear values from 0 to 1 as sRGB (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def decode_srgb(encoded: FloatArray) -> FloatArray:
    """Linear values of sRGB values."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
