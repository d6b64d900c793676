"""Options of the command line for welding and subdivision."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from cagemap.errors import ParameterError
from cagemap.mesh import Bilinear, ControlMesh
from cagemap.mesh.repairs import RepairedMesh, unrepaired
from cagemap.mesh.weld import weld_mesh
from cagemap.subdivision import default_scheme, with_options


@dataclass(frozen=True)
class SubdivisionRequest:
    """Subdivision options of the command line; None keeps the file's option."""

    scheme: str | None = None
    boundary: str | None = None
    uv_interpolation: str | None = None
    creasing: str | None = None

    def apply(self, control: ControlMesh) -> ControlMesh:
        """Return the mesh with these subdivision options."""
        words = (self.boundary, self.uv_interpolation, self.creasing)
        boundary, uvs, creasing = (None if word is None else word.replace("-", "_") for word in words)
        if (self.scheme, boundary, uvs, creasing) == (None,) * 4:
            return control
        options = self.scheme, boundary, uvs, creasing
        objects = (
            with_options(replace(control, scheme=object_scheme), *options).scheme
            for object_scheme in control.object_schemes
        )
        schemes = tuple(scheme for scheme in objects if scheme is not None)
        return replace(with_options(control, *options), object_schemes=schemes)

    def unused_notes(self, meshes: Iterable[ControlMesh]) -> list[str]:
        """A note for each option that none of the meshes uses, as they are plain or bilinear."""
        if not all(isinstance(default_scheme(mesh), Bilinear) for mesh in meshes):  # Plain is a Bilinear
            return []
        given = {"boundary": self.boundary, "uv-interpolation": self.uv_interpolation, "creasing": self.creasing}
        return [f"--{name} is not used: only Catmull-Clark and Loop use it" for name, word in given.items() if word]


AUTO = "auto"


def weld_asked(control: ControlMesh, word: str | None) -> RepairedMesh:
    """The mesh welded by ``--weld`` (``auto`` or a tolerance); not welded for None."""
    return unrepaired(control) if word is None else weld_mesh(control, _tolerance(word))


def weld_side(control: ControlMesh, request: Any, side: str) -> RepairedMesh:
    """The mesh of one side welded as a request with ``--weld`` and ``--target-weld``, ``--source-weld`` says."""
    own = getattr(request, f"{side}_weld")
    return weld_asked(control, request.weld if own is None else own)


def _tolerance(word: str) -> float | None:
    if word == AUTO:
        return None
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 0.1:
        raise ParameterError(
            f"--weld: expected {AUTO} or a distance from 0 to 0.1 in units of the bounding-box diagonal, got {word!r}"
        )
    return value
