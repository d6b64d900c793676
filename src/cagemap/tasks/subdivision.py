"""Options of the command line for welding and subdivision."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from cagemap.errors import ParameterError

if TYPE_CHECKING:  # the command line starts without the numerics
    from cagemap.mesh import ControlMesh
    from cagemap.mesh.weld import Welded


class SchemeName(StrEnum):
    """Subdivision schemes."""

    CATMULL_CLARK = "catmull-clark"
    LOOP = "loop"
    BILINEAR = "bilinear"
    NONE = "none"


class BoundaryName(StrEnum):
    """Boundary rules."""

    EDGE_AND_CORNER = "edge-and-corner"
    EDGE_ONLY = "edge-only"
    NONE = "none"


class UvName(StrEnum):
    """Rules for linear interpolation of UVs."""

    NONE = "none"
    CORNERS_ONLY = "corners-only"
    CORNERS_PLUS1 = "corners-plus1"
    CORNERS_PLUS2 = "corners-plus2"
    BOUNDARIES = "boundaries"
    ALL = "all"


class CreasingName(StrEnum):
    """Rules for semi-sharp creases."""

    UNIFORM = "uniform"
    CHAIKIN = "chaikin"


@dataclass(frozen=True)
class SubdivisionRequest:
    """Subdivision options of the command line; None keeps the file's option."""

    scheme: str | None = None
    boundary: str | None = None
    uv_interpolation: str | None = None
    creasing: str | None = None

    def applied(self, control: ControlMesh) -> ControlMesh:
        """The mesh with these subdivision options."""
        from cagemap.subdivision import with_options

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


AUTO = "auto"


def weld_asked(control: ControlMesh, word: str | None) -> Welded:
    """The mesh welded by ``--weld`` (``auto`` or a tolerance); not welded for None."""
    from cagemap.mesh.weld import keep_unwelded, weld_mesh

    return keep_unwelded(control) if word is None else weld_mesh(control, _tolerance(word))


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
