"""What a renderer sees at islands' borders: mip chains of baked images under several fills of the background.

The truth of a level is the mean of what the same island covers of its texels: nothing of the background, and nothing of
the islands beside it, which no fill can keep away where a texel of the level holds both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray
from scipy import ndimage, sparse

import cagemap
from cagemap.surface.triangles import triangle_neighbors
from cagemap.transfer import BakeOptions
from cagemap.transfer.baking import make_layout
from cagemap.transfer.texels import dilate, rasterize_band

Image = NDArray[np.float64]
# Texels of a level that a point at a border may lie from it.
_NEAR = 1.5


def border_errors(
    transfer: cagemap.transfer.Transfer, texture: NDArray[np.uint8], size: int, levels: int
) -> dict[str, list[float]]:
    """Root mean square error, 8-bit levels, of lookups near islands' borders in each level of the mip chain."""
    bare = cagemap.bake_texture(transfer, texture, size=size, options=BakeOptions(dilation=0)).astype(np.float64)
    islands, covered = _islands(transfer, size)
    filled = {name: fill(bare, covered) for name, fill in FILLS.items()}
    errors: dict[str, list[float]] = {name: [] for name in filled}
    own = islands >= 0
    inside = {k: box for k, box in enumerate(ndimage.find_objects(islands + 1)) if box is not None}
    for level in range(levels):
        step = 2**level
        chains = {name: _halved(image, level) for name, image in filled.items()}
        sums: dict[str, list[float]] = {name: [] for name in filled}
        for k, (rows, columns) in inside.items():
            # Whole texels of the level around the island.
            top, left = (max(0, s.start // step * step - 2 * step) for s in (rows, columns))
            ends = [min(size, -(-s.stop // step) * step + 2 * step) for s in (rows, columns)]
            window = np.s_[top : ends[0], left : ends[1]]
            mine = own[window] & (islands[window] == k)
            distance = ndimage.distance_transform_edt(np.pad(mine, 1))[1:-1, 1:-1]
            near = np.argwhere(mine & (distance <= _NEAR * step))
            share = mine[..., None].astype(np.float64)
            numerator, weight = (_halved(image, level) for image in (bare[window] * share, share))
            at = (near + 0.5) / step - 0.5
            truth = _bilinear(numerator, at) / _bilinear(weight, at)
            for name, chain in chains.items():
                seen = _bilinear(chain, at + np.array([top, left]) / step)
                sums[name].append(((seen - truth) ** 2).sum(axis=1))
        for name, squares in sums.items():
            errors[name].append(float(np.sqrt(np.concatenate(squares).mean() / 3)))
    return errors


def _islands(transfer: cagemap.transfer.Transfer, size: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Island of every texel whose centre lies in one, -1 elsewhere; and texels that are baked, with their gutter."""
    neighbors = triangle_neighbors(transfer.target.layout()[1])
    triangle, side = np.nonzero(neighbors >= 0)
    edges = sparse.coo_array(
        (np.ones(len(triangle)), (triangle, neighbors[triangle, side])), shape=(len(neighbors),) * 2
    )
    labels = sparse.csgraph.connected_components(edges, directed=False)[1]
    layout = make_layout(transfer, size, BakeOptions(supersample=1))
    cells, wide = (
        np.concatenate([rasterize_band(one, band) for band in range(len(one.band_triangles))])
        for one in (replace(layout, gutter=0.0), layout)
    )
    return np.where(cells >= 0, labels[cells], -1), wide >= 0


def _halved(image: Image, times: int) -> Image:
    for _ in range(times):
        image = image.reshape(len(image) // 2, 2, -1, 2, image.shape[2]).mean(axis=(1, 3))
    return image


def _bilinear(image: Image, at: NDArray[np.float64]) -> Image:
    """(k, c) values at rows and columns, in texels from the first one's centre; clamped."""
    top = np.array(image.shape[:2]) - 1
    at = np.clip(at, 0, top)
    low = np.floor(at).astype(int)
    high, (fr, fc) = np.minimum(low + 1, top), (at - low).T[..., None]
    upper = image[low[:, 0], low[:, 1]] * (1 - fc) + image[low[:, 0], high[:, 1]] * fc
    lower = image[high[:, 0], low[:, 1]] * (1 - fc) + image[high[:, 0], high[:, 1]] * fc
    return np.asarray(upper * (1 - fr) + lower * fr)


def _nearest(image: Image, covered: NDArray[np.bool_], distance: int | None = None) -> Image:
    filled = np.ascontiguousarray(np.where(covered[..., None], image, 0.0).astype(np.uint8))
    dilate(filled, covered, distance=distance)
    return filled.astype(np.float64)


def _push_pull(image: Image, covered: NDArray[np.bool_]) -> Image:
    table = np.dstack([image * covered[..., None], covered]).astype(np.float32)
    given = oiio.ImageBuf(oiio.ImageSpec(image.shape[1], image.shape[0], 4, oiio.FLOAT))
    given.set_pixels(oiio.ROI(), table)
    pixels = oiio.ImageBufAlgo.fillholes_pushpull(given).get_pixels(oiio.FLOAT)
    return np.where(covered[..., None], image, np.asarray(pixels)[..., :3])


FILLS: dict[str, Callable[[Image, NDArray[np.bool_]], Image]] = {
    "black": lambda image, covered: np.where(covered[..., None], image, 0.0),
    "nearest, 16 texels": lambda image, covered: _nearest(image, covered, 16),
    "nearest": _nearest,
    "push-pull": _push_pull,
}
