"""Source textures (an image or UDIM tiles) and their lookup at surface points.

Textures that are not minified are interpolated by the six-point cubic of Keys, *Cubic convolution interpolation for
digital image processing* (1981, eq. 24). It interpolates the texels and reproduces cubics. Its loss of detail three
texels wide is a twelfth of a bilinear lookup's. Values are limited to the range of the two texels around a point,
except at local peaks, and to the range of the image: hard edges do not ring. Alpha is looked up like colours, which may
be premultiplied by it. At borders of islands, where some of the six texels are not covered, the lookup is bilinear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, Literal

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.mesh.udim import udim_of, udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of
from cagemap.transfer.locate import TexelSamples

Pixels = NDArray[Any]

# Texels on either side of a point that the smooth lookup needs.
_KERNEL_REACH = 3


def smooth_cells(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h, w) whether the 6 x 6 texels around points between a texel and its lower right one are covered."""
    height, width = covered.shape
    inside = np.zeros((height, width), dtype=np.bool_)
    rows, columns = height - 2 * _KERNEL_REACH + 1, width - 2 * _KERNEL_REACH + 1
    if rows < 1 or columns < 1:
        return inside
    whole_columns = reduce(np.logical_and, [covered[k : k + rows] for k in range(2 * _KERNEL_REACH)])
    whole = reduce(np.logical_and, [whole_columns[:, k : k + columns] for k in range(2 * _KERNEL_REACH)])
    inside[_KERNEL_REACH - 1 : height - _KERNEL_REACH, _KERNEL_REACH - 1 : width - _KERNEL_REACH] = whole
    return inside


def channel_range(pixels: Pixels) -> tuple[Pixels, Pixels]:
    """(c,) smallest and largest value of every channel."""
    # NumPy reduces over whole rows fast, over rows and columns at once a hundred times slower.
    return np.fmin.reduce(np.fmin.reduce(pixels)), np.fmax.reduce(np.fmax.reduce(pixels))


@dataclass(frozen=True, eq=False)
class SmoothTile:
    """Cells of a tile that are looked up smoothly, and the range of its channels."""

    cells: NDArray[np.bool_]  # (h, w) whether all 6 x 6 texels are covered, see `smooth_cells`, and not all equal
    # `lowest`, `highest`: (c,) range of every channel, to which values are limited
    lowest: FloatArray
    highest: FloatArray

    @classmethod
    def of(cls, pixels: Pixels, covered: NDArray[np.bool_]) -> SmoothTile:
        """Smooth lookup of a tile (h, w, c) of which ``covered`` (h, w) texels are in the layout.

        NaN and infinite texels count as uncovered. If all 6 x 6 texels are equal, the bilinear lookup gives the same.
        """
        if pixels.dtype.kind == "f" and not (numbers := np.isfinite(pixels)).all():
            covered = covered & numbers.all(axis=2)
        cells = smooth_cells(covered)
        _leave_even(pixels.view(np.uint16) if pixels.dtype == np.float16 else pixels, cells)
        return cls(cells, *(end.astype(np.float64) for end in channel_range(pixels)))


@numba.njit(cache=True, nogil=True)
def _leave_even(pixels, cells):  # type: ignore[no-untyped-def]
    """Remove from ``cells`` those whose 6 x 6 texels are equal, by the largest uniform square at each texel.

    The square at (r, c) is one larger than the smallest of its right, lower and diagonal neighbours' squares, if these
    four texels are equal.
    """
    height, width, channels = pixels.shape
    below = np.zeros(width + 1, dtype=np.uint8)
    for r in range(height - 1, -1, -1):
        right, across = np.uint8(0), np.uint8(0)  # at (r, c + 1) and (r + 1, c + 1)
        for c in range(width - 1, -1, -1):
            square = np.uint8(1)
            if right > 0 and below[c] > 0 and across > 0:
                same = True
                for k in range(channels):
                    value = pixels[r, c, k]
                    if value != pixels[r, c + 1, k] or value != pixels[r + 1, c, k] or value != pixels[r + 1, c + 1, k]:
                        same = False
                        break
                if same:
                    square = np.uint8(min(min(right, below[c], across) + 1, 2 * _KERNEL_REACH))
            across, below[c], right = below[c], square, square
            if square == 2 * _KERNEL_REACH:
                cells[r + _KERNEL_REACH - 1, c + _KERNEL_REACH - 1] = False


