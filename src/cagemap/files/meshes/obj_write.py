"""Writer of Wavefront OBJ: a mesh, or a copy of a file with new UVs or positions."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import all_or_nothing, require_replaceable, write_whole
from cagemap.files.meshes.colors import NO_IMAGES, read_material_statements, write_materials
from cagemap.files.meshes.obj import MATERIAL_FILE_LINE, material_files, read_obj
from cagemap.files.meshes.obj_tags import format_tags
from cagemap.files.ownership import mark
from cagemap.files.text import check_writable_name, make_distinct, read_text
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray

# Material of faces without one, where an image is bound.
_UNNAMED = "baked"


def write_obj(
    path: str | Path,
    mesh: ControlMesh,
    images: Mapping[str, str] = NO_IMAGES,
    *,
    like: str | Path | None = None,
    force: bool = False,
) -> None:
    """Write a mesh as OBJ, with a ``.mtl`` of the same stem if it has materials.

    Numbers have as many digits as are needed to read the same float64 back.

    ``images``: of all materials, see `write_materials`; a mesh without materials gets one.
    ``like``: OBJ file with the mesh's materials; its ``.mtl`` files, with their images, are named instead.
    """
    file = Path(path)
    names = mesh.material_names
    if images and mesh.face_materials is None:
        mesh, names = replace(mesh, face_materials=np.zeros(mesh.n_faces, np.int64)), ("",)
    names = tuple(name or _UNNAMED for name in names) if images else names
    mesh = replace(mesh, material_names=make_distinct(names))
    for name in (*mesh.material_names, *mesh.object_names, *mesh.group_names):
        check_writable_name(name)
    library, has_materials = file.with_suffix(".mtl"), mesh.face_materials is not None
    named = _libraries_of(like, file.parent) if has_materials else ""
    is_own = has_materials and not named
    for written in [library, file] if is_own else [file]:
        require_replaceable(written, force=force)
    uvs = "" if mesh.uvs is None else _format_lines("vt %r %r\n", mesh.uvs)
    head = [f"# {mark()}\n", f"mtllib {library.name}\n" if is_own else named]
    parts = [*head, _format_vertices(mesh), uvs, *_format_faces(mesh), format_tags(mesh)]
    with all_or_nothing():
        if is_own:
            colors = np.full((len(names), 3), np.nan) if mesh.material_colors is None else mesh.material_colors
            statements = {  # a mesh whose materials were removed may have more colours than names
                name: ["Kd {!r} {!r} {!r}".format(*color.tolist())] if np.isfinite(color).all() else []
                for name, color in zip(mesh.material_names, colors[: len(names)], strict=True)
            }
            write_materials(library, statements, images, force=force)
        write_whole(file, "".join(parts), force=force)


def obj_files(path: Path, mesh: ControlMesh, like: str | Path | None = None) -> list[Path]:
    """Files that `write_obj` writes for a mesh."""
    is_own = mesh.face_materials is not None and not _libraries_of(like, path.parent)
    return [path.with_suffix(".mtl"), path] if is_own else [path]


def _libraries_of(file: str | Path | None, folder: Path) -> str:
    """``mtllib`` lines for a copy of a file in a folder; '' unless it is an OBJ file whose material files exist."""
    if file is None or Path(file).suffix.lower() != ".obj" or not Path(file).is_file():
        return ""
    return _libraries(read_text(Path(file), "an OBJ file"), Path(file), folder)


def _format_lines(pattern: str, table: FloatArray) -> str:
    return (pattern * len(table)) % tuple(np.asarray(table, dtype=np.float64).ravel().tolist())


def _format_vertices(mesh: ControlMesh) -> str:
    if mesh.vertex_colors is None:
        return _format_lines("v %r %r %r\n", mesh.positions)
    colored = np.asarray(np.isfinite(mesh.vertex_colors).all(axis=1))
    if colored.all():
        return _format_lines("v %r %r %r %r %r %r\n", np.column_stack([mesh.positions, mesh.vertex_colors]))
    rows = zip(mesh.positions.tolist(), mesh.vertex_colors.tolist(), colored.tolist(), strict=True)
    lines = (position + color if known else position for position, color, known in rows)
    return "".join("v " + " ".join(map(repr, line)) + "\n" for line in lines)


def _format_faces(mesh: ControlMesh) -> list[str]:
    """Lines of the faces in order, with ``o``, ``g`` or ``usemtl`` wherever the name changes."""
    indices = mesh.face_indices[:, None] + 1
    corner = " %d"
    if mesh.uv_indices is not None:
        indices = np.column_stack([indices, mesh.uv_indices + 1])
        corner = " %d/%d"
    named = [
        ("o", mesh.face_objects, mesh.object_names),
        ("g", mesh.face_groups, mesh.group_names),
        ("usemtl", mesh.face_materials, mesh.material_names),
    ]
    labels = [(keyword, numbers, names) for keyword, numbers, names in named if numbers is not None and mesh.n_faces]
    changes = [np.flatnonzero(np.diff(numbers)) + 1 for _, numbers, _ in labels]
    runs = np.unique(np.concatenate([[0, mesh.n_faces], *changes])).astype(np.int64)
    patterns = {size: "f" + corner * size + "\n" for size in np.unique(mesh.face_sizes).tolist()}
    sizes = mesh.face_sizes.tolist()
    parts = []
    for first, last in zip(runs[:-1].tolist(), runs[1:].tolist(), strict=True):
        for keyword, numbers, names in labels:
            name = names[numbers[first]]
            changed = not first or numbers[first] != numbers[first - 1]
            # Faces before the first statement have no name.
            if changed and (first or name or len(names) == 1):
                parts.append(f"{keyword} {name}\n")
        pattern = "".join([patterns[size] for size in sizes[first:last]])
        corner_numbers = indices[mesh.face_offsets[first] : mesh.face_offsets[last]]
        parts.append(pattern % tuple(corner_numbers.ravel().tolist()))
    return parts


_UV_LINE = re.compile(r"(?m)^[ \t]*vt\b[^\n]*\n?")
# A position may continue on the next line; the text after its three numbers is kept.
_POSITION_LINE = re.compile(r"(?m)^[ \t]*v(?:(?:[ \t]|\\[ \t]*\n)+[^\s\\]+){3}([^\n]*)")
_NORMAL_LINE = re.compile(r"(?m)^[ \t]*vn\b[^\n]*\n?")
_WITH_NORMAL = re.compile(r"(-?\d+)(?:(/-?\d+)/|//)-?\d+")
_FACE = re.compile(r"(?m)^[ \t]*fo?[ \t](?:\\[ \t]*\n|[^\n])*")
_MATERIAL = re.compile(r"(?m)^[ \t]*usemtl[ \t]+([^\n]*)")
_OLD_MARK = re.compile(r"(?m)^# written by cagemap [^\n]*\n")


def write_obj_layout(
    path: str | Path, original: str | Path, laid_out: ControlMesh, images: Mapping[str, str], *, force: bool = False
) -> None:
    """Write a copy of an OBJ file with the texture coordinates of ``laid_out``, and a ``.mtl`` of the same stem.

    Groups, objects, normals, names, comments and the numbering of vertices and faces are kept. Materials keep their
    names and statements; images of the old layout are left out.

    ``original``: the file that ``laid_out`` was read from.
    ``laid_out``: the mesh with texture coordinates.
    ``images``: of all materials, see `write_materials`.
    """
    file, kept = Path(path), Path(original)
    if laid_out.uvs is None or laid_out.uv_indices is None:
        raise FormatError(
            f"{laid_out.name}: expected texture coordinates to write to {file}, the mesh has none. `unwrap` makes them."
        )
    library_file = file.with_suffix(".mtl")
    for written in (library_file, file):
        require_replaceable(written, force=force)
    known = read_obj(kept)
    if known.face_indices.tolist() != laid_out.face_indices.tolist() or len(known.face_offsets) != len(
        laid_out.face_offsets
    ):
        raise FormatError(f"{kept}: expected the faces of {laid_out.name}, found others. Match the meshes again.")
    text = _UV_LINE.sub("", _OLD_MARK.sub("", read_text(kept, "an OBJ file")))
    statements: dict[str, list[str]] = {}
    for library in material_files(kept, text):
        statements = read_material_statements(library) | statements
    text = MATERIAL_FILE_LINE.sub("", text)
    first = _FACE.search(text)
    assert first is not None  # the mesh has faces
    used = [name.strip() for name in _MATERIAL.findall(text)]
    head = text[: first.start()]
    if not _MATERIAL.search(head):
        used, head = [_UNNAMED, *used], f"{head}usemtl {_UNNAMED}\n"
    uvs = _format_lines("vt %r %r\n", laid_out.uvs)
    numbers = iter((laid_out.uv_indices + 1).tolist())
    faces = _FACE.sub(lambda found: _renumber_texture_vertices(found[0], numbers), text[first.start() :])
    with all_or_nothing():
        write_materials(library_file, {name: statements.get(name, []) for name in used}, images, force=force)
        write_whole(file, f"# {mark()}\nmtllib {library_file.name}\n{head}{uvs}{faces}", force=force)


def write_obj_positions(path: str | Path, original: str | Path, moved: ControlMesh, *, force: bool = False) -> None:
    """Write a copy of an OBJ file with the positions of ``moved``.

    Groups, objects, texture coordinates, materials, creases, comments and the numbering of vertices and faces are kept,
    also the text after a position (a colour). Normals are removed, since they are those of the old shape.

    ``original``: the file that ``moved`` was read from.
    """
    file, kept = Path(path), Path(original)
    known = read_obj(kept)
    if known.face_indices.tolist() != moved.face_indices.tolist() or len(known.positions) != len(moved.positions):
        raise FormatError(f"{kept}: expected the vertices and faces of {moved.name}, found others. Match again.")
    text = _OLD_MARK.sub("", read_text(kept, "an OBJ file"))
    text = MATERIAL_FILE_LINE.sub(lambda found: _libraries(found[0], kept, file.parent) or found[0], text)
    positions = iter(moved.positions.tolist())
    text = _POSITION_LINE.sub(lambda found: f"v {' '.join(map(repr, next(positions)))}{found[1]}", text)
    text = _FACE.sub(lambda found: _WITH_NORMAL.sub(r"\1\2", found[0]), _NORMAL_LINE.sub("", text))
    write_whole(file, f"# {mark()}\n{text}", force=force)


def _libraries(text: str, original: Path, folder: Path) -> str:
    """``mtllib`` lines for a copy of an OBJ file in a folder: one for each material file that exists."""
    files = material_files(original.parent.resolve() / original.name, text)
    with suppress(ValueError):  # another drive
        files = [Path(os.path.relpath(file, folder.resolve())) for file in files]
    return "".join(f"mtllib {file.as_posix()}\n" for file in files)


def _renumber_texture_vertices(line: str, numbers: Iterator[int]) -> str:
    """A face statement with new texture vertices at its corners ``v/vt/vn``."""
    body, hash_mark, comment = re.sub(r"\\[ \t]*\n", " ", line).partition("#")
    keyword, *corners = body.split()
    words = []
    for corner in corners:
        vertex, *fields = corner.split("/")
        normal = f"/{fields[1]}" if len(fields) > 1 and fields[1] else ""
        words.append(f"{vertex}/{next(numbers)}{normal}")
    return " ".join([keyword, *words]) + (f" {hash_mark}{comment}" if hash_mark else "")
