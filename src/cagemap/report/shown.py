"""Both surfaces of a result, simplified to what a page can show smoothly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.operators.coarse_levels import simplified
from cagemap.report.viewpoints import Seen
from cagemap.spectral import Surface
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.transfer.textured_surface import TexturedSurface

# Vertices of each surface; more neither look different on a page nor fit into its 5 MB.
MAX_VERTICES = 60_000
# Of sqrt(area): source places farther from the target's image are not reached, whatever the size of the triangles.
REACH = 0.01


@dataclass(frozen=True, eq=False)
class ShownSurface:
    """One surface, some of whose finest vertices are shown.

    Attributes
    ----------
    surface : Surface
    vertices : (n,) int64
        Of the finest level.
    triangles : (t, 3) int64
        Between them.
    positions : (n, 3) float64
        Turned upright, centred, and in the unit ball.
    turn, centre, radius
        ``positions`` are ``(p @ turn - centre) / radius``.
    corner_uvs : (t, 3, 2) float64 or None
    control_faces : (t,) int64 or None
        Face of the control mesh that each triangle is a part of; None where the surface is simplified.
    """

    surface: Surface
    vertices: IndexArray
    triangles: IndexArray
    positions: FloatArray
    turn: FloatArray
    centre: FloatArray
    radius: float
    corner_uvs: FloatArray | None
    control_faces: IndexArray | None

    def placed(self, positions: FloatArray) -> FloatArray:
        """Positions (p, 3) of the file in the frame of the page."""
        return np.asarray((positions @ self.turn - self.centre) / self.radius)


def shown_surface(surface: Surface, turn: FloatArray, most: int = MAX_VERTICES) -> ShownSurface:
    """The finest level of at most so many vertices; of a larger plain mesh a simplification."""
    refinement = surface.refinement
    positions = np.asarray(refinement.finest.positions)
    small = [k for k, level in enumerate(refinement.levels) if level.n_vertices <= most and level.faces is not None]
    uvs, parents = None, None
    if small and (not refinement.is_plain or small[-1] == refinement.n_levels):
        level = refinement.levels[small[-1]]
        textured = TexturedSurface.from_level(level, refinement.holes(small[-1]))
        kept = slice(None) if textured.holes is None else ~textured.holes
        triangles, vertices = textured.triangles[kept], refinement.on_finest(small[-1])
        uvs = None if textured.uvs is None else textured.corner_uvs()[kept]
        parents = textured.face_parents[textured.triangle_faces][kept]
    else:
        coarse = simplified(positions, surface.finest_triangles.triangles, most)
        vertices, triangles = coarse.kept, coarse.triangles
    turned = positions[vertices] @ turn
    centre = (turned.min(0) + turned.max(0)) / 2
    radius = float(np.linalg.norm(turned - centre, axis=1).max()) or 1.0
    return ShownSurface(surface, vertices, triangles, (turned - centre) / radius, turn, centre, radius, uvs, parents)


def shown_surfaces(result: MatchResult, views: Seen, most: int = MAX_VERTICES) -> tuple[ShownSurface, ShownSurface]:
    """Target and source."""
    return (
        shown_surface(result.target, views.target.turn, most),
        shown_surface(result.source, views.source_turn, most),
    )


def reached(result: MatchResult, source: ShownSurface) -> NDArray[np.bool_]:
    """(n,) which shown vertices of the source some part of the target maps to."""
    images, triangles = result.point_map.images.positions, result.point_map.target.triangles
    places = result.point_map.source
    corners = images[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    queries = places.positions[source.vertices]
    found, _, distance = closest_points(
        build_tree(images, triangles), queries, places.vertex_normals[source.vertices], minimum_cosine=0.0
    )
    within = np.where(found >= 0, 0.5 * np.minimum(longest[found], 0.1), 0.0)
    return np.asarray(distance <= np.maximum(REACH, within))
