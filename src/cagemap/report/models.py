"""Data of a report's models for `viewer.js`: quantised arrays and a description."""

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
from cagemap.pictures import TRUST_SCALE, distinct_colors, scalar_colors
from cagemap.report.marks import SOURCE, TARGET, Mark
from cagemap.report.shown import DisplaySurface, matched_source_vertices

CHECKER_CELLS = 24  # along the longest side of the matched part
# Least extent of the matched part along an axis, of its longest side: what is outside a flat part costs it precision.
MIN_EXTENT = 0.02


@dataclass(frozen=True, eq=False)
class Look:
    """One way to colour both models."""

    name: str
    legend: str
    # What each model is drawn with: colours (n, 3) of its vertices, or the id of the HTML element of a texture; None if
    # the page computes the colours itself.
    source: FloatArray | str | None = None
    target: FloatArray | str | None = None
    kind: str = "own"  # "own" (colours or texture), "checker", "places" or "doubt"


@dataclass(frozen=True, eq=False)
class Shape:
    """Another shape of the models: positions (n, 3) of the displayed vertices in page coordinates."""

    name: str
    source: FloatArray | None = None
    target: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Models:
    """Both models of a page."""

    target: DisplaySurface
    source: DisplaySurface
    looks: tuple[Look, ...]
    trust: Mapping[str, FloatArray]  # (n,) by side, from 0 to 1
    marks: tuple[Mark, ...] = ()
    shapes: tuple[Shape, ...] = ()
    # (t, 3) by side, where colours may jump between triangles: a vertex is drawn once for each key
    corner_keys: Mapping[str, IndexArray] = field(default_factory=dict)
    # texture coordinates (k, 2) or colours (k, 3) of the keys
    key_values: Mapping[str, FloatArray] = field(default_factory=dict)


class _ArrayPacker:
    """Concatenated arrays, each quantised to few bytes a number."""

    def __init__(self) -> None:
        self.parts, self.length = list[bytes](), 0

    def add(self, values: NDArray[Any], kind: str) -> dict[str, Any]:
        """Append an array; return its offset, type and number of values."""
        raw = np.ascontiguousarray(values.astype(np.dtype(kind).newbyteorder("<")))
        # Bytes of equal significance side by side compress better.
        content = np.ascontiguousarray(raw.view(np.uint8).reshape(-1, raw.itemsize).T).tobytes()
        entry = {"at": self.length, "kind": kind, "count": raw.size}
        self.parts.append(content)
        self.length += len(content)
        return entry

    def add_rows(self, values: FloatArray) -> dict[str, Any]:
        """Append rows of numbers as 16-bit differences in units of ``step``."""
        step = float(np.abs(values).max(initial=0.0)) / 32767 or 1.0
        rounded = np.round(values / step).astype(np.int64)
        differences = np.diff(rounded, axis=0, prepend=np.zeros((1, rounded.shape[1]), dtype=np.int64))
        wrapped = (differences + 32768) % 65536 - 32768
        return self.add(wrapped, "int16") | {"step": step, "columns": values.shape[1]}

    def add_shares(self, values: FloatArray) -> dict[str, Any]:
        """Append numbers from 0 to 1 as bytes."""
        columns = 1 if values.ndim == 1 else values.shape[1]
        return self.add(np.round(255 * values.clip(0.0, 1.0)), "uint8") | {"columns": columns}

    def add_indices(self, values: IndexArray) -> dict[str, Any]:
        """Append integers as differences."""
        differences = np.diff(values.ravel(), prepend=0)
        return self.add(differences, "int32") | {"columns": 1}


