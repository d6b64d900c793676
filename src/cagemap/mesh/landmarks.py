"""Landmarks: pairs of points, one on the target and one on the source, that are the same place.

A point is a control vertex, or lies anywhere on the control mesh: three vertices of a face and their weights.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from cagemap.errors import InvalidLandmarksError
from cagemap.geometry.closest import build_tree, closest_points
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.measures import fan_triangles
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray, IndexArray

# A point with at least this weight on one vertex is that vertex.
AT_VERTEX = 1.0 - 1e-6
# A place in space farther from the mesh than this share of the mesh's size (the diagonal of its box) is none of it.
FAR = 0.1


@dataclass(frozen=True, eq=False)
class NamedPoints:
    """Points of one mesh as people keep them.

    Attributes
    ----------
    names : tuple of str
    vertices : (q,) int64
        Control vertices, 0-based; -1 where a place in space is given instead.
    positions : (q, 3) float64
        Places on or near the mesh, in its file's units; NaN where a vertex is given.
    mesh_name : str
        The mesh that they were made for; '' where unknown.
    """

    names: tuple[str, ...]
    vertices: IndexArray
    positions: FloatArray
    mesh_name: str = ""


@dataclass(frozen=True, eq=False)
class CagePoints:
    """Points of a control mesh.

    Attributes
    ----------
    corners : (q, 3) int64
        Vertices of the triangle of a face's fan that holds each point.
    weights : (q, 3) float64
        Not negative, rows sum to 1.
    """

    corners: IndexArray
    weights: FloatArray

    @classmethod
    def of_vertices(cls, vertices: IndexArray) -> CagePoints:
        """Control vertices as points."""
        weights = np.zeros((len(vertices), 3))
        weights[:, 0] = 1.0
        return cls(np.repeat(vertices[:, None], 3, axis=1), weights)

    @property
    def vertices(self) -> IndexArray:
        """(q,) vertices that the points are, -1 where they lie between them."""
        heaviest = self.weights.argmax(axis=1)
        rows = np.arange(len(heaviest))
        at_vertex = self.weights[rows, heaviest] >= AT_VERTEX
        return np.where(at_vertex, self.corners[rows, heaviest], -1).astype(np.int64)

    @property
    def keys(self) -> list[bytes]:
        """Equal points, equal keys."""
        vertices = self.vertices
        return [
            vertex.tobytes() if vertex >= 0 else corners.tobytes() + weights.tobytes()
            for vertex, corners, weights in zip(vertices, self.corners, self.weights, strict=True)
        ]

    @property
    def nearest_vertices(self) -> IndexArray:
        """(q,) the vertex of largest weight."""
        return np.take_along_axis(self.corners, self.weights.argmax(axis=1)[:, None], axis=1)[:, 0]

    def of(self, values: FloatArray) -> FloatArray:
        """(q, d) values (n_0, d) of the control vertices at the points."""
        return np.einsum("qk,qkd->qd", self.weights, values[self.corners])

    def at(self, rows: IndexArray) -> CagePoints:
        """Some of the points."""
        return CagePoints(self.corners[rows], self.weights[rows])


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Pairs of points that correspond.

    Attributes
    ----------
    names : tuple of str
        One per pair, such as ``nose_tip``.
    target, source : (q,) int64
        Control vertices of the two meshes, 0-based; -1 where the landmark lies between them.
    target_name, source_name : str
        The meshes that the numbers were made for; '' where unknown.
    target_points, source_points : CagePoints, optional
        The landmarks wherever they lie; the control vertices if not given.
    """

    names: tuple[str, ...]
    target: IndexArray
    source: IndexArray
    target_name: str = ""
    source_name: str = ""
    target_points: CagePoints = field(default_factory=lambda: CagePoints.of_vertices(np.zeros(0, dtype=np.int64)))
    source_points: CagePoints = field(default_factory=lambda: CagePoints.of_vertices(np.zeros(0, dtype=np.int64)))

    def __post_init__(self) -> None:
        for side in ("target", "source"):
            vertices, points = getattr(self, side), getattr(self, f"{side}_points")
            known = len(points.corners) == len(vertices) and np.array_equal(points.vertices, vertices)
            if not known:
                object.__setattr__(self, f"{side}_points", CagePoints.of_vertices(vertices))

    @classmethod
    def of_points(
        cls, names: tuple[str, ...], target: CagePoints, source: CagePoints, target_name: str, source_name: str
    ) -> Landmarks:
        """Pairs of points that may lie anywhere."""
        return cls(names, target.vertices, source.vertices, target_name, source_name, target, source)

    @classmethod
    def none(cls) -> Landmarks:
        """No pair at all."""
        return cls((), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.names)

    def reversed(self) -> Landmarks:
        """Return the same pairs for the map the other way round."""
        return replace(
            self,
            target=self.source,
            source=self.target,
            target_name=self.source_name,
            source_name=self.target_name,
            target_points=self.source_points,
            source_points=self.target_points,
        )

    def new_since(self, before: Landmarks) -> IndexArray:
        """Places of the pairs that were not there before, or joined other points."""
        known = set(before.places)
        return np.array([i for i, pair in enumerate(self.places) if pair not in known], dtype=np.int64)

    @property
    def places(self) -> list[tuple[bytes, bytes]]:
        """What tells pairs apart: the points that each joins, whatever its name."""
        return list(zip(self.target_points.keys, self.source_points.keys, strict=True))

    def without(self, left_out: Collection[int]) -> Landmarks:
        """Return the pairs whose places are not among those given."""
        kept = np.setdiff1d(np.arange(len(self)), list(left_out))
        names = tuple(self.names[i] for i in kept)
        return replace(
            self,
            names=names,
            target=self.target[kept],
            source=self.source[kept],
            target_points=self.target_points.at(kept),
            source_points=self.source_points.at(kept),
        )


