"""The material files beside an OBJ: of all they hold, only the diffuse colour ``Kd``, taken as linear RGB."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.text import at_line, read_text
from cagemap.numerics.arrays import FloatArray

Color = tuple[float, float, float]
_UNKNOWN: Color = (float("nan"), float("nan"), float("nan"))


def read_material_colors(path: Path) -> dict[str, Color]:
    """Diffuse colour of every material of a ``.mtl`` file; NaN where it gives none as RGB.

    Raises
    ------
    FormatError
        If the file is no text or a ``Kd`` line is malformed.
    """
    colors: dict[str, Color] = {}
    name = None
    for number, line in enumerate(read_text(path, "a material file").split("\n"), start=1):
        keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
        if keyword == "newmtl":
            name = rest.strip()
            colors.setdefault(name, _UNKNOWN)
        elif keyword == "Kd" and name is not None:
            colors[name] = _parse_color(path, number, line, rest.partition("#")[0].split())
    return colors


def _parse_color(path: Path, number: int, line: str, fields: list[str]) -> Color:
    if fields and fields[0] in ("spectral", "xyz"):
        return _UNKNOWN
    try:
        values = [float(field) for field in fields[:3]]
    except ValueError:
        values = []
    if len(values) == 1:  # one number stands for grey
        values *= 3
    if len(values) != 3 or not np.isfinite(values).all():
        raise FormatError(at_line(path, number, "'Kd' and three finite numbers", line, "Export the materials again."))
    return values[0], values[1], values[2]


def write_materials(path: Path, names: Sequence[str], colors: FloatArray | None, *, force: bool = False) -> None:
    """Write a ``.mtl`` file; a material of unknown colour gets no ``Kd``."""
    lines = [f"# {mark()}\n"]
    for i, name in enumerate(names):
        is_known = colors is not None and np.isfinite(colors[i]).all()
        if name or is_known:
            lines.append(f"newmtl {name}\n")
        if colors is not None and is_known:
            lines.append("Kd {!r} {!r} {!r}\n".format(*colors[i].tolist()))
    write_whole(path, "".join(lines), force=force)
