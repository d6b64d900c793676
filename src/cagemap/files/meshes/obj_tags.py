"""Subdivision tags in OBJ files, as by OpenSubdiv's shapes: ``t name ints/floats/strings values...``, 0-based.

================================== ================================================
``t crease 2/1/0 v0 v1 s``         edge of sharpness s
``t corner 1/1/0 v s``             vertex of sharpness s
``t hole n/0/0 f...``              faces that are holes
``t interpolateboundary 1/0/0 n``  number of an option, in ``_CHOICES``
``t creasemethod 0/0/1 word``      word of an option, in ``_WORDS``; ``scheme`` is ours
================================== ================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import SCHEMES, CatmullClark, Loop, scheme_name

_CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "interpolateboundary": ("boundary", ("none", "edge_and_corner", "edge_only")),
    "facevaryinginterpolateboundary": (
        "uv_interpolation",
        ("none", "corners_only", "corners_plus1", "corners_plus2", "boundaries", "all"),
    ),
}
_WORDS: dict[str, tuple[str, dict[str, str]]] = {
    "creasemethod": ("creasing", {"normal": "uniform", "chaikin": "chaikin"}),
    "smoothtriangles": ("triangles", {"normal": "catmull_clark", "smooth": "smooth"}),
    "scheme": ("scheme", {name: name for name in SCHEMES}),
}
_COUNTS = {"crease": (2, 1, 0), "corner": (1, 1, 0)}


def parse_tags(
    lines: Sequence[str], fail: Callable[[int, str], FormatError], n_vertices: int, n_faces: int, *, triangles: bool
) -> dict[str, Any]:
    """Fields of a control mesh from all tag lines of a file; tags of unknown names are ignored.

    ``fail``: makes the error for line number i of ``lines``, given what was expected.
    ``triangles``: whether all faces are triangles; options without a scheme are Loop's then.
    """
    sharp: dict[str, list[tuple[list[int], float]]] = {"crease": [], "corner": []}
    holes: list[int] = []
    options: dict[str, str] = {}
    for row, line in enumerate(lines):
        name, ints, floats, words = _parse_line(line, partial(fail, row))
        if name in sharp:
            wanted = _COUNTS[name]
            if (len(ints), len(floats), len(words)) != wanted or not floats[0] >= 0:
                raise fail(row, f"'t {name} {'/'.join(map(str, wanted))}', 0-based vertices and a sharpness")
            _check_range(ints, n_vertices, "vertices", partial(fail, row))
            sharp[name].append((ints, floats[0]))
        elif name == "hole":
            _check_range(ints, n_faces, "faces", partial(fail, row))
            holes += ints
        elif name in _CHOICES:
            option, choices = _CHOICES[name]
            if len(ints) != 1 or not 0 <= ints[0] < len(choices):
                raise fail(row, f"'t {name} 1/0/0' and a number from 0 to {len(choices) - 1}")
            options[option] = choices[ints[0]]
        elif name in _WORDS:
            option, meanings = _WORDS[name]
            if len(words) != 1 or words[0] not in meanings:
                raise fail(row, f"'t {name} 0/0/1' and one of {', '.join(meanings)}")
            options[option] = meanings[words[0]]
    values: dict[str, Any] = {}
    for name, where in (("crease", "crease_edges"), ("corner", "corner_vertices")):
        if sharp[name]:
            numbers = np.array([ints for ints, _ in sharp[name]], dtype=np.int64)
            values[where] = numbers if name == "crease" else numbers[:, 0]
            values[f"{name}_sharpness"] = np.array([sharpness for _, sharpness in sharp[name]])
    if holes:
        values["hole_faces"] = np.unique(np.array(holes, dtype=np.int64))
    if options:
        kind = SCHEMES[options.pop("scheme")] if "scheme" in options else Loop if triangles else CatmullClark
        values["scheme"] = kind(**options)  # type: ignore[arg-type]
    return values


def _parse_line(line: str, fail: Callable[[str], FormatError]) -> tuple[str, list[int], list[float], list[str]]:
    parts = line.partition("#")[0].split()
    expected = "'t', a name, three counts such as 2/1/0, and as many values"
    if len(parts) < 3:
        raise fail(expected)
    try:
        n_ints, n_floats, n_words = (int(count) for count in parts[2].split("/"))
        values = parts[3:]
        if min(n_ints, n_floats, n_words) < 0 or len(values) != n_ints + n_floats + n_words:
            raise fail(expected)
        ints = [int(value) for value in values[:n_ints]]
        floats = [float(value) for value in values[n_ints : n_ints + n_floats]]
    except ValueError as error:
        if isinstance(error, FormatError):
            raise
        raise fail(expected) from None
    return parts[1], ints, floats, values[n_ints + n_floats :]


def _check_range(numbers: Sequence[int], count: int, what: str, fail: Callable[[str], FormatError]) -> None:
    if any(not 0 <= number < count for number in numbers):
        raise fail(f"{what} from 0 to {count - 1} (tags are 0-based)")


def format_tags(mesh: ControlMesh) -> str:
    """Tags of a mesh, one a line, without options that have their defaults."""
    lines, scheme = [], mesh.scheme
    if scheme is not None:
        default = CatmullClark()
        stated = {field.name: getattr(scheme, field.name) for field in fields(scheme)}
        stated = {name: value for name, value in stated.items() if value != getattr(default, name)}
        lines += [
            f"t {tag} 1/0/0 {choices.index(stated[option])}"
            for tag, (option, choices) in _CHOICES.items()
            if option in stated
        ]
        stated["scheme"] = scheme_name(scheme)
        for tag, (option, meanings) in _WORDS.items():
            words = [word for word, meaning in meanings.items() if meaning == stated.get(option)]
            lines += [f"t {tag} 0/0/1 {word}" for word in words]
    if mesh.crease_edges is not None and mesh.crease_sharpness is not None:
        pairs = zip(mesh.crease_edges.tolist(), mesh.crease_sharpness.tolist(), strict=True)
        lines += [f"t crease 2/1/0 {a} {b} {sharpness!r}" for (a, b), sharpness in pairs]
    if mesh.corner_vertices is not None and mesh.corner_sharpness is not None:
        corners = zip(mesh.corner_vertices.tolist(), mesh.corner_sharpness.tolist(), strict=True)
        lines += [f"t corner 1/1/0 {vertex} {sharpness!r}" for vertex, sharpness in corners]
    if mesh.hole_faces is not None and len(mesh.hole_faces):
        lines.append(f"t hole {len(mesh.hole_faces)}/0/0 " + " ".join(map(str, mesh.hole_faces.tolist())))
    return "".join(line + "\n" for line in lines)
