"""Reader of Wavefront OBJ: polygons of any size, UV seams and material colours, in the file's order."""

from __future__ import annotations

import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.meshes.colors import KEYWORD, read_material_colors, read_polypaint, to_unit_range
from cagemap.files.meshes.obj_tags import parse_tags
from cagemap.files.text import at_line, decode_text, file_in, is_number, read_text
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.numerics.arrays import FloatArray, IndexArray, offsets_of

_log = logging.getLogger(__name__)

_KEYWORDS = {"v": 1, "vt": 2, "f": 3, "fo": 3, "usemtl": 4, "o": 5, "g": 6, "t": 7}
_POSITION, _UV, _FACE, _USE_MATERIAL, _OBJECT, _GROUP, _TAG = range(1, 8)
# It may continue on the next line.
MATERIAL_FILE_LINE = re.compile(r"(?m)^[ \t]*mtllib[ \t]((?:\\[ \t]*\n|[^\n])*)\n?")

# Classes of bytes in a face line: separators of corners, separators within a corner, parts of numbers.
_BLANK, _SLASH, _NUMBER = 1, 2, 3
_BYTE_CLASS = np.zeros(256, dtype=np.int8)
_BYTE_CLASS[[ord(" "), ord("\n")]] = _BLANK
_BYTE_CLASS[ord("/")] = _SLASH
_BYTE_CLASS[[ord(character) for character in "0123456789+-"]] = _NUMBER
_IS_DIGIT = (np.arange(256) >= ord("0")) & (np.arange(256) <= ord("9"))


@dataclass(frozen=True, eq=False)
class _Statements:
    """Statements of a file without comment lines; ``numbers`` are line numbers from 1."""

    path: Path
    lines: list[str]
    numbers: IndexArray
    kinds: NDArray[np.int8]

    def rows(self, kind: int) -> IndexArray:
        return np.flatnonzero(self.kinds == kind)

    def fail(self, row: int, expected: str, remedy: str) -> FormatError:
        return FormatError(at_line(self.path, int(self.numbers[row]), expected, self.lines[row], remedy))


def read_obj(path: str | Path) -> ControlMesh:
    """Read a control mesh from an OBJ file.

    Vertices and faces keep the numbering of the ``v`` and ``f`` lines. Polygons stay polygons; texture coordinates keep
    their own indices. ``usemtl`` gives the faces' materials, with ``Kd`` of the ``.mtl`` as colour (NaN if missing),
    ``o`` and ``g`` their objects and groups; those of one name are one. A ``v`` line of six or seven numbers has a
    position and a colour; without such lines ZBrush's polypaint gives colours. ``t`` lines are creases, corners, holes
    and options (`obj_tags`). Normals, points, lines and smoothing groups are ignored. Several objects become one mesh.
    """
    file = Path(path)
    text = read_text(file, "an OBJ file")
    statements = _split_statements(file, text)
    positions = _read_table(statements, _POSITION, "v", required=3, kept=3)
    if len(positions) == 0:
        raise FormatError(f"{file}: expected an OBJ file with 'v' lines, found none. Export the control mesh again.")
    face_rows = statements.rows(_FACE)
    if len(face_rows) == 0:
        raise FormatError(
            f"{file}: expected polygons, found {len(positions)} vertices and no 'f' line. "
            "Export the control mesh with its faces."
        )
    corners = _read_corners(statements, face_rows)
    face_indices = _resolve(statements, corners, corners.vertices, _POSITION, "vertex")
    uvs, uv_indices = _read_uvs(statements, corners)
    names, face_materials = _read_names(statements, face_rows, _USE_MATERIAL)
    objects, face_objects = _read_names(statements, face_rows, _OBJECT)
    _warn_of_equal_objects(statements, corners, face_indices, objects, face_objects)
    groups, face_groups = _read_names(statements, face_rows, _GROUP)
    tag_rows = statements.rows(_TAG)

    def fail(row: int, expected: str) -> FormatError:
        return statements.fail(int(tag_rows[row]), expected, "See the formats page of the documentation.")

    tag_lines, triangles = [statements.lines[row] for row in tag_rows], bool(np.all(corners.sizes == 3))
    tags = parse_tags(tag_lines, fail, len(positions), len(corners.sizes), triangles=triangles)
    known: dict[str, tuple[float, float, float]] = {}
    for library in material_files(file, text) if names else ():
        known = read_material_colors(library) | known  # the first file with a name wins
    unknown = (np.nan, np.nan, np.nan)
    colors = np.array([known.get(name, unknown) for name in names], dtype=np.float64) if names else None
    return ControlMesh(
        positions=positions,
        face_offsets=offsets_of(corners.sizes),
        face_indices=face_indices,
        uvs=uvs,
        uv_indices=uv_indices,
        face_materials=face_materials,
        material_names=names,
        material_colors=colors,
        vertex_colors=_read_vertex_colors(statements, len(positions)),
        face_objects=face_objects,
        object_names=objects,
        face_groups=face_groups,
        group_names=groups,
        name=file.name,
        **tags,
    )


