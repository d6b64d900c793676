"""Mip maps: low-passed, halved images of a texture, for texels that span several texels of the source.

The cubic of Mitchell and Netravali (1988) passes 1 % of the frequencies above the limit as moire (a box: 10 %), with
little ringing. Images for further levels are halved by a Lanczos kernel, which keeps frequencies below the limit.
Both use covered texels only (normalised convolution, Knutsson and Westin 1993), so that no colours bleed into islands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.texture import Filter, Pixels, SmoothTile, Texture, channel_range, look_up

_LOBES = 3
# Least share of the kernel on covered texels; below it means replace it: negative lobes would amplify.
_MIN_KERNEL_SHARE = 0.75
# Rows of a halved image per block: about 100 bytes for each texel of the source.
_MIP_ROWS = 128
# Weight of uncovered texels: so small that they matter only without covered ones.
_UNCOVERED_WEIGHT = 1e-5

Coverage = NDArray[np.float32] | NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MipMaps:
    """A texture and its mip levels that target triangles read."""

    levels: dict[int, Texture]  # by level; only levels that are read, and 0, the texture itself
    of_triangle: NDArray[np.int64]  # (t1,) level for every target triangle
    smooth: dict[int, SmoothTile]  # smooth lookup of level 0, by tile
    nearest: bool = False  # whether texels are labels, which are not interpolated

    @classmethod
    def build(
        cls,
        texture: Texture,
        of_triangle: NDArray[np.int64],
        coverage: dict[int, NDArray[np.bool_]],
        *,
        exact: bool = False,
        kind: Filter = "smooth",
    ) -> MipMaps:
        """Mip levels of a texture that target triangles read, ``of_triangle`` (t1,).

        Level l is the image halved l - 1 times and then low-passed to half its frequencies, so that bilinear lookups
        are accurate. Only tiles with ``coverage``, texels in the source's layout, are halved. ``exact`` keeps floats
        instead of the texture's number type: means of directions are short. ``kind`` is the interpolation of level 0.
        """
        smooth = coverage.items() if kind == "smooth" else ()
        fine = {tile: SmoothTile.of(texture.tiles[tile], share) for tile, share in smooth}
        levels, tiles = {0: texture}, {tile: texture.tiles[tile] for tile in coverage}
        shares: dict[int, Coverage] = dict(coverage)
        for level in range(1, int(of_triangle.max(initial=0)) + 1):
            if np.any(of_triangle == level):
                soft = {
                    tile: low_passed(pixels, shares[tile], None if exact else texture.tiles[tile])
                    for tile, pixels in tiles.items()
                }
                levels[level] = replace(texture, tiles=texture.tiles | soft)
            if level < of_triangle.max():
                pairs = {tile: halve(pixels, shares[tile]) for tile, pixels in tiles.items()}
                tiles = {tile: pixels for tile, (pixels, _) in pairs.items()}
                shares = {tile: covered for tile, (_, covered) in pairs.items()}
        return cls(levels, of_triangle, fine, kind == "nearest")

    def look_up(self, samples: TexelSamples) -> FloatArray:
        """(k, c) values of texels by `cagemap.transfer.texture.look_up`, each in its triangle's mip level."""
        if len(self.levels) == 1:
            return look_up(self.levels[0], samples, self.smooth, nearest=self.nearest)
        texel_levels = self.of_triangle[samples.target_triangle]
        values = np.empty((len(texel_levels), self.levels[0].channels))
        for level in np.unique(texel_levels).tolist():
            texels = np.flatnonzero(texel_levels == level)
            values[texels] = look_up(self.levels[level], samples.part(texels), self.smooth if level == 0 else None)
        return values


