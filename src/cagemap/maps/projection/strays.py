"""Return stray images: single vertices projected onto a part that only touches the one of their neighbours."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cagemap.maps.projection.relax import neighbour_means, touched_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray, mask_of
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import corner_sums, normalize_rows, row_lengths

# Radius around an image in which parts of the source count as connected: in its longest edges; at most, in sqrt(area).
_REACH, _MAX_REACH = 3.0, 0.1


def return_strays(
    images: SurfacePoints, triangles: IndexArray, held: IndexArray, *, min_cosine: float
) -> SurfacePoints:
    """Images, with those that are not on the part of the source of most of their neighbours moved onto it.

    Lips, lids and toes touch: where a vertex of the upper lip is projected onto the lower one, a shape that opens the
    mouth pulls a shard out of the lip. Held vertices (p,) stay, and images whose normal has a larger cosine than
    ``min_cosine`` with the mean of their neighbours' normals.
    """
    surface, n, normals = images.surface, len(images), images.normals
    twice = corner_sums(triangles, normals[triangles].sum(axis=1), n)
    twice -= normals * np.bincount(triangles.ravel(), minlength=n)[:, None]
    cosines = np.einsum("nd,nd->n", normalize_rows(twice), normals)
    doubtful = np.setdiff1d(np.flatnonzero(cosines < min_cosine), held)
    if not len(doubtful):
        return images
    is_doubtful = mask_of(doubtful, n)
    around = neighbour_means(triangles[touched_triangles(triangles, is_doubtful)], is_doubtful)
    edges = neighbour_means(surface.triangles, np.ones(surface.n, dtype=np.bool_))
    tree, corners = cKDTree(surface.positions), images.heaviest_corners
    for vertex, neighbours in zip(doubtful, np.split(around.indices, around.indptr[1:-1]), strict=True):
        place = images.positions[vertex]
        reach = _REACH * float(row_lengths(images.positions[neighbours] - place).max())
        inside = np.sort(tree.query_ball_point(place, min(reach, _MAX_REACH))).astype(np.int64)
        part = connected_components(edges[inside][:, inside], directed=False)[1]
        part_of = dict(zip(inside.tolist(), part.tolist(), strict=True))
        parts = [part_of.get(corner, -1) for corner in corners[neighbours].tolist()]
        most = max(parts, key=parts.count)
        if most < 0 or most == part_of.get(int(corners[vertex])) or 2 * parts.count(most) <= len(parts):
            continue
        images = images.replaced(vertex[None], _nearest_among(surface, inside[part == most], place))
    return images


def _nearest_among(surface: TriangleSurface, vertices: IndexArray, place: FloatArray) -> SurfacePoints:
    """The point (1,) nearest to a place (3,) of the triangles with a corner among vertices (k,)."""
    rows = np.flatnonzero(mask_of(vertices, surface.n)[surface.triangles].any(axis=1))
    found = SurfacePoints.nearest(TriangleSurface(surface.positions, surface.triangles[rows]), place[None])
    return SurfacePoints(surface, rows[found.triangle], found.barycentric)
