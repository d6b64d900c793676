"""Residual of a wrap: the source as a detailed mesh over the wrapped surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.transfer.baking import Transfer
from cagemap.transfer.detail import Detail, detail_over, own_transfer
from cagemap.wrap.wrapping import Wrapped

# Level of both surfaces at least: what most programs render a subdivision surface at.
_RENDERED = 4
# No finer than this, whatever the level.
_MOST_VERTICES = 1_500_000


def missing_detail(wrapped: Wrapped, target: Refinement, source: Refinement) -> tuple[Transfer, Detail, Refinement]:
    """The wrapped surface, to bake into its own layout, and the source as the detail over it.

    Both surfaces are refined past the levels of the match: where it is coarse, its triangles are not the surface. Where
    a vertex was not to follow, the detail does not count. The last value is the refined source, of the detail.
    """
    transfer, follow = wrapped_transfer(wrapped, target)
    other = _refined(source, max(source.n_levels, _RENDERED))
    triangles = level_triangles(other, other.n_levels)
    detail = detail_over(transfer.point_map.source, other.finest.positions, triangles)
    return transfer, replace(detail, follow=follow), other


def wrapped_transfer(wrapped: Wrapped, target: Refinement) -> tuple[Transfer, FloatArray]:
    """The wrapped surface as it is rendered, to bake into its own layout; and how far its vertices (n,) follow."""
    fine = _refined(target, max(target.n_levels, _RENDERED))
    # `refine` works on the control mesh; positions of the net are refined from their own level.
    positions = fine.prolong(wrapped.mesh.positions, wrapped.level, fine.n_levels)
    follow = np.clip(fine.prolong(wrapped.follow, target.n_levels, fine.n_levels), 0.0, 1.0)
    return own_transfer(replace(fine.finest, positions=positions)), follow


def _refined(refinement: Refinement, level: int) -> Refinement:
    """The refinement up to a level, or up to the last one that is not too large."""
    size = refinement.finest.n_vertices
    while level > refinement.n_levels and size * 4 ** (level - refinement.n_levels) > _MOST_VERTICES:
        level -= 1
    if level == refinement.n_levels or refinement.is_plain:
        return refinement
    return refine(refinement.control, level, refinement.scheme)