Filter = Literal["smooth", "linear", "nearest"]

# UVs outside a tile by less than this are rounding: half a texel of a 4k image.
OVERHANG = 1.0 / 8192.0
# Up to this many samples a texel spans less than two texels of the texture and is interpolated smoothly.
_MAX_SMOOTH_SAMPLES = 4
# Largest overshoot of a peak between two texels, as a share of their drop to the outer neighbours (parabola: 1/8).
_PEAK = 0.25
# Value of every half float by its bits: Numba has no half floats, and a converted copy of a large texture takes
# gigabytes.
_HALVES = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Texture:
    """The source's texture with the texture coordinates of its triangles."""

    # (h, w, c) pixels by UDIM number, row 0 at the top; a plain image has the single key 0. Sizes
    # may differ, channels and number type not.
    tiles: dict[int, Pixels]
    uvs: FloatArray  # (p, 2)
    uv_triangles: IndexArray  # (t2, 3)
    triangle_tiles: IndexArray  # (t2,) tile of each triangle's centre; all 0 for a plain image

    @property
    def repeat(self) -> bool:
        """Whether points outside wrap around, as of a plain image; else they are clamped to the tile's edge."""
        return 0 in self.tiles

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(next(iter(self.tiles.values())).shape[2])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Number type of the pixels."""
        return next(iter(self.tiles.values())).dtype

    def corner_texels(self) -> FloatArray:
        """(t2, 3, 2) texel coordinates of every triangle's corners in its tile."""
        sizes = np.zeros((len(self.triangle_tiles), 2))
        for tile, pixels in self.tiles.items():
            sizes[self.triangle_tiles == tile] = (pixels.shape[1], pixels.shape[0])
        return self.uvs[self.uv_triangles] * sizes[:, None, :] * (1.0, -1.0)


def lay_texture(texture: Pixels | Mapping[int, Pixels], uvs: FloatArray, uv_triangles: IndexArray) -> Texture:
    """Check a texture, (h, w), (h, w, c) or such by UDIM number, and combine it with texture coordinates.

    A plain image repeats outside the unit square, as in renderers.
    """
    if not isinstance(texture, Mapping):
        tiles = {0: as_pixels(texture)}
        return Texture(tiles, uvs, uv_triangles, np.zeros(len(uv_triangles), dtype=np.int64))
    tiles = {int(number): as_pixels(pixels) for number, pixels in texture.items()}
    kinds = {(pixels.shape[2], str(pixels.dtype)) for pixels in tiles.values()}
    if len(kinds) != 1:
        raise ParameterError(f"texture tiles: expected one number of channels and one number type, got {sorted(kinds)}")
    triangle_tiles = udim_of(tile_cells(uvs[uv_triangles]))
    missing = np.setdiff1d(triangle_tiles, list(tiles))
    if len(missing):
        raise ParameterError(
            f"texture tiles: the source's UVs lie in tiles {missing[:5].tolist()}, which are not among the given "
            f"{sorted(tiles)[:10]}; add those images"
        )
    return Texture(tiles, uvs, uv_triangles, triangle_tiles)


def tile_cells(corners: FloatArray) -> FloatArray:
    """(t, 2) lower left corner of the unit square of each UV triangle (t, 3, 2).

    A triangle that crosses a border only by rounding belongs to the tile of its other corners.
    """
    cells = np.floor(corners.mean(axis=1))
    cells = cells - (corners.max(axis=1) - cells <= OVERHANG)
    return np.asarray(cells + (cells + 1.0 - corners.min(axis=1) <= OVERHANG))


def each_tile(texture: Pixels | Mapping[int, Pixels], change: Callable[[Pixels], Pixels]) -> Pixels | dict[int, Pixels]:
    """A texture with ``change`` applied to its image or to each tile."""
    if isinstance(texture, Mapping):
        return {tile: change(pixels) for tile, pixels in texture.items()}
    return change(texture)


