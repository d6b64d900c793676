"""Points and curves of control meshes on the finest surfaces, and how far a map misses a curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.point_map import PointMap
from cagemap.mesh.curves import CageCurvePairs, Curve, CurvePair
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import CagePoints
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import IndexArray, pair_keys
from cagemap.spectral import Surface
from cagemap.subdivision import Refinement
from cagemap.surface.polylines import Polyline
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows

# Weight of normals, of sqrt(area), when a landmark is placed on the surface: thin parts have two sides.
LANDMARK_NORMAL_WEIGHT = 0.01
# Closest-point searches per landmark; each reduces the distance from the normal's line by the square of the slope.
LANDMARK_STEPS = 4
# Correction steps that find a surface point's counterpart on the control mesh.
INVERSE_STEPS = 8
# Curves are sampled on the first level with so many vertices: finer than the deformed level.
CURVE_VERTICES = 15_000
# Pieces of a straight line between two points of a curve that no edge joins.
STRAIGHT_PIECES = 8


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
    aims = points.positions
    best, least = None, np.full(len(points), np.inf)
    for _ in range(INVERSE_STEPS):
        near = SurfacePoints.nearest(cage, aims, points.normals, normal_weight=LANDMARK_NORMAL_WEIGHT)
        tried = CagePoints(near.corners, near.barycentric)
        missed = points.positions - locate(finest, tried).positions
        distance = np.linalg.norm(missed, axis=1)
        better = distance < least
        best = tried if best is None else choose_points(better, tried, best)
        least, aims = np.minimum(distance, least), near.positions + missed
    assert best is not None
    return best


def choose_points(chosen: NDArray[np.bool_], one: CagePoints, other: CagePoints) -> CagePoints:
    """Points of one set where chosen (p,), else of the other."""
    return CagePoints(
        np.where(chosen[:, None], one.corners, other.corners), np.where(chosen[:, None], one.weights, other.weights)
    )


@dataclass(frozen=True)
class CurveMiss:
    """Distances between the image of a curve and its counterpart, both ways, of sqrt(area)."""

    name: str
    mean: float
    worst: float


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


def curve_miss(pair: CurvePair[SurfacePoints], point_map: PointMap) -> CurveMiss:
    """Distances from the image of the target curve to the source curve, and back."""
    image = Polyline(pair.target.points.interpolate(point_map.images.positions), pair.target.closed)
    target, source = pair.target.line, pair.source.line
    to_source = np.linalg.norm(source.nearest(image.positions)[0] - image.positions, axis=1)
    to_target = np.linalg.norm(image.nearest(source.positions)[0] - source.positions, axis=1)
    mean = 0.5 * (target.point_shares @ to_source + source.point_shares @ to_target)
    return CurveMiss(pair.name, float(mean), float(max(to_source.max(), to_target.max())))


def _straight(start: SurfacePoints, stop: SurfacePoints) -> SurfacePoints:
    """Surface points nearest to the straight line between two of its points, without the second."""
    share = np.arange(STRAIGHT_PIECES)[:, None] / STRAIGHT_PIECES
    places = (1.0 - share) * start.positions + share * stop.positions
    normals = (1.0 - share) * start.normals + share * stop.normals
    near = SurfacePoints.nearest(start.surface, places, normals, normal_weight=LANDMARK_NORMAL_WEIGHT)
    return near.replaced(np.array([0]), start)
