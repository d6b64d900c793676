"""Data of the models of a report: quantised arrays and a description, for `viewer.js`."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures import ENOUGH, distinct_colors, scalar_colors
from cagemap.report.marks import SOURCE, TARGET, Mark
from cagemap.report.shown import ShownSurface

CELLS = 24  # of the checker, along the longest side


@dataclass(frozen=True, eq=False)
class Look:
    """One way to colour both models.

    Attributes
    ----------
    name, legend : str
    source, target : (n, 3) float64, str or None
        Colours of the shown vertices, the id of a picture of the page, or None for what ``kind`` draws.
    kind : str
        "own" (colours or pictures), "checker", "places" or "doubt".
    """

    name: str
    legend: str
    source: FloatArray | str | None = None
    target: FloatArray | str | None = None
    kind: str = "own"


@dataclass(frozen=True, eq=False)
class Shape:
    """Another shape of one model or both: positions (n, 3) of the shown vertices in the page's frame."""

    name: str
    source: FloatArray | None = None
    target: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Models:
    """All that turns on a page.

    Attributes
    ----------
    target, source : ShownSurface
    looks : tuple of Look
    doubt : dict of str to (n,) float64
        By side: 1 where all is well, 0 where it is not.
    marks : tuple of Mark
    shapes : tuple of Shape
    corner_keys : dict of str to (t, 3) int64
        By side, where colours may jump between triangles: vertices are drawn once for each key.
    key_values : dict of str to (k, 2) or (k, 3) float64
        Texture coordinates (2) or colours (3) of the keys.
    """

    target: ShownSurface
    source: ShownSurface
    looks: tuple[Look, ...]
    doubt: Mapping[str, FloatArray]
    marks: tuple[Mark, ...] = ()
    shapes: tuple[Shape, ...] = ()
    corner_keys: Mapping[str, IndexArray] = field(default_factory=dict)
    key_values: Mapping[str, FloatArray] = field(default_factory=dict)


class _Blob:
    """Arrays one after the other, each in the smallest whole numbers that hold it."""

    def __init__(self) -> None:
        self.parts, self.length = list[bytes](), 0

    def add(self, values: NDArray[Any], kind: str) -> dict[str, Any]:
        """The entry of an array: where it begins, its kind and number of values."""
        raw = np.ascontiguousarray(values.astype(np.dtype(kind).newbyteorder("<")))
        # Bytes of equal weight side by side compress better.
        content = np.ascontiguousarray(raw.view(np.uint8).reshape(-1, raw.itemsize).T).tobytes()
        entry = {"at": self.length, "kind": kind, "count": raw.size}
        self.parts.append(content)
        self.length += len(content)
        return entry

    def whole(self, values: FloatArray) -> dict[str, Any]:
        """Rows of numbers as differences of 16 bits; ``step`` is their unit."""
        step = float(np.abs(values).max(initial=0.0)) / 32767 or 1.0
        rounded = np.round(values / step).astype(np.int64)
        differences = np.diff(rounded, axis=0, prepend=np.zeros((1, rounded.shape[1]), dtype=np.int64))
        wrapped = (differences + 32768) % 65536 - 32768
        return self.add(wrapped, "int16") | {"step": step, "columns": values.shape[1]}

    def share(self, values: FloatArray) -> dict[str, Any]:
        """Numbers from 0 to 1 as bytes."""
        columns = 1 if values.ndim == 1 else values.shape[1]
        return self.add(np.round(255 * values.clip(0.0, 1.0)), "uint8") | {"columns": columns}

    def indices(self, values: IndexArray) -> dict[str, Any]:
        """Whole numbers as differences."""
        differences = np.diff(values.ravel(), prepend=0)
        return self.add(differences, "int32") | {"columns": 1}