def as_pixels(image: Pixels) -> Pixels:
    """(h, w, c) contiguous pixels of an image."""
    pixels = array_of(image)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise ParameterError(f"expected an image of shape (height, width, channels), got shape {np.shape(image)}")
    if pixels.dtype.kind not in "uf":
        raise ParameterError(f"expected pixels of unsigned integers or floats, got {pixels.dtype}")
    kind = pixels.dtype.newbyteorder("=") if pixels.dtype.itemsize <= 8 else np.dtype(np.float64)
    return np.ascontiguousarray(pixels, dtype=kind)  # kernels need native byte order and at most 64 bits


_ROUGH = SmoothTile(np.zeros((0, 0), dtype=np.bool_), np.zeros(0), np.zeros(0))


def look_up(
    texture: Texture, samples: TexelSamples, smooth: Mapping[int, SmoothTile] | None = None, *, nearest: bool = False
) -> FloatArray:
    """(k, c) mean over every texel's samples of the interpolated texture, in the texture's own values.

    Cells ``smooth``, by tile, are looked up smoothly, others bilinearly. ``nearest`` takes the texel that contains the
    point, for labels.
    """
    result = np.zeros((len(samples.first) - 1, texture.channels))
    # A band of texels uses few tiles of a large set: the others are skipped.
    used = np.zeros(len(texture.triangle_tiles), dtype=bool)
    used[samples.triangle] = True
    for tile in np.unique(texture.triangle_tiles[used]).tolist():
        pixels = texture.tiles[tile]
        u, v = udim_origin(tile)
        half = pixels.dtype == np.float16
        fine = (smooth or {}).get(tile, _ROUGH)
        _accumulate(
            (pixels.view(np.uint16) if half else pixels, _HALVES if half else None),
            (fine.cells, fine.lowest, fine.highest),
            (nearest, texture.repeat, tile, u, v),
            (texture.uvs, texture.uv_triangles, texture.triangle_tiles),
            (samples.first, samples.triangle, samples.barycentric),
            result,
        )
    result /= np.diff(samples.first)[:, None]
    return result


@numba.njit(cache=True, nogil=True)
def _accumulate(image, fine, options, layout, points, result):  # type: ignore[no-untyped-def]
    """Add the lookups of samples in one tile to their texels.

    Bilinear interpolation is written a + f (b - a), which leaves a constant texture constant to the last bit. A point
    outside wraps around if ``repeat``, but the texels around a point do not: an island at the image's edge must not mix
    with the opposite edge.
    """
    (pixels, halves), (smooth, lowest, highest) = image, fine
    nearest, repeat, tile, origin_u, origin_v = options
    (uvs, uv_triangles, triangle_tiles), (first, triangle, barycentric) = layout, points
    height, width, channels = pixels.shape
    across, down = np.empty(6), np.empty(6)
    for texel in range(len(first) - 1):
        for s in range(first[texel], first[texel + 1]):
            t = triangle[s]
            if triangle_tiles[t] != tile:
                continue
            u, v = -origin_u, -origin_v
            for k in range(3):
                u += barycentric[s, k] * uvs[uv_triangles[t, k], 0]
                v += barycentric[s, k] * uvs[uv_triangles[t, k], 1]
            if repeat:
                i, j, k = uv_triangles[t, 0], uv_triangles[t, 1], uv_triangles[t, 2]
                u = _wrap_coordinate(u, (uvs[i, 0] + uvs[j, 0] + uvs[k, 0]) / 3.0)
                v = _wrap_coordinate(v, (uvs[i, 1] + uvs[j, 1] + uvs[k, 1]) / 3.0)
            x = min(max(u * width - 0.5, 0.0), width - 1.0)
            y = min(max((1.0 - v) * height - 0.5, 0.0), height - 1.0)
            if nearest:
                x, y = np.floor(x + 0.5), np.floor(y + 0.5)
            c0, r0 = int(x), int(y)
            c1, r1 = int(np.ceil(x)), int(np.ceil(y))  # a texel of weight 0 may be NaN: it is not read
            fx, fy = x - c0, y - r0
            if len(smooth) and first[texel + 1] - first[texel] <= _MAX_SMOOTH_SAMPLES and smooth[r0, c0]:
                _six_points(fx, across)
                _six_points(fy, down)
                for channel in range(channels):
                    value = _smooth_value(pixels, halves, r0, c0, channel, down, across)
                    result[texel, channel] += min(max(value, lowest[channel]), highest[channel])
                continue
            for channel in range(channels):
                upper = _value(pixels, halves, r0, c0, channel)
                upper += fx * (_value(pixels, halves, r0, c1, channel) - upper)
                lower = _value(pixels, halves, r1, c0, channel)
                lower += fx * (_value(pixels, halves, r1, c1, channel) - lower)
                result[texel, channel] += upper + fy * (lower - upper)