def _split_statements(path: Path, text: str) -> _Statements:
    """Join continued lines and classify the statements by keyword."""
    text = text.replace("\t", " ")
    continuations = None
    if "\\" in text:
        # A comment that ends in a backslash (a Windows path) does not continue on the next line.
        text = re.sub(rf"(?m)^(?! *{KEYWORD})( *(?:(?:vt?|vn|fo?|l|p) [^#\n]*)?)#.*$", r"\1", text)
        text = re.sub(r"\\ *(?:\n|\Z)", "\0", text)
        continuations = np.array([line.count("\0") for line in text.split("\n")], dtype=np.int64)
        text = text.replace("\0", " ")
    lines = [line.strip() for line in text.split("\n")]
    numbers = np.arange(1, len(lines) + 1, dtype=np.int64)
    if continuations is not None:
        numbers += np.cumsum(continuations) - continuations
    kinds = np.fromiter((_KEYWORDS.get(line.partition(" ")[0], 0) for line in lines), np.int8, len(lines))
    return _Statements(path, lines, numbers, kinds)


def _read_table(statements: _Statements, kind: int, keyword: str, *, required: int, kept: int) -> FloatArray:
    """Read the first ``kept`` numbers of every line of a kind; later ones (weights, colours) are ignored."""
    rows = statements.rows(kind)
    lines = [statements.lines[row] for row in rows]
    try:
        table = np.loadtxt(lines, usecols=range(1, kept + 1), comments="#", ndmin=2) if lines else np.zeros((0, kept))
    except ValueError:
        table = np.array([_read_numbers(statements, row, keyword, required, kept) for row in rows], dtype=np.float64)
    infinite = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(infinite):
        what = "finite positions" if kind == _POSITION else "finite texture coordinates"
        remedy = f"{len(infinite)} such line(s); repair them in the modelling program and export again."
        raise statements.fail(rows[infinite[0]], what, remedy)
    return table


def _read_numbers(statements: _Statements, row: int, keyword: str, required: int, kept: int) -> list[float]:
    """Read one line of a table of unequal line lengths; raises the error if it is malformed."""
    fields = statements.lines[row].partition("#")[0].split()[1 : kept + 1]
    try:
        # Python's float also takes 1_000 and digits of other alphabets, which numpy.loadtxt refuses.
        values = [float(field) if field.isascii() and "_" not in field else float("") for field in fields]
    except ValueError:
        values = []
    if len(values) < required:
        expected = f"'{keyword}' and at least {count_noun(required, 'number')}"
        raise statements.fail(row, expected, "The file may be cut short; export it again.")
    return values + [0.0] * (kept - len(values))


@dataclass(frozen=True, eq=False)
class _Corners:
    """Corners of all faces as written: 1-based or negative numbers, 0 without a texture coordinate."""

    rows: IndexArray
    sizes: IndexArray
    vertices: IndexArray
    uvs: IndexArray
    has_uv: NDArray[np.bool_]

    @property
    def faces(self) -> IndexArray:
        return np.repeat(np.arange(len(self.sizes)), self.sizes)


