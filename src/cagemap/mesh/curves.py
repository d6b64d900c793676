"""Curves: pairs of polylines on target and source that correspond as a whole (eyelids, lips, hems).

Single points of paired curves need not correspond. Ends of open curves do, in either order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import depth_first_order

from cagemap.errors import InvalidLandmarksError
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
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.topology import mesh_topology
from cagemap.numerics.arrays import IndexArray, offsets_of, pair_keys


@dataclass(frozen=True, eq=False)
class CageCurves:
    """Polylines on a control mesh."""

    points: CagePoints  #: points of all curves, one curve after the other
    starts: IndexArray  #: (q + 1,) curve i has the points ``starts[i]`` to ``starts[i + 1] - 1``
    closed: np.ndarray  #: (q,) whether the last point of a curve is joined to its first

    @classmethod
    def of_vertices(cls, chains: Sequence[IndexArray], closed: Sequence[bool]) -> CageCurves:
        """Curves from chains of control vertices."""
        vertices = np.concatenate([np.zeros(0, dtype=np.int64), *chains]).astype(np.int64)
        starts = offsets_of([len(chain) for chain in chains])
        return cls(CagePoints.of_vertices(vertices), starts, np.array(closed, dtype=bool))

    @classmethod
    def joined(cls, curves: Sequence[CageCurves]) -> CageCurves:
        """Concatenate several sets of curves."""
        curves = (cls.of_vertices((), ()), *curves)
        points = CagePoints.joined([part.points for part in curves])
        sizes = np.concatenate([np.diff(part.starts) for part in curves])
        return cls(points, offsets_of(sizes), np.concatenate([part.closed for part in curves]))

    def __len__(self) -> int:
        return len(self.closed)

    @property
    def curve_of(self) -> IndexArray:
        """(c,) curve of every point."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    @property
    def segments(self) -> IndexArray:
        """(s, 2) indices of the two end points of every segment."""
        count = len(self.points.corners)
        after = np.arange(1, count + 1)
        last = self.starts[1:] - 1
        after[last] = np.where(self.closed, self.starts[:-1], -1)
        joined = np.flatnonzero(after >= 0)
        return np.column_stack([joined, after[joined]])

    def at(self, rows: Sequence[int]) -> CageCurves:
        """The curves in the given rows."""
        chosen = np.asarray(rows, dtype=np.int64)
        kept = np.concatenate([np.zeros(0, dtype=np.int64), *(np.flatnonzero(self.curve_of == row) for row in rows)])
        return CageCurves(self.points.at(kept), offsets_of(np.diff(self.starts)[chosen]), self.closed[chosen])


@dataclass(frozen=True, eq=False)
class Curves:
    """Pairs of polylines that correspond as a whole."""

    names: tuple[str, ...]  #: one per pair, such as ``left_eyelid``
    target: CageCurves
    source: CageCurves

    @classmethod
    def none(cls) -> Curves:
        """An empty set of curves."""
        return cls((), CageCurves.of_vertices((), ()), CageCurves.of_vertices((), ()))

    def __len__(self) -> int:
        return len(self.names)

    def reversed(self) -> Curves:
        """The same pairs with target and source exchanged."""
        return Curves(self.names, self.source, self.target)

    def only(self, rows: Sequence[int]) -> Curves:
        """The pairs in the given rows."""
        return Curves(tuple(self.names[row] for row in rows), self.target.at(rows), self.source.at(rows))

    def renumbered(self, target: Renumbering, source: Renumbering) -> Curves:
        """The curves with new vertex numbers of their points' corners; curves with a -1 are dropped."""
        both = (self.target, target), (self.source, source)
        sides = [replace(side, points=side.points.renumbered(number)) for side, number in both]
        lost = [side.curve_of[(side.points.corners < 0).any(axis=1)] for side in sides]
        kept = np.setdiff1d(np.arange(len(self)), np.concatenate(lost))
        return Curves(self.names, *sides).only(kept.tolist())

    def joined_with(self, others: Curves) -> Curves:
        """Return these pairs followed by others."""
        sides = (self.target, others.target), (self.source, others.source)
        return Curves(self.names + others.names, *(CageCurves.joined(side) for side in sides))


