"""OFF: vertices and polygons as text, the format of most research data sets."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.text import read_text
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray, IndexArray, offsets_of

# The prefixes mean texture coordinates, colours or normals, which MeshLab writes in its own order; in some files the
# counts follow without a space.
_FIRST_WORD = re.compile(r"(?:ST|C|N)*OFF(?=\d*\Z)", re.IGNORECASE)
_FORM = "OFF, then the numbers of vertices, faces and edges, then a line each: x y z, and 3 a b c"


def read_off(path: str | Path) -> ControlMesh:
    """Read a control mesh from an OFF file in the file's order; normals and colours are ignored."""
    file = Path(path)
    lines = read_text(file, "an OFF file").split("\n")  # `str.splitlines` splits comments at other characters too
    rows = [words for line in lines if (words := line.partition("#")[0].split())]
    first = _FIRST_WORD.match(rows[0][0]) if rows else None
    if first is None:
        raise FormatError(
            f"{file}: expected an OFF file of places in space, got another beginning. The form is {_FORM}."
        )
    same_line = [word for word in (rows[0][0][first.end() :], *rows[0][1:]) if word]
    counts = same_line or (rows[1] if len(rows) > 1 else [])
    body = rows[1:] if same_line else rows[2:]
    try:
        n, m = (int(word) for word in counts[:2])
    except ValueError:
        n, m = -1, -1
    if n < 1 or m < 1 or len(body) < n + m:
        raise FormatError(
            f"{file}: expected numbers of vertices and faces and a line for each, got counts {' '.join(counts)[:40]!r} "
            f"and {len(body)} lines. The form is {_FORM}."
        )
    positions = _positions(file, body[:n])
    sizes, indices = _faces(file, body[n : n + m])
    outside = np.flatnonzero((indices < 0) | (indices >= n))
    if len(outside):
        raise FormatError(f"{file}: expected vertices from 0 to {n - 1}, got {first_few(indices[outside])}.")
    return ControlMesh(positions, offsets_of(sizes), indices, name=file.name)


def write_off(path: str | Path, mesh: ControlMesh, *, force: bool = False) -> None:
    """Write positions and faces of a mesh; OFF stores nothing else."""
    lines = [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.positions.tolist()]
    corners = np.split(mesh.face_indices, mesh.face_offsets[1:-1])
    lines += [f"{len(face)} {' '.join(map(str, face.tolist()))}" for face in corners]
    text = "\n".join(["OFF", f"# {mark()}", f"{mesh.n_vertices} {mesh.n_faces} 0", *lines])
    write_whole(path, f"{text}\n", force=force)


def _positions(file: Path, rows: list[list[str]]) -> FloatArray:
    try:
        positions = np.array([row[:3] for row in rows], dtype=np.float64)
    except ValueError:
        positions = np.zeros((0, 0))
    if positions.shape != (len(rows), 3) or not np.isfinite(positions).all():
        raise FormatError(f"{file}: expected three finite numbers for every vertex, got something else.")
    return positions


def _faces(file: Path, rows: list[list[str]]) -> tuple[IndexArray, IndexArray]:
    """Number of corners of every face, and the vertices of all corners."""
    try:
        sizes = np.array([row[0] for row in rows], dtype=np.int64)
        lengths = np.array([len(row) for row in rows])
        if np.any(sizes < 1) or np.any(lengths < sizes + 1):
            raise ValueError
        starts = offsets_of(sizes)
        indices = np.empty(int(starts[-1]), dtype=np.int64)
        for size in np.unique(sizes):
            rows_of_size = np.flatnonzero(sizes == size)
            corners = np.array([rows[i][1 : size + 1] for i in rows_of_size], dtype=np.int64)
            indices[starts[rows_of_size][:, None] + np.arange(size)] = corners
    except (ValueError, OverflowError):
        raise FormatError(f"{file}: expected a number of corners and as many vertices for every face.") from None
    return sizes, indices
