"""Masks: how much every place of two surfaces counts in a match, and in what is transferred."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers
from cagemap.surface.surface_points import SurfacePoints

# A mask that leaves less of a surface than this leaves nothing to match.
LEAST = 1e-4


@dataclass(frozen=True, eq=False)
class Masks:
    """How much every vertex of two surfaces counts, from 0 (not at all) to 1.

    A correspondence counts as the product of both its ends: what is masked on either side neither pulls nor is pulled,
    it only follows its surroundings, and nothing is transferred there.

    Attributes
    ----------
    target : (n1,) float64 or None
        Of the target's finest vertices; a fit has those of its levels. None where all of it counts.
    source : (n2,) float64 or None
    """

    target: FloatArray | None = None
    source: FloatArray | None = None

    def __post_init__(self) -> None:
        for side, mask in (("target", self.target), ("source", self.source)):
            if mask is not None:
                object.__setattr__(self, side, real_numbers(mask, f"{side} mask"))

    def __repr__(self) -> str:
        sides = ("target", self.target), ("source", self.source)
        shown = [
            f"{name}: {np.count_nonzero(mask)} of {len(mask)} vertices" for name, mask in sides if mask is not None
        ]
        return f"Masks({', '.join(shown)})"

    @property
    def any(self) -> bool:
        """Whether anything is masked."""
        return self.target is not None or self.source is not None

    def reversed(self) -> Masks:
        """The same with the source in the target's place."""
        return Masks(self.source, self.target)

    def at(self, target: IndexArray, source: IndexArray) -> Masks:
        """The same of some vertices of target and source, in their order."""
        mine, theirs = self.target, self.source
        return Masks(None if mine is None else mine[target], None if theirs is None else theirs[source])

    def for_vertices(self, vertices: IndexArray) -> Masks:
        """The same of some target vertices, in their order."""
        return self if self.target is None else Masks(self.target[vertices], self.source)

    def of_target(self, n: int) -> FloatArray:
        """(n,) of all target vertices, also where none is masked."""
        return np.ones(n) if self.target is None else self.target

    def of_source(self, n: int) -> FloatArray:
        """(n,) of all source vertices, also where none is masked."""
        return np.ones(n) if self.source is None else self.source

    def at_source(self, points: SurfacePoints) -> FloatArray:
        """(m,) at points of the source."""
        if self.source is None:
            return np.ones(len(points))
        return np.minimum(points.interpolate(self.of_source(points.surface.n)), 1.0)

    def joint(self, point_map: PointMap) -> FloatArray:
        """(n1,) what every target vertex counts with its image: the product of both masks."""
        return self.of_target(point_map.target.n) * self.at_source(point_map.images)

    def require_fit(self, n_target: int, n_source: int) -> None:
        """Refuse masks of other surfaces, values outside [0, 1], and masks that leave nothing.

        Raises
        ------
        ParameterError
        """
        for side, mask, n in (("target", self.target, n_target), ("source", self.source, n_source)):
            if mask is None:
                continue
            if mask.shape != (n,) or not np.all((mask >= 0) & (mask <= 1)):
                raise ParameterError(
                    f"{side} mask: expected {n} numbers from 0 to 1, one a vertex of the finest level, got shape "
                    f"{mask.shape}; `cagemap.vertex_mask` and its like make them from what a file has"
                )
            if mask.mean() < LEAST:
                raise ParameterError(f"{side} mask: expected some of the surface to count, got 0 nearly everywhere")


# Nothing is masked.
WHOLE = Masks()
