"""`cagemap transfer --base`: values of the target itself, which stay where nothing is transferred."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.usd.read import USD_SUFFIXES
from cagemap.files.values.attributes import Attributes, read_attributes
from cagemap.files.values.part_numbering import FileRows, to_file
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.tasks.requests.transfer import TransferRequest, base_of


def keep_base(
    request: TransferRequest, result: MatchResult, carried: Attributes, rows: FileRows | None
) -> tuple[Attributes, list[str]]:
    """Carried values over the target's own ones outside the masks; and what is to be said where there are none.

    Parameters
    ----------
    request : TransferRequest
    result : MatchResult
    carried : dict of str to array
    rows : FileRows or None
        Of the target's file.

    Raises
    ------
    ParameterError
        If the base lacks a value, or has another number of rows or columns.
    """
    if not result.masks.any:
        return carried, []
    base = base_of(request)
    if base is None:
        return carried, [
            "outside the masks values are carried as well; --base with the target's own values keeps those"
        ]
    own = read_attributes(base, result.target.control, rows)
    weight = result.masks.joint(result.point_map)
    kept: Attributes = {}
    for name, values in carried.items():
        below = _named(own, name, len(carried))
        if below is None or below.shape != values.shape:
            found = "none" if below is None else f"shape {below.shape}"
            raise ParameterError(
                f"--base {base}: expected {name} of shape {values.shape}, as what is carried, got {found}. Give "
                "the target's own values."
            )
        share = _rows(result, weight, len(values)).reshape(-1, *([1] * (values.ndim - 1)))
        if values.dtype.kind == "i" or below.dtype.kind == "i":
            kept[name] = np.where(share >= 0.5, values, below)
        else:
            kept[name] = below + share * (values - below)
    return kept, []


def in_file(request: TransferRequest, carried: Attributes, rows: FileRows | None) -> Attributes:
    """Values of a part of the target's file numbered as the file: elsewhere those of ``--base``, or 0."""
    base = None if rows is None else base_of(request)
    usd = base is not None and base.suffix.lower() in USD_SUFFIXES
    own = {} if base is None or rows is None or usd else read_attributes(base, rows.whole)
    below = {name: values for name in carried if (values := _named(own, name, len(carried))) is not None}
    return to_file(carried, rows, below)


def _named(own: Attributes, name: str, count: int) -> NDArray[Any] | None:
    """The target's own values of a name, or its only ones where only one is carried."""
    return own.get(name, next(iter(own.values())) if len(own) == count == 1 else None)


def _rows(result: MatchResult, weight: FloatArray, count: int) -> FloatArray:
    """(count,) how much control vertices, control faces, face corners or refined vertices count."""
    control = result.target.control
    at_vertices = weight[: control.n_vertices]
    if count == len(at_vertices):
        return at_vertices
    at_corners = at_vertices[control.face_indices]
    if count == control.n_faces:
        return np.add.reduceat(at_corners, control.face_offsets[:-1]) / control.face_sizes
    return at_corners if count == len(at_corners) else weight
