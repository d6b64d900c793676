"""Points of control meshes: a control vertex, or three vertices of a face and their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidLandmarksError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal
from cagemap.surface.closest_points import build_tree, closest_points

Renumbering = Callable[[IndexArray], IndexArray]

AT_VERTEX = 1.0 - 1e-6  # a point with at least this weight on one vertex is that vertex
MAX_DISTANCE = 0.1  # largest distance of a position from its mesh, in units of the mesh's bounding-box diagonal
# Positions whose median distance exceeds this share of their own bounding-box diagonal are in another unit. Needed as a
# body scaled by 0.01 about a point inside it is near the mesh everywhere.
MAX_MEDIAN_DISTANCE = 0.25


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
