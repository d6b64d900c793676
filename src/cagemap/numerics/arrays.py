"""Types of the arrays that pass between rooms, and arrays that nobody changes."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

Array = TypeVar("Array", bound=NDArray)  # type: ignore[type-arg]


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
