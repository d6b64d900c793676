"""Landmarks: pairs of control vertices, one on the target and one on the source, that are the same place."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import InvalidLandmarksError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import IndexArray


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Pairs of control vertices that correspond.

    Attributes
    ----------
    names : tuple of str
        One per pair, such as ``nose_tip``.
    target, source : (q,) int64
        Control vertices of the two meshes, 0-based.
    target_name, source_name : str
        The meshes that the numbers were made for; '' where unknown.
    """

    names: tuple[str, ...]
    target: IndexArray
    source: IndexArray
    target_name: str = ""
    source_name: str = ""

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
        )

    def new_since(self, before: Landmarks) -> IndexArray:
        """Places of the pairs that were not there before, or joined other vertices."""
        known = set(zip(before.target.tolist(), before.source.tolist(), strict=True))
        now = zip(self.target.tolist(), self.source.tolist(), strict=True)
        return np.array([i for i, pair in enumerate(now) if pair not in known], dtype=np.int64)

    def without(self, left_out: Collection[int]) -> Landmarks:
        """Return the pairs whose places are not among those given."""
        kept = np.setdiff1d(np.arange(len(self)), list(left_out))
        names = tuple(self.names[i] for i in kept)
        return replace(self, names=names, target=self.target[kept], source=self.source[kept])


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
    for side, vertices, mesh in (("target", landmarks.target, target), ("source", landmarks.source, source)):
        faults += _side_faults(side, vertices, names, mesh)
    if faults:
        listed = "".join(f"\n  - {fault}" for fault in faults)
        raise InvalidLandmarksError(f"landmarks for target {target.name} and source {source.name}:{listed}")


def _side_faults(side: str, vertices: IndexArray, names: np.ndarray, mesh: ControlMesh) -> list[str]:
    faults = []
    outside = np.flatnonzero((vertices < 0) | (vertices >= mesh.n_vertices))
    if len(outside):
        pairs = first_few(f"{names[i]} ({vertices[i]})" for i in outside)
        faults.append(
            f"expected {side} vertices from 0 to {mesh.n_vertices - 1}, those of {mesh.name}, got {pairs}. Numbers are "
            "0-based; check that target and source are not exchanged and that the mesh was not renumbered."
        )
    repeated = _repeated(vertices)
    if len(repeated):
        pairs = first_few(f"{names[i]} ({vertices[i]})" for i in repeated)
        faults.append(f"expected every {side} vertex in one pair only, got these again: {pairs}. Remove one of each.")
    return faults


def _repeated(values: np.ndarray) -> IndexArray:
    """Places whose value occurred before."""
    return np.setdiff1d(np.arange(len(values)), np.unique(values, return_index=True)[1])
