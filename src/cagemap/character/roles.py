"""Which part of a character is its body."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cagemap.character.values import Part
from cagemap.errors import ParameterError
from cagemap.mesh.faces import face_areas
from cagemap.mesh.mesh_report import first_few

# Words in the names of parts that are worn or set in, whatever their size.
_PASSENGERS = re.compile(
    r"eye|lash|brow|teeth|tooth|tongue|gum|hair|beard|moustache|hat|cap\b|helmet|glasses|shirt|top\b|jacket|coat|suit|"
    r"dress|skirt|trouser|pant|jean|short|cloth|outfit|garment|shoe|boot|sock|glove|belt|bag|scarf|cape|armor|armour|"
    r"weapon|sword|accessor",
    re.IGNORECASE,
)


def role(name: str) -> str:
    """The word in a part's name that says what is worn or set in, in lower case; '' where there is none."""
    found = _PASSENGERS.search(name)
    return "" if found is None else found[0].lower()


def body_of(parts: Sequence[Part], name: str | None = None) -> Part:
    """The part of that name; without one the part with the largest area among those not named as passengers.

    Raises
    ------
    ParameterError
        If there is no such part, or no part at all.
    """
    if not parts:
        raise ParameterError("expected a character with meshes, got none")
    if name is not None:
        found = [part for part in parts if part.name == name]
        if not found:
            listed = first_few([part.name for part in parts])
            raise ParameterError(f"expected a part named {name!r}, there is none. It has {listed}.")
        return found[0]
    candidates = [part for part in parts if not role(part.name)] or list(parts)
    return max(candidates, key=lambda part: float(face_areas(part.mesh).sum()))
