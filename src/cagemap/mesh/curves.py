"""Curves of control meshes and of finest surfaces.

Paired curves (eyelids, lips, hems) correspond as a whole: their single points need not. Ends of open curves do, in
either order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from cagemap.mesh.cage_points import (
    CagePoints,
    NamedCurve,
    NamedPoints,
    Renumbering,
    find_repeats,
    on_cage,
    outside_fault,
    repeated_fault,
    shared_names,
)
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few, place_text
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import IndexArray, box_diagonal, pair_keys, whole_numbers
from cagemap.numerics.threads import kept
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints

MIN_CURVE_EXTENT = 1e-9  # least extent of a curve, of the mesh's; shorter ones have no direction

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
