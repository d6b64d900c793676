"""Points and curves of control meshes.

A point is a control vertex, or three vertices of a face and their weights. Paired curves (eyelids, lips, hems)
correspond as a whole: their single points need not. Ends of open curves do, in either order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidLandmarksError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.mesh_report import first_few, place_text
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, pair_keys, whole_numbers
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints

Renumbering = Callable[[IndexArray], IndexArray]

AT_VERTEX = 1.0 - 1e-6  # a point with at least this weight on one vertex is that vertex
MAX_DISTANCE = 0.1  # largest distance of a position from its mesh, in units of the mesh's bounding-box diagonal
# Positions whose median distance exceeds this share of their own bounding-box diagonal are in another unit. Needed as a
# body scaled by 0.01 about a point inside it is near the mesh everywhere.
MAX_MEDIAN_DISTANCE = 0.25
MIN_CURVE_EXTENT = 1e-9  # least extent of a curve, of the mesh's; shorter ones have no direction


@dataclass(frozen=True, eq=False)
class NamedCurve:
    """A polyline of one mesh as in a file: by vertex numbers or positions."""

    name: str
    vertices: IndexArray  #: (c,) control vertices along it, 0-based; -1 where a position is given instead
    positions: FloatArray  #: (c, 3) positions on or near the mesh, in its file's units; NaN where a vertex is given
    closed: bool  #: whether its last point is joined to its first


@dataclass(frozen=True, eq=False)
class NamedPoints:
    """Points of one mesh as in a file: by vertex numbers or positions."""

    names: tuple[str, ...]
    vertices: IndexArray  #: (q,) control vertices, 0-based; -1 where a position is given instead
    positions: FloatArray  #: (q, 3) positions on or near the mesh, in its file's units; NaN where a vertex is given
    mesh_name: str = ""  #: name of the mesh in their file; '' where unknown
    curves: tuple[NamedCurve, ...] = ()


@dataclass(frozen=True, eq=False)
class CagePoints:
    """Points of a control mesh: corners (q, 3) of triangles of faces, and weights (q, 3), sum 1."""

    corners: IndexArray
    weights: FloatArray

    @classmethod
    def of_vertices(cls, vertices: IndexArray) -> Self:
        """Points at control vertices (q,)."""
        weights = np.zeros((len(vertices), 3))
        weights[:, 0] = 1.0
        return cls(np.repeat(vertices[:, None], 3, axis=1), weights)

    @property
    def vertices(self) -> IndexArray:
        """(q,) control vertex of every point, -1 for points between vertices."""
        return np.where(self.weights.max(axis=1) >= AT_VERTEX, self.heaviest_corners, -1).astype(np.int64)

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def keys(self) -> list[bytes]:
        """One key per point; equal points have equal keys."""
        vertices = self.vertices
        return [
            vertex.tobytes() if vertex >= 0 else corners.tobytes() + weights.tobytes()
            for vertex, corners, weights in zip(vertices, self.corners, self.weights, strict=True)
        ]

    @property
    def heaviest_corners(self) -> IndexArray:
        """(q,) vertex of largest weight."""
        return np.take_along_axis(self.corners, self.weights.argmax(axis=1)[:, None], axis=1)[:, 0]

    def of(self, values: FloatArray) -> FloatArray:
        """Interpolate values (n, d) of the mesh's vertices: (q, d) at the points."""
        return np.einsum("qk,qkd->qd", self.weights, values[self.corners])

    def at(self, rows: IndexArray) -> Self:
        """The points in the given rows."""
        return replace(self, corners=self.corners[rows], weights=self.weights[rows])

    def renumbered(self, number: Renumbering) -> Self:
        """The points with new vertex numbers of their corners; -1 for removed vertices."""
        return replace(self, corners=number(self.corners))

    @classmethod
    def joined(cls, points: Sequence[CagePoints]) -> Self:
        """Concatenate several sets of points."""
        return cls(np.concatenate([part.corners for part in points]), np.concatenate([part.weights for part in points]))


P = TypeVar("P", CagePoints, SurfacePoints)


@dataclass(frozen=True, eq=False)
class Curve(Generic[P]):
    """A polyline of points of a control mesh, or of a finest surface."""

    points: P
    closed: bool  #: whether the last point is joined to the first

    @staticmethod
    def of_vertices(vertices: Sequence[int] | IndexArray, closed: bool) -> Curve[CagePoints]:
        """The curve along control vertices."""
        return Curve(CagePoints.of_vertices(whole_numbers(vertices, "curve")), closed)

    @property
    def segments(self) -> IndexArray:
        """(s, 2) indices of the two end points of every segment."""
        count = len(self.points)
        first = np.arange(count if self.closed else count - 1)
        return np.column_stack([first, (first + 1) % max(count, 1)])

    @kept
    def line(self: Curve[SurfacePoints]) -> Polyline:
        """Polyline in space of a curve on a finest surface, which has unit area."""
        return Polyline(self.points.positions, self.closed)