def halve(pixels: Pixels, coverage: Coverage) -> tuple[Pixels, Coverage]:
    """An image (h, w, c) and its coverage at half the size: (ceil(h / 2), ceil(w / 2), c) float32."""
    sides = [_kernels(count, count / ((count + 1) // 2), (count + 1) // 2, _lanczos) for count in pixels.shape[:2]]
    return _filter(pixels, coverage, sides[0], sides[1])


def low_passed(pixels: Pixels, coverage: Coverage, like: Pixels | None = None) -> Pixels:
    """(h, w, c) covered texels of an image, low-passed for texels of twice the size.

    As float32, or in the number type and clipped to the range of ``like``: kernels overshoot at edges.
    """
    sides = [_kernels(count, 2.0, count, _mitchell) for count in pixels.shape[:2]]
    return _filter(pixels, coverage, sides[0], sides[1], like)[0]


_Matrices = tuple[sparse.csr_array, sparse.csr_array]


def _filter(
    pixels: Pixels, coverage: Coverage, down: _Matrices, across: _Matrices, like: Pixels | None = None
) -> tuple[Pixels, Coverage]:
    """Normalised convolution by a kernel along both sides; means where too little of the kernel is covered.

    NaN and infinite texels have no weight.
    """
    shape, ends = (down[0].shape[0], across[0].shape[0]), None if like is None else channel_range(like)
    result = np.zeros((*shape, pixels.shape[2]), dtype=np.float32 if like is None else like.dtype)
    covered = np.zeros(shape, dtype=np.float32)

    def fill(rows: slice) -> None:
        row_matrices = [matrix[rows] for matrix in down]
        first, last = int(row_matrices[0].indices.min()), int(row_matrices[0].indices.max()) + 1
        weight = np.maximum(coverage[first:last].astype(np.float32), np.float32(_UNCOVERED_WEIGHT))
        values_in = pixels[first:last].astype(np.float32)
        numbers = np.isfinite(values_in)
        if not numbers.all():
            known = np.asarray(numbers.all(axis=2))
            values_in, weight = np.where(known[..., None], values_in, 0), np.where(known, weight, 0)
        table = np.dstack([values_in * weight[..., None], weight])
        sharp, mean = (
            _apply_separably(table, vertical[:, first:last], horizontal)
            for vertical, horizontal in zip(row_matrices, across, strict=True)
        )
        values = np.where((sharp[..., -1] >= _MIN_KERNEL_SHARE)[..., None], sharp, mean)
        with np.errstate(invalid="ignore"):
            filtered = values[..., :-1] / values[..., -1:]
        if ends is not None:
            filtered = np.clip(filtered, *ends)
        result[rows] = np.rint(filtered) if result.dtype.kind == "u" else filtered
        covered[rows] = mean[..., -1]

    in_threads(fill, row_slices(len(result), _MIP_ROWS))
    return result, covered


def _apply_separably(table: NDArray[Any], down: sparse.csr_array, across: sparse.csr_array) -> NDArray[Any]:
    """(h', w', c) product of a table (h, w, c) with a matrix for its rows and one for its columns."""
    height, width, channels = table.shape
    rows = (down @ table.reshape(height, -1)).reshape(-1, width, channels).transpose(1, 0, 2)
    both = (across @ np.ascontiguousarray(rows).reshape(width, -1)).reshape(across.shape[0], -1, channels)
    return np.asarray(both.transpose(1, 0, 2))


def _kernels(count: int, step: float, fewer: int, kernel: Callable[[FloatArray], FloatArray]) -> _Matrices:
    """(m, n) matrices from n texels to m evenly spaced centres: a kernel ``step`` wide, and means."""
    centres = ((np.arange(fewer) + 0.5) * (count / fewer))[:, None]
    reach = int(np.ceil(_LOBES * step)) + 1
    cells = np.floor(centres).astype(np.int64) + np.arange(-reach, reach + 1)
    weights = kernel(np.abs(cells + 0.5 - centres) / step)
    low, high = (np.clip(ends, centres - step / 2, centres + step / 2) for ends in (cells, cells + 1))
    return _matrix(cells, weights, count), _matrix(cells, high - low, count)


def _lanczos(at: FloatArray) -> FloatArray:
    """Sinc windowed by a wider one, for distances in units of the resulting texels."""
    return np.asarray(np.where(at < _LOBES, np.sinc(at) * np.sinc(at / _LOBES), 0.0))


def _mitchell(at: FloatArray) -> FloatArray:
    """Piecewise cubic with B = C = 1/3, for distances in units of the resulting texels."""
    near = (7.0 * at**3 - 12.0 * at**2 + 16.0 / 3.0) / 6.0
    far = (-7.0 / 3.0 * at**3 + 12.0 * at**2 - 20.0 * at + 32.0 / 3.0) / 6.0
    return np.asarray(np.where(at < 1.0, near, np.where(at < 2.0, far, 0.0)))


def _matrix(cells: NDArray[np.int64], weights: FloatArray, count: int) -> sparse.csr_array:
    """Sparse rows of weights, scaled to sum 1 before cells beyond the ends are left out."""
    scaled = weights / weights.sum(axis=1, keepdims=True)
    kept = (cells >= 0) & (cells < count) & (np.abs(scaled) > 1e-9)
    rows = np.broadcast_to(np.arange(len(cells))[:, None], cells.shape)[kept]
    return sparse.csr_array((scaled[kept].astype(np.float32), (rows, cells[kept])), shape=(len(cells), count))
