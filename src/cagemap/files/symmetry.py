"""Self-maps of a control mesh: one image for every control vertex, -1 where it is not known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.npz import read_npy
from cagemap.files.text import read_bytes
from cagemap.numerics.arrays import IndexArray

_REMEDY = (
    "A symmetry file has one vertex number for every control vertex, from 0, -1 where the image is not known: "
    "a JSON list, text with a number a line, or .npy."
)


def read_symmetry(path: Path) -> IndexArray:
    """Read the image of every control vertex from ``.npy``, ``.json`` or text.

    Raises
    ------
    FormatError
        If the file does not hold one list of whole numbers.
    """
    content = read_bytes(path, "a symmetry file")
    if path.suffix == ".npy":
        values = read_npy(content, path, _REMEDY)
    else:
        try:
            text = content.decode("utf-8")
            values = np.array(json.loads(text) if path.suffix == ".json" else [int(word) for word in text.split()])
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}: is no list of whole numbers ({error}). {_REMEDY}") from None
    if values.ndim != 1 or not len(values) or not np.issubdtype(values.dtype, np.integer):
        raise FormatError(
            f"{path}: expected a list of whole numbers, got {values.dtype} of shape {values.shape}. {_REMEDY}"
        )
    return values.astype(np.int64)
