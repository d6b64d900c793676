"""Control meshes and schemes as named arrays and plain entries, the form in which archives store them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import SCHEMES, Scheme

CONTROL_ARRAYS = (
    "positions",
    "face_offsets",
    "face_indices",
    "uvs",
    "uv_indices",
    "face_materials",
    "material_colors",
    "vertex_colors",
    "face_objects",
    "face_groups",
    "crease_edges",
    "crease_sharpness",
    "corner_vertices",
    "corner_sharpness",
    "hole_faces",
)
# Names beside those of materials; each an array of text.
_NAMES = ("object_names", "group_names")


def control_to_arrays(control: ControlMesh, prefix: str) -> dict[str, Any]:
    """Arrays of a control mesh, those that it has."""
    arrays = {f"{prefix}{name}": getattr(control, name) for name in CONTROL_ARRAYS}
    arrays |= {f"{prefix}{name}": np.array(getattr(control, name)) for name in _NAMES if getattr(control, name)}
    return {name: array for name, array in arrays.items() if array is not None}


def control_from_arrays(
    arrays: Mapping[str, Any], prefix: str, material_names: Sequence[str], name: str, scheme: Scheme | None = None
) -> ControlMesh:
    """Undo `control_to_arrays`; the scheme is the one that the mesh was refined with."""
    stored: dict[str, Any] = {key: arrays.get(f"{prefix}{key}") for key in CONTROL_ARRAYS}
    stored |= {key: tuple(str(text) for text in arrays.get(f"{prefix}{key}", ())) for key in _NAMES}
    return ControlMesh(**stored, material_names=tuple(material_names), name=name, scheme=scheme)


def scheme_to_entry(scheme: Scheme) -> dict[str, Any]:
    """Name and settings of a scheme, for JSON."""
    name = next(name for name, kind in SCHEMES.items() if isinstance(scheme, kind))
    return {"name": name, **asdict(scheme)}


def scheme_from_entry(entry: Mapping[str, Any]) -> Scheme:
    """Undo `scheme_to_entry`.

    Raises
    ------
    KeyError, TypeError
        If the entry lacks something or has too much.
    """
    settings = dict(entry)
    return SCHEMES[settings.pop("name")](**settings)
