"""Parts of the target without a counterpart on the source: they follow their surroundings instead of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.relax import patches
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import corner_sums, triangle_areas
from cagemap.wrap.config import CounterpartConfig


def counterpart(point_map: PointMap, config: CounterpartConfig = CounterpartConfig()) -> FloatArray:
    """(n1,) 1 where the map finds room on the source, 0 where it finds none.

    It squeezes what the source lacks into next to nothing. What lies behind may be laid over a place that belongs to
    another part: the back of a mouth bag, whose sides are squeezed into the corners of the lips, over the lips.
    """
    target = point_map.target
    image = triangle_areas(point_map.images.positions, target.triangles)
    sums = corner_sums(target.triangles, np.column_stack([target.areas, image]), target.n)
    # A vertex in a squeezed part has squeezed neighbours as well; single slivers do not count.
    for _ in range(2):
        sums = corner_sums(target.triangles, sums[target.triangles].mean(axis=1), target.n)
    ratio = np.divide(sums[:, 1], sums[:, 0], out=np.ones(target.n), where=sums[:, 0] > 0)
    found = np.clip((ratio - config.squeezed) / (config.whole - config.squeezed), 0.0, 1.0)
    found[_hollow(point_map, found >= 0.5, config)] = 0.0
    return found


def _hollow(point_map: PointMap, whole: NDArray[np.bool_], config: CounterpartConfig) -> NDArray[np.bool_]:
    """(n1,) squeezed parts with what lies behind them, where that is laid over images of the rest; ``whole`` is not."""
    target, images = point_map.target, point_map.images.positions
    nowhere = np.zeros(target.n, dtype=np.bool_)
    if whole.all():
        return nowhere
    part, piece = patches(target.triangles, whole), patches(target.triangles, np.ones(target.n, dtype=np.bool_))
    areas = np.bincount(part, np.where(whole, target.vertex_areas, 0.0))
    largest = np.zeros(int(piece.max()) + 1)
    np.maximum.at(largest, piece, areas[part])
    behind = whole & (areas[part] < largest[piece])
    if target.vertex_areas[behind].sum() < config.min_area:
        return nowhere
    distance, _ = cKDTree(images[whole & ~behind]).query(images[behind])
    near = np.bincount(part[behind], distance <= config.among, len(areas)) > 0.5 * np.bincount(
        part, minlength=len(areas)
    )
    laid_over = behind & near[part]
    hollow = patches(target.triangles, ~whole | laid_over)
    share = np.bincount(hollow, np.where(laid_over, target.vertex_areas, 0.0))
    return np.asarray(share[hollow] >= config.min_area)


def boundary_vertices(surface: TriangleSurface) -> NDArray[np.bool_]:
    """(n,) whether a vertex lies on the boundary of a surface."""
    triangle, opposite = np.nonzero(surface.neighbors < 0)
    found = np.zeros(surface.n, dtype=np.bool_)
    for k in (1, 2):
        found[surface.triangles[triangle, (opposite + k) % 3]] = True
    return found
