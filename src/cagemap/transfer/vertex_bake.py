"""Bake values at the vertices of a surface into its own UV layout."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Level
from cagemap.transfer.baking import BakeOptions, lay_canvas, paint, unit
from cagemap.transfer.locate import cell_barycentric
from cagemap.transfer.surface import TexturedSurface
from cagemap.transfer.texture import Pixels


def bake_vertex_values(
    level: Level,
    values: FloatArray,
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike = np.float32,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake values at the vertices of a refined level, linear in its triangles.

    Parameters
    ----------
    level : Level
        With texture coordinates.
    values : (n,) or (n, q) array
    size : int or (height, width)
    dtype : optional
        Integers stand for the range 0 to 1.
    options : BakeOptions, optional

    Returns
    -------
    (height, width, q) array

    Raises
    ------
    ParameterError
        If there is not one row a vertex, or the level has no texture coordinates.
    """
    options = options or BakeOptions()
    surface = TexturedSurface.from_level(level)
    if len(values) != len(surface.positions):
        raise ParameterError(f"expected {len(surface.positions)} rows, one a vertex, got {len(values)}")
    kept = np.dtype(dtype)
    table = np.asarray(values, dtype=np.float64).reshape(len(values), -1) * unit(kept)
    canvas = lay_canvas(surface, size, options)

    def shade_cells(triangle: NDArray[np.int32], cells: IndexArray, top: int) -> FloatArray:
        inside = cell_barycentric(canvas.corners, triangle, cells, canvas.layout.width, top)
        return np.asarray(np.einsum("kc,kcq->kq", inside, table[surface.triangles[triangle]]))

    return paint(canvas, shade_cells, table.shape[1], kept, options)
