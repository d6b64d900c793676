"""UDIM tile numbers of texture coordinates, and origins of tiles."""

from __future__ import annotations

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray

# Number of the tile with texture coordinates from 0 to 1, and tiles in a row.
FIRST_TILE = 1001
TILES_PER_ROW = 10


def udim_of(uvs: FloatArray) -> IndexArray:
    """(...,) UDIM numbers 1001 + floor(u) + 10 floor(v); ParameterError for UVs outside the grid of ten columns."""
    cells = np.floor(uvs).astype(np.int64)
    outside = (cells[..., 0] < 0) | (cells[..., 0] >= TILES_PER_ROW) | (cells[..., 1] < 0)
    if outside.any():
        raise ParameterError(
            f"expected texture coordinates inside the UDIM grid (0 <= u < {TILES_PER_ROW}, 0 <= v), "
            f"got {uvs[outside][:3].round(4).tolist()}; move those islands into the grid"
        )
    return FIRST_TILE + cells[..., 0] + TILES_PER_ROW * cells[..., 1]


def udim_origin(tile: int) -> tuple[float, float]:
    """Texture coordinates of the lower left corner of a UDIM tile, (0, 0) for a plain image (tile 0)."""
    if tile == 0:
        return 0.0, 0.0
    return float((tile - FIRST_TILE) % TILES_PER_ROW), float((tile - FIRST_TILE) // TILES_PER_ROW)
