"""Two prepared surfaces with corresponding points and curves, which are located on the finest surfaces."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import CageCurvePairs, Curve, CurvePair
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys, whole_numbers
from cagemap.numerics.threads import in_threads
from cagemap.spectral import Surface
from cagemap.spectral.surface import Progress as Progress
from cagemap.spectral.surface import no_progress as no_progress
from cagemap.subdivision import Refinement
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows

NEAR_VERTICES = 3000  # least number of vertices of the level on which points between vertices get a near vertex
LANDMARK_NORMAL_WEIGHT = 0.01  # of sqrt(area), where landmarks are placed: thin parts have two sides
LANDMARK_STEPS = 4  # searches for a landmark; each reduces its error by the square of the slope
INVERSE_STEPS = 8  # correction steps that find a surface point's counterpart on the control mesh
CURVE_VERTICES = 15_000  # curves are sampled on the first level with so many vertices: finer than the deformed level
STRAIGHT_PIECES = 8  # number of segments into which a curve is divided between two of its points that no edge joins

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

    def __post_init__(self) -> None:
        if self.symmetries and (self.target.refinement.is_plain or self.source.refinement.is_plain):
            raise ParameterError("symmetries: a plain mesh (scheme none) takes no symmetries. Leave them out.")

    def __repr__(self) -> str:
        count = len(self.landmarks.target.triangle)
        return f"Pair({self.target} -> {self.source}, {count} landmarks, {len(self.symmetries)} symmetries)"

    def levels(self, given: LevelPair | None = None) -> LevelPair:
        """Levels of target and source, by default the finest; ParameterError for missing ones."""
        finest = self.target.finest_level, self.source.finest_level
        levels = finest if given is None else tuple(whole_numbers(given, "levels").ravel().tolist())
        if len(levels) != 2 or not all(0 <= level <= last for level, last in zip(levels, finest, strict=True)):
            raise ParameterError(f"levels: expected the target's and the source's, up to {finest}, got {given}")
        return levels[0], levels[1]

    @property
    def target_landmarks(self) -> IndexArray:
        """(p,) vertices of the target nearest to the landmarks, see `near_vertices`."""
        return near_vertices(self.landmarks.target, self.target)

    @property
    def source_landmarks(self) -> IndexArray:
        """(p,) vertices of the source nearest to the landmarks, see `near_vertices`."""
        return near_vertices(self.landmarks.source, self.source)


@dataclass(frozen=True)
class CurveMiss:
    """Distances between the image of a curve and its counterpart, both ways, of sqrt(area)."""

    name: str
    mean: float
    worst: float


def symmetry_pairs(given: Sequence[SymmetryPair]) -> tuple[SymmetryPair, ...]:
    """Symmetries of `Pair` as arrays of whole numbers; ParameterError if they are no pairs of these."""
    listed = isinstance(given, Sequence)
    if not listed or not all(isinstance(pair, tuple | list) and len(pair) == 2 for pair in given):
        raise ParameterError("symmetries: expected pairs of arrays, the target's images and the source's, got others")
    return tuple((whole_numbers(one, "symmetries"), whole_numbers(other, "symmetries")) for one, other in given)


def point_pairs(target: Surface, source: Surface, landmarks: Landmarks) -> PointPairs:
    """Landmarks of control meshes as points, and their curves as curves, of the finest surfaces."""
    sides = (target.finest_triangles, landmarks.target_points), (source.finest_triangles, landmarks.source_points)
    on_target, on_source = in_threads(lambda side: locate(*side), sides)
    return PointPairs(on_target, on_source, curve_pairs(target, source, landmarks.curves), landmarks.names)


def locate(finest: TriangleSurface, points: CagePoints) -> SurfacePoints:
    """Points of a control mesh on a refined surface, whose first vertices are the control mesh's.

    A point between vertices is placed on the line along its mean normal: the closest point is searched again from where
    the last one projects onto that line. From the mean position itself, strips along edges between facets are nearest
    to no point.
    """
    vertices = points.vertices
    located = SurfacePoints.from_vertices(finest, np.where(vertices >= 0, vertices, points.corners[:, 0]))
    between = np.flatnonzero(vertices < 0)
    if not len(between):
        return located
    some = points.at(between)
    places, normals = some.of(finest.positions), normalize_rows(some.of(finest.vertex_normals))
    aim = places
    for step in range(LANDMARK_STEPS):
        # The nearer the aim is to its side of a thin part, the less weight normals need.
        weight = LANDMARK_NORMAL_WEIGHT / 4.0**step
        near = SurfacePoints.nearest(finest, aim, normals, normal_weight=weight)
        along = np.einsum("qd,qd->q", near.positions - places, normals)
        aim = places + along[:, None] * normals
    return located.replaced(between, near)


def cage_points_of(surface: Surface, points: SurfacePoints) -> CagePoints:
    """Inverse of `locate` by fixed-point steps; the best point of all steps is kept."""
    finest = surface.finest_triangles
    triangles, _ = cage_triangles(surface.control)
    cage = TriangleSurface(finest.positions[: surface.control.n_vertices], triangles, finest.scale)
    aims, least = points.positions, np.full(len(points), np.inf)
    best = CagePoints(np.zeros((len(points), 3), dtype=np.int64), np.zeros((len(points), 3)))
    for _ in range(INVERSE_STEPS):
        near = SurfacePoints.nearest(cage, aims, points.normals, normal_weight=LANDMARK_NORMAL_WEIGHT)
        missed = points.positions - locate(finest, CagePoints(near.corners, near.barycentric)).positions
        distance = np.linalg.norm(missed, axis=1)
        better = distance < least
        best.corners[better], best.weights[better] = near.corners[better], near.barycentric[better]
        least, aims = np.minimum(distance, least), near.positions + missed
    return best


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


def curve_pairs(target: Surface, source: Surface, curves: CageCurvePairs) -> tuple[CurvePair[SurfacePoints], ...]:
    """Curves of control meshes as curves of the finest surfaces."""
    return tuple(
        CurvePair(pair.name, surface_curve(target, pair.target), surface_curve(source, pair.source)) for pair in curves
    )


def surface_curve(surface: Surface, curve: Curve[CagePoints]) -> Curve[SurfacePoints]:
    """A curve of a control mesh on the finest surface: along subdivided edges, else straight."""
    refinement, finest, segments = surface.refinement, surface.finest_triangles, curve.segments
    at_points = locate(finest, curve.points)
    # An edge of a plain mesh is straight already.
    chains = np.full((len(segments), 1), -1)
    if not refinement.is_plain:
        chains = refined_edges(refinement, curve.points.vertices[segments], refinement.coarsest_level(CURVE_VERTICES))
    pieces = [
        SurfacePoints.from_vertices(finest, chain[:-1])
        if chain[-1] >= 0
        else _straight(at_points.at(ends[:1]), at_points.at(ends[1:]))
        for chain, ends in zip(chains, segments, strict=True)
    ]
    if not curve.closed:
        pieces.append(at_points.at(segments[-1:, 1]))
    points = SurfacePoints(
        finest, np.concatenate([piece.triangle for piece in pieces]), np.vstack([p.barycentric for p in pieces])
    )
    return Curve(points, curve.closed)


def refined_edges(refinement: Refinement, ends: IndexArray, level: int) -> IndexArray:
    """(e, 2^level + 1) vertices of a level along control edges (e, 2); -1 where two control vertices have no edge.

    Edge k of a level gives vertex n + k of the next, and its two halves are that level's edges 2 k and 2 k + 1
    (`cagemap.subdivision.topology`).
    """
    topology, count = mesh_topology(refinement.control), refinement.control.n_vertices
    keys, wanted = pair_keys(topology.edge_vertices, count), pair_keys(ends, count)
    edges = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    reverse = topology.edge_ends[edges, 0] != ends[:, 0]
    chains = ends
    for number in range(level):
        middle = refinement.levels[number].n_vertices + 2**number * edges[:, None] + np.arange(2**number)
        middle[reverse] = middle[reverse, ::-1]
        finer = np.empty((len(chains), 2 * chains.shape[1] - 1), dtype=np.int64)
        finer[:, ::2], finer[:, 1::2] = chains, middle
        chains = finer
    return np.where((keys[edges] == wanted)[:, None], chains, -1)


def _straight(start: SurfacePoints, stop: SurfacePoints) -> SurfacePoints:
    """Surface points nearest to the straight line between two of its points, without the second."""
    share = np.arange(STRAIGHT_PIECES)[:, None] / STRAIGHT_PIECES
    places = (1.0 - share) * start.positions + share * stop.positions
    normals = (1.0 - share) * start.normals + share * stop.normals
    near = SurfacePoints.nearest(start.surface, places, normals, normal_weight=LANDMARK_NORMAL_WEIGHT)
    return near.replaced(np.array([0]), start)


def curve_miss(pair: CurvePair[SurfacePoints], point_map: PointMap) -> CurveMiss:
    """Distances from the image of the target curve to the source curve, and back."""
    image = Polyline(pair.target.points.interpolate(point_map.images.positions), pair.target.closed)
    target, source = pair.target.line, pair.source.line
    to_source = np.linalg.norm(source.nearest(image.positions)[0] - image.positions, axis=1)
    to_target = np.linalg.norm(image.nearest(source.positions)[0] - source.positions, axis=1)
    mean = 0.5 * (target.point_shares @ to_source + source.point_shares @ to_target)
    return CurveMiss(pair.name, float(mean), float(max(to_source.max(), to_target.max())))
