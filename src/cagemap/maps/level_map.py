"""A map between one level of the target and one of the source, of methods that go from level to level."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.maps.pair import LevelPair
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True, eq=False)
class LevelMap:
    """Functional map and vertex matches between one level of the target and one of the source.

    Attributes
    ----------
    levels : (int, int)
        Level of the target, level of the source.
    functional_map : (k1, k2) array
        C12 on the basis functions of these levels.
    match : (n1,) array
        Source vertex of every target vertex.
    points : PointMap or None
        The same as points of the source's triangles; None while the finer levels are not found yet.
    """

    levels: LevelPair
    functional_map: FloatArray
    match: IndexArray
    points: PointMap | None = None