def _read_corners(statements: _Statements, rows: IndexArray) -> _Corners:
    """Read the corners ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn`` of every face; a file may mix these forms."""
    # The text of all faces is one array of bytes: corners and numbers begin where the class of bytes changes.
    bodies = [statements.lines[row].partition("#")[0].partition(" ")[2] for row in rows]
    text = "\n".join(bodies) + "\n"
    data = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    kind = _BYTE_CLASS[data]
    before = np.concatenate([np.array([_BLANK], dtype=np.int8), kind[:-1]])
    line_of_byte = np.cumsum(data == ord("\n"), dtype=np.int32)

    def fail(byte: int) -> FormatError:
        # A newline counts as a byte of the line after it, but ``byte`` is never one.
        row = rows[line_of_byte[byte]]
        return statements.fail(row, "'f' and corners such as 3, 3/7, 3//2 or 3/7/2", "Export the control mesh again.")

    # Malformed are other characters, and signs that do not begin a number. `numpy.fromstring` then reads everything. It
    # limits numbers too large for int64, and no mesh has so many vertices.
    sign = (kind == _NUMBER) & ~_IS_DIGIT[data]
    malformed = np.flatnonzero((kind == 0) | (sign & ((before == _NUMBER) | ~_IS_DIGIT[np.roll(data, -1)])))
    if len(malformed):
        raise fail(malformed[0])
    begins = (kind != _BLANK) & (before == _BLANK)
    corner_starts = np.flatnonzero(begins)
    sizes = np.bincount(line_of_byte[corner_starts], minlength=len(rows)).astype(np.int64)
    if sizes.min() == 0:
        row = rows[np.argmin(sizes)]
        raise statements.fail(row, "'f' and at least three corners", "The file may be cut short; export it again.")
    number_starts = np.flatnonzero((kind == _NUMBER) & (before != _NUMBER))
    numbers = np.fromstring(text.replace("/", " "), dtype=np.int64, sep=" ")
    slashes = np.cumsum(kind == _SLASH, dtype=np.int32) - (kind == _SLASH)
    corner_of_number = np.cumsum(begins, dtype=np.int32)[number_starts] - 1
    place = slashes[number_starts] - slashes[corner_starts[corner_of_number]]
    if len(place) and place.max() > 2:
        raise fail(number_starts[np.argmax(place > 2)])
    vertices = np.zeros(len(corner_starts), dtype=np.int64)
    has_vertex = np.zeros(len(corner_starts), dtype=bool)
    uvs, has_uv = vertices.copy(), has_vertex.copy()
    vertices[corner_of_number[place == 0]] = numbers[place == 0]
    has_vertex[corner_of_number[place == 0]] = True
    uvs[corner_of_number[place == 1]] = numbers[place == 1]
    has_uv[corner_of_number[place == 1]] = True
    if not has_vertex.all():
        raise fail(corner_starts[np.argmin(has_vertex)])
    return _Corners(rows, sizes, vertices, uvs, has_uv)


def _resolve(statements: _Statements, corners: _Corners, numbers: IndexArray, kind: int, what: str) -> IndexArray:
    """0-based indices from 1-based numbers, or negative ones that count back from their line."""
    before = np.cumsum(statements.kinds == kind)
    count = int(before[-1])
    indices = np.where(numbers < 0, before[np.repeat(corners.rows, corners.sizes)] + numbers, numbers - 1)
    outside = np.flatnonzero((indices < 0) | (indices >= count))
    if len(outside):
        face = corners.faces[outside[0]]
        raise statements.fail(
            corners.rows[face],
            f"{what} numbers from 1 to {count} (this face is number {face}, 0-based, and names {numbers[outside[0]]})",
            f"{len(np.unique(corners.faces[outside]))} face(s) are affected; export the mesh again.",
        )
    return indices.astype(np.int64)


def _read_uvs(statements: _Statements, corners: _Corners) -> tuple[FloatArray | None, IndexArray | None]:
    """Read texture coordinates; faces without any get `NO_UV`, with a warning."""
    if not corners.has_uv.any():
        return None, None
    if corners.has_uv.all():
        uvs = _read_table(statements, _UV, "vt", required=1, kept=2)
        return uvs, _resolve(statements, corners, corners.uvs, _UV, "texture vertex")
    bare = np.unique(corners.faces[~corners.has_uv])
    half = np.intersect1d(bare, corners.faces[corners.has_uv])
    if len(half):
        raise FormatError(
            f"{statements.path}: expected texture coordinates at all corners of a face or at none, got "
            f"{len(half)} face(s) with some: {first_few(half)} (0-based; the first is line "
            f"{statements.numbers[corners.rows[half[0]]]}). Unwrap those faces, or export without UVs."
        )
    warn_of_bare_faces(statements.path, len(bare), len(corners.sizes))
    uvs = _read_table(statements, _UV, "vt", required=1, kept=2)
    indices = _resolve(statements, corners, np.where(corners.has_uv, corners.uvs, 1), _UV, "texture vertex")
    return np.vstack([uvs, [NO_UV]]), np.where(corners.has_uv, indices, len(uvs))


def warn_of_bare_faces(path: Path, count: int, n_faces: int) -> None:
    """Warn of faces without texture coordinates, if there are any."""
    if count:
        _log.warning("%s: %d of %d faces have no texture coordinates: no image is baked there", path, count, n_faces)


