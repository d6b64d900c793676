"""Values in the numbers of a mesh file, for a result about a part of it or about the welded mesh."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.manifest import input_file
from cagemap.files.usd.read import USD_SUFFIXES, UsdMesh, in_world, read_usd, read_usd_meshes
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

Attributes = dict[str, NDArray[Any]]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class FileRows:
    """How the rows of a file's mesh and those of a part of it go together."""

    # with ``file_vertices`` and ``file_faces``, ``file_copies`` where it was welded; its order may be another than the
    # file's
    part: ControlMesh
    whole: ControlMesh  # the file's mesh

    @property
    def vertices(self) -> IndexArray:
        """(n,) number in the file of every vertex of the part."""
        assert self.part.file_vertices is not None
        return self.part.file_vertices

    @property
    def faces(self) -> IndexArray:
        """(m,) number in the file of every face of the part."""
        assert self.part.file_faces is not None
        return self.part.file_faces

    @property
    def copies(self) -> IndexArray:
        """(k, 2) vertex of the part, and number in the file of a further vertex that it is."""
        none = np.zeros((0, 2), dtype=np.int64)
        return none if self.part.file_copies is None else self.part.file_copies

    @property
    def corners(self) -> IndexArray:
        """(c,) number in the file of every face corner of the part: that of its face at its vertex."""
        first = np.arange(self.whole.n_vertices)  # of the vertices that were welded
        first[self.copies[:, 1]] = self.vertices[self.copies[:, 0]]
        size = self.whole.n_vertices
        known = self.whole.corner_faces * size + first[self.whole.face_indices]
        asked = self.faces[self.part.corner_faces] * size + first[self.vertices[self.part.face_indices]]
        order = np.argsort(known, kind="stable")
        return np.asarray(order[np.searchsorted(known[order], asked)])

    def to_part(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values numbered as the file, at the part's vertices, faces or corners; others as they are.

        At vertices that were welded the mean, where they are numbers with fractions, else those of the first.
        """
        vertices, faces, corners = _counts(self.whole)
        if len(values) == vertices:
            return self._means(values)
        if len(values) == faces:
            return values[self.faces]
        return values[self.corners] if len(values) == corners else values

    def _means(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values at the part's vertices; what is said where those of welded vertices differ."""
        found, (own, further) = values[self.vertices], self.copies.T
        if not np.any(values[further] != found[own]):
            return found
        differ = len(np.unique(own[np.any((values[further] != found[own]).reshape(len(own), -1), axis=1)]))
        _log.warning(
            "%s: values differ at %d vertices that were welded: %s",
            *(self.part.name, differ, "averaged" if found.dtype.kind == "f" else "those of the first are taken"),
        )
        if found.dtype.kind != "f":
            return found
        sums, counts = found.astype(np.float64), np.ones(len(found))
        np.add.at(sums, own, values[further])
        np.add.at(counts, own, 1.0)
        return np.asarray(sums / counts.reshape(-1, *[1] * (values.ndim - 1)), dtype=values.dtype)

    def to_file(self, values: NDArray[Any], below: NDArray[Any] | None = None) -> NDArray[Any]:
        """The part's values, numbered as the file; elsewhere those of ``below``, or 0."""
        kinds = list(zip(_counts(self.part), _counts(self.whole), strict=True))
        kind = next((number for number, (own, _) in enumerate(kinds) if len(values) == own), None)
        if kind is None:
            return values
        shape = (kinds[kind][1], *values.shape[1:])
        fits = below is not None and below.shape == shape
        found = np.array(below, dtype=values.dtype) if fits else np.zeros(shape, dtype=values.dtype)
        if kind == 0:
            return self._spread(found, values)
        found[self.faces if kind == 1 else self.corners] = values
        return found

    def _spread(self, found: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
        """Values of the part's vertices, written into those of the file's."""
        found[self.vertices] = values
        found[self.copies[:, 1]] = values[self.copies[:, 0]]
        return found

    def placed(self, positions: FloatArray) -> FloatArray:
        """The file's positions, with those of the part replaced."""
        return self._spread(np.array(self.whole.positions), positions)


def file_rows(folder: str | Path, result: MatchResult, side: str) -> FileRows | None:
    """The rows of a side's file; None if a result is about the whole of it, or, with a warning, the file is gone.

    In a USD file with several meshes, those of the one that the part lies in.
    """
    control = (result.target if side == "target" else result.source).control
    if control.file_vertices is None:
        return None
    file = input_file(folder, result.manifest, side)
    if file is None:
        _log.warning(
            "%s: was matched %s, and is not where the match read it, or has changed: values of the %s are "
            "numbered as matched (%d vertices, %d faces), not as the file. Put it back to have them as the file.",
            *(control.name, _how(control), side, control.n_vertices, control.n_faces),
        )
    return rows_of(file, control)


def rows_of(path: Path | None, control: ControlMesh) -> FileRows | None:
    """As `file_rows`, for a file that is there, or None."""
    if path is None or control.file_vertices is None or control.file_faces is None:
        return None
    if path.suffix.lower() not in USD_SUFFIXES:
        return FileRows(control, read_mesh(path))
    meshes = read_usd_meshes(path)
    inside = [] if len(meshes) < 2 else _objects(control)
    if len(inside) != 1:
        return FileRows(control, read_usd(path, mixed=True))
    return prim_rows([in_world(mesh) for mesh in meshes], inside[0], control)


def _objects(control: ControlMesh) -> list[str]:
    """Names of the objects that a mesh has faces of."""
    numbers = [] if control.face_objects is None else np.unique(control.face_objects).tolist()
    return [control.object_names[number] for number in numbers]


def prim_rows(meshes: Sequence[UsdMesh], prim: str, control: ControlMesh) -> FileRows | None:
    """The rows of one mesh of a USD file that a control mesh is a part of; None where it is not, or all of it."""
    if control.file_vertices is None or control.file_faces is None:
        return None
    number = [mesh.path for mesh in meshes].index(prim)
    before = meshes[:number]
    vertices = control.file_vertices - sum(mesh.control.n_vertices for mesh in before)
    faces = control.file_faces - sum(mesh.control.n_faces for mesh in before)
    whole = meshes[number].control
    if vertices.min() < 0 or vertices.max() >= whole.n_vertices or faces.max() >= whole.n_faces:
        return None
    copies = control.file_copies
    if copies is not None:  # a vertex may be welded to one of another mesh
        copies = copies - np.array([0, sum(mesh.control.n_vertices for mesh in before)])
        copies = copies[(copies[:, 1] >= 0) & (copies[:, 1] < whole.n_vertices)]
    return FileRows(replace(control, file_vertices=vertices, file_faces=faces, file_copies=copies), whole)


def to_part(values: Mapping[str, NDArray[Any]], rows: FileRows | None) -> Attributes:
    """Each array at the elements of the part; as it is where there are no rows of a file."""
    return {name: array if rows is None else rows.to_part(array) for name, array in values.items()}


def to_file(
    values: Mapping[str, NDArray[Any]], rows: FileRows | None, own: Mapping[str, NDArray[Any]] | None = None
) -> Attributes:
    """Each array numbered as the file, with the file's ``own`` values elsewhere where there are such."""
    below = own or {}
    return {name: array if rows is None else rows.to_file(array, below.get(name)) for name, array in values.items()}


def other_rows(control: ControlMesh, rows: FileRows | None) -> str:
    """What else could be given, for messages: rows of the file that a mesh is a part of."""
    if rows is not None:
        return f"; or, since {control.name} was matched {_how(control)}, for each of the file's {rows.whole.n_vertices}"
    if control.file_vertices is None:
        return ""
    return (
        f"; {control.name} was matched {_how(control)}: put its file back where the match read it, to give values of "
        "all of it"
    )


def _how(control: ControlMesh) -> str:
    return "in part" if control.file_copies is None else "welded"


def _counts(mesh: ControlMesh) -> tuple[int, int, int]:
    return mesh.n_vertices, mesh.n_faces, len(mesh.face_indices)
