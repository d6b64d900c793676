"""Mip levels and numbers of samples with which a texture neither aliases nor blurs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.udim import udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.surface.triangles import triangle_neighbors
from cagemap.transfer.locate import MappedSurface, locate_centers
from cagemap.transfer.mip_maps import MipMaps
from cagemap.transfer.texels import GUTTER_RADIUS, Layout, dilate, lay_out, rasterize_band
from cagemap.transfer.texture import Filter, Pixels, Texture, tile_cells

# Most samples of a texel along each axis; texels that need more read a coarser mip level.
MAX_SAMPLES_PER_AXIS = 16
# Largest span, in texels of the source, for which one sample is enough: unscaled textures are not blurred.
UNSCALED = 1.25
# A span of 2^l texels, less this share of an octave, reads level l.
_LEVEL_SLACK = 0.1
# Triangles that one thread plans at a time: 300 bytes each.
_PLANNED_AT_ONCE = 1 << 15
# Texels that are rasterised at a time.
_BAND_TEXELS = 1 << 18
# Largest distance, in texels, from a texel beside an island to the island's texel that replaces it.
_PADDING = 3
# Rows and columns, at most, of the texels far from islands that are compared with each other.
_SAMPLED_ROWS = 256


def plan_lookups(
    mapped: MappedSurface,
    layout: Layout,
    laid: Texture,
    *,
    exact: bool = False,
    kind: Filter = "smooth",
) -> tuple[MipMaps, NDArray[np.int32], NDArray[np.bool_]]:
    """Mip levels and samples with which a raster of the target's layout reads a texture.

    ``exact`` and ``kind`` are as of `MipMaps.build`; minified textures are interpolated too, except by "nearest". Also
    returns the samples along x and y in a raster cell of target triangles (t1, 2), and whether (t1,) a texel spans at
    most one texel of the source: its centre alone is sampled.
    """
    centers = locate_centers(mapped)
    texels = laid.corner_texels() * (kind != "nearest")  # labels are not averaged: one sample of the texture itself
    spans = texel_spans(mapped, layout.corners, texels, centers)
    covering = np.unique(np.concatenate([*layout.band_triangles, *layout.border_triangles]))
    levels = np.zeros(len(spans), dtype=np.int64)
    levels[covering] = mip_levels(spans[covering])
    reached = np.concatenate([centers[covering], mapped.start_triangles[mapped.target_triangles[covering]].ravel()])
    padded, coverage = pad_islands(laid, np.unique(laid.triangle_tiles[reached]).tolist())
    crisp = np.asarray((spans * layout.supersample <= UNSCALED).all(axis=1))
    mips = MipMaps.build(padded, levels, coverage, exact=exact, kind=kind)
    return mips, samples_for(spans / 2.0 ** levels[:, None]), crisp


def mip_levels(spans: FloatArray) -> NDArray[np.int64]:
    """(t1,) mip level for triangles of spans (t1, 2) in texels of the texture.

    The shorter span decides, so that nothing blurs along it; several samples cover the longer span, up to a limit.
    """
    shorter = np.floor(np.log2(np.maximum(spans.min(axis=1), 1.0)) + _LEVEL_SLACK)
    longer = np.ceil(np.log2(np.maximum(spans.max(axis=1), 1.0) / MAX_SAMPLES_PER_AXIS) - _LEVEL_SLACK)
    return np.asarray(np.maximum(shorter, longer), dtype=np.int64)


def pad_islands(laid: Texture, tiles: list[int]) -> tuple[Texture, dict[int, NDArray[np.bool_]]]:
    """The texture with its islands extended over the background; and the texels (h, w) of each tile that it covers.

    Lookups at borders of islands read the texels beside them. Those that have the background's colour (the median of
    all beside the islands) get the colour of the nearest island. Where the image is flat far from the islands, so do
    those that are nearer to that colour than to the island's: JPEG changes the background beside islands.
    """
    coverage, inside, padded = covered_texels(laid, tiles), covered_texels(laid, tiles, gutter=0.0), dict(laid.tiles)
    for tile, covered in coverage.items():
        pixels, beside = laid.tiles[tile], covered & ~inside[tile]
        sampled = (slice(None, None, 1 + max(covered.shape) // _SAMPLED_ROWS),) * 2
        colors, background = pixels[beside], pixels[sampled][~covered[sampled]]
        replaced = np.isclose(colors, _median(colors), rtol=0, atol=0, equal_nan=True).all(axis=1)
        typical = _median(background)
        is_flat = len(background) > 0 and bool((background == typical).all(axis=1).mean() > 0.5)
        if replaced.any() or is_flat:
            padded[tile] = pixels.copy()
            dilate(padded[tile], inside[tile], distance=_PADDING)
            if is_flat:
                is_background = _distances(colors, typical) < _distances(colors, padded[tile][beside])
                if 2 * is_background.sum() > len(is_background):  # else the texture has padding
                    replaced |= is_background
            beside[beside] = replaced
            np.copyto(padded[tile], pixels, where=~beside[..., None])
    return replace(laid, tiles=padded), coverage


def _median(colors: Pixels) -> Pixels:
    """(1, c) median of every channel of colours (k, c): one of their values, unlike NumPy's; NaN are last."""
    return np.sort(colors, axis=0)[len(colors) // 2 :][:1]


def _distances(colors: Pixels, others: Pixels) -> FloatArray:
    """(k,) distances between colours."""
    with np.errstate(invalid="ignore"):  # of infinite values
        return np.asarray(np.linalg.norm(colors.astype(np.float64) - others, axis=1))


def plain_lookups(laid: Texture, kind: Filter) -> MipMaps:
    """Lookups of a texture that is not minified."""
    padded, coverage = pad_islands(laid, np.unique(laid.triangle_tiles).tolist())
    return MipMaps.build(padded, np.zeros(0, dtype=np.int64), coverage, kind=kind)


def covered_texels(laid: Texture, tiles: list[int], gutter: float = GUTTER_RADIUS) -> dict[int, NDArray[np.bool_]]:
    """(h, w) by tile: texels covered by a texture's triangles and a border ``gutter`` texels wide."""
    neighbors = triangle_neighbors(laid.uv_triangles) if tiles else np.zeros((0, 3), dtype=np.int32)
    coverage = {}
    for tile in tiles:
        height, width = laid.tiles[tile].shape[:2]
        in_tile = laid.triangle_tiles == tile
        corners = laid.uvs[laid.uv_triangles] - udim_origin(tile)
        if tile == 0:  # a plain image repeats: move every triangle into the unit square
            corners = corners - tile_cells(corners)[:, None]
        corners[~in_tile] = 0.0
        rows = max(1, _BAND_TEXELS // width)
        coverage[tile] = _covered(lay_out(corners, neighbors, height, width, band_rows=rows, gutter=gutter))
    return coverage


def _covered(layout: Layout) -> NDArray[np.bool_]:
    covered = np.empty((layout.height, layout.width), dtype=np.bool_)

    def fill(bands: slice) -> None:
        for band in range(bands.start, bands.stop):
            covered[band * layout.band_rows : (band + 1) * layout.band_rows] = rasterize_band(layout, band) >= 0

    in_threads(fill, row_slices(len(layout.band_triangles), 1))
    return covered


def plan_samples(surface: MappedSurface, layout_corners: FloatArray, source_texels: FloatArray) -> NDArray[np.int32]:
    """(t1, 2) samples along x and y in a texel of each target triangle: one for each source texel of `texel_spans`."""
    return samples_for(texel_spans(surface, layout_corners, source_texels, locate_centers(surface)))


def samples_for(spans: FloatArray) -> NDArray[np.int32]:
    """(t1, 2) samples along x and y for spans (t1, 2) in texels of the source."""
    return np.clip(np.ceil(spans - UNSCALED + 1.0), 1, MAX_SAMPLES_PER_AXIS).astype(np.int32)


def texel_spans(
    surface: MappedSurface, layout_corners: FloatArray, source_texels: FloatArray, source: IndexArray
) -> FloatArray:
    """(t1, 2) texels of the source spanned by a texel of each target triangle, along x and y.

    With ``G`` the (2, 3) gradient of the source's texel coordinates (t2, 3, 2) on its triangle at the image of the
    centre, ``source`` (t1,), and ``Q`` the (3, 2) differential of the map from target texels (t1, 3, 2) to space, the
    columns of ``G Q`` say how many source texels a target texel spans along x and along y.
    """
    spans = np.empty((len(source), 2))

    def plan(part: slice) -> None:
        mapped = surface.mapped[surface.target_triangles[part]]
        sides = source_texels[source[part]]
        # Row i of the first product: source's barycentric coordinates 1 and 2 along the target triangle's edge i.
        slopes = np.einsum("tij,tkj->tik", mapped[:, 1:] - mapped[:, :1], surface.frames[source[part], 1:])
        texels = np.einsum("tik,tkj->tij", slopes, sides[:, 1:] - sides[:, :1])  # source texels along the edges
        corners = layout_corners[part]
        (x1, y1), (x2, y2) = (corners[:, 1:] - corners[:, :1]).transpose(1, 2, 0)
        area = x1 * y2 - x2 * y1
        scale = 1.0 / np.where(area == 0, np.inf, area)
        along_x = (texels[:, 0] * y2[:, None] - texels[:, 1] * y1[:, None]) * scale[:, None]
        along_y = (texels[:, 1] * x1[:, None] - texels[:, 0] * x2[:, None]) * scale[:, None]
        spans[part] = np.sqrt(np.stack([(along_x**2).sum(axis=1), (along_y**2).sum(axis=1)], axis=1))

    in_threads(plan, row_slices(len(source), _PLANNED_AT_ONCE))
    return spans
