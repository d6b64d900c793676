"""Colours in mesh files: fractions or bytes, ZBrush's polypaint, diffuse colours in .mtl files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.text import at_line, read_text
from cagemap.numerics.arrays import FloatArray

_BYTE = 255.0
# Colours above this are bytes: light is never so many times as bright as white, and bytes below are nearly black.
_BRIGHTEST = 16.0


def to_unit_range(colors: FloatArray, largest: float | None = None) -> FloatArray:
    """Colours scaled so that 1 is full intensity.

    ``colors``: (n, 3), NaN at vertices without a colour.
    ``largest``: the value of full intensity, if the file states it. Otherwise colours are taken for bytes if they are
        whole numbers above 1, or far above 1 (means of bytes).
    """
    known = colors[np.isfinite(colors)]
    if largest is None:
        brightest = known.max(initial=0.0)
        bytes_ = brightest > _BRIGHTEST or bool(brightest > 1.0 and np.all(known == np.rint(known)))
        largest = _BYTE if bytes_ else 1.0
    return colors / largest


KEYWORD = "#MRGB"
_VALUE = 4  # bytes: mask, red, green, blue


def read_polypaint(lines: Sequence[str], n_vertices: int, fail: Callable[[int, str], FormatError]) -> FloatArray | None:
    """Colours (n, 3) from 0 to 1 of ZBrush's lines ``#MRGB``; None without such lines.

    ``lines``: all lines that begin with `KEYWORD`, with up to 64 values MMRRGGBB each.
    ``fail``: makes the error for line number i of ``lines``, given what was expected.
    """
    if not lines:
        return None
    values = []
    for number, line in enumerate(lines):
        try:
            row = bytes.fromhex(line[len(KEYWORD) :])
        except ValueError:
            row = b"?"
        if len(row) % _VALUE:
            raise fail(number, f"{KEYWORD} and eight hexadecimal digits for each vertex")
        values.append(row)
    colors = np.frombuffer(b"".join(values), dtype=np.uint8).reshape(-1, _VALUE)[:, 1:]
    if len(colors) != n_vertices:
        raise fail(len(lines) - 1, f"{KEYWORD} values of all {n_vertices} vertices, there are {len(colors)}")
    return np.asarray(colors / 255.0)


NO_IMAGES: Mapping[str, str] = MappingProxyType({})
Color = tuple[float, float, float]
_UNKNOWN: Color = (float("nan"), float("nan"), float("nan"))


def read_material_colors(path: Path) -> dict[str, Color]:
    """Diffuse colour of every material of a ``.mtl`` file; NaN without one in RGB."""
    colors: dict[str, Color] = {}
    for name, number, line in material_lines(path):
        keyword, _, rest = line.partition(" ")
        colors.setdefault(name, _UNKNOWN)
        if keyword == "Kd":
            colors[name] = _parse_color(path, number, line, rest.partition("#")[0].split())
    return colors


def material_lines(path: Path) -> Iterator[tuple[str, int, str]]:
    """Name of the material, number from 1 and text of every line from the first ``newmtl`` of a ``.mtl`` file on."""
    name = None
    for number, line in enumerate(read_text(path, "a material file").split("\n"), start=1):
        line = line.strip().replace("\t", " ")
        keyword, _, rest = line.partition(" ")
        name = rest.strip() if keyword == "newmtl" else name
        if name is not None:
            yield name, number, line


def _parse_color(path: Path, number: int, line: str, fields: list[str]) -> Color:
    if fields and fields[0] in ("spectral", "xyz"):
        return _UNKNOWN
    try:
        values = [float(field) for field in fields[:3]]
    except ValueError:
        values = []
    if len(values) == 1:  # a single number is grey
        values *= 3
    if len(values) != 3 or not np.isfinite(values).all():
        raise FormatError(at_line(path, number, "'Kd' and three finite numbers", line, "Export the materials again."))
    return values[0], values[1], values[2]


# Statements of a material that name an image, without their prefix ``map_``.
_IMAGE_STATEMENTS = ("bump", "disp", "decal", "norm", "refl")


def read_material_statements(path: Path) -> dict[str, list[str]]:
    """Statements of every material of a ``.mtl`` file, without its images and comments."""
    statements: dict[str, list[str]] = {}
    for name, _, line in material_lines(path):
        keyword = line.partition(" ")[0]
        if keyword == "newmtl":
            statements[name] = []
        elif keyword and not keyword.startswith(("#", "map_")) and keyword not in _IMAGE_STATEMENTS:
            statements[name].append(line)
    return statements


def write_materials(
    path: Path, statements: Mapping[str, Sequence[str]], images: Mapping[str, str] = NO_IMAGES, *, force: bool = False
) -> None:
    """Write a ``.mtl`` file.

    ``statements``: of every material, by name.
    ``images``: of all materials, by statement (``map_Kd``); white is multiplied by a colour image.
    """
    lines = [f"# {mark()}"]
    for name, kept in statements.items():
        if name or kept or images:
            lines.append(f"newmtl {name}")
        if "map_Kd" in images:
            kept = ["Kd 1.0 1.0 1.0", *(statement for statement in kept if statement.split()[0] != "Kd")]
        lines += [*kept, *(f"{statement} {image}" for statement, image in images.items())]
    write_whole(path, "\n".join([*lines, ""]), force=force)
