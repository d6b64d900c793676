"""Curves in landmark files: chains of control vertices, edges in any order, or positions.

A file of pairs has ``"curves": [{"name": "lips", "source": [3, 4, 9], "target": [7, 8, 2], "closed": true}, ...]``, a
file of one mesh ``"curves": [{"name": "lips", "vertices": [3, 4, 9], "closed": true}, ...]``, or ``"positions"``
instead of ``"vertices"``. A list of vertex pairs is a list of edges, which are put in order.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import depth_first_order

from cagemap.errors import FormatError, InvalidLandmarksError
from cagemap.files.text import whole_characters
from cagemap.mesh.cage_points import CagePoints, NamedCurve
from cagemap.mesh.curves import CageCurvePairs, Curve, CurvePair
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import IndexArray, shown

FORM = '{"name": "lips", "source": [3, 4, 9], "target": [7, 8, 2], "closed": true}'
MESH_FORM = '{"name": "lips", "vertices": [3, 4, 9], "closed": true}'
_LARGEST = 2**62


def pair_curves(path: Path, items: Any) -> CageCurvePairs:
    """Curves of a landmark file with pairs of two meshes."""
    curves = []
    for number, item in enumerate(_require_list(path, items, FORM)):
        name, entry = _require_entry(path, number, item, FORM)
        target, source = (
            Curve.of_vertices(*_chain(path, name, side, entry.get(side), entry.get("closed"), FORM))
            for side in ("target", "source")
        )
        curves.append(CurvePair(name, target, source))
    return tuple(curves)


def is_along_vertices(pair: CurvePair[CagePoints]) -> bool:
    """Whether a file of pairs can hold a curve: it goes through control vertices alone."""
    return all(bool((side.vertices >= 0).all()) for side in pair.points)


def pair_entries(path: str | Path, curves: CageCurvePairs) -> list[str]:
    """Entries of curves as JSON, as `pair_curves` reads them."""
    entries = []
    for pair in curves:
        target, source = (side.vertices.tolist() for side in pair.points)
        if not is_along_vertices(pair):
            raise FormatError(
                f"{path}: expected curves of control vertices, got '{pair.name}' with points between them. "
                "Write a file of points for each mesh instead."
            )
        entry = {"name": pair.name, "source": source, "target": target, "closed": pair.target.closed}
        entries.append(json.dumps(entry, ensure_ascii=False))
    return entries


def mesh_curves(path: Path, items: Any) -> tuple[NamedCurve, ...]:
    """Curves of a landmark file of one mesh."""
    curves = []
    for number, item in enumerate(_require_list(path, items, MESH_FORM)):
        name, entry = _require_entry(path, number, item, MESH_FORM)
        if "positions" in entry:
            curves.append(curve_through(path, name, entry["positions"], bool(entry.get("closed", False))))
            continue
        chain, closed = _chain(path, name, "vertices", entry.get("vertices"), entry.get("closed"), MESH_FORM)
        curves.append(NamedCurve(name, chain, np.full((len(chain), 3), np.nan), closed))
    return tuple(curves)


def mesh_entries(curves: Sequence[NamedCurve]) -> list[str]:
    """Entries of curves with known positions as JSON, for `mesh_curves`; positions unless all points are vertices."""
    entries = []
    for curve in curves:
        by_vertices = bool((curve.vertices >= 0).all())
        points = {"vertices": curve.vertices.tolist()} if by_vertices else {"positions": curve.positions.tolist()}
        entries.append(json.dumps({"name": curve.name, **points, "closed": curve.closed}, ensure_ascii=False))
    return entries


def curve_through(path: Path, name: str, places: Any, closed: bool) -> NamedCurve:
    """A curve through positions; closed too if the first position is repeated at the end."""
    try:
        positions = np.array(places, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        positions = np.zeros(0)
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise FormatError(
            f"{path}: curve '{name}': expected a list of finite places [x, y, z], got something else. Write it again."
        )
    if len(positions) > 1 and np.array_equal(positions[0], positions[-1]):
        positions, closed = positions[:-1], True
    return NamedCurve(name, np.full(len(positions), -1, dtype=np.int64), positions, closed)


def _require_list(path: Path, items: Any, form: str) -> list[Any]:
    if not isinstance(items, list):
        raise FormatError(f"{path}: expected a list 'curves', got {shown(items)}. An entry is {form}.")
    return items


def _require_entry(path: Path, number: int, item: Any, form: str) -> tuple[str, dict[str, Any]]:
    name = item.get("name", f"curve {number}") if isinstance(item, dict) else None
    if not isinstance(name, str) or not isinstance(item.get("closed", False), bool):
        raise FormatError(f"{path}: curve {number} (0-based): expected {form}, got {shown(item)}.")
    return whole_characters(name), item


def _chain(path: Path, name: str, key: str, values: Any, closed: bool | None, form: str) -> tuple[IndexArray, bool]:
    """Vertices of a curve in order, and whether it is closed, from ordered vertices or unordered edges."""
    values = values if isinstance(values, list) else []
    if values and all(map(is_vertex, values)):
        if len(values) > 1 and values[0] == values[-1]:  # the first vertex repeated at the end: closed
            values, closed = values[:-1], True
        return np.array(values, dtype=np.int64), bool(closed)
    edges = values and all(isinstance(e, list) and len(e) == 2 and all(map(is_vertex, e)) for e in values)
    if not edges:
        raise FormatError(
            f"{path}: curve '{name}': expected control vertices, or edges [[3, 4], [4, 9], ...], as '{key}', got "
            f"{shown(values)}. An entry is {form}."
        )
    try:
        return chain_of_edges(np.array(values, dtype=np.int64))
    except InvalidLandmarksError as error:
        raise FormatError(f"{path}: curve '{name}', '{key}': {error}") from None


def chain_of_edges(edges: IndexArray) -> tuple[IndexArray, bool]:
    """Order edges (e, 2) into one chain or loop: its vertices, and whether it is a loop; else InvalidLandmarksError."""
    vertices, local = np.unique(np.sort(edges, axis=1), return_inverse=True)
    heads, tails = np.concatenate([local.reshape(-1, 2), local.reshape(-1, 2)[:, ::-1]]).T
    graph = sparse.csr_array((np.ones(len(heads)), (heads, tails)), shape=(len(vertices), len(vertices)))
    degrees = np.diff(graph.indptr)
    branching, ends = vertices[degrees > 2].tolist(), vertices[degrees == 1].tolist()
    first = int(np.argmax(degrees == 1))  # an end, or any vertex of a loop
    order = depth_first_order(graph, first, return_predecessors=False)
    unreached = np.delete(vertices, order).tolist()
    faults = {
        f"a branch at vertex {first_few(branching)}": branching,
        f"pieces that end at vertices {first_few(ends)}": ends[2:],  # one chain has two
        f"pieces: vertices {first_few(unreached)} are joined to no other": unreached,
    }
    for text, found in faults.items():
        if found:
            raise InvalidLandmarksError(
                f"expected the edges of one chain or loop, got {text}. Make each a curve of its own."
            )
    return vertices[order].astype(np.int64), not ends


def is_vertex(value: Any) -> TypeGuard[int]:
    """Whether a value of JSON, where true and false are no integers, is a vertex number."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _LARGEST
