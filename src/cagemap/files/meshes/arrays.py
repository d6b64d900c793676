"""Control meshes, points, curves and schemes as named arrays and JSON entries for archives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError, InvalidMeshError
from cagemap.files.npz import Archive, ArraySpec, lie_in_triangles
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.checks import SEVERAL, require_valid
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.curves import CageCurvePairs, Curve, CurvePair
from cagemap.mesh.schemes import SCHEMES, Scheme, scheme_name
from cagemap.numerics.arrays import offsets_of

# Letters of sizes: c vertices, f faces, q face corners, t texture vertices, m materials.
CONTROL_FORMS = {
    "positions": ArraySpec(("c", 3)),
    "face_offsets": ArraySpec(("f+1",), below="q+1"),
    "face_indices": ArraySpec(("q",), below="c"),
    "uvs": ArraySpec(("t", 2), optional=True),
    "uv_indices": ArraySpec(("q",), below="t", optional=True),
    "face_materials": ArraySpec(("f",), below="m", optional=True),
    "material_colors": ArraySpec(("m", 3), optional=True, nan=True),
    "vertex_colors": ArraySpec(("c", 3), optional=True, nan=True),
    "face_objects": ArraySpec(("f",), below="objects", optional=True),
    "face_groups": ArraySpec(("f",), below="groups", optional=True),
    "crease_edges": ArraySpec(("creases", 2), below="c", optional=True),
    "crease_sharpness": ArraySpec(("creases",), optional=True, nan=True),
    "corner_vertices": ArraySpec(("corners",), below="c", optional=True),
    "corner_sharpness": ArraySpec(("corners",), optional=True, nan=True),
    "hole_faces": ArraySpec(("holes",), below="f", optional=True),
    "file_vertices": ArraySpec(("c",), below="file_c", optional=True),
    "file_faces": ArraySpec(("f",), below="file_f", optional=True),
    "file_copies": ArraySpec(("copies", 2), below="file_c", optional=True),
    "upright": ArraySpec((3, 3), optional=True),
}
CONTROL_ARRAYS = tuple(CONTROL_FORMS)
# Names other than those of materials; each an array of text.
_NAMES = ("object_names", "group_names")
_UV_NAME = "uv_name"
_UV_SETS = "uv_set_names"
# Numbers of vertices and faces in the file of a mesh that is a part of it: unknown, so a bound that never limits.
_ANY = 2**40


def control_to_arrays(control: ControlMesh, prefix: str) -> dict[str, Any]:
    """Arrays of a control mesh, without absent ones."""
    arrays = {f"{prefix}{name}": getattr(control, name) for name in CONTROL_ARRAYS}
    arrays |= {f"{prefix}{name}": np.array(getattr(control, name)) for name in _NAMES if getattr(control, name)}
    if control.uv_name:
        arrays[f"{prefix}{_UV_NAME}"] = np.array([control.uv_name])
    if control.uv_sets:
        arrays[f"{prefix}{_UV_SETS}"] = np.array([uv_set.name for uv_set in control.uv_sets])
    for number, uv_set in enumerate(control.uv_sets):
        values, indices = _uv_set_arrays(prefix, number)
        arrays |= {values: uv_set.uvs, indices: uv_set.uv_indices}
    return {name: array for name, array in arrays.items() if array is not None}


def control_from_arrays(
    archive: Archive, prefix: str, material_names: Sequence[str], name: str, scheme: Scheme | None = None
) -> ControlMesh:
    """A control mesh from the arrays of `control_to_arrays`; ``scheme`` is the one it was refined with."""
    arrays = archive.arrays
    stored = {key: arrays[f"{prefix}{key}"] for key in CONTROL_ARRAYS if f"{prefix}{key}" in arrays}
    texts: dict[str, Any] = {key: _texts(archive, f"{prefix}{key}") for key in _NAMES}
    sizes = {"m": len(material_names), "objects": len(texts["object_names"]), "groups": len(texts["group_names"])}
    sizes |= {"file_c": _ANY, "file_f": _ANY}
    values: dict[str, Any] = replace(archive, arrays=stored).take(CONTROL_FORMS, sizes)
    archive.check_offsets(f"{prefix}face_offsets", values["face_offsets"], sizes["q"])
    for first, second in (
        ("uvs", "uv_indices"),
        ("crease_edges", "crease_sharpness"),
        ("corner_vertices", "corner_sharpness"),
    ):
        if (first in values) != (second in values):
            archive.refuse(f"{prefix}{first} and {prefix}{second} belong together, one is missing")
    copies = values.get("file_copies")
    if copies is not None and (copies[:, 0] >= sizes["c"]).any():
        archive.refuse(f"{prefix}file_copies name vertices that are not there")
    texts[_UV_NAME] = "".join(_texts(archive, f"{prefix}{_UV_NAME}"))
    values["uv_sets"] = _uv_sets(archive, prefix, sizes)
    control = ControlMesh(**values, **texts, material_names=tuple(material_names), name=name, scheme=scheme)
    try:
        require_valid(control, allowed=[SEVERAL])
    except InvalidMeshError as error:
        archive.refuse(f"its control mesh is damaged ({error})")
    return control


def _uv_set_arrays(prefix: str, number: int) -> tuple[str, str]:
    """Names of the arrays of a further UV set: texture coordinates, and their indices of face corners."""
    return f"{prefix}uv_set_{number}", f"{prefix}uv_set_{number}_indices"


def _uv_sets(archive: Archive, prefix: str, sizes: dict[str, int]) -> tuple[UvSet, ...]:
    """The UV sets that are not in use."""
    sets = []
    for number, name in enumerate(_texts(archive, f"{prefix}{_UV_SETS}")):
        values, indices = _uv_set_arrays(prefix, number)
        size = f"t of set {number}"
        specs = {values: ArraySpec((size, 2)), indices: ArraySpec(("q",), below=size)}
        checked = archive.take(specs, sizes)
        sets.append(UvSet(name, checked[values], checked[indices]))
    return tuple(sets)


def _texts(archive: Archive, name: str) -> tuple[str, ...]:
    array = archive.arrays.get(name)
    if array is None:
        return ()
    if array.ndim != 1 or array.dtype.kind != "U":
        archive.refuse(f"{name} holds {array.dtype} of shape {array.shape}, expected names")
    return tuple(map(str, array.tolist()))


def points_from_arrays(archive: Archive, arrays: Mapping[str, Any], prefix: str) -> CagePoints | None:
    """Points of a control mesh from checked arrays; None if absent."""
    corners, weights = arrays.get(f"{prefix}corners"), arrays.get(f"{prefix}weights")
    if corners is None and weights is None:
        return None
    if corners is None or weights is None or not lie_in_triangles(weights):
        archive.refuse(f"{prefix}corners and {prefix}weights are not points of the mesh")
    return CagePoints(corners, weights)


def curves_to_arrays(curves: CageCurvePairs) -> dict[str, Any]:
    """Arrays of all curves; points of a curve follow those of the curve before. Empty without curves."""
    arrays: dict[str, Any] = {}
    for side in ("target", "source") if curves else ():
        lines: list[Curve[CagePoints]] = [getattr(pair, side) for pair in curves]
        points = CagePoints.joined([line.points for line in lines])
        parts = {"corners": points.corners, "weights": points.weights}
        parts["starts"] = offsets_of([len(line.points) for line in lines])
        parts["closed"] = np.array([line.closed for line in lines], dtype=np.int64)
        arrays |= {f"{side}_curve_{name}": array for name, array in parts.items()}
    return arrays


def curves_from_arrays(archive: Archive, names: Sequence[str], vertices: tuple[int, int]) -> CageCurvePairs:
    """Curves from the arrays of `curves_to_arrays`.

    ``vertices``: numbers of control vertices of target and source.
    """
    if not names:
        return ()
    sides = []
    for side, count in zip(("target", "source"), vertices, strict=True):
        prefix = f"{side}_curve_"
        specs = {
            f"{prefix}corners": ArraySpec(("p", 3), below="c"),
            f"{prefix}weights": ArraySpec(("p", 3)),
            f"{prefix}starts": ArraySpec(("q+1",), below="p+1"),
            f"{prefix}closed": ArraySpec(("q",), below="two"),
        }
        checked = archive.take(specs, {"c": count, "q": len(names), "two": 2})
        points = points_from_arrays(archive, checked, prefix)
        starts = checked[f"{prefix}starts"]
        archive.check_offsets(f"{prefix}starts", starts, len(checked[f"{prefix}corners"]))
        if points is None or np.any(np.diff(starts) < 2):
            archive.refuse(f"{prefix}starts leave curves of fewer than two points")
        closed = (checked[f"{prefix}closed"] == 1).tolist()
        rows = map(np.arange, starts[:-1], starts[1:])
        sides.append([Curve(points.at(own), loop) for own, loop in zip(rows, closed, strict=True)])
    return tuple(map(CurvePair, names, *sides))


def scheme_to_entry(scheme: Scheme) -> dict[str, Any]:
    """Name and settings of a scheme, for JSON."""
    return {"name": scheme_name(scheme), **asdict(scheme)}


def scheme_from_entry(path: Path, entry: Mapping[str, Any], remedy: str) -> Scheme:
    """A scheme from the entry of `scheme_to_entry`."""
    settings = dict(entry)
    try:
        return SCHEMES[settings.pop("name")](**settings)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: names no scheme of subdivision that is known ({error}). {remedy}") from error
