"""Access to what ufbx gives.

ufbx 0.0.5 counts too few references to its Python objects: one that is asked for twice is freed while it is used. So
nothing that it gives is ever released; the process ends with the file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray

_EVERYTHING: list[Any] = []


def held(value: Any) -> Any:
    """The same object, which stays until the process ends."""
    _EVERYTHING.append(value)
    return value


def get(value: Any, *names: str) -> Any:
    """An attribute, of an attribute and so on."""
    for name in names:
        value = held(getattr(value, name))
    return value


def items(value: Any, *names: str) -> list[Any]:
    """A list behind attributes, as a list of Python."""
    found: list[Any] = held(list(get(value, *names)))
    return found


def floats(value: Any, *names: str, columns: int) -> FloatArray:
    """A list of vectors behind attributes, as an array (n, columns)."""
    return np.array(get(value, *names), dtype=np.float64).reshape(-1, columns)


def whole(value: Any, *names: str) -> IndexArray:
    """A list of numbers behind attributes, as an array (n,)."""
    return np.array(get(value, *names), dtype=np.int64)