def paired(
    target_points: NamedPoints, source_points: NamedPoints, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks from the points of two meshes, matched by name, and notes on names that only one side has.

    Raises
    ------
    InvalidLandmarksError
        If a name occurs twice on one side, a vertex is out of range, or a place is far from its mesh.
    """
    places = []
    for side, points in (("target", target_points), ("source", source_points)):
        repeated = _repeated(np.array(points.names, dtype=object))
        if len(repeated):
            again = first_few(np.array(points.names, dtype=object)[repeated])
            raise InvalidLandmarksError(
                f"{side} points: expected every name once, got these again: {again}. Rename them."
            )
        places.append({name: i for i, name in enumerate(points.names)})
    shared = tuple(name for name in target_points.names if name in places[1])
    notes = tuple(
        f"landmarks only on the {side}, which were not used: {first_few(only)}"
        for side, points, other in (("target", target_points, places[1]), ("source", source_points, places[0]))
        if (only := [name for name in points.names if name not in other])
    )
    on_target, on_source = (
        on_cage(points, mesh).at(np.array([place[name] for name in shared], dtype=np.int64))
        for points, place, mesh in zip((target_points, source_points), places, (target, source), strict=True)
    )
    return Landmarks.of_points(shared, on_target, on_source, target.name, source.name), notes


def on_cage(points: NamedPoints, mesh: ControlMesh) -> CagePoints:
    """Points of a control mesh: the vertices given, and the mesh's nearest points to places in space.

    Raises
    ------
    InvalidLandmarksError
        If a vertex is out of range or a place is far from the mesh.
    """
    outside = np.flatnonzero(points.vertices >= mesh.n_vertices)
    if len(outside):
        listed = first_few(f"{points.names[i]} ({points.vertices[i]})" for i in outside)
        raise InvalidLandmarksError(
            f"expected vertices from 0 to {mesh.n_vertices - 1}, those of {mesh.name}, got {listed}. They are 0-based."
        )
    found = CagePoints.of_vertices(np.maximum(points.vertices, 0))
    corners, weights = found.corners.copy(), found.weights.copy()
    free = np.flatnonzero(points.vertices < 0)
    if len(free):
        triangles, _ = fan_triangles(mesh)
        held_by, barycentric, distances = closest_points(build_tree(mesh.positions, triangles), points.positions[free])
        size = float(np.linalg.norm(np.ptp(mesh.positions, axis=0)))
        far = np.flatnonzero(distances > FAR * size)
        if len(far):
            listed = first_few(f"{points.names[free[i]]} ({distances[i]:.3g})" for i in far)
            raise InvalidLandmarksError(
                f"expected landmark points on or near {mesh.name}, whose size is {size:.3g}, got distances {listed}. "
                "The points may belong to another mesh, or be in another unit or axis order."
            )
        corners[free], weights[free] = triangles[held_by], barycentric
    return CagePoints(corners, weights)


def check_landmarks(landmarks: Landmarks, target: ControlMesh, source: ControlMesh) -> None:
    """Raise unless the landmarks fit the two meshes.

    Raises
    ------
    InvalidLandmarksError
        If a name or a vertex is used twice, or a vertex number is out of range; all such faults are listed by pair.
    """
    count = len(landmarks.names)
    if landmarks.target.shape != (count,) or landmarks.source.shape != (count,):
        raise InvalidLandmarksError(
            f"landmarks: expected one target and one source vertex for each of {count} names, got arrays of shape "
            f"{landmarks.target.shape} and {landmarks.source.shape}. Give one of each per pair."
        )
    faults = []
    names = np.array(landmarks.names, dtype=object)
    repeated = _repeated(names)
    if len(repeated):
        faults.append(f"expected every name once, got these again: {first_few(names[repeated])}. Rename them.")
    sides = (("target", landmarks.target_points, target), ("source", landmarks.source_points, source))
    for side, points, mesh in sides:
        faults += _side_faults(side, points, names, mesh)
    if faults:
        listed = "".join(f"\n  - {fault}" for fault in faults)
        raise InvalidLandmarksError(f"landmarks for target {target.name} and source {source.name}:{listed}")


def _side_faults(side: str, points: CagePoints, names: np.ndarray, mesh: ControlMesh) -> list[str]:
    faults = []
    outside = np.flatnonzero(((points.corners < 0) | (points.corners >= mesh.n_vertices)).any(axis=1))
    if len(outside):
        pairs = first_few(f"{names[i]} ({points.corners[i, points.weights[i].argmax()]})" for i in outside)
        faults.append(
            f"expected {side} vertices from 0 to {mesh.n_vertices - 1}, those of {mesh.name}, got {pairs}. Numbers are "
            "0-based; check that target and source are not exchanged and that the mesh was not renumbered."
        )
    vertices = points.vertices
    at_vertices = np.flatnonzero(vertices >= 0)
    repeated = at_vertices[_repeated(vertices[at_vertices])]
    if len(repeated):
        pairs = first_few(f"{names[i]} ({vertices[i]})" for i in repeated)
        faults.append(f"expected every {side} vertex in one pair only, got these again: {pairs}. Remove one of each.")
    return faults


def _repeated(values: np.ndarray) -> IndexArray:
    """Places whose value occurred before."""
    return np.setdiff1d(np.arange(len(values)), np.unique(values, return_index=True)[1])
