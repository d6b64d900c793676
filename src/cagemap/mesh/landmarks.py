"""Landmarks: pairs of corresponding points and curves on target and source.

A point is a control vertex, or three vertices of a face with barycentric weights.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from unicodedata import normalize

import numpy as np

from cagemap.errors import DirectionError, InvalidLandmarksError
from cagemap.mesh.cage_points import (
    CagePoints,
    NamedPoints,
    Renumbering,
    find_repeats,
    on_cage,
    outside_fault,
    repeated_fault,
    shared_names,
)
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.curves import CageCurvePairs, curve_faults, paired_curves
from cagemap.mesh.mesh_report import first_few, list_problems
from cagemap.numerics.arrays import IndexArray, whole_numbers


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Pairs of points that correspond; InvalidLandmarksError for names, ParameterError for vertices of another kind."""

    names: tuple[str, ...]  #: one per pair, such as ``nose_tip``
    target: IndexArray  #: (q,) control vertices of the target, 0-based; -1 for a landmark between vertices
    source: IndexArray  #: (q,) the same of the source
    target_name: str = ""  #: name of the mesh that the target's points were placed on; '' where unknown
    source_name: str = ""
    #: the landmarks as points of the meshes; default: the control vertices
    target_points: CagePoints = field(default_factory=lambda: CagePoints.of_vertices(np.zeros(0, dtype=np.int64)))
    source_points: CagePoints = field(default_factory=lambda: CagePoints.of_vertices(np.zeros(0, dtype=np.int64)))
    curves: CageCurvePairs = ()  #: pairs of polylines that correspond as a whole; their single points need not

    def __post_init__(self) -> None:
        names = None if isinstance(self.names, str) or not isinstance(self.names, Iterable) else tuple(self.names)
        if names is None or not all(isinstance(name, str) for name in names):
            raise InvalidLandmarksError(f"landmarks: expected a name for every pair, got names={self.names!r}")
        object.__setattr__(self, "names", names)
        for side in ("target", "source"):
            vertices = np.array(whole_numbers(getattr(self, side), f"landmarks: {side}"))
            points = getattr(self, f"{side}_points")
            object.__setattr__(self, side, vertices)
            known = len(points) == len(vertices) and np.array_equal(points.vertices, vertices)
            if not known:
                object.__setattr__(self, f"{side}_points", CagePoints.of_vertices(vertices))

    @classmethod
    def of_points(
        cls,
        names: tuple[str, ...],
        target: CagePoints,
        source: CagePoints,
        target_name: str,
        source_name: str,
        curves: CageCurvePairs = (),
    ) -> Landmarks:
        """Landmarks from pairs of points anywhere on the meshes, and pairs of curves."""
        return cls(names, target.vertices, source.vertices, target_name, source_name, target, source, curves)

    @classmethod
    def none(cls) -> Landmarks:
        """An empty set of landmarks."""
        return cls((), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        named = ", ".join(self.names[:3]) + (", ..." if len(self) > 3 else "")
        also = f", {len(self.curves)} curves" if self.curves else ""
        return f"Landmarks({len(self)} pairs{f': {named}' if named else ''}{also})"

    def renumbered(self, target: Renumbering, source: Renumbering) -> Landmarks:
        """Return the pairs with new vertex numbers; pairs with a removed vertex (-1) are dropped."""
        on_target, on_source = self.target_points.renumbered(target), self.source_points.renumbered(source)
        inside = np.flatnonzero(np.all([on_target.corners >= 0, on_source.corners >= 0], axis=(0, 2)))
        numbered = [pair.renumbered(target, source) for pair in self.curves]
        curves = tuple(pair for pair in numbered if all((side.corners >= 0).all() for side in pair.points))
        return self._with(self.names, on_target, on_source, curves)._at(inside, inside)

    def joined_with(self, others: Landmarks) -> Landmarks:
        """Return these pairs and curves followed by others, on the same meshes."""
        target, source = (self.target_points, others.target_points), (self.source_points, others.source_points)
        joined = CagePoints.joined(target), CagePoints.joined(source)
        return self._with(self.names + others.names, *joined, self.curves + others.curves)

    def reversed(self) -> Landmarks:
        """Return the same pairs with target and source exchanged."""
        curves = tuple(pair.reversed() for pair in self.curves)
        return Landmarks.of_points(
            self.names, self.source_points, self.target_points, self.source_name, self.target_name, curves
        )

    def new_since(self, before: Landmarks) -> IndexArray:
        """Indices of the pairs that are not in ``before``; names are ignored."""
        known = set(before.places)
        return np.array([i for i, pair in enumerate(self.places) if pair not in known], dtype=np.int64)

    @property
    def places(self) -> list[tuple[bytes, bytes]]:
        """Keys of the two points of each pair; names are ignored."""
        return list(zip(self.target_points.keys, self.source_points.keys, strict=True))

    def exchanged(self, places: Collection[tuple[int, int]]) -> Landmarks:
        """Pair target point i with source point j for every (i, j), under the name of i."""
        target, source = (np.array([place[side] for place in places], dtype=np.int64) for side in (0, 1))
        return self._at(target, source)

    def without(self, left_out: Collection[int]) -> Landmarks:
        """Return all pairs except those at the given indices."""
        kept = np.setdiff1d(np.arange(len(self)), list(left_out))
        return self._at(kept, kept)

    def _at(self, target: IndexArray, source: IndexArray) -> Landmarks:
        """Pair the target points of rows ``target`` with the source points of rows ``source``; target names stay."""
        names = tuple(self.names[i] for i in target.tolist())
        return self._with(names, self.target_points.at(target), self.source_points.at(source), self.curves)

    def _with(
        self, names: tuple[str, ...], target: CagePoints, source: CagePoints, curves: CageCurvePairs
    ) -> Landmarks:
        """Other pairs and curves on the same meshes."""
        return Landmarks.of_points(names, target, source, self.target_name, self.source_name, curves)


def _composed(points: NamedPoints) -> NamedPoints:
    """Points and curves with composed accents in their names; macOS writes decomposed ones."""
    curves = tuple(replace(curve, name=normalize("NFC", curve.name)) for curve in points.curves)
    return replace(points, names=tuple(normalize("NFC", name) for name in points.names), curves=curves)


def pair_by_name(
    target_points: NamedPoints, source_points: NamedPoints, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Pair points and curves of two meshes by name; also notes on names of one side only.

    DirectionError if a file of points names the other mesh; InvalidLandmarksError if no name is on both sides.
    """
    target_points, source_points = _composed(target_points), _composed(source_points)
    for points, mesh, other_mesh in ((target_points, target, source), (source_points, source, target)):
        stated_name, own_name, other_name = (
            PurePath(normalize("NFC", name)).stem.casefold() for name in (points.mesh_name, mesh.name, other_mesh.name)
        )
        if stated_name == other_name != own_name:
            raise DirectionError(
                f"landmark points: expected those of {mesh.name}, got a file that says it is of {points.mesh_name}, "
                "the other mesh. Exchange the two files of points, or target and source."
            )
    names = target_points.names, source_points.names
    shared, notes = shared_names(*names, what="points", noted="landmarks")
    places = [{name: i for i, name in enumerate(points.names)} for points in (target_points, source_points)]
    on_target, on_source = (
        on_cage(points, mesh).at(np.array([place[name] for name in shared], dtype=np.int64))
        for points, place, mesh in zip((target_points, source_points), places, (target, source), strict=True)
    )
    curves, curve_notes = paired_curves(target_points, source_points, target, source)
    if all(names) and not shared and not curves:
        raise InvalidLandmarksError(
            f"landmark points: expected names that both sides have, got {first_few(names[0])} on the target and "
            f"{first_few(names[1])} on the source. Rename them so that those of the same place are called alike."
        )
    landmarks = Landmarks.of_points(shared, on_target, on_source, target.name, source.name, curves)
    return landmarks, notes + curve_notes


def check_landmarks(landmarks: Landmarks, target: ControlMesh, source: ControlMesh) -> None:
    """Raise InvalidLandmarksError, listing all faults, unless the landmarks fit the two meshes."""
    count = len(landmarks.names)
    if landmarks.target.shape != (count,) or landmarks.source.shape != (count,):
        raise InvalidLandmarksError(
            f"landmarks: expected one target and one source vertex for each of {count} names, got arrays of shape "
            f"{landmarks.target.shape} and {landmarks.source.shape}. Give one of each per pair."
        )
    faults = [repeated_fault(landmarks.names, "name")]
    sides = (("target", landmarks.target_points, target), ("source", landmarks.source_points, source))
    for side, points, mesh in sides:
        faults.append(outside_fault(points, landmarks.names, mesh, f"{side} vertices"))
        vertices = points.vertices
        at_vertices = np.flatnonzero(vertices >= 0)
        repeated = at_vertices[find_repeats(vertices[at_vertices])]
        if len(repeated):
            pairs = first_few(f"{landmarks.names[i]} ({vertices[i]})" for i in repeated)
            faults.append(
                f"expected every {side} vertex in one pair only, got these again: {pairs}. Remove one of each."
            )
    faults = [fault for fault in (*faults, *curve_faults(landmarks.curves, target, source)) if fault]
    if faults:
        made_for = landmarks.target_name, landmarks.source_name
        intended = f", which were made for {made_for[0]} and {made_for[1]}" if all(made_for) else ""
        intended = "" if made_for == (target.name, source.name) else intended
        raise InvalidLandmarksError(
            f"landmarks for target {target.name} and source {source.name}{intended}:{list_problems(faults)}"
        )
