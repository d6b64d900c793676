"""Values in the numbering of a mesh file, for results about a part of it or the welded mesh."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.manifest import input_file
from cagemap.files.usd.read import UsdMesh, objects_of, place_in_world, read_usd, read_usd_meshes
from cagemap.files.usd.stages import is_usd
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import place_counts, place_of_rows
from cagemap.numerics.arrays import FloatArray, IndexArray

Attributes = dict[str, NDArray[Any]]
_PLACE_WORDS = {"vertices": "vertex", "faces": "face", "corners": "face corner"}

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class FileRows:
    """Rows of a file's mesh that belong to the vertices, faces and corners of a part of it."""

    # with ``file_vertices``, ``file_faces``, and ``file_copies`` if it was welded; in any order
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
        """(k, 2) welded vertices: vertex of the part, number of a further copy in the file."""
        none = np.zeros((0, 2), dtype=np.int64)
        return none if self.part.file_copies is None else self.part.file_copies

    @property
    def corners(self) -> IndexArray:
        """(c,) number in the file of every face corner of the part, by its face and vertex."""
        first = np.arange(self.whole.n_vertices)  # first copy of each vertex
        first[self.copies[:, 1]] = self.vertices[self.copies[:, 0]]
        size = self.whole.n_vertices
        known = self.whole.corner_faces * size + first[self.whole.face_indices]
        asked = self.faces[self.part.corner_faces] * size + first[self.vertices[self.part.face_indices]]
        order = np.argsort(known, kind="stable")
        return np.asarray(order[np.searchsorted(known[order], asked)])

    def to_part(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of the whole file at the part's vertices, faces or corners; values of other sizes are unchanged.

        At welded vertices floats are averaged; of other types the first copy's value is taken.
        """
        place = place_of_rows(self.whole, len(values))
        if place == "vertices":
            return self._means(values)
        return values[self.faces if place == "faces" else self.corners] if place else values

    def _means(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values at the part's vertices, averaged over welded copies; warns if these differ."""
        of_first, (welded, further) = values[self.vertices], self.copies.T
        if not np.any(values[further] != of_first[welded]):
            return of_first
        differ = len(np.unique(welded[np.any((values[further] != of_first[welded]).reshape(len(welded), -1), axis=1)]))
        _log.warning(
            "%s: values differ at %d vertices that were welded: %s",
            *(self.part.name, differ, "averaged" if of_first.dtype.kind == "f" else "those of the first are taken"),
        )
        if of_first.dtype.kind != "f":
            return of_first
        sums, counts = of_first.astype(np.float64), np.ones(len(of_first))
        np.add.at(sums, welded, values[further])
        np.add.at(counts, welded, 1.0)
        return np.asarray(sums / counts.reshape(-1, *[1] * (values.ndim - 1)), dtype=values.dtype)

    def to_file(
        self, values: NDArray[Any], below: NDArray[Any] | None = None, place: str | None = None
    ) -> NDArray[Any]:
        """The part's values in the file's numbering; elsewhere those of ``below``, which has a row for each, or 0.

        ``place``: of the values, see `place_of_rows`; by default by their number.
        """
        place = place_of_rows(self.part, len(values)) if place is None else place
        if place not in _PLACE_WORDS:
            return values
        shape = (place_counts(self.whole)[place], *values.shape[1:])
        if below is not None and below.shape != shape:
            raise ParameterError(
                f"values outside the part: expected an array of shape {shape}, one row a "
                f"{_PLACE_WORDS[place]} of {self.whole.name}, got {below.shape}. Give the file's "
                "own values."
            )
        # Whole numbers over fractions become floats.
        filled = np.zeros(shape, values.dtype) if below is None else np.array(below, np.result_type(values, below))
        if place == "vertices":
            return self._spread(filled, values)
        filled[self.faces if place == "faces" else self.corners] = values
        return filled

    def _spread(self, found: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
        """Write values at the part's vertices into those of the file, at all copies; returns these."""
        found[self.vertices] = values
        found[self.copies[:, 1]] = values[self.copies[:, 0]]
        return found

    def placed(self, positions: FloatArray) -> FloatArray:
        """The file's positions with those of the part replaced."""
        return self._spread(np.array(self.whole.positions), positions)

    def laid_out(self, uvs: FloatArray, uv_indices: IndexArray) -> ControlMesh:
        """The file's mesh with texture coordinates of the part; its other faces keep theirs, or have (0, 0).

        They are in the part's UV set, if the file's mesh has UVs.
        """
        whole, name = self.whole, self.part.uv_name
        if whole.uvs is not None and name in {one.name for one in whole.uv_sets}:
            whole = whole.with_uv_set(name)
        others = np.zeros((1, 2)) if whole.uvs is None else whole.uvs
        every = np.zeros(len(whole.face_indices), dtype=np.int64) if whole.uv_indices is None else whole.uv_indices
        every = every + len(uvs)
        every[self.corners] = uv_indices
        return whole.with_uvs(np.vstack([uvs, others]), every)


def file_rows(folder: str | Path, result: MatchResult, side: str) -> FileRows | None:
    """Rows of a side's file; None if the result is about the whole mesh or, with a warning, the file is gone.

    For a part of one mesh among several in a USD file, rows are those of that mesh.
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
    """Rows of a given file, see `file_rows`; None without a file or for a whole mesh."""
    if path is None or control.file_vertices is None or control.file_faces is None:
        return None
    if not is_usd(path):
        return FileRows(control, read_mesh(path))
    meshes = read_usd_meshes(path)
    inside = [] if len(meshes) < 2 else objects_of(control)
    if len(inside) != 1:
        return FileRows(control, read_usd(path, mixed=True))
    return prim_rows([place_in_world(mesh) for mesh in meshes], inside[0], control)


def prim_rows(meshes: Sequence[UsdMesh], prim: str, control: ControlMesh) -> FileRows | None:
    """Rows of one mesh of a USD file; None if ``control`` is not a part of it."""
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
    """Arrays at the elements of the part; unchanged without ``rows``."""
    return {name: array if rows is None else rows.to_part(array) for name, array in values.items()}


def to_file(
    values: Mapping[str, NDArray[Any]],
    rows: FileRows | None,
    own: Mapping[str, NDArray[Any]] = MappingProxyType({}),
    places: Mapping[str, str] = MappingProxyType({}),
) -> Attributes:
    """Arrays in the file's numbering, elsewhere the file's ``own`` values or 0; unchanged without ``rows``.

    ``places``: of arrays by name, see `place_of_rows`; of others by their number of rows.
    """
    if rows is None:
        return dict(values)
    return {name: rows.to_file(array, own.get(name), places.get(name)) for name, array in values.items()}


def other_rows(control: ControlMesh, rows: FileRows | None) -> str:
    """The end of a message on which other numbers of rows are accepted: those of the whole file."""
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
