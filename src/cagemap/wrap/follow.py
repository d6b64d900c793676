"""How far each vertex of the target may follow the map: parts without a counterpart follow their surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import corner_sums, triangle_areas
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray

# Area on the source by area on the target, both of one: parts that the source lacks (a mouth bag, eye sockets) are
# squeezed into a spot of it, a hundredth and less; what both have is squeezed to a fifth at most.
_SQUEEZED, _WHOLE = 0.03, 0.1


def counterpart(point_map: PointMap) -> FloatArray:
    """(n1,) 1 where the map finds room on the source, 0 where it squeezes the target into next to nothing."""
    target = point_map.target
    image = triangle_areas(point_map.images.positions, target.triangles)
    sums = corner_sums(target.triangles, np.column_stack([target.areas, image]), target.n)
    # A vertex in a squeezed part has squeezed neighbours as well; single slivers do not count.
    for _ in range(2):
        sums = corner_sums(target.triangles, sums[target.triangles].mean(axis=1), target.n)
    ratio = np.divide(sums[:, 1], sums[:, 0], out=np.ones(target.n), where=sums[:, 0] > 0)
    return np.clip((ratio - _SQUEEZED) / (_WHOLE - _SQUEEZED), 0.0, 1.0)


def boundary_vertices(surface: TriangleSurface) -> NDArray[np.bool_]:
    """(n,) whether a vertex lies on the boundary of a surface."""
    triangle, opposite = np.nonzero(surface.neighbors < 0)
    found = np.zeros(surface.n, dtype=np.bool_)
    for k in (1, 2):
        found[surface.triangles[triangle, (opposite + k) % 3]] = True
    return found
