"""Types of the arrays that pass between rooms, and arrays that nobody changes."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cagemap.errors import ParameterError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

Array = TypeVar("Array", bound=NDArray)  # type: ignore[type-arg]


def whole_numbers(values: ArrayLike, what: str) -> IndexArray:
    """Values as int64; floats only where nothing is lost.

    Raises
    ------
    ParameterError
        If they are no whole numbers.
    """
    given = np.asarray(values)
    if not given.size:
        return np.zeros(given.shape, dtype=np.int64)
    whole = given.dtype.kind in "iu" or (given.dtype.kind == "f" and bool(np.all(given == np.floor(given))))
    if not whole or (given.dtype.kind in "uf" and not np.all(np.abs(given) < 2.0**63)):
        raise ParameterError(f"{what}: expected whole numbers, got {given.dtype} values such as {given.ravel()[:3]}")
    return np.ascontiguousarray(given, dtype=np.int64)


def real_numbers(values: ArrayLike, what: str) -> FloatArray:
    """Values as float64.

    Raises
    ------
    ParameterError
        If they are no real numbers.
    """
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "biufO":
            raise ValueError
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ParameterError(f"{what}: expected an array of real numbers, got {shown(values)}") from None


def shown(value: object) -> str:
    """A value as a message shows it, cut short where it is long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def pair_keys(pairs: IndexArray, count: int) -> IndexArray:
    """(m,) one number for every pair (m, 2) of numbers below ``count``, whichever of the two comes first."""
    return np.asarray(np.sort(pairs, axis=1) @ [count, 1])


def grouped_sums(groups: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """(count, d) sums of rows (m, d) by group (m,)."""
    return np.column_stack([np.bincount(groups, column, minlength=count) for column in values.T]).astype(np.float64)


def read_only(array: Array) -> Array:
    """The same numbers behind a view that refuses to be written to; the array itself stays as it is.

    Values hold such views. Compiled kernels get them too: they are compiled anew for each kind of argument, and so meet
    one kind only.
    """
    if not array.flags.writeable:
        return array
    view: Array = array.view()
    view.flags.writeable = False
    return view
