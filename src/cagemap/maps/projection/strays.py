"""Return stray images: single vertices projected onto a part that only touches that of their neighbours."""

from __future__ import annotations

import numpy as np

from cagemap.maps.projection.relax import neighbour_means, touched_triangles
from cagemap.numerics.arrays import IndexArray, mask_of
from cagemap.surface.triangle_surface import SurfacePoints, nearest_facing
from cagemap.surface.triangles import corner_sums, normalize_rows, row_lengths

# A stray image's normal has a cosine below the negative of this with the mean of its neighbours', and above it once it
# has returned: parts that touch face each other.
_OPPOSITE = 0.5
# How far an image returns, in distances to the farthest image of its neighbours.
_REACH = 3.0


def return_strays(images: SurfacePoints, triangles: IndexArray, held: IndexArray) -> SurfacePoints:
    """Images, with those that face away from their neighbours moved to the nearest place that faces as these do.

    Lips, lids and toes touch: where a vertex of the upper lip is projected onto the lower one, a shape that opens the
    mouth pulls a shard out of the lip. Held vertices (p,) stay.
    """
    n, normals = len(images), images.normals
    around = corner_sums(triangles, normals[triangles].sum(axis=1), n)
    around -= normals * np.bincount(triangles.ravel(), minlength=n)[:, None]  # without the vertex itself
    means = normalize_rows(around)
    away = np.setdiff1d(np.flatnonzero(np.einsum("nd,nd->n", means, normals) < -_OPPOSITE), held)
    if not len(away):
        return images
    is_away = mask_of(away, n)
    neighbours = neighbour_means(triangles[touched_triangles(triangles, is_away)], is_away)
    apart = images.positions[neighbours.indices] - images.positions[np.repeat(away, np.diff(neighbours.indptr))]
    reach = _REACH * np.maximum.reduceat(row_lengths(apart), neighbours.indptr[:-1])
    near, _ = nearest_facing(images.surface, images.positions[away], means[away], reach)
    facing = np.einsum("nd,nd->n", near.normals, means[away]) > _OPPOSITE
    return images.replaced(away[facing], near.at(facing))
