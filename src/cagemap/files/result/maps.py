"""Point maps in files, read from and written for other programs; maps of all levels in a RESULT folder.

Vertex numbers count from 0, except in ``.vts``, where they count from 1 by convention.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_path
from cagemap.files.npz import Archive, ArraySpec, lie_in_triangles, read_npy, read_npz, write_npy, write_npz
from cagemap.files.ownership import mark
from cagemap.files.schema import LevelMapRecord
from cagemap.files.text import read_text, require_file, require_suffix
from cagemap.maps.functional_maps import LevelMap
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import Surface
from cagemap.subdivision import Refinement, level_triangles
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

SUFFIXES = (".npy", ".npz", ".mtx", ".vts")
# Entry of an archive with triangles: number of vertices of the source that they belong to.
SOURCE_SIZE = "source_size"
_REMEDY = "Write it again."
# Limit for dense matrices, 0.5 GB: 7000 vertices a side. Most entries are zeros; the sparse form omits them.
DENSE_ENTRIES = 1 << 26
_PIECE = 1 << 24
# Comments and blank lines above the size of a matrix.
_COMMENTS = re.compile(r"(?:[ \t\r]*(?:%[^\n]*)?\n)*")


def read_images(path: str | Path, source: TriangleSurface) -> SurfacePoints:
    """Read the images of target vertices on a source.

    - ``.npy``, ``.vts`` (text): the number of a source vertex for each.
    - ``.npz``: ``triangle`` and ``barycentric``, or a sparse matrix as SciPy writes it.
    - ``.mtx`` (Matrix Market): a matrix, each row the weights of the corners of one source triangle; its dense form
      (``array``) up to `DENSE_ENTRIES`.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    require_suffix(file, SUFFIXES, "a map", "Write it in one of these.")
    require_file(file, "a point map")
    if suffix == ".npy":
        return SurfacePoints.from_vertices(source, _vertices(file, read_npy(file.read_bytes(), file, _REMEDY)))
    if suffix == ".vts":
        words = read_text(file, "vertex numbers").split()
        try:
            numbers = np.array(words, dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise FormatError(f"{file}: expected one vertex number a line, counted from 1, found {error}") from error
        return SurfacePoints.from_vertices(source, _vertices(file, numbers) - 1)
    if suffix == ".mtx":
        return SurfacePoints.from_matrix(source, _matrix_market(file))
    arrays = read_npz(file, _REMEDY)
    if {"triangle", "barycentric"} <= set(arrays):
        n = _last(arrays.get(SOURCE_SIZE))
        if n not in (None, source.n):
            raise FormatError(
                f"{file}: expected triangles of a source with {source.n} vertices, those of the file are of one with "
                f"{n}. Give the level that has them, or write the map as .npy: vertices are the same on all levels."
            )
        return SurfacePoints(source, _vertices(file, arrays["triangle"]), arrays["barycentric"])
    if {"indices", "indptr", "data", "shape"} <= set(arrays):
        try:
            matrix: Any = sparse.load_npz(file)
            matrix.check_format()  # SciPy crashes natively on indices out of range
        except ValueError as error:
            raise FormatError(f"{file}: expected a sparse matrix, found an error ({error}). {_REMEDY}") from error
        return SurfacePoints.from_matrix(source, sparse.csr_array(matrix))
    raise FormatError(
        f"{file}: expected 'triangle' and 'barycentric', or a sparse matrix written by SciPy, found {', '.join(arrays)}"
    )


def source_level(path: str | Path, source: Refinement) -> int | None:
    """The source's level, from 1, of a map in a file; None for maps to vertices, which all levels share.

    It is the level with as many vertices as the file states, or as the matrix has columns; otherwise the coarsest level
    with all triangles of the map.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in (".npz", ".mtx") or not file.is_file():
        return None
    levels = range(1, source.finest_level + 1)
    arrays = {} if suffix == ".mtx" else read_npz(file, _REMEDY)
    numbers, n = arrays.get("triangle"), _last(arrays.get(SOURCE_SIZE))
    if n is None and numbers is not None and numbers.dtype.kind in "iu" and numbers.size:
        return next((level for level in levels if numbers.max() < len(level_triangles(source, level))), None)
    if numbers is None:
        n = _columns(file) if suffix == ".mtx" else _last(arrays.get("shape"))
    return next((level for level in levels if source.levels[level].n_vertices == n), None)


def _last(numbers: NDArray[np.generic] | None) -> int | None:
    """The last of an array of whole numbers; None if it is empty or absent."""
    if numbers is None or not numbers.size or numbers.dtype.kind not in "iu":
        return None
    return int(np.ravel(numbers)[-1])


def _columns(file: Path) -> int | None:
    """Number of columns in the header of a Matrix Market file; its entries are not read."""
    words = _size_line(read_text(file, "a sparse matrix").partition("\n")[2])[0].split()
    return int(words[1]) if len(words) > 1 and re.fullmatch("[0-9]{1,18}", words[1]) else None


def _matrix_market(file: Path) -> sparse.csr_array:
    """A matrix of Matrix Market's coordinate or array form; SciPy's reader crashes natively on damaged files."""
    head, _, rest = read_text(file, "a sparse matrix").partition("\n")
    words = head.lower().split()
    if words[1:] in (["matrix", "array", "real", "general"], ["matrix", "array", "integer", "general"]):
        return _dense(file, rest)
    lines = [line for line in rest.splitlines() if line.strip() and not line.startswith("%")]
    form = "expected a sparse matrix (Matrix Market: matrix coordinate real general)"
    if (
        words[:3] != ["%%matrixmarket", "matrix", "coordinate"]
        or words[3:4] not in (["real"], ["integer"], ["pattern"])
        or words[4:] not in (["general"], ["symmetric"])
    ):
        raise FormatError(f"{file}: {form}, found the first line {head[:80]!r}. {_REMEDY}")
    try:
        n, m, count = (int(word) for word in (lines or [""])[0].split())
        table = np.array([line.split() for line in lines[1:]], dtype=np.float64)
        if words[3] == "pattern":
            table = np.column_stack([table, np.ones(len(table))])
        numbers = table[:, :2]
        inside = (numbers == np.floor(numbers)) & (numbers >= 1) & (numbers <= [n, m])
        if table.shape != (count, 3) or not inside.all() or not np.isfinite(table).all():
            raise ValueError(f"not {count} entries in {n} x {m}")
        i, j = numbers.astype(np.int64).T - 1
        values = table[:, 2]
        if words[4] == "symmetric":
            off = i != j
            i, j, values = np.append(i, j[off]), np.append(j, i[off]), np.append(values, values[off])
        return sparse.csr_array((values, (i, j)), shape=(n, m))
    except (ValueError, IndexError, OverflowError) as error:
        raise FormatError(f"{file}: {form}, found {error}. {_REMEDY}") from error


def _dense(file: Path, text: str) -> sparse.csr_array:
    """A matrix from the text below the first line of Matrix Market's array form: size, then numbers by columns."""
    form = "expected a dense matrix (Matrix Market: its size, then one number a line, column by column)"
    size, end = _size_line(text)
    try:
        n, m = (int(word) for word in size.split())
        if min(n, m) < 1:
            raise ValueError(f"a size of {n} x {m}")
    except ValueError as error:
        raise FormatError(f"{file}: {form}, found {error}. {_REMEDY}") from error
    if n * m > DENSE_ENTRIES:
        raise FormatError(
            f"{file}: expected at most {DENSE_ENTRIES} numbers of a dense matrix, found {n} x {m}. Write it in the "
            "coordinate form (scipy.io.mmwrite of a sparse matrix), which leaves the zeros out."
        )
    numbers, known = np.empty(n * m), 0
    try:
        while end < len(text):  # in pieces, since all words at once take much memory
            start, end = end, _line_end(text, end + _PIECE)
            values = np.array(text[start:end].split(), dtype=np.float64)
            if known + len(values) > n * m:
                raise ValueError(f"more than {n} x {m} numbers")
            numbers[known : known + len(values)] = values
            known += len(values)
    except ValueError as error:
        raise FormatError(f"{file}: {form}, found {error}. {_REMEDY}") from error
    if known != n * m or not np.isfinite(numbers).all():
        raise FormatError(f"{file}: {form}, found not {n} x {m} finite numbers. {_REMEDY}")
    return sparse.csr_array(numbers.reshape(m, n).T)


def _size_line(text: str) -> tuple[str, int]:
    """The first line after comments and blank lines, and its end."""
    comments = _COMMENTS.match(text)
    start = 0 if comments is None else comments.end()
    end = _line_end(text, start)
    return text[start:end], end


def _line_end(text: str, start: int) -> int:
    end = text.find("\n", start)
    return len(text) if end < 0 else end


def _vertices(file: Path, numbers: NDArray[np.generic]) -> NDArray[np.int64]:
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or len(numbers) == 0:
        raise FormatError(
            f"{file}: expected a list of whole numbers, one for each target vertex, found {numbers.dtype} of shape "
            f"{numbers.shape}"
        )
    return numbers.astype(np.int64)


def dense_map(images: SurfacePoints, target: Refinement, surface: TriangleSurface) -> PointMap:
    """A map of the target's finest vertices, from images of its vertices at any level.

    Images of a coarser level are refined like the surface, and projected to the source.
    """
    sizes = [level.n_vertices for level in target.levels]
    if len(images) == sizes[-1]:
        return PointMap(surface, images)
    if len(images) not in sizes:
        raise FormatError(
            f"map: expected a point for each vertex of the target at some level ({', '.join(map(str, sizes))}), got "
            f"{len(images)}; is it the map from source to target, or one of other meshes?"
        )
    level = sizes.index(len(images))
    places = target.prolong(images.positions, level, target.finest_level)
    fine = SurfacePoints.nearest(images.surface, places)
    known = np.arange(len(images))
    return PointMap(surface, fine.replaced(known, images))


def write_map(path: str | Path, point_map: PointMap, *, force: bool = False) -> None:
    """Write a map in a format of `read_images`, by suffix; ``.npy`` and ``.vts`` have the nearest corners."""
    file = Path(path)
    suffix = file.suffix.lower()
    require_suffix(file, SUFFIXES)
    nearest = point_map.images.corners[np.arange(point_map.target.n), point_map.barycentric.argmax(axis=1)]
    with atomic_path(file, force=force) as temporary:
        if suffix == ".npy":
            write_npy(temporary, nearest)
        elif suffix == ".vts":
            temporary.write_text("\n".join(map(str, (nearest + 1).tolist())) + "\n", encoding="utf-8")
        elif suffix == ".mtx":
            from scipy import io  # here, since few commands write such files

            with temporary.open("wb") as stream:  # given a name, SciPy reports no error on a full disk
                io.mmwrite(stream, sparse.coo_array(point_map.to_sparse()), comment=mark())
        else:
            source = np.array(point_map.source.n)
            write_npz(
                temporary, {"triangle": point_map.triangle, "barycentric": point_map.barycentric, SOURCE_SIZE: source}
            )


def stored_levels(result: MatchResult) -> tuple[LevelMap, ...]:
    """The level maps that a folder stores; none if a side is a plain mesh, whose coarse levels are not stored."""
    if result.target.refinement.is_plain or result.source.refinement.is_plain or not result.has_spectral:
        return ()
    if any(level_map.points is None for level_map in result.level_maps):
        return ()
    return result.level_maps


def level_arrays(result: MatchResult) -> dict[str, NDArray[Any]]:
    """Arrays of the stored level maps: vertex matches; except for the last, also functional and point maps."""
    arrays: dict[str, NDArray[Any]] = {}
    maps = stored_levels(result)
    for i, level_map in enumerate(maps):
        arrays[f"level_{i}_match"] = level_map.match
        if level_map is not maps[-1] and level_map.points is not None:
            arrays[f"level_{i}_functional_map"] = level_map.functional_map
            arrays[f"level_{i}_triangle"] = level_map.points.triangle
            arrays[f"level_{i}_barycentric"] = level_map.points.barycentric
    return arrays


def read_level_maps(
    archive: Archive,
    entries: list[LevelMapRecord],
    surfaces: tuple[Surface, Surface],
    point_map: PointMap,
    functional_map: FloatArray | None,
) -> tuple[LevelMap, ...]:
    """The level maps that `level_arrays` wrote; the last is the result's own map."""
    if functional_map is None or not entries:
        return ()
    target, source = surfaces
    levels = [(entry.target, entry.source) for entry in entries]
    finest = target.refinement.finest_level, source.refinement.finest_level
    if levels[-1] != finest or any(
        target_level > finest[0] or source_level > finest[1] for target_level, source_level in levels
    ):
        archive.refuse(f"expected levels of maps that end at {finest}, the manifest has {levels}")
    maps = []
    for i, entry in enumerate(entries):
        last = i == len(entries) - 1
        sides = target.triangles(entry.target), source.triangles(entry.source)
        specs = {f"level_{i}_match": ArraySpec(("n1",), below="n2")}
        if not last:
            specs |= {
                f"level_{i}_functional_map": ArraySpec((f"k1_{i}", f"k2_{i}")),
                f"level_{i}_triangle": ArraySpec(("n1",), below="t2"),
                f"level_{i}_barycentric": ArraySpec(("n1", 3)),
            }
        sizes = {"n1": sides[0].n, "n2": sides[1].n, "t2": len(sides[1].triangles)}
        arrays = archive.take(specs, sizes)
        points, c = point_map, functional_map
        if not last:
            c = arrays[f"level_{i}_functional_map"]
            places = arrays[f"level_{i}_triangle"], arrays[f"level_{i}_barycentric"]
            if not lie_in_triangles(places[1]):
                archive.refuse(f"level_{i}_barycentric lie outside their triangles")
            points = PointMap.from_arrays(*sides, *places)
        maps.append(LevelMap((entry.target, entry.source), c, arrays[f"level_{i}_match"], points))
    return tuple(maps)
