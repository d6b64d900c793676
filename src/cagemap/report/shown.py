"""Both surfaces of a result, simplified for display on a page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.operators.coarse_levels import simplify_mesh
from cagemap.report.viewpoints import Viewpoints
from cagemap.spectral import Surface
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.transfer.textured_surface import TexturedSurface

# More vertices look the same on a page and do not fit into its 5 MB.
MAX_MODEL_VERTICES = 60_000
# Of sqrt(area): source vertices this close to the target's image count as reached, however small its triangles are.
MIN_REACH = 0.01


@dataclass(frozen=True, eq=False)
class DisplaySurface:
    """The vertices and triangles of a surface that a page displays."""

    surface: Surface
    vertices: IndexArray  # (n,) of the finest level
    triangles: IndexArray  # (t, 3) of ``vertices``
    positions: FloatArray  # (n, 3) upright, centred, in the unit ball
    # `turn`, `centre`, `radius`: ``positions`` are ``(p @ turn - centre) / radius``
    turn: FloatArray
    centre: FloatArray
    radius: float
    corner_uvs: FloatArray | None  # (t, 3, 2)
    control_faces: IndexArray | None  # (t,) control face of each triangle; None if the surface is simplified

    def to_page(self, positions: FloatArray) -> FloatArray:
        """Page coordinates (p, 3) of positions in file units."""
        return np.asarray((positions @ self.turn - self.centre) / self.radius)


def display_surface(surface: Surface, turn: FloatArray, max_vertices: int = MAX_MODEL_VERTICES) -> DisplaySurface:
    """The finest level with at most ``max_vertices``; larger plain meshes are simplified."""
    refinement = surface.refinement
    positions = np.asarray(refinement.finest.positions)
    level_numbers = [
        k for k, level in enumerate(refinement.levels) if level.n_vertices <= max_vertices and level.faces is not None
    ]
    uvs, parents = None, None
    if level_numbers and (not refinement.is_plain or level_numbers[-1] == refinement.finest_level):
        level = refinement.levels[level_numbers[-1]]
        textured = TexturedSurface.from_level(level, refinement.holes(level_numbers[-1]))
        rows = slice(None) if textured.holes is None else ~textured.holes
        triangles, vertices = textured.triangles[rows], refinement.on_finest(level_numbers[-1])
        uvs = None if textured.uvs is None else textured.corner_uvs()[rows]
        parents = textured.face_parents[textured.triangle_faces][rows]
    else:
        coarse = simplify_mesh(positions, surface.finest_triangles.triangles, max_vertices)
        vertices, triangles = coarse.kept, coarse.triangles
    upright = positions[vertices] @ turn
    centre = (upright.min(0) + upright.max(0)) / 2
    radius = float(np.linalg.norm(upright - centre, axis=1).max()) or 1.0
    return DisplaySurface(surface, vertices, triangles, (upright - centre) / radius, turn, centre, radius, uvs, parents)


def display_surfaces(
    result: MatchResult, viewpoints: Viewpoints, max_vertices: int = MAX_MODEL_VERTICES
) -> tuple[DisplaySurface, DisplaySurface]:
    """Displayed target and source."""
    return (
        display_surface(result.target, viewpoints.target.turn, max_vertices),
        display_surface(result.source, viewpoints.source_turn, max_vertices),
    )


def matched_source_vertices(result: MatchResult) -> FloatArray:
    """(m, 3) source vertices that are unmasked and have a counterpart; colours and checkers span their extent."""
    vertices = result.source.vertices
    return vertices[result.masks.within(result.shared).of_source(len(vertices)) > 0]


def reached_vertices(result: MatchResult, source: DisplaySurface) -> NDArray[np.bool_]:
    """(n,) mask of the displayed source vertices that the map reaches."""
    images, triangles = result.point_map.images.positions, result.point_map.target.triangles
    surface = result.point_map.source
    corners = images[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    vertices = surface.positions[source.vertices]
    triangle, _, distance = closest_points(
        build_tree(images, triangles), vertices, surface.vertex_normals[source.vertices], minimum_cosine=0.0
    )
    half_edge = np.where(triangle >= 0, 0.5 * np.minimum(longest[triangle], 0.1), 0.0)
    return np.asarray(distance <= np.maximum(MIN_REACH, half_edge))