def chain_of_edges(edges: IndexArray) -> tuple[IndexArray, bool]:
    """Order edges (e, 2) into one chain or loop: its vertices, and whether it is a loop; else InvalidLandmarksError."""
    vertices, local = np.unique(np.sort(edges, axis=1), return_inverse=True)
    heads, tails = np.concatenate([local.reshape(-1, 2), local.reshape(-1, 2)[:, ::-1]]).T
    graph = sparse.csr_array((np.ones(len(heads)), (heads, tails)), shape=(len(vertices), len(vertices)))
    degrees = np.diff(graph.indptr)
    branching, ends = vertices[degrees > 2].tolist(), vertices[degrees == 1].tolist()
    order = depth_first_order(graph, int(np.argmax(degrees == 1)), return_predecessors=False)
    left = np.delete(vertices, order).tolist()
    found = {
        f"a branch at vertex {first_few(branching)}": branching,
        f"pieces that end at vertices {first_few(ends)}": ends[2:],
        f"pieces: vertices {first_few(left)} are joined to no other": left,
    }
    for text, vertices_found in found.items():
        if vertices_found:
            raise InvalidLandmarksError(
                f"expected the edges of one chain or loop, got {text}. Make each a curve of its own."
            )
    return vertices[order].astype(np.int64), not ends


def paired_curves(
    target_points: NamedPoints, source_points: NamedPoints, target: ControlMesh, source: ControlMesh
) -> tuple[Curves, tuple[str, ...]]:
    """Pair the curves of two meshes by name; also notes on names of one side only."""
    by_name = [{curve.name: curve for curve in points.curves} for points in (target_points, source_points)]
    shared, notes = shared_names(
        *([curve.name for curve in points.curves] for points in (target_points, source_points)),
        what="curves",
        noted="curves",
    )
    sides = [
        CageCurves.joined([on_cage_curve(curves_by_name[name], mesh) for name in shared])
        for curves_by_name, mesh in zip(by_name, (target, source), strict=True)
    ]
    return Curves(shared, sides[0], sides[1]), notes


def on_cage_curve(curve: NamedCurve, mesh: ControlMesh) -> CageCurves:
    """Put a curve on a control mesh: its vertices, and nearest points to its positions."""
    names = tuple(f"{curve.name}, point {i}" for i in range(len(curve.vertices)))
    points = on_cage(NamedPoints(names, curve.vertices, curve.positions), mesh)
    return CageCurves(points, np.array([0, len(names)]), np.array([curve.closed]))


def curve_faults(curves: Curves, target: ControlMesh, source: ControlMesh) -> list[str]:
    """One sentence for each fault of the curves on two meshes."""
    if not len(curves):
        return []  # saves listing the edges of large meshes
    names = list(curves.names)
    faults = [repeated_fault(names, "name of a curve")]
    for side, lines, mesh in (("target", curves.target, target), ("source", curves.source, source)):
        faults += _side_faults(side, lines, names, mesh)
    halves = [name for name, a, b in zip(names, curves.target.closed, curves.source.closed, strict=True) if a != b]
    if halves:
        faults.append(
            f"expected curves closed on both sides or open on both, got these closed on one only: {first_few(halves)}."
        )
    return [fault for fault in faults if fault]


def _side_faults(side: str, curves: CageCurves, names: list[str], mesh: ControlMesh) -> list[str]:
    points, of = curves.points, curves.curve_of
    if outside := outside_fault(points, [names[i] for i in of], mesh, f"{side} vertices of curves"):
        return [outside]
    faults = []
    short = np.flatnonzero(np.diff(curves.starts) < np.where(curves.closed, 3, 2))
    if len(short):
        faults.append(
            f"expected curves of the {side} with two points or more, closed ones with three, got fewer: "
            f"{first_few(names[i] for i in short)}."
        )
    vertices = points.vertices
    at_vertices = np.flatnonzero(vertices >= 0)
    again = at_vertices[find_repeats((of * mesh.n_vertices + vertices)[at_vertices])]
    if len(again):
        listed = first_few(f"{names[of[i]]} ({vertices[i]})" for i in again)
        faults.append(f"expected every {side} vertex once in a curve, got these again: {listed}.")
    segments = curves.segments
    # A position may coincide with a vertex; only points given as vertices have to follow edges.
    stated = np.where(points.corners[:, 0] == points.corners[:, 1], vertices, -1)
    ends = stated[segments]
    joined = np.isin(pair_keys(ends, mesh.n_vertices), pair_keys(mesh_topology(mesh).edge_vertices, mesh.n_vertices))
    apart = np.flatnonzero((ends >= 0).all(axis=1) & ~joined)
    if len(apart):
        listed = first_few(
            f"{names[of[segments[i, 0]]]} ({vertices[segments[i, 0]]} to {vertices[segments[i, 1]]})" for i in apart
        )
        faults.append(
            f"expected neighbours in a curve of the {side} to be joined by edges of {mesh.name}, got none "
            f"for {listed}. Give every vertex along the curve, or places in space."
        )
    return faults
