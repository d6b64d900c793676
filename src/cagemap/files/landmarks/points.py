"""Points, curves and symmetries of one mesh, read from cagemap's JSON, MeshLab, 3D Slicer, Wrap and CSV files.

One file for each mesh: any two meshes are matched by the names that their files share.
`cagemap.files.landmarks.point_formats` writes such files.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.landmarks.curves import MESH_FORM, curve_through, is_vertex, mesh_curves
from cagemap.files.npz import read_npy
from cagemap.files.ownership import MARKED
from cagemap.files.schema import parse_json
from cagemap.files.text import read_bytes, read_text, whole_characters
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import NamedCurve, NamedPoints
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import IndexArray

Named = list[tuple[str, int, tuple[float, float, float] | None]]

FORMS = (
    '{"mesh": "a.obj", "points": [{"name": "nose", "vertex": 3}, {"name": "chin", "position": [x, y, z]}, ...], '
    f'"curves": [{MESH_FORM}, ...]}}, '
    "MeshLab .pp, 3D Slicer .mrk.json or .fcsv, Wrap's [[triangle, u, v], ...], or .csv with columns name, x, y, z or "
    "name, vertex"
)


def read_points(path: str | Path, mesh: ControlMesh | None = None) -> NamedPoints:
    """Read the named points of one mesh.

    ``path``: cagemap's .json, .pp (MeshLab), .mrk.json or .fcsv (3D Slicer), .csv, or Wrap's list (.json or .txt).
    ``mesh``: the mesh of the points, needed only for Wrap's list, which refers to triangles.
    """
    file = Path(path)
    name = file.name.lower()
    text = read_text(file, "a file of landmark points")
    readers = {".pp": _meshlab, ".fcsv": _fiducials, ".csv": _table}
    reader = next((reader for ending, reader in readers.items() if name.endswith(ending)), None)
    return _json(file, text, mesh) if reader is None else _points(reader(file, text), "")


def _points(found: Named, mesh_name: str, curves: tuple[NamedCurve, ...] = ()) -> NamedPoints:
    unknown = (math.nan,) * 3
    return NamedPoints(
        tuple(whole_characters(name) for name, _, _ in found),
        np.array([vertex for _, vertex, _ in found], dtype=np.int64),
        np.array([unknown if at is None else at for _, _, at in found], dtype=np.float64).reshape(-1, 3),
        whole_characters(mesh_name),
        curves,
    )


def _json(path: Path, text: str, mesh: ControlMesh | None) -> NamedPoints:
    data = parse_json(text, path, f"Known are {FORMS}.")
    if isinstance(data, list):
        return _points(_wrap(path, data, mesh), mesh.name if mesh is not None else "")
    if isinstance(data, dict) and isinstance(data.get("markups"), list):
        return _markups(path, data["markups"])
    if isinstance(data, dict) and isinstance(data.get("points", data.get("curves")), list):
        named = [_own(path, number, item) for number, item in enumerate(data.get("points", []))]
        return _points(named, str(data.get("mesh", "")), mesh_curves(path, data.get("curves", [])))
    raise FormatError(f"{path}: expected landmark points, got other JSON. Known are {FORMS}.")


def _own(path: Path, number: int, item: Any) -> tuple[str, int, tuple[float, float, float] | None]:
    entry = item if isinstance(item, dict) else {}
    name, vertex = str(entry.get("name", f"point {number}")), entry.get("vertex")
    if is_vertex(vertex):
        return name, vertex, None
    if "position" in entry:
        return name, -1, _place(path, name, entry["position"])
    raise FormatError(
        f"{path}: point {number} (0-based), '{name}': expected a vertex or a position. Known are {FORMS}."
    )


def _wrap(path: Path, data: list[Any], mesh: ControlMesh | None) -> Named:
    """Wrap's points: a triangle of the triangulated mesh and u, v: P = (1 - u - v) A + u B + v C."""
    if mesh is None:
        raise FormatError(f"{path}: expected the mesh beside Wrap's points, which are triangles of it, got none.")
    triangles = cage_triangles(mesh)[0]
    named: Named = []
    for number, item in enumerate(data):
        triangle, u, v = _place(path, f"point {number}", item)
        if triangle != int(triangle) or not 0 <= triangle < len(triangles):
            raise FormatError(
                f"{path}: point {number} (0-based): expected a triangle from 0 to {len(triangles) - 1} of {mesh.name}, "
                f"got {triangle:g}. Do the points belong to another mesh?"
            )
        a, b, c = mesh.positions[triangles[int(triangle)]]
        x, y, z = ((1 - u - v) * a + u * b + v * c).tolist()
        named.append((f"point {number}", -1, (x, y, z)))
    return named


def _markups(path: Path, markups: list[Any]) -> NamedPoints:
    """Points and curves of 3D Slicer's markups, in LPS as its mesh files; RAS has x and y negated."""
    all_points: Named = []
    curves: list[NamedCurve] = []
    for markup in markups:
        points = markup.get("controlPoints", []) if isinstance(markup, dict) else None
        if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
            raise FormatError(f"{path}: expected markups with a list of controlPoints, got others. Known are {FORMS}.")
        turned = str(markup.get("coordinateSystem", "LPS")).upper() == "RAS"
        named: Named = []
        for number, point in enumerate(points):
            if point.get("positionStatus", "defined") != "defined":
                continue
            name = str(point.get("label") or point.get("id") or f"point {number}")
            named.append((name, -1, _in_lps(_place(path, name, point.get("position")), turned)))
        kind = str(markup.get("type", ""))
        if kind in ("Curve", "ClosedCurve"):
            title = whole_characters(str(markup.get("name") or path.name.partition(".")[0]))
            curves.append(curve_through(path, title, [place for _, _, place in named], kind == "ClosedCurve"))
        else:
            all_points += named
    return _points(all_points, "", tuple(curves))