@numba.njit(cache=True, nogil=True)
def _wrap_coordinate(place, centre):  # type: ignore[no-untyped-def]
    """A coordinate moved into 0 to 1 with its triangle's centre; the right edge of that square stays 1, not 0."""
    place -= np.floor(centre)
    return place - np.floor(place) if place < -OVERHANG or place > 1.0 + OVERHANG else place


@numba.njit(cache=True, nogil=True)
def _value(pixels, halves, row, column, channel):  # type: ignore[no-untyped-def]
    """A texel's value; ``halves`` is the table of half floats by their bits, or None for other types."""
    if halves is None:
        return np.float64(pixels[row, column, channel])
    return halves[pixels[row, column, channel]]


@numba.njit(cache=True, nogil=True)
def _six_points(f, weights):  # type: ignore[no-untyped-def]
    """Weights of the texels at -2, -1, 0, 1, 2, 3 for a point at ``f``, 0 to 1."""
    for k in range(6):
        s = abs(k - 2 - f)
        if s < 1.0:
            weights[k] = (4.0 / 3.0 * s - 7.0 / 3.0) * s * s + 1.0
        elif s < 2.0:
            weights[k] = ((-7.0 / 12.0 * s + 3.0) * s - 59.0 / 12.0) * s + 2.5
        else:
            weights[k] = ((s / 12.0 - 2.0 / 3.0) * s + 1.75) * s - 1.5


@numba.njit(cache=True, nogil=True)
def _interpolate_six(a, b, c, d, e, f, weights):  # type: ignore[no-untyped-def]
    """Weighted sum of six values, limited to the range of the middle two plus the peak of their slopes."""
    total = weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d + weights[4] * e + weights[5] * f
    rise, fall = max(min(c - b, d - e), 0.0), max(min(b - c, e - d), 0.0)
    return min(max(total, min(c, d) - fall * _PEAK), max(c, d) + rise * _PEAK)


@numba.njit(cache=True, nogil=True)
def _interpolate_row(pixels, halves, row, column, channel, across):  # type: ignore[no-untyped-def]
    """Value between texels ``column`` and ``column + 1`` of a row."""
    return _interpolate_six(
        _value(pixels, halves, row, column - 2, channel),
        _value(pixels, halves, row, column - 1, channel),
        _value(pixels, halves, row, column, channel),
        _value(pixels, halves, row, column + 1, channel),
        _value(pixels, halves, row, column + 2, channel),
        _value(pixels, halves, row, column + 3, channel),
        across,
    )


@numba.njit(cache=True, nogil=True)
def _smooth_value(pixels, halves, r0, c0, channel, down, across):  # type: ignore[no-untyped-def]
    """Value between texels (r0, c0) and (r0 + 1, c0 + 1)."""
    return _interpolate_six(
        _interpolate_row(pixels, halves, r0 - 2, c0, channel, across),
        _interpolate_row(pixels, halves, r0 - 1, c0, channel, across),
        _interpolate_row(pixels, halves, r0, c0, channel, across),
        _interpolate_row(pixels, halves, r0 + 1, c0, channel, across),
        _interpolate_row(pixels, halves, r0 + 2, c0, channel, across),
        _interpolate_row(pixels, halves, r0 + 3, c0, channel, across),
        down,
    )
