"""Two prepared surfaces, and points that are known to correspond on them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.basis import Surface
from cagemap.errors import ParameterError
from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.numerics.arrays import IndexArray

Progress = Callable[[str], None]
LevelPair = tuple[int, int]
SymmetryPair = tuple[IndexArray, IndexArray]


@dataclass(frozen=True, eq=False)
class PointPairs:
    """Landmarks as a map sees them: p points of the target and where they belong on the source.

    Attributes
    ----------
    target, source : SurfacePoints
        Of the finest surfaces, one each for every pair. A control vertex is a point like any other.

    Raises
    ------
    ParameterError
        If the sides have different numbers of points.
    """

    target: SurfacePoints
    source: SurfacePoints

    def __post_init__(self) -> None:
        if len(self.target) != len(self.source):
            raise ParameterError(
                f"expected as many points on both surfaces, got {len(self.target)} and {len(self.source)}"
            )

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

    @property
    def target_vertices(self) -> IndexArray:
        """(p,) the target's points as vertices, for methods that know no other points."""
        return as_vertices(self.target)

    @property
    def source_vertices(self) -> IndexArray:
        """(p,) the source's points as vertices, for methods that know no other points."""
        return as_vertices(self.source)

    def only(self, kept: Sequence[int] | IndexArray) -> PointPairs:
        """The pairs at some places."""
        rows = np.asarray(kept, dtype=np.int64)
        return PointPairs(self.target.at(rows), self.source.at(rows))

    def without(self, left_out: Collection[int]) -> PointPairs:
        """The pairs whose places are not among those given."""
        return self.only(np.setdiff1d(np.arange(len(self)), list(left_out)))


@dataclass(frozen=True, eq=False)
class Pair:
    """The two prepared surfaces and what is known to correspond.

    Attributes
    ----------
    target, source : Surface
    landmarks : PointPairs
    symmetries : tuple of ((n_0 target,), (n_0 source,)) arrays
        Self-maps of the control meshes that correspond, each side's as the image of every control vertex, -1 where it
        is not known (see `cagemap.descriptors.check_symmetry`).
    """

    target: Surface
    source: Surface
    landmarks: PointPairs
    symmetries: tuple[SymmetryPair, ...] = ()

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
        surfaces = target.triangles(target.finest), source.triangles(source.finest)
        return cls(target, source, PointPairs.of_vertices(*surfaces, target_vertices, source_vertices), symmetries)

    @property
    def target_landmarks(self) -> IndexArray:
        """(p,) landmarks of the target as vertices."""
        return self.landmarks.target_vertices

    @property
    def source_landmarks(self) -> IndexArray:
        """(p,) landmarks of the source as vertices."""
        return self.landmarks.source_vertices

    def without(self, left_out: Collection[int]) -> Pair:
        """The same surfaces without some of the landmarks."""
        return replace(self, landmarks=self.landmarks.without(left_out))


def as_vertices(points: SurfacePoints) -> IndexArray:
    """(m,) vertices that points lie on.

    Raises
    ------
    ParameterError
        If a point is not a vertex.
    """
    corner = points.barycentric.argmax(axis=1)
    rows = np.arange(len(points))
    between = np.flatnonzero(points.barycentric[rows, corner] != 1.0)
    if len(between):
        raise ParameterError(f"expected landmarks at vertices, got points between them at places {between[:5]}")
    return np.asarray(points.corners[rows, corner])
