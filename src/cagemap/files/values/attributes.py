"""Values at vertices and faces in files: .npy, .npz, .csv, and vertex groups in .json."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cagemap.errors import FormatError
from cagemap.files import VALUE_SUFFIXES
from cagemap.files.atomic import atomic_path
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.gltf.read import gltf_weights
from cagemap.files.npz import read_npy, read_npz, write_npy, write_npz
from cagemap.files.ownership import mark
from cagemap.files.schema import Record, parse_json, parse_record, to_json
from cagemap.files.text import is_number, read_text, require_file, require_suffix
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.usd.read import one_mesh, place_in_world, read_usd_meshes
from cagemap.files.usd.stages import is_usd
from cagemap.files.values.part_numbering import Attributes, FileRows, prim_rows, to_part
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, as_float64


def read_attributes(path: str | Path, control: ControlMesh | None = None, rows: FileRows | None = None) -> Attributes:
    """Read named arrays with a row for each vertex, face or face corner.

    An ``.npy`` is one array, named like the file; an ``.npz`` any number. A ``.csv`` with names in its first line has
    an array in each column, one without names is a single array, named like the file. A ``.json`` has vertex groups
    (`read_groups`), each a weight for every vertex. A USD file has the primvars, skinning and blend shapes of its mesh
    (`cagemap.files.usd.prims`), a glTF file the skinning weights of its meshes. Integers stay integers; others become
    float64.

    ``control``: the mesh of the values; needed if a USD file has several.
    ``rows``: for a mesh that is a part of a file: values of the whole file are taken at the part.
    """
    file = Path(path)
    require_file(file, "a file of attributes")
    if is_usd(file):
        return _read_usd(file, control)
    if file.suffix.lower() in SCENE_SUFFIXES:
        return to_part({JOINT_WEIGHTS: gltf_weights(file)}, rows)
    if file.suffix.lower() not in VALUE_SUFFIXES:
        raise FormatError(
            f"{file}: expected values as {', '.join(VALUE_SUFFIXES)}, or in a glTF, FBX or USD file, got "
            f"{file.suffix or 'no suffix'}. Export them in one of these."
        )
    if file.suffix.lower() == ".json":
        if control is None:
            raise FormatError(f"{file}: vertex groups are not taken here. Write a .csv or .npz with a row a vertex.")
        groups = read_groups(file, control.n_vertices if rows is None else rows.whole.n_vertices)
        return to_part({name: _check(file, name, array) for name, array in groups.items()}, rows)
    try:
        if file.suffix.lower() == ".csv":
            arrays = _read_csv(file)
        elif file.suffix.lower() == ".npz":
            arrays = read_npz(file, "Write it again.")
        else:
            arrays = {file.stem: read_npy(file.read_bytes(), file, "Write it again.")}
    except FormatError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise FormatError(f"{file}: could not read it as {file.suffix}: {error}. Write it again.") from error
    if not arrays:
        raise FormatError(f"{file}: expected at least one array, found none. Write it again with its values.")
    return to_part({name: _check(file, name, array) for name, array in arrays.items()}, rows)


def _read_usd(file: Path, control: ControlMesh | None) -> Attributes:
    meshes = read_usd_meshes(file)
    # Several meshes are in world space, and so are their offsets.
    meshes = meshes if len(meshes) == 1 else tuple(place_in_world(mesh) for mesh in meshes)
    chosen = one_mesh(file, meshes, control)
    arrays = {name: _check(file, name, array) for name, array in chosen.attributes.items()}
    return to_part(arrays, None if control is None else prim_rows(meshes, chosen.path, control))


def write_attributes(path: str | Path, attributes: Mapping[str, NDArray[Any]], *, force: bool = False) -> None:
    """Write named arrays in the format given by the suffix.

    An ``.npy`` takes one array. A ``.csv`` has columns ``name``, or ``name_0``, ``name_1``, ... A ``.json`` has vertex
    groups. An ``.npy`` or ``.csv`` stores no mark of cagemap: an existing one is replaced only with ``force``.
    """
    file = Path(path)
    require_suffix(file, VALUE_SUFFIXES)
    suffix = file.suffix.lower()
    if suffix == ".npy" and len(attributes) != 1:
        raise FormatError(f"{file}: an .npy holds one array, got {sorted(attributes)}. Write an .npz.")
    if suffix == ".csv" and len({len(array) for array in attributes.values()}) != 1:
        rows = {name: len(array) for name, array in attributes.items()}
        raise FormatError(f"{file}: columns of a .csv have equally many rows, got {rows}. Write an .npz.")
    with atomic_path(file, force=force) as temporary:
        if suffix == ".npy":
            write_npy(temporary, next(iter(attributes.values())))
        elif suffix == ".npz":
            write_npz(temporary, attributes, compressed=True)
        elif suffix == ".json":
            temporary.write_text(groups_text(attributes, file), encoding="utf-8")
        else:
            _write_csv(temporary, attributes)


def _read_csv(file: Path) -> Attributes:
    with file.open(newline="", encoding="utf-8-sig") as stream:
        lines = [line for line in stream if line.strip()]
    # Names may contain other delimiters, numbers do not.
    delimiter = next((sign for sign in ";\t" if lines and sign in lines[-1]), ",")
    rows = [row for row in csv.reader(lines, delimiter=delimiter) if any(cell.strip() for cell in row)]
    if not rows:
        return {}
    names = None if is_number(rows[0][0]) else [cell.strip() for cell in rows[0]]
    if names is not None and len(set(names)) != len(names):
        raise FormatError(f"{file}: expected columns of different names, got {', '.join(names)[:80]}. Rename them.")
    if names is not None and "" in names:
        raise FormatError(
            f"{file}: expected a name for every column, got none for column {1 + names.index('')}. Name it, or leave "
            "the column out (with pandas: `index=False`)."
        )
    body = rows if names is None else rows[1:]
    for number, row in enumerate(body, 1 if names is None else 2):
        if len(row) != len(rows[0]) or not all(is_number(cell) for cell in row):
            raise FormatError(
                f"{file}: expected {len(rows[0])} numbers in row {number}, found {', '.join(row)[:80]}. Separate "
                "columns by commas, semicolons or tabs, and write decimals with a point."
            )
    columns = [_column(cells) for cells in zip(*body, strict=True)]
    if names is None:
        return {file.stem: columns[0] if len(columns) == 1 else np.column_stack(columns)}
    return dict(zip(names, columns, strict=False))


def _column(cells: tuple[str, ...]) -> NDArray[Any]:
    """Cells as integers if all are written so, else as floats."""
    try:
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    except (ValueError, OverflowError):  # also for more digits than int64 stores
        return np.array([float(cell) for cell in cells])


def _write_csv(file: Path, attributes: Mapping[str, NDArray[Any]]) -> None:
    names, columns = [], []
    for name, array in attributes.items():
        table = array.reshape(len(array), -1)
        names += [name] if array.ndim == 1 else [f"{name}_{k}" for k in range(table.shape[1])]
        columns += list(table.T)
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*(column.tolist() for column in columns), strict=True))


def _check(file: Path, name: str, array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind not in "biuf" or array.ndim not in (1, 2) or array.size == 0:
        raise FormatError(
            f"{file}: expected numbers of shape (n,) or (n, q) in '{name}', found {array.dtype} of shape {array.shape}"
        )
    if array.dtype.kind in "iub":  # labels
        if array.dtype == np.uint64 and array.max() > np.iinfo(np.int64).max:
            raise FormatError(f"{file}: expected whole numbers below 2^63 in '{name}', found {array.max()}.")
        return array.astype(np.int64)
    numbers = as_float64(array)
    bad = np.flatnonzero(~np.isfinite(numbers.reshape(len(array), -1)).all(axis=1))
    if len(bad):
        raise FormatError(
            f"{file}: expected finite numbers in '{name}', found others in rows {bad[:5].tolist()} (0-based)"
        )
    return numbers


_REMEDY = 'Expected {"groups": [{"name": "lips", "vertices": [0, 5], "weights": [1.0, 0.5]}, ...]}.'
# Smaller weights are rounding of the map's barycentric coordinates; such a vertex is not in the group.
_NOTHING = 1e-9


class GroupRecord(Record):
    """A vertex group: 0-based vertices with weights, which are 1 by default."""

    name: str
    vertices: list[Annotated[int, Field(ge=0)]]
    weights: list[float] | None = None


class GroupsRecord(Record):
    """All vertex groups of a file."""

    groups: list[GroupRecord]


def read_groups(path: Path, count: int) -> dict[str, FloatArray]:
    """Read vertex groups as weights (count,) of all vertices, 0 outside the group."""
    stated = parse_json(read_text(path, "vertex groups"), path, _REMEDY)
    weights_of: dict[str, FloatArray] = {}
    for group in parse_record(GroupsRecord, stated, path, _REMEDY).groups:
        vertices = np.array(group.vertices, dtype=np.float64)
        weights = [1.0] * len(vertices) if group.weights is None else group.weights
        if group.name in weights_of or len(weights) != len(vertices) or len(np.unique(vertices)) != len(vertices):
            raise FormatError(
                f"{path}: group {group.name}: expected a name of its own, every vertex once and a weight for each, got "
                f"{len(vertices)} vertices and {len(weights)} weights. {_REMEDY}"
            )
        if len(vertices) and vertices.max() >= count:
            raise FormatError(
                f"{path}: group {group.name}: expected vertices 0 to {count - 1}, got {vertices.max():.0f}. Is it of "
                "another mesh?"
            )
        weights_of[group.name] = np.zeros(count)
        weights_of[group.name][vertices.astype(np.int64)] = weights
    return weights_of


def groups_text(attributes: Mapping[str, NDArray[Any]], path: Path) -> str:
    """JSON text of vertex groups: the vertices of each array whose weights are not 0."""
    groups = []
    for name, array in attributes.items():
        if array.ndim != 1:
            raise FormatError(
                f"{path}: vertex groups have one weight a vertex, {name} has shape {array.shape}. Write a .npz."
            )
        inside = np.flatnonzero(np.abs(array) > _NOTHING)
        groups.append({"name": name, "vertices": inside, "weights": array[inside].astype(np.float64)})
    return to_json({"written_by": mark(), "groups": groups})
