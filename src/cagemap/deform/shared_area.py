"""Shared area of two surfaces: where each has a counterpart on the other in a finished fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import ElasticConfig
from cagemap.deform.problem import PreparedPair
from cagemap.maps.masks import Masks
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface


@dataclass(frozen=True, eq=False)
class SharedArea:
    """Area of two surfaces that has a counterpart on the other one."""

    target: FloatArray  # (n1,) of every finest vertex, 1 where it has a counterpart, 0 where it has none
    source: FloatArray  # (n2,)
    target_share: float  # share of the target's area that has a counterpart
    source_share: float

    @classmethod
    def of_vertices(
        cls, surfaces: tuple[TriangleSurface, TriangleSurface], values: tuple[FloatArray, FloatArray]
    ) -> SharedArea:
        """Shared area from values at the vertices of both finest surfaces."""
        shares = [float(surface.vertex_areas @ mask) for surface, mask in zip(surfaces, values, strict=True)]
        return cls(values[0], values[1], shares[0], shares[1])

    @classmethod
    def of_fit(cls, prepared: PreparedPair, places: FloatArray) -> SharedArea | None:
        """Shared area of a fit with the target's vertices at places (n, 3); None if neither is open.

        A vertex has a counterpart where the closest point that faces the same way is near and not on a boundary.
        Squeezed area has none.
        """
        mesh, source, config = prepared.mesh, prepared.source_surface, prepared.elastic
        if not (mesh.is_open or source.is_open):
            return None
        moved = TriangleSurface(places, mesh.triangles)
        shrunk = moved.vertex_areas / np.maximum(mesh.vertex_areas, 1e-12)
        kept = shrunk >= config.data.received[0] * (moved.vertex_areas @ shrunk)
        target_near = _near(moved, source, config) & kept
        source_near = _near(source, moved, config)
        target, level = prepared.target, prepared.source.hierarchy.coarsest_level(config.source_vertices)
        sides = ((target, prepared.levels[0], target_near), (prepared.source, level, source_near))
        values = [
            np.clip(side.hierarchy.prolong(has_counterpart.astype(np.float64), at, side.finest_level), 0.0, 1.0)
            for side, at, has_counterpart in sides
        ]
        return cls.of_vertices((target.finest_triangles, prepared.source.finest_triangles), (values[0], values[1]))

    def within(self, masks: Masks) -> Masks:
        """Masks of the unmasked area that has a counterpart; ``masks`` unchanged if no area has one."""
        if not (self.target.any() and self.source.any()):
            return masks
        n, m = len(self.target), len(self.source)
        return Masks(masks.of_target(n) * self.target, masks.of_source(m) * self.source)

    def summary(self) -> dict[str, float]:
        """The shares as plain numbers for a manifest."""
        return {"target": self.target_share, "source": self.source_share}


def _near(surface: TriangleSurface, other: TriangleSurface, config: ElasticConfig) -> NDArray[np.bool_]:
    """(n,) which vertices have another surface near them."""
    at, barycentric, gaps = closest_points(
        other.tree, surface.positions, surface.vertex_normals, normal_weight=config.normal_weight
    )
    near = ~other.at_boundary(at, barycentric) | (gaps <= config.data.at_boundary)
    return np.asarray((gaps <= config.data.shared_gap) & near)