@dataclass(frozen=True, eq=False)
class CurvePair(Generic[P]):
    """Two curves that correspond as a whole."""

    name: str  #: such as ``left_eyelid``
    target: Curve[P]
    source: Curve[P]

    @staticmethod
    def of_vertices(
        name: str, target: Sequence[int] | IndexArray, source: Sequence[int] | IndexArray, *, closed: bool = False
    ) -> CurvePair[CagePoints]:
        """Two curves along control vertices."""
        return CurvePair(name, Curve.of_vertices(target, closed), Curve.of_vertices(source, closed))

    @property
    def points(self) -> tuple[P, P]:
        """Points of target and source along the curves."""
        return self.target.points, self.source.points

    def reversed(self) -> CurvePair[P]:
        """The pair with target and source exchanged."""
        return CurvePair(self.name, self.source, self.target)

    def renumbered(self: CurvePair[CagePoints], target: Renumbering, source: Renumbering) -> CurvePair[CagePoints]:
        """The pair with new vertex numbers, by functions of the old ones that give -1 for removed vertices."""
        sides = (self.target, target), (self.source, source)
        return CurvePair(self.name, *(Curve(side.points.renumbered(to_new), side.closed) for side, to_new in sides))


CageCurvePairs = tuple[CurvePair[CagePoints], ...]  # of two control meshes


def on_cage(points: NamedPoints, mesh: ControlMesh) -> CagePoints:
    """Place points on a control mesh: at vertices, or nearest to positions; InvalidLandmarksError where far off."""
    at_vertices = CagePoints.of_vertices(np.maximum(points.vertices, 0))
    if fault := outside_fault(at_vertices, points.names, mesh, "vertices of landmark points"):
        raise InvalidLandmarksError(fault)
    corners, weights = at_vertices.corners, at_vertices.weights
    free = np.flatnonzero(points.vertices < 0)
    if len(free):
        triangles, _ = cage_triangles(mesh)
        held_by, barycentric, distances = closest_points(build_tree(mesh.positions, triangles), points.positions[free])
        size = box_diagonal(mesh.positions)
        far = np.flatnonzero(distances > MAX_DISTANCE * size)
        if len(far):
            listed = first_few(f"{points.names[free[i]]} ({distances[i]:.3g})" for i in far)
            raise InvalidLandmarksError(
                f"expected landmark points on or near {mesh.name}, whose size is {size:.3g}, got distances {listed}. "
                "Give the points of this mesh, in its unit and axis order; are target and source exchanged?"
            )
        spread, typical = box_diagonal(points.positions[free]), float(np.median(distances))
        if len(free) >= 3 and typical > max(MAX_MEDIAN_DISTANCE * spread, 0.1 * MAX_DISTANCE * size):
            raise InvalidLandmarksError(
                f"expected landmark points on {mesh.name}, whose size is {size:.3g}, got {len(free)} within "
                f"{spread:.3g} of each other that are typically {typical:.3g} away from it. They look like points in "
                "another unit: scale them as the mesh is."
            )
        corners[free], weights[free] = triangles[held_by], barycentric
    return CagePoints(corners, weights)


def paired_curves(
    target_points: NamedPoints, source_points: NamedPoints, target: ControlMesh, source: ControlMesh
) -> tuple[CageCurvePairs, tuple[str, ...]]:
    """Pair the curves of two meshes by name; also notes on names of one side only."""
    both = [{curve.name: curve for curve in points.curves} for points in (target_points, source_points)]
    shared, notes = shared_names(
        *([curve.name for curve in points.curves] for points in (target_points, source_points)),
        what="curves",
        noted="curves",
    )
    on_target, on_source = (
        [on_cage_curve(curves_by_name[name], mesh) for name in shared]
        for curves_by_name, mesh in zip(both, (target, source), strict=True)
    )
    return tuple(map(CurvePair, shared, on_target, on_source)), notes


def on_cage_curve(curve: NamedCurve, mesh: ControlMesh) -> Curve[CagePoints]:
    """Put a curve on a control mesh: its vertices, and nearest points to its positions."""
    names = tuple(f"{curve.name}, point {i}" for i in range(len(curve.vertices)))
    return Curve(on_cage(NamedPoints(names, curve.vertices, curve.positions), mesh), curve.closed)


