"""ZBrush's polypaint: vertex colours in comments of an OBJ file, ``#MRGB`` and up to 64 values MMRRGGBB a line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cagemap.errors import FormatError
from cagemap.numerics.arrays import FloatArray

KEYWORD = "#MRGB"
_VALUE = 4  # bytes: mask, red, green, blue


def polypaint(lines: Sequence[str], n_vertices: int, fail: Callable[[int, str], FormatError]) -> FloatArray | None:
    """Colours (n, 3) from 0 to 1 of all vertices, in their order; None if there are no such lines.

    Parameters
    ----------
    lines : sequence of str
        All that begin with `KEYWORD`.
    n_vertices : int
    fail : callable
        Makes the error about a line, given its number among these and what was expected.

    Raises
    ------
    FormatError
        If a line is no such list, or there is not one value for every vertex.
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
