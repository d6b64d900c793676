"""Writers of the file formats that `cagemap.files.landmarks.points` reads, and what each format can store."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.landmarks.curves import mesh_entries
from cagemap.files.ownership import mark
from cagemap.mesh.cage_points import NamedCurve, NamedPoints
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.closest_points import build_tree, closest_points

# 3D Slicer recognises its markups by this text; some versions demand it. The address itself no longer works.
_MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


@dataclass(frozen=True)
class PointForm:
    """A file format of landmark points."""

    ending: str  # ending of file names
    title: str  # name for users
    # `names`, `curves`: whether it can store them
    names: bool
    curves: bool
    text: Callable[[NamedPoints, ControlMesh], str]  # content of a file, from points and their mesh

    def lost(self, points: NamedPoints) -> tuple[str, ...]:
        """What the format cannot store of these points, in sentences."""
        sentences = []
        if not self.names and len(points.names):
            sentences.append(f"{self.title} has no names: points are told apart by their order alone")
        if not self.curves and points.curves:
            sentences.append(f"{self.title} has no curves: {', '.join(curve.name for curve in points.curves)} left out")
        return tuple(sentences)


def is_of_pairs(path: str | Path) -> bool:
    """Whether a file's name is that of pairs of two meshes (`files.landmarks.pairs`), not of points of one."""
    name = Path(path).name.lower()
    return name.endswith(".json") and not any(name.endswith(form.ending) for form in POINT_FORMS)


def point_form(path: str | Path) -> PointForm:
    """The format of a file by its name; cagemap's own for any other ``.json``."""
    name = Path(path).name.lower()
    chosen = next((form for form in POINT_FORMS if name.endswith(form.ending)), None)
    if chosen is None and name.endswith(".json"):
        chosen = POINT_FORMS[0]
    if chosen is None:
        known = ", ".join(f"{form.ending} ({form.title})" for form in POINT_FORMS)
        raise FormatError(
            f"{path}: expected a file of landmark points that ends in one of {known}. Choose such a name."
        )
    return chosen


def write_points(path: str | Path, points: NamedPoints, mesh: ControlMesh, *, force: bool = False) -> None:
    """Write named points in the format given by the file's name.

    ``mesh``: the mesh of the points. Formats of other programs store positions; Wrap's stores its triangles.
    """
    form = point_form(path)
    if points.curves and not form.curves:
        raise FormatError(f"{path}: expected points alone, got curves, which {form.title} has not. Write .points.json.")
    write_whole(path, form.text(points, mesh), force=force)


def _own(points: NamedPoints, mesh: ControlMesh) -> str:
    shown = [
        json.dumps({"name": name} | ({"vertex": vertex} if vertex >= 0 else {"position": at}), ensure_ascii=False)
        for name, vertex, at in zip(points.names, points.vertices.tolist(), points.positions.tolist(), strict=True)
    ]
    listed = ",\n  ".join(shown)
    entered = ",\n  ".join(mesh_entries([replace(curve, positions=_places(curve, mesh)) for curve in points.curves]))
    curves = f',\n "curves": [\n  {entered}\n ]' if entered else ""
    head = f'{{"written_by": "{mark()}",\n "mesh": {json.dumps(points.mesh_name)},'
    return f'{head}\n "points": [\n  {listed}\n ]{curves}}}\n'


def _meshlab(points: NamedPoints, mesh: ControlMesh) -> str:
    lines = [
        f'<point name="{_attribute(name)}" x="{x!r}" y="{y!r}" z="{z!r}" active="1"/>'
        for name, (x, y, z) in zip(points.names, _places(points, mesh).tolist(), strict=True)
    ]
    body = "\n ".join(lines)
    return f"<!DOCTYPE PickedPoints>\n<PickedPoints>\n <!-- {mark()} -->\n {body}\n</PickedPoints>\n"


def _markups(points: NamedPoints, mesh: ControlMesh) -> str:
    """3D Slicer's markups, in LPS as its mesh files: one of all points, and one for every curve."""
    markups = [_markup("Fiducial", "landmarks", points.names, _places(points, mesh))]
    for curve in points.curves:
        labels = tuple(f"{curve.name}-{number}" for number in range(1, 1 + len(curve.vertices)))
        kind = "ClosedCurve" if curve.closed else "Curve"
        markups.append(_markup(kind, curve.name, labels, _places(curve, mesh)))
    content = {"written_by": mark(), "@schema": _MARKUPS_SCHEMA, "markups": markups}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _markup(kind: str, name: str, labels: tuple[str, ...], places: FloatArray) -> dict[str, Any]:
    controls = [
        {"id": str(number), "label": label, "position": place, "positionStatus": "defined"}
        for number, (label, place) in enumerate(zip(labels, places.tolist(), strict=True), 1)
    ]
    return {"type": kind, "name": name, "coordinateSystem": "LPS", "controlPoints": controls}


def _fiducials(points: NamedPoints, mesh: ControlMesh) -> str:
    """3D Slicer's older table (fcsv)."""
    rows = [
        [f"vtk{number}", *map(repr, place), "0", "0", "0", "1", "1", "1", "0", name, "", ""]
        for number, (name, place) in enumerate(zip(points.names, _places(points, mesh).tolist(), strict=True))
    ]
    head = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n"
    columns = "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    return f"{head}{columns}# {mark()}\n{_csv(rows)}"


def _table(points: NamedPoints, mesh: ControlMesh) -> str:
    """Columns vertex, x, y, z and name, which is last, since a line that begins with # is a comment."""
    rows = [
        ["" if vertex < 0 else str(vertex), *map(repr, place), name]
        for name, vertex, place in zip(
            points.names, points.vertices.tolist(), _places(points, mesh).tolist(), strict=True
        )
    ]
    return _csv([["vertex", "x", "y", "z", "name"], *rows]) + f"# {mark()}\n"


def _wrap(points: NamedPoints, mesh: ControlMesh) -> str:
    """Wrap's list: a triangle of the triangulated mesh and two barycentric coordinates for each point."""
    if not points.names:
        return "[]\n"
    triangles, _ = cage_triangles(mesh)
    on_triangles, weights, _ = closest_points(build_tree(mesh.positions, triangles), _places(points, mesh))
    rows = [[triangle, u, v] for triangle, (_, u, v) in zip(on_triangles.tolist(), weights.tolist(), strict=True)]
    return json.dumps(rows) + "\n"


def _places(points: NamedPoints | NamedCurve, mesh: ControlMesh) -> FloatArray:
    """(q, 3) positions of points, and of vertices on the mesh."""
    vertices = points.vertices
    places = mesh.positions[np.maximum(vertices, 0)]
    return np.where(vertices[:, None] >= 0, places, points.positions)


def _csv(rows: list[list[str]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def _attribute(text: str) -> str:
    """Text escaped as the value of an XML attribute."""
    return escape(text).replace("\n", "&#10;").replace("\r", "&#13;").replace("\t", "&#9;")


POINT_FORMS = (
    PointForm(".points.json", "cagemap's own form", names=True, curves=True, text=_own),
    PointForm(".pp", "MeshLab's form", names=True, curves=False, text=_meshlab),
    PointForm(".mrk.json", "3D Slicer's form", names=True, curves=True, text=_markups),
    PointForm(".fcsv", "3D Slicer's table", names=True, curves=False, text=_fiducials),
    PointForm(".csv", "a table", names=True, curves=False, text=_table),
    PointForm(".txt", "Wrap's form", names=False, curves=False, text=_wrap),
)