def curve_faults(curves: CageCurvePairs, target: ControlMesh, source: ControlMesh) -> list[str]:
    """One sentence for each fault of the curves on two meshes."""
    if not curves:
        return []  # saves listing the edges of large meshes
    names = [pair.name for pair in curves]
    faults = [
        repeated_fault(names, "name of a curve"),
        *_side_faults("target", names, [pair.target for pair in curves], target),
        *_side_faults("source", names, [pair.source for pair in curves], source),
    ]
    mixed = [pair.name for pair in curves if pair.target.closed != pair.source.closed]
    if mixed:
        faults.append(
            f"expected curves closed on both sides or open on both, got these closed on one only: {first_few(mixed)}."
        )
    return [fault for fault in faults if fault]


def _side_faults(side: str, names: list[str], curves: list[Curve[CagePoints]], mesh: ControlMesh) -> list[str]:
    points = CagePoints.joined([curve.points for curve in curves])
    named = list(zip(names, curves, strict=True))
    name_of_point = [name for name, curve in named for _ in range(len(curve.points))]
    if outside := outside_fault(points, name_of_point, mesh, f"{side} vertices of curves"):
        return [outside]
    short = [name for name, curve in named if len(curve.points) < (3 if curve.closed else 2)]
    repeated, unjoined, flat = list[str](), list[str](), list[str]()
    least = MIN_CURVE_EXTENT * box_diagonal(mesh.positions)
    edges = pair_keys(mesh_topology(mesh).edge_vertices, mesh.n_vertices)
    for name, curve in named:
        vertices, corners = curve.points.vertices, curve.points.corners
        places = curve.points.of(mesh.positions)
        if len(places) > 1 and box_diagonal(places) <= least:
            flat.append(f"{name} at {place_text(places[0])}")
        at_vertices = vertices[vertices >= 0]
        repeated += [f"{name} ({at_vertices[i]})" for i in find_repeats(at_vertices)]
        # A position may coincide with a vertex; only points given as vertices have to follow edges.
        given_as_vertex = corners[:, 0] == corners[:, 1]
        ends = np.where(given_as_vertex, vertices, -1)[curve.segments]
        joined = np.isin(pair_keys(ends, mesh.n_vertices), edges)
        unjoined += [f"{name} ({a} to {b})" for a, b in ends[(ends >= 0).all(axis=1) & ~joined]]
    faults = {
        f"expected curves of the {side} with two points or more, closed ones with three, got fewer: "
        f"{first_few(short)}.": short,
        f"expected curves of the {side} with a length, got all points at one place: {first_few(flat)}. Leave such "
        "a curve out, or give its other points.": flat,
        f"expected every {side} vertex once in a curve, got these again: {first_few(repeated)}.": repeated,
        f"expected neighbours in a curve of the {side} to be joined by edges of {mesh.name}, got none "
        f"for {first_few(unjoined)}. Give every vertex along the curve, or places in space.": unjoined,
    }
    return [fault for fault, found in faults.items() if found]


def outside_fault(points: CagePoints, names: Sequence[str], mesh: ControlMesh, what: str) -> str:
    """Error message that lists the named points at vertices that the mesh does not have; '' if there are none."""
    outside = np.flatnonzero(((points.corners < 0) | (points.corners >= mesh.n_vertices)).any(axis=1))
    if not len(outside):
        return ""
    listed = first_few(f"{names[i]} ({points.heaviest_corners[i]})" for i in outside.tolist())
    return (
        f"expected {what} from 0 to {mesh.n_vertices - 1}, those of {mesh.name}, got {listed}. Numbers are "
        "0-based; check that target and source are not exchanged and that the mesh was not renumbered."
    )


def repeated_fault(names: Sequence[str], what: str) -> str:
    """Error message that lists the names that are repeated; '' if all differ."""
    again = [names[i] for i in find_repeats(np.array(names, dtype=object))]
    return f"expected every {what} once, got these again: {first_few(again)}. Rename them." if again else ""


def shared_names(
    target: Sequence[str], source: Sequence[str], *, what: str, noted: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names on both sides, in the target's order, and notes on others; InvalidLandmarksError for a repeated name."""
    sides = ("target", target, frozenset(target)), ("source", source, frozenset(source))
    for side, names, _ in sides:
        if fault := repeated_fault(names, "name"):
            raise InvalidLandmarksError(f"{side} {what}: {fault}")
    notes = tuple(
        f"{noted} only on the {side}, which were not used: {first_few(only)}"
        for (side, own_names, _), (_, _, other_names) in (sides, sides[::-1])
        if (only := [name for name in own_names if name not in other_names])
    )
    return tuple(name for name in target if name in sides[1][2]), notes


def find_repeats(values: NDArray[Any]) -> IndexArray:
    """Indices of values that occurred before."""
    return np.setdiff1d(np.arange(len(values)), np.unique(values, return_index=True)[1])