def pack_models(models: Models, result: MatchResult) -> tuple[str, str]:
    """Description as JSON, and arrays as base64 of deflate."""
    packer = _ArrayPacker()
    low, span = _box(result)
    sides = {}
    for name, display in ((SOURCE, models.source), (TARGET, models.target)):
        triangles, copies, keys = _split_vertices(display, models.corner_keys.get(name))
        entry: dict[str, Any] = {
            "vertices": len(display.vertices),
            "positions": packer.add_rows(display.positions),
            "copies": packer.add_indices(copies),
            "triangles": packer.add_indices(triangles),
            "doubt": packer.add_shares(models.trust[name]),
        }
        if name == TARGET:
            entry["places"] = packer.add_rows((result.image()[display.vertices] - low) / span)
        else:  # places are a linear function of the positions
            linear = display.radius * display.turn.T / span
            entry["places_of_positions"] = [*linear.T.ravel(), *((display.centre @ display.turn.T - low) / span)]
        values = models.key_values.get(name)
        if values is not None:
            if values.shape[1] == 2:
                entry["uvs"] = packer.add_rows(values[keys])
            else:
                entry["key_colors"] = packer.add_shares(values[keys])
        entry["landmarks"] = _landmark_places(display, result, name)
        sides[name] = entry
    looks = [
        {"name": look.name, "legend": look.legend, "kind": look.kind}
        | {side: _pack_colors(packer, getattr(look, side)) for side in (SOURCE, TARGET)}
        for look in models.looks
    ]
    shapes = [
        {"name": shape.name}
        | {
            side: None if getattr(shape, side) is None else packer.add_rows(getattr(shape, side))
            for side in (SOURCE, TARGET)
        }
        for shape in models.shapes
    ]
    description = {
        "sides": sides,
        "looks": looks,
        "shapes": shapes,
        "marks": [_mark(models, mark) for mark in models.marks],
        "landmarks": list(result.landmarks.names),
        "landmark_colors": np.round(255 * distinct_colors(len(result.landmarks))).astype(int).tolist(),
        "cells": (CHECKER_CELLS * span / span.max()).tolist(),
        "ramp": scalar_colors(np.linspace(0.0, 1.0, 6), 0.0, 1.0, TRUST_SCALE).tolist(),
    }
    arrays = base64.b64encode(zlib.compress(b"".join(packer.parts), 9)).decode("ascii")
    return json.dumps(description, separators=(",", ":")).replace("<", "\\u003c"), arrays


def _box(result: MatchResult) -> tuple[FloatArray, FloatArray]:
    """Lowest corner and extent of the source's matched area."""
    vertices = matched_source_vertices(result)
    low, high = vertices.min(0), vertices.max(0)
    span = high - low
    return low, np.maximum(span, MIN_EXTENT * float(span.max())) if span.any() else np.ones(3)


def _split_vertices(display: DisplaySurface, keys: IndexArray | None) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Split vertices by key: triangles, originals of added vertices, keys of all vertices."""
    n = len(display.vertices)
    if keys is None:
        return display.triangles, np.zeros(0, dtype=np.int64), np.zeros(n, dtype=np.int64)
    count = int(keys.max()) + 1
    codes, inverse = np.unique(display.triangles * count + keys, return_inverse=True)
    owner = codes // count
    first = np.r_[True, owner[1:] != owner[:-1]]
    number = np.where(first, owner, n + np.cumsum(~first) - 1)
    key = np.zeros(n + int((~first).sum()), dtype=np.int64)
    key[number] = codes % count
    return number[inverse].reshape(-1, 3), owner[~first], key


def _pack_colors(packer: _ArrayPacker, colors: FloatArray | str | None) -> Any:
    return colors if colors is None or isinstance(colors, str) else packer.add_shares(colors)


def _landmark_places(display: DisplaySurface, result: MatchResult, side: str) -> list[list[float]]:
    """Positions of the landmarks and surface normals there."""
    pairs = result.landmarks
    points = pairs.target_points if side == TARGET else pairs.source_points
    return [_place(display, int(vertex)) for vertex in points.heaviest_corners]


def _place(display: DisplaySurface, vertex: int) -> list[float]:
    finest = display.surface.finest_triangles
    position = display.to_page(display.surface.vertices[[vertex]])[0]
    return np.round([*position, *(finest.vertex_normals[vertex] @ display.turn)], 4).tolist()


def _mark(models: Models, mark: Mark) -> dict[str, Any]:
    display = models.target if mark.side == TARGET else models.source
    return {"number": mark.number, "side": mark.side, "text": mark.text, "place": _place(display, mark.vertex)}
