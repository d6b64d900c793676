"""Smaller images of a texture, for texels that span more of it than samples can see."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.numerics.arrays import FloatArray
from cagemap.transfer.locate import MAX_SAMPLES_PER_AXIS, UNSCALED, Samples
from cagemap.transfer.texture import Pixels, Texture, look_up


@dataclass(frozen=True, eq=False)
class MipMaps:
    """A texture and the halvings of it that some target triangles read.

    Attributes
    ----------
    levels : dict of int to Texture
        By how often it was halved; only those that are read.
    of_triangle : (t1,) int64
        Level for every target triangle.
    """

    levels: dict[int, Texture]
    of_triangle: NDArray[np.int64]

    @classmethod
    def build(cls, texture: Texture, spans: FloatArray) -> MipMaps:
        """Halve a texture until the longer of each triangle's spans (t1, 2) is no more than samples can see."""
        most = MAX_SAMPLES_PER_AXIS + UNSCALED - 1.0
        longest = np.maximum(spans.max(axis=1, initial=0.0), most)
        of_triangle = np.ceil(np.log2(longest / most) - 1e-9).astype(np.int64)
        levels, current = {}, texture
        for level in range(int(of_triangle.max(initial=0)) + 1):
            if level:
                tiles = {tile: halved(pixels) for tile, pixels in current.tiles.items()}
                current = replace(current, tiles=tiles)
            if level == 0 or np.any(of_triangle == level):
                levels[level] = current
        return cls(levels, of_triangle)

    def look_up(self, samples: Samples) -> FloatArray:
        """(k, c) as `cagemap.transfer.texture.look_up`, every texel in the image of its triangle's level."""
        if len(self.levels) == 1:
            return look_up(self.levels[0], samples)
        own = self.of_triangle[samples.target_triangle]
        values = np.empty((len(own), self.levels[0].channels))
        for level in np.unique(own).tolist():
            texels = np.flatnonzero(own == level)
            values[texels] = look_up(self.levels[level], samples.part(texels))
        return values


def halved(pixels: Pixels) -> Pixels:
    """(ceil(h / 2), ceil(w / 2), c) float32 means of a (h, w, c) image over equal areas, whatever its size."""
    height, width, channels = pixels.shape
    values = pixels.astype(np.float32)
    fewer: Pixels = _area_means(height) @ values.reshape(height, width * channels)
    rows = fewer.reshape(-1, width, channels).transpose(1, 0, 2)
    both: Pixels = _area_means(width) @ np.ascontiguousarray(rows).reshape(width, -1)
    return np.ascontiguousarray(both.reshape(-1, rows.shape[1], channels).transpose(1, 0, 2))


def _area_means(count: int) -> sparse.csr_array:
    """(ceil(n / 2), n) means over equal shares of n cells."""
    fewer = (count + 1) // 2
    edges = np.arange(fewer + 1) * (count / fewer)
    first = np.floor(edges[:-1] + 1e-9).astype(np.int64)
    cells = first[:, None] + np.arange(3)
    overlap = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    kept = (cells < count) & (overlap > 1e-9)
    rows = np.broadcast_to(np.arange(fewer)[:, None], cells.shape)[kept]
    weights = (overlap * (fewer / count))[kept].astype(np.float32)
    return sparse.csr_array((weights, (rows, cells[kept])), shape=(fewer, count))
