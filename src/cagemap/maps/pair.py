"""Two prepared surfaces with corresponding points and curves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.places import curve_pairs, locate
from cagemap.mesh.curves import CurvePair
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads
from cagemap.spectral import Surface
from cagemap.spectral.surface import Progress as Progress
from cagemap.spectral.surface import no_progress as no_progress
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface

# Least number of vertices of the level on which points between vertices get a near vertex.
NEAR_VERTICES = 3000

LevelPair = tuple[int, int]
SymmetryPair = tuple[IndexArray, IndexArray]


@dataclass(frozen=True, eq=False)
class PointPairs:
    """Landmarks on the finest surfaces: p points of the target and their source points."""

    target: SurfacePoints  #: points of the finest target
    source: SurfacePoints  #: as many points of the finest source, else ParameterError
    curves: tuple[CurvePair[SurfacePoints], ...] = ()  #: curves that correspond as a whole
    names: tuple[str, ...] = ()  #: of the points, for messages; ``point 0``, ... if not given

    def __post_init__(self) -> None:
        if len(self.target) != len(self.source):
            raise ParameterError(
                f"expected as many points on both surfaces, got {len(self.target)} and {len(self.source)}"
            )
        names = tuple(self.names) or tuple(f"point {i}" for i in range(len(self)))
        if len(names) != len(self):
            raise ParameterError(f"names: expected one for each of the pair's {len(self)} landmarks, got {len(names)}")
        object.__setattr__(self, "names", names)

    def __repr__(self) -> str:
        return f"PointPairs({len(self.target)} points, {len(self.curves)} curves)"

    @classmethod
    def of_vertices(
        cls, target: TriangleSurface, source: TriangleSurface, target_vertices: IndexArray, source_vertices: IndexArray
    ) -> PointPairs:
        """Pairs of vertices."""
        return cls(
            SurfacePoints.from_vertices(target, target_vertices), SurfacePoints.from_vertices(source, source_vertices)
        )

    def __len__(self) -> int:
        return len(self.target)

    def reversed(self) -> PointPairs:
        """The pairs and curves with target and source exchanged."""
        return PointPairs(self.source, self.target, tuple(curve.reversed() for curve in self.curves), self.names)

    def only(self, kept: Sequence[int] | IndexArray) -> PointPairs:
        """The pairs at the given indices."""
        rows = np.asarray(kept, dtype=np.int64)
        names = tuple(self.names[row] for row in rows.tolist())
        return PointPairs(self.target.at(rows), self.source.at(rows), self.curves, names)

    def without(self, left_out: Collection[int]) -> PointPairs:
        """The pairs except those at the given indices."""
        return self.only(np.setdiff1d(np.arange(len(self)), list(left_out)))


@dataclass(frozen=True, eq=False)
class Pair:
    """Two prepared surfaces with landmarks, curves and symmetries that correspond."""

    target: Surface
    source: Surface
    landmarks: PointPairs
    #: self-maps of the control meshes that correspond, each side's (n_0,) as the image of every control vertex, -1 if
    #: unknown (see `cagemap.paper.symmetries.check_symmetry`)
    symmetries: tuple[SymmetryPair, ...] = ()

    def __repr__(self) -> str:
        count = len(self.landmarks.target.triangle)
        return f"Pair({self.target} -> {self.source}, {count} landmarks, {len(self.symmetries)} symmetries)"

    @classmethod
    def of_vertices(
        cls,
        target: Surface,
        source: Surface,
        target_vertices: IndexArray,
        source_vertices: IndexArray,
        symmetries: tuple[SymmetryPair, ...] = (),
    ) -> Pair:
        """Two surfaces with landmarks at control vertices, which are vertices of all levels."""
        surfaces = target.finest_triangles, source.finest_triangles
        return cls(target, source, PointPairs.of_vertices(*surfaces, target_vertices, source_vertices), symmetries)

    @property
    def target_landmarks(self) -> IndexArray:
        """(p,) vertices of the target nearest to the landmarks, see `near_vertices`."""
        return near_vertices(self.landmarks.target, self.target)

    @property
    def source_landmarks(self) -> IndexArray:
        """(p,) vertices of the source nearest to the landmarks, see `near_vertices`."""
        return near_vertices(self.landmarks.source, self.source)


def near_vertices(points: SurfacePoints, surface: Surface, level: int | None = None) -> IndexArray:
    """(m,) distinct vertices of a level (the finest by default), one at or near each point.

    A point between vertices gets the nearest vertex that no other point has, of a level that the basis, the search
    and ``level`` have in common.
    """
    vertices, levels = points.vertices, surface.hierarchy
    level = levels.finest_level if level is None else level
    if (levels.on_level(0, vertices) < 0).any():
        common = min(surface.basis.last_level, levels.coarsest_level(NEAR_VERTICES), level)
        on_common = levels.on_level(common, vertices)
        between, positions = np.flatnonzero(on_common < 0), surface.triangles(common).positions
        if len(points) > len(positions):
            raise ParameterError(
                f"landmarks: expected at most {len(positions)} on a level of as many vertices, got {len(points)}. "
                "Give fewer, or refine once more."
            )
        free = nearest_free_vertices(positions, points.positions[between], on_common[on_common >= 0])
        vertices[between] = levels.on_finest(common)[free]
    return levels.on_level(level, vertices)


def nearest_free_vertices(positions: FloatArray, places: FloatArray, taken: IndexArray) -> IndexArray:
    """(q,) distinct vertices nearest to places (q, 3), none of them taken. If places share one, the first gets it."""
    chosen, free = np.full(len(places), -1, dtype=np.int64), np.setdiff1d(np.arange(len(positions)), taken)
    while len(left := np.flatnonzero(chosen < 0)):
        near, first = np.unique(cKDTree(positions[free]).query(places[left])[1], return_index=True)
        chosen[left[first]] = free[near]
        free = np.delete(free, near)
    return chosen


def point_pairs(target: Surface, source: Surface, landmarks: Landmarks) -> PointPairs:
    """Landmarks of control meshes as points, and their curves as curves, of the finest surfaces."""
    sides = (target.finest_triangles, landmarks.target_points), (source.finest_triangles, landmarks.source_points)
    on_target, on_source = in_threads(lambda side: locate(*side), sides)
    return PointPairs(on_target, on_source, curve_pairs(target, source, landmarks.curves), landmarks.names)
