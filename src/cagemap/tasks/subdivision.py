"""How the command line says that meshes are to be subdivided."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line starts without the numerics
    from cagemap.mesh import ControlMesh


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
    """Where UVs stay linear."""

    NONE = "none"
    CORNERS_ONLY = "corners-only"
    CORNERS_PLUS1 = "corners-plus1"
    CORNERS_PLUS2 = "corners-plus2"
    BOUNDARIES = "boundaries"
    ALL = "all"


class CreasingName(StrEnum):
    """How sharpness falls."""

    UNIFORM = "uniform"
    CHAIKIN = "chaikin"


@dataclass(frozen=True)
class SubdivisionRequest:
    """Options of the command line; None leaves what the file says."""

    scheme: str | None = None
    boundary: str | None = None
    uv_interpolation: str | None = None
    creasing: str | None = None

    def applied(self, control: ControlMesh) -> ControlMesh:
        """The mesh, to be subdivided as asked."""
        from cagemap.subdivision import with_options

        words = (self.boundary, self.uv_interpolation, self.creasing)
        boundary, uvs, creasing = (None if word is None else word.replace("-", "_") for word in words)
        if (self.scheme, boundary, uvs, creasing) == (None,) * 4:
            return control
        options = self.scheme, boundary, uvs, creasing
        objects = (with_options(replace(control, scheme=own), *options).scheme for own in control.object_schemes)
        schemes = tuple(scheme for scheme in objects if scheme is not None)
        return replace(with_options(control, *options), object_schemes=schemes)
