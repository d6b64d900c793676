"""Shared area of two surfaces: where each has a counterpart on the other in a finished fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import ElasticConfig
from cagemap.deform.problem import PreparedPair
from cagemap.maps.masks import Masks
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface


def shared_area(prepared: PreparedPair, places: FloatArray) -> Masks | None:
    """Masks of the area with a counterpart, of a fit with the target's vertices at places (n, 3); None if both closed.

    A vertex has a counterpart, 1, where the closest point that faces the same way is near and not on a boundary.
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
    sides = ((prepared.target, prepared.levels[0], target_near), (prepared.source, prepared.source_level, source_near))
    return Masks(
        *(
            np.clip(side.hierarchy.prolong(has_counterpart.astype(np.float64), at, side.finest_level), 0.0, 1.0)
            for side, at, has_counterpart in sides
        )
    )


def _near(surface: TriangleSurface, other: TriangleSurface, config: ElasticConfig) -> NDArray[np.bool_]:
    """(n,) which vertices have another surface near them."""
    at, barycentric, gaps = closest_points(
        other.tree, surface.positions, surface.vertex_normals, normal_weight=config.normal_weight
    )
    near = ~other.at_boundary(at, barycentric) | (gaps <= config.data.at_boundary)
    return np.asarray((gaps <= config.data.shared_gap) & near)
