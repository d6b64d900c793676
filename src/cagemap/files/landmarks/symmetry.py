"""Self-maps of a control mesh: one image for every control vertex, -1 where it is not known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.npz import read_npy
from cagemap.files.text import read_bytes
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import IndexArray

_REMEDY = (
    "A symmetry file has one vertex number for every control vertex, from 0, -1 where the image is not known: "
    "a JSON list, text with a number a line, or .npy."
)


def read_symmetry(path: Path) -> IndexArray:
    """Read the image of every control vertex from ``.npy``, ``.json`` or text."""
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


def symmetry_on(images: IndexArray, control: ControlMesh) -> IndexArray:
    """Images of a file's vertices on a mesh that is welded, or a part of the file; others as they are."""
    first = control.file_vertices
    if first is None or len(images) == control.n_vertices or len(images) <= first.max():
        return images
    number = np.full(len(images) + 1, -1, dtype=np.int64)  # the last: where the image is not known
    number[first] = np.arange(control.n_vertices)
    if control.file_copies is not None:
        number[control.file_copies[:, 1]] = control.file_copies[:, 0]
    inside = (images >= -1) & (images < len(images))
    return np.asarray(np.where(inside, number[np.where(inside, images, -1)], images)[first])
