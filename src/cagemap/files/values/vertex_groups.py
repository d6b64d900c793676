"""Vertex groups as modelling programs keep them: JSON, a name with vertices and their weights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cagemap.errors import FormatError
from cagemap.files.ownership import mark
from cagemap.files.schema import Record, checked_record, parse_json, to_json
from cagemap.files.text import read_text
from cagemap.numerics.arrays import FloatArray

_REMEDY = 'Expected {"groups": [{"name": "lips", "vertices": [0, 5], "weights": [1.0, 0.5]}, ...]}.'
# Weights below this are no membership: rounding of the map's barycentric coordinates.
_NOTHING = 1e-9


class GroupRecord(Record):
    """Some vertices by number from 0, each with a weight; 1 where none are given."""

    name: str
    vertices: list[Annotated[int, Field(ge=0)]]
    weights: list[float] | None = None


class GroupsRecord(Record):
    """All groups of a file."""

    groups: list[GroupRecord]


def read_groups(path: Path, count: int) -> dict[str, FloatArray]:
    """Read vertex groups as a weight (count,) for every vertex of a mesh, 0 where it is not in the group.

    Raises
    ------
    FormatError
        If the file is none of groups, a name or a vertex comes twice, or there is no such vertex.
    """
    stated = parse_json(read_text(path, "vertex groups"), path, _REMEDY)
    found: dict[str, FloatArray] = {}
    for group in checked_record(GroupsRecord, stated, path, _REMEDY).groups:
        vertices = np.array(group.vertices, dtype=np.float64)
        weights = [1.0] * len(vertices) if group.weights is None else group.weights
        if group.name in found or len(weights) != len(vertices) or len(np.unique(vertices)) != len(vertices):
            raise FormatError(
                f"{path}: group {group.name}: expected a name of its own, every vertex once and a weight for each, got "
                f"{len(vertices)} vertices and {len(weights)} weights. {_REMEDY}"
            )
        if len(vertices) and vertices.max() >= count:
            raise FormatError(
                f"{path}: group {group.name}: expected vertices 0 to {count - 1}, got {vertices.max():.0f}. Is it of "
                "another mesh?"
            )
        found[group.name] = np.zeros(count)
        found[group.name][vertices.astype(np.int64)] = weights
    return found


def groups_text(attributes: Mapping[str, NDArray[Any]], path: Path) -> str:
    """Text of a file of groups: of every array, the vertices whose weight is not 0.

    Raises
    ------
    FormatError
        If an array has several numbers a vertex.
    """
    groups = []
    for name, array in attributes.items():
        if array.ndim != 1:
            raise FormatError(f"{path}: vertex groups have one weight a vertex, {name} has shape {array.shape}.")
        inside = np.flatnonzero(np.abs(array) > _NOTHING)
        groups.append({"name": name, "vertices": inside, "weights": array[inside].astype(np.float64)})
    return to_json({"written_by": mark(), "groups": groups})
