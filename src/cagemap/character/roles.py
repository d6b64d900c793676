"""The body among the parts of a character."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cagemap.character.values import Part
from cagemap.errors import ParameterError
from cagemap.mesh.faces import face_areas
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import passenger_word

# Of the body's size: vertices closer than this are at the same place.
_SAME_PLACE = 1e-5
_FEWEST_JOINED = 3  # vertices along a common edge
_MIN_JOINED_AREA = 0.1  # of the body's


def find_continuing_parts(body: Part, parts: Sequence[Part]) -> list[Part]:
    """Other parts that continue the body's surface: a torso whose lower edge is the upper edge of the legs."""
    tree, area = cKDTree(body.mesh.positions), float(face_areas(body.mesh).sum())
    reach = _SAME_PLACE * float(np.ptp(body.mesh.positions, axis=0).max())
    found = []
    for part in parts:
        distances, _ = tree.query(part.mesh.positions, distance_upper_bound=reach)
        is_large = float(face_areas(part.mesh).sum()) >= _MIN_JOINED_AREA * area
        if part is not body and is_large and np.isfinite(distances).sum() >= _FEWEST_JOINED:
            found.append(part)
    return found


def find_body(parts: Sequence[Part], name: str | None = None) -> Part:
    """The part of that name; by default the largest one without a passenger's name.

    Raises
    ------
    ParameterError
        If there is no such part, or no part at all.
    """
    if not parts:
        raise ParameterError("expected a character with meshes, got none")
    if name is not None:
        matches = [part for part in parts if part.name == name]
        if not matches:
            names = first_few([part.name for part in parts])
            raise ParameterError(f"expected a part named {name!r}, there is none. It has {names}.")
        return matches[0]
    candidates = [part for part in parts if not passenger_word(part.name)] or list(parts)
    return max(candidates, key=lambda part: float(face_areas(part.mesh).sum()))