def pack(models: Models, result: MatchResult) -> tuple[str, str]:
    """The description as JSON and the arrays as text (base64 of deflate)."""
    blob = _Blob()
    low, span = _box(result)
    sides = {}
    for name, shown in ((SOURCE, models.source), (TARGET, models.target)):
        triangles, copies, keys = _drawn(shown, models.corner_keys.get(name))
        entry: dict[str, Any] = {
            "vertices": len(shown.vertices),
            "positions": blob.whole(shown.positions),
            "copies": blob.indices(copies),
            "triangles": blob.indices(triangles),
            "doubt": blob.share(models.doubt[name]),
        }
        if name == TARGET:
            entry["places"] = blob.whole((result.image()[shown.vertices] - low) / span)
        else:  # the page has the positions: places are a linear function of them
            linear = shown.radius * shown.turn.T / span
            entry["places_of_positions"] = [*linear.T.ravel(), *((shown.centre @ shown.turn.T - low) / span)]
        values = models.key_values.get(name)
        if values is not None:
            if values.shape[1] == 2:
                entry["uvs"] = blob.whole(values[keys])
            else:
                entry["key_colors"] = blob.share(values[keys])
        entry["landmarks"] = _landmarks(shown, result, name)
        sides[name] = entry
    looks = [
        {"name": look.name, "legend": look.legend, "kind": look.kind}
        | {side: _colors(blob, getattr(look, side)) for side in (SOURCE, TARGET)}
        for look in models.looks
    ]
    shapes = [
        {"name": shape.name}
        | {
            side: None if getattr(shape, side) is None else blob.whole(getattr(shape, side))
            for side in (SOURCE, TARGET)
        }
        for shape in models.shapes
    ]
    described = {
        "sides": sides,
        "looks": looks,
        "shapes": shapes,
        "marks": [_mark(models, mark) for mark in models.marks],
        "landmarks": list(result.landmark_names),
        "landmark_colors": np.round(255 * distinct_colors(len(result.landmarks))).astype(int).tolist(),
        "cells": (CELLS * span / span.max()).tolist(),
        "ramp": scalar_colors(np.linspace(0.0, 1.0, 6), 0.0, 1.0, ENOUGH).tolist(),
    }
    packed = base64.b64encode(zlib.compress(b"".join(blob.parts), 9)).decode("ascii")
    return json.dumps(described, separators=(",", ":")).replace("<", "\\u003c"), packed


def _box(result: MatchResult) -> tuple[FloatArray, FloatArray]:
    """Lowest corner and extent of the source."""
    low, high = result.source.vertices.min(0), result.source.vertices.max(0)
    span = high - low
    return low, np.maximum(span, 1e-9 * max(float(span.max()), np.finfo(np.float64).tiny))


def _drawn(shown: ShownSurface, keys: IndexArray | None) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Triangles of drawn vertices, the vertex of each drawn one after the first n, and the key of every drawn one."""
    n = len(shown.vertices)
    if keys is None:
        return shown.triangles, np.zeros(0, dtype=np.int64), np.zeros(n, dtype=np.int64)
    count = int(keys.max()) + 1
    codes, inverse = np.unique(shown.triangles * count + keys, return_inverse=True)
    owner = codes // count
    first = np.r_[True, owner[1:] != owner[:-1]]
    number = np.where(first, owner, n + np.cumsum(~first) - 1)
    key = np.zeros(n + int((~first).sum()), dtype=np.int64)
    key[number] = codes % count
    return number[inverse].reshape(-1, 3), owner[~first], key


def _colors(blob: _Blob, colors: FloatArray | str | None) -> Any:
    return colors if colors is None or isinstance(colors, str) else blob.share(colors)


def _landmarks(shown: ShownSurface, result: MatchResult, side: str) -> list[list[float]]:
    """Places of the landmarks, and the normals of the surface there."""
    pairs = result.landmarks
    points = pairs.target_points if side == TARGET else pairs.source_points
    return [_place(shown, int(vertex)) for vertex in points.nearest_vertices]


def _place(shown: ShownSurface, vertex: int) -> list[float]:
    finest = shown.surface.finest_triangles
    position = shown.placed(shown.surface.vertices[[vertex]])[0]
    return np.round([*position, *(finest.vertex_normals[vertex] @ shown.turn)], 4).tolist()


def _mark(models: Models, mark: Mark) -> dict[str, Any]:
    shown = models.target if mark.side == TARGET else models.source
    return {"number": mark.number, "side": mark.side, "text": mark.text, "place": _place(shown, mark.vertex)}
