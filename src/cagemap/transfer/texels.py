"""Rasterise UV layouts to the triangle of every texel, with a gutter around islands; fill the background.

Texel coordinates: x to the right and y down, in texels, so that texel (row r, column c) has its centre at
(c + 0.5, r + 0.5) and v = 1 is y = 0.

Renderers filter across island borders, at coarser mip levels over many texels. Borders do not show if the background
has the nearest texel's colour. Distances are exact and Euclidean, in time linear in the number of texels: Meijster,
Roerdink, Hesselink, *A general algorithm for computing distance transforms in linear time* (2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, row_slices

TriangleImage = NDArray[np.int32]

# Tolerance of barycentric coordinates: a texel centre on an edge must not be missed by both triangles.
EDGE_TOLERANCE = 1e-7
# Bilinear lookups inside an island touch texels whose centre is up to a texel away along both axes.
GUTTER_RADIUS = float(np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class Layout:
    """A UV layout in texel coordinates, its triangles and island borders sorted into bands of rows."""

    corners: FloatArray  # (t, 3, 2) texel coordinates of the triangles' corners
    # `height`, `width`: size of the raster
    height: int
    width: int
    band_rows: int  # rows in a band; the last may have fewer
    gutter: float  # width of the extension of islands beyond their border, in texels
    supersample: int  # raster texels along the side of a texel of the image
    # `band_triangles`, `border_triangles`, `border_corners`: triangles that touch the band, and border edges within
    # the gutter of it: an edge is a triangle and its first corner. The first covers the others.
    band_triangles: tuple[IndexArray, ...]
    border_triangles: tuple[IndexArray, ...]
    border_corners: tuple[IndexArray, ...]


def texel_coordinates(uvs: FloatArray, height: int, width: int) -> FloatArray:
    """(..., 2) texel coordinates of texture coordinates; v points up, rows count down."""
    return np.stack([uvs[..., 0] * width, (1.0 - uvs[..., 1]) * height], axis=-1)


def lay_out(
    corner_uvs: FloatArray,
    neighbors: NDArray[np.int32],
    height: int,
    width: int,
    rank: IndexArray | None = None,
    *,
    band_rows: int,
    gutter: float = GUTTER_RADIUS,
    supersample: int = 1,
) -> Layout:
    """Convert a layout (t, 3, 2) to texel coordinates and sort its triangles and borders into bands.

    ``neighbors`` (t, 3) are triangles across the edge opposite to every corner *in the UV layout*, -1 at an island's
    border. Islands are extended by ``gutter`` texels beyond their border. Where triangles overlap, texels take the
    one of the lowest ``rank`` (t,).
    """
    corners = np.ascontiguousarray(texel_coordinates(corner_uvs, height, width))
    triangle_bands = _sort_into_bands(corners, height, width, band_rows, 0.0)
    triangle, opposite = np.nonzero(neighbors < 0)
    if rank is not None:
        triangle_bands = [band[np.argsort(rank[band], kind="stable")] for band in triangle_bands]
        order = np.argsort(rank[triangle], kind="stable")
        triangle, opposite = triangle[order], opposite[order]
    start = (opposite + 1) % 3
    edges = np.stack([corners[triangle, start], corners[triangle, (start + 1) % 3]], axis=1)
    edge_bands = _sort_into_bands(edges, height, width, band_rows, gutter)
    return Layout(
        corners,
        height,
        width,
        band_rows,
        gutter,
        supersample,
        tuple(triangle_bands),
        tuple(triangle[edge] for edge in edge_bands),
        tuple(start[edge] for edge in edge_bands),
    )


def _sort_into_bands(points: FloatArray, height: int, width: int, band_rows: int, margin: float) -> list[IndexArray]:
    """For every band, the elements (e, p, 2 points) whose bounding box with a margin touches it."""
    places = points.transpose(1, 0, 2)  # NumPy reduces over a short axis slowly, over pairs of arrays fast
    low, high = reduce(np.minimum, places) - margin, reduce(np.maximum, places) + margin
    inside = np.flatnonzero((high[:, 0] > 0) & (high[:, 1] > 0) & (low[:, 0] < width) & (low[:, 1] < height))
    n_bands = -(-height // band_rows)
    first = np.clip(low[inside, 1] // band_rows, 0, n_bands - 1).astype(np.int64)
    last = np.clip(high[inside, 1] // band_rows, 0, n_bands - 1).astype(np.int64)
    repeats = last - first + 1
    elements = np.repeat(inside, repeats)
    bands = np.repeat(first, repeats) + np.arange(len(elements)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    order = np.argsort(bands, kind="stable")
    limits = np.searchsorted(bands[order], np.arange(n_bands + 1))
    return [elements[order[begin:end]] for begin, end in pairwise(limits)]


def rasterize_band(layout: Layout, band: int) -> TriangleImage:
    """(rows, width) triangle of every texel of a band, -1 outside the islands and their gutter.

    A texel whose centre is in several triangles (an overlapping layout) takes the first. Outside texels up to
    ``layout.gutter`` texels from an island's border take the triangle at the nearest border. Its linear extension is
    the right value for bilinear lookups at the border.
    """
    top = band * layout.band_rows
    rows = min(layout.band_rows, layout.height - top)
    image = np.full((rows, layout.width), -1, dtype=np.int32)
    _rasterize(image, top, layout.corners, layout.band_triangles[band])
    if layout.gutter > 0:
        borders = layout.border_triangles[band], layout.border_corners[band]
        nearest = np.full(image.shape, layout.gutter**2 + 1e-9)
        border_triangle = np.full(image.shape, -1, dtype=np.int32)
        _grow_gutter(image, top, layout.corners, *borders, layout.gutter, nearest, border_triangle)
        image = np.where(border_triangle >= 0, border_triangle, image)
    return image


@numba.njit(cache=True, nogil=True)
def _rasterize(image, top, corners, triangles):  # type: ignore[no-untyped-def]
    """Set texels of ``image`` that are -1 to the triangle at their centre; the first row is ``top``."""
    rows, width = image.shape
    for t in triangles:
        x0, y0 = corners[t, 0, 0], corners[t, 0, 1]
        x1, y1 = corners[t, 1, 0] - x0, corners[t, 1, 1] - y0
        x2, y2 = corners[t, 2, 0] - x0, corners[t, 2, 1] - y0
        area = x1 * y2 - x2 * y1
        if area == 0.0:
            continue
        left = max(int(np.floor(x0 + min(0.0, x1, x2) - 0.5)), 0)
        right = min(int(np.ceil(x0 + max(0.0, x1, x2) - 0.5)), width - 1)
        upper = max(int(np.floor(y0 + min(0.0, y1, y2) - 0.5)) - top, 0)
        lower = min(int(np.ceil(y0 + max(0.0, y1, y2) - 0.5)) - top, rows - 1)
        scale = 1.0 / area
        for r in range(upper, lower + 1):
            y = r + top + 0.5 - y0
            for c in range(left, right + 1):
                x = c + 0.5 - x0
                b1 = (x * y2 - x2 * y) * scale
                b2 = (x1 * y - x * y1) * scale
                if b1 >= -EDGE_TOLERANCE and b2 >= -EDGE_TOLERANCE and b1 + b2 <= 1.0 + EDGE_TOLERANCE:
                    if image[r, c] < 0:
                        image[r, c] = t


@numba.njit(cache=True, nogil=True)
def _grow_gutter(image, top, corners, triangles, starts, radius, nearest, found):  # type: ignore[no-untyped-def]
    """For texels that are -1, find the triangle of a border edge closer than sqrt(``nearest``)."""
    rows, width = image.shape
    for e in range(len(triangles)):
        t, k = triangles[e], starts[e]
        x0, y0 = corners[t, k, 0], corners[t, k, 1]
        x1, y1 = corners[t, (k + 1) % 3, 0] - x0, corners[t, (k + 1) % 3, 1] - y0
        x2, y2 = corners[t, (k + 2) % 3, 0] - x0, corners[t, (k + 2) % 3, 1] - y0
        length2 = x1 * x1 + y1 * y1
        if x1 * y2 - x2 * y1 == 0.0:
            continue
        left = max(int(np.floor(x0 + min(0.0, x1) - 0.5 - radius)), 0)
        right = min(int(np.ceil(x0 + max(0.0, x1) - 0.5 + radius)), width - 1)
        upper = max(int(np.floor(y0 + min(0.0, y1) - 0.5 - radius)) - top, 0)
        lower = min(int(np.ceil(y0 + max(0.0, y1) - 0.5 + radius)) - top, rows - 1)
        for r in range(upper, lower + 1):
            y = r + top + 0.5 - y0
            for c in range(left, right + 1):
                if image[r, c] >= 0:
                    continue
                x = c + 0.5 - x0
                s = min(max((x * x1 + y * y1) / length2, 0.0), 1.0)
                dx, dy = x - s * x1, y - s * y1
                distance2 = dx * dx + dy * dy
                if distance2 < nearest[r, c]:
                    nearest[r, c] = distance2
                    found[r, c] = t


_STRIP = 512
_NOWHERE = np.int16(-1)
LARGEST_SIDE = int(np.iinfo(np.int16).max)


def dilate(image: NDArray[Any], covered: NDArray[np.bool_], *, distance: int | None = None) -> None:
    """Copy the nearest covered texel, in place, to texels of a contiguous image (h, w, c) that are not covered (h, w).

    Sides are up to 32767 texels. ``distance`` is the largest to fill, in texels; default: the whole background.
    """
    height, width = covered.shape
    if not covered.any():
        return
    reach = -1 if distance is None else int(distance)
    texels = image.view(np.uint8).reshape(height, width, -1)
    nearest_row = np.empty((height, width), dtype=np.int16)

    def fill(rows: slice) -> None:
        _fill_rows(texels, nearest_row, reach, rows.start, rows.stop, *np.empty((2, width), dtype=np.int64))

    in_threads(lambda part: _nearest_rows(covered, nearest_row, part.start, part.stop), row_slices(width, _STRIP))
    in_threads(fill, row_slices(height, _STRIP))


@numba.njit(cache=True, nogil=True)
def _nearest_rows(covered, nearest_row, begin, end):  # type: ignore[no-untyped-def]
    """Row of the nearest covered texel in the same column, or _NOWHERE; for columns ``begin`` to ``end``."""
    height = len(covered)
    for r in range(height):
        for c in range(begin, end):
            if covered[r, c]:
                nearest_row[r, c] = r
            elif r > 0:
                nearest_row[r, c] = nearest_row[r - 1, c]
            else:
                nearest_row[r, c] = _NOWHERE
    for r in range(height - 2, -1, -1):
        for c in range(begin, end):
            below = nearest_row[r + 1, c]
            above = nearest_row[r, c]
            if below != _NOWHERE and (above == _NOWHERE or below - r < r - above):
                nearest_row[r, c] = below


@numba.njit(cache=True, nogil=True)
def _fill_rows(texels, nearest_row, reach, begin, end, site, since):  # type: ignore[no-untyped-def]
    """Fill rows ``begin`` to ``end`` from the nearest texel, by the lower envelope of the columns' parabolas.

    Column i has the parabola (c - i)^2 + h_i^2, h_i being the distance along the column. Only texels that are not
    covered are written, and only covered ones are read, so rows may be filled in any order. Work arrays: ``site`` for
    the columns of the envelope, ``since`` for the first texel at which each is the lowest.
    """
    width = texels.shape[1]
    for r in range(begin, end):
        top = -1
        open_texels = False
        for c in range(width):
            row = nearest_row[r, c]
            if row != r:
                open_texels = True
            if row == _NOWHERE:
                continue
            height2 = np.int64(row - r) * np.int64(row - r)
            first = np.int64(0)
            while top >= 0:
                other = site[top]
                other_height = np.int64(nearest_row[r, other] - r)
                # First texel at which this parabola is below the other one.
                numerator = c * c - other * other + height2 - other_height * other_height
                first = numerator // (2 * (c - other)) + 1
                if first > since[top]:
                    break
                top -= 1
            if top < 0:
                first = np.int64(0)
            if first < width:
                top += 1
                site[top], since[top] = c, first
        if top < 0 or not open_texels:
            continue
        current = 0
        for c in range(width):
            while current < top and since[current + 1] <= c:
                current += 1
            if nearest_row[r, c] == r:
                continue
            column = site[current]
            row = nearest_row[r, column]
            if reach >= 0:
                dr, dc = np.int64(row - r), c - column
                if dr * dr + dc * dc > reach * reach:
                    continue
            for k in range(texels.shape[2]):
                texels[r, c, k] = texels[row, column, k]