def _read_names(statements: _Statements, face_rows: IndexArray, kind: int) -> tuple[tuple[str, ...], IndexArray | None]:
    """Material, object or group of every face: the last name stated before it, '' before the first."""
    rows = statements.rows(kind)
    if len(rows) == 0:
        return (), None
    stated = ["", *(statements.lines[row].partition(" ")[2].strip() for row in rows)]
    used = np.searchsorted(rows, face_rows)
    order = np.unique(used, return_index=True)
    names = tuple(dict.fromkeys(stated[i] for i in order[0][np.argsort(order[1])]))
    number = {name: i for i, name in enumerate(names)}
    return names, np.array([number.get(name, -1) for name in stated], dtype=np.int64)[used]


def _warn_of_equal_objects(
    statements: _Statements,
    corners: _Corners,
    face_indices: IndexArray,
    names: tuple[str, ...],
    face_objects: IndexArray | None,
) -> None:
    """Warn of objects of one name without common vertices. Exporters repeat the name of one object, too."""
    blocks = np.searchsorted(statements.rows(_OBJECT), corners.rows)
    different, first = np.unique(blocks, return_index=True)
    if face_objects is None or len(different) == len(names):
        return
    for number in np.flatnonzero(np.bincount(face_objects[first]) > 1).tolist():
        of_object = (face_objects == number)[corners.faces]
        used = np.column_stack([blocks[corners.faces], face_indices])[of_object]
        if len(np.unique(used, axis=0)) == len(np.unique(used[:, 1])):
            text = "%s: %d objects are named %s and become one. Give each its own name to match or select them apart."
            _log.warning(text, statements.path, len(np.unique(used[:, 0])), names[number])


def _read_vertex_colors(statements: _Statements, n_vertices: int) -> FloatArray | None:
    """(n, 3) colours from ``v`` lines of six or seven numbers, else from polypaint; None without colours."""
    texts = [statements.lines[row] for row in statements.rows(_POSITION)]
    several = max((text.count(" ") for text in texts), default=0) >= 6
    lines = [text.partition("#")[0].split()[4:] for text in texts] if several else []
    colored = [fields for fields in lines if len(fields) in (3, 4)]
    if not colored:
        painted = [row for row, line in enumerate(statements.lines) if line.startswith(KEYWORD)]

        def fail(number: int, expected: str) -> FormatError:
            return statements.fail(painted[number], expected, "Export the mesh again, or take these lines out.")

        return read_polypaint([statements.lines[row] for row in painted], n_vertices, fail)
    unknown = [np.nan, np.nan, np.nan]
    try:
        # Of seven numbers, the last is an opacity, or the fourth the position's weight: if all of these are 1.
        fours = [[float(field) for field in fields] for fields in colored if len(fields) == 4]
        weighted = bool(fours) and all(four[0] == 1 for four in fours) and any(four[3] != 1 for four in fours)
        first = {3: 0, 4: int(weighted)}
        kept = [fields[first[len(fields)] :][:3] if len(fields) in first else None for fields in lines]
        table = [unknown if fields is None else [float(field) for field in fields] for fields in kept]
    except ValueError:
        rows = statements.rows(_POSITION)
        bad = next(i for i, fields in enumerate(lines) if len(fields) in (3, 4) and not all(map(is_number, fields)))
        raise statements.fail(
            int(rows[bad]), "'v', three coordinates and three colour values", "Export the mesh again."
        ) from None
    return to_unit_range(np.array(table, dtype=np.float64))


def material_files(path: Path, text: str) -> list[Path]:
    """Existing material files of an OBJ file: a ``mtllib`` line names one file, else one with each word."""
    files: list[Path] = []
    for whole, *words in _material_names(text):
        names = [whole] if os.path.isfile(file_in(path.parent, whole)) else words
        files += [file for file in (file_in(path.parent, name) for name in names) if os.path.isfile(file)]
    return files


def _material_names(text: str) -> list[list[str]]:
    """Possible names in each ``mtllib`` line: the whole rest of it, then each word."""
    lines = (
        re.sub(r"\\[ \t]*\n|\t", " ", line).strip().replace("\\", "/") for line in MATERIAL_FILE_LINE.findall(text)
    )
    return [[line, *line.split()] for line in lines]


def named_material_files(name: str, content: bytes) -> list[str]:
    """All names of material files that `read_obj` would search for an OBJ file of this content."""
    return [file for names in _material_names(decode_text(content, Path(name), "an OBJ file")) for file in names]