def _rows(path: Path, text: str) -> list[list[str]]:
    try:
        return list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise FormatError(
            f"{path}: expected a table of landmark points, got broken CSV ({error}). Export it again."
        ) from None


def _fiducials(path: Path, text: str) -> Named:
    """Points of 3D Slicer's older table: id, x, y, z, ..., label in column 12; a comment states LPS or RAS."""
    turned = False
    named: Named = []
    for row in _rows(path, text):
        if row and row[0].startswith("#"):
            if "coordinatesystem" in (line := row[0].replace(" ", "").lower()):
                turned = line.endswith(("=ras", "=0"))
            continue
        if len(row) >= 4:
            name = row[11] if len(row) > 11 and row[11] else row[0]
            named.append((name, -1, _in_lps(_place(path, name, row[1:4]), turned)))
    return named


def _table(path: Path, text: str) -> Named:
    """Points of a table with columns name, x, y, z (also without a header) or name, vertex."""
    # A row that begins with # is a comment; below a header only if it is shorter, or holds cagemap's mark.
    all_rows = [row for row in _rows(path, text) if row]
    rows = [row for row in all_rows if not row[0].startswith("#")]
    head = [cell.strip().lower() for cell in rows[0]] if rows else []
    if {"name", "label"} & set(head):
        body = all_rows[all_rows.index(rows[0]) + 1 :]
        rows = [row for row in body if not row[0].startswith("#") or (len(row) >= len(head) and MARKED not in row[0])]
    else:
        head = ["name", "x", "y", "z"]
    title = "name" if "name" in head else "label"
    named: Named = []
    for number, row in enumerate(rows):
        cells = dict(zip(head, (cell.strip() for cell in row), strict=False))
        name = cells.get(title) or f"point {number}"
        if re.fullmatch("[0-9]{1,18}", cells.get("vertex", "")):
            named.append((name, int(cells["vertex"]), None))
        else:
            named.append((name, -1, _place(path, name, [cells.get(axis) for axis in "xyz"])))
    return named


def _meshlab(path: Path, text: str) -> Named:
    if "<!ENTITY" in text:
        raise FormatError(f"{path}: expected MeshLab's picked points, got XML with entities, which it never writes.")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise FormatError(f"{path}: expected MeshLab's picked points, got broken XML ({error}).") from None
    named: Named = []
    for number, point in enumerate(root.iter("point")):
        name = point.get("name") or f"point {number}"
        if point.get("active", "1") != "0":
            named.append((name, -1, _place(path, name, [point.get(axis) for axis in "xyz"])))
    return named


def _in_lps(place: tuple[float, float, float], turned: bool) -> tuple[float, float, float]:
    return (-place[0], -place[1], place[2]) if turned else place


def _place(path: Path, name: str, values: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        raise FormatError(
            f"{path}: '{name}': expected three numbers, got {str(values)[:60]}. Known are {FORMS}."
        ) from None
    if not all(map(math.isfinite, (x, y, z))):
        raise FormatError(f"{path}: '{name}': expected finite numbers, got {values}.")
    return x, y, z


_SYMMETRY_REMEDY = (
    "A symmetry file has one vertex number for every control vertex, from 0, -1 where the image is not known: "
    "a JSON list, text with a number a line, or .npy."
)


def read_symmetry(path: Path) -> IndexArray:
    """Read the mirror image of every control vertex from ``.npy``, ``.json`` or text."""
    content, suffix = read_bytes(path, "a symmetry file"), path.suffix.lower()
    if suffix == ".npy":
        values = read_npy(content, path, _SYMMETRY_REMEDY)
    else:
        try:
            text = content.decode("utf-8")
            values = np.array(json.loads(text) if suffix == ".json" else [int(word) for word in text.split()])
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}: is no list of whole numbers ({error}). {_SYMMETRY_REMEDY}") from None
    if values.ndim != 1 or not len(values) or not np.issubdtype(values.dtype, np.integer):
        raise FormatError(
            f"{path}: expected a list of whole numbers, got {values.dtype} of shape {values.shape}. {_SYMMETRY_REMEDY}"
        )
    return values.astype(np.int64)


def symmetry_on(images: IndexArray, control: ControlMesh) -> IndexArray:
    """A file's mirror images for a welded mesh or a part of the file; for other meshes unchanged."""
    first = control.file_vertices
    if first is None or len(images) == control.n_vertices or len(images) <= first.max():
        return images
    number = np.full(len(images) + 1, -1, dtype=np.int64)  # the last entry: images that are not known
    number[first] = np.arange(control.n_vertices)
    if control.file_copies is not None:
        number[control.file_copies[:, 1]] = control.file_copies[:, 0]
    inside = (images >= -1) & (images < len(images))
    return np.asarray(np.where(inside, number[np.where(inside, images, -1)], images)[first])
