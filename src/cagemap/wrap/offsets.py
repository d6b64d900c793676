"""What a wrapped cage still misses of the source, as displacement: cage plus displacement is the source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import vertex_normals
from cagemap.numerics.arrays import FloatArray
from cagemap.refinement import Level, Refinement, level_triangles, refine
from cagemap.wrap.fit import NORMAL_WEIGHT
from cagemap.wrap.wrapping import Wrapped

# Level of the wrapped surface at least: what most programs render a subdivision surface at.
_RENDERED = 4
# No finer than this, whatever the level.
_MOST_VERTICES = 1_500_000


@dataclass(frozen=True, eq=False)
class Offsets:
    """The way from a wrapped surface to the source, in the source's units.

    Attributes
    ----------
    level : Level
        The wrapped surface, finely refined, with the target's texture coordinates.
    vectors : (n, 3) float64
        From each of its vertices to the source; shorter where a vertex was not to follow.
    heights : (n,) float64
        Their parts along the vertex normals.
    """

    level: Level
    vectors: FloatArray
    heights: FloatArray


def offsets_to_source(wrapped: Wrapped, target: Refinement, source: Refinement) -> Offsets:
    """Find how far a wrapped surface is from the source, at the level at which it is rendered.

    Both surfaces are refined past the levels of the match: where it is coarse, its triangles are not the surface.

    Parameters
    ----------
    wrapped : Wrapped
    target, source : Refinement
        Of the match.
    """
    # `refine` works on the control mesh; positions of the net are refined from their own level.
    fine = _refined(target, max(target.n_levels, _RENDERED))
    positions = fine.prolong(wrapped.mesh.positions, wrapped.level, fine.n_levels)
    follow = np.clip(fine.prolong(wrapped.follow, target.n_levels, fine.n_levels), 0.0, 1.0)
    other = _refined(source, max(source.n_levels, _RENDERED))
    surface = TriangleSurface.from_faces(other.finest.positions, np.asarray(other.finest.faces))
    normals = vertex_normals(positions, level_triangles(fine, fine.n_levels))
    feet = SurfacePoints.nearest(surface, surface.scale * positions, normals, normal_weight=NORMAL_WEIGHT)
    feet_positions = feet.positions / surface.scale
    vectors = follow[:, None] * (feet_positions - positions)
    finest = fine.finest
    level = Level(positions, finest.faces, finest.face_parents, finest.uvs, finest.uv_indices)
    return Offsets(level, vectors, np.einsum("nd,nd->n", vectors, normals))


def _refined(refinement: Refinement, level: int) -> Refinement:
    """The refinement up to a level, or up to the last one that is not too large."""
    size = refinement.finest.n_vertices
    while level > refinement.n_levels and size * 4 ** (level - refinement.n_levels) > _MOST_VERTICES:
        level -= 1
    if level == refinement.n_levels:
        return refinement
    return refine(refinement.control, level, refinement.scheme)
