"""Bake images: every texel of the target takes the source's value at its image under T12.

    texel -> point of the target -> T12 -> point of the source -> value there

Each arrow is a function of its own module: `texels` rasterises, `locate` follows the map, and a *shade* function
gives the value at the source points. This module runs them over bands of the image, in threads, and fills the
background.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cagemap.errors import ParameterError
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.point_map import PointMap
from cagemap.mesh.control_mesh import MIN_UV_AREA
from cagemap.mesh.udim import udim_of, udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, shown
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.subdivision import Level
from cagemap.surface.triangles import triangle_areas, triangle_neighbors
from cagemap.transfer.locate import (
    MappedSurface,
    TexelSamples,
    locate_samples,
    map_surface,
)
from cagemap.transfer.lookups import plan_lookups
from cagemap.transfer.mip_maps import MipMaps
from cagemap.transfer.texels import GUTTER_RADIUS, LARGEST_SIDE, Layout, TriangleImage, dilate, lay_out, rasterize_band
from cagemap.transfer.texture import Filter, Pixels, Texture, lay_texture, tile_cells
from cagemap.transfer.textured_surface import TexturedSurface

Shade = Callable[[TexelSamples], FloatArray]

# Texels per band, the work of one thread at a time: about 100 bytes each.
_BAND_TEXELS = 1 << 18
# Samples located at a time within a band: 60 bytes each.
_SAMPLE_BUDGET = 1 << 20


@dataclass(frozen=True, eq=False)
class Transfer:
    """A match prepared for bakes; one serves many images."""

    target: TexturedSurface
    source: TexturedSurface
    point_map: PointMap  #: T12, from the target's vertices to the source's triangles
    mapped: MappedSurface  #: images of the target's vertices, and the source as triangles to walk over
    masks: Masks = WHOLE  #: weights of both surfaces' vertices, see `cagemap.transfer.masks`

    def __repr__(self) -> str:
        return f"Transfer({self.point_map})"


@dataclass(frozen=True)
class BakeOptions:
    """Options of every bake of an image.

    Attributes
    ----------
    tile : int
        UDIM number of the tile to bake, or 0 for the unit square of a plain layout.
    supersample : int, optional
        Raster samples along a texel's side. Default: 1, or 3 or 5 if triangles are smaller than texels. With odd
        numbers, texels that span at most one texel of the source use their centre alone. With filter "nearest": 1.
    dilation : int, optional
        Width in texels of the filled border around islands; the whole background by default.
    filter : "smooth", "linear" or "nearest"
        Interpolation of textures that are not minified. Nearest is for labels: colours are never mixed.
    """

    tile: int = 0
    supersample: int | None = None
    dilation: int | None = None
    filter: Filter = "smooth"

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.tile != 0 and not 1001 <= self.tile <= 1999:
            raise ParameterError(f"tile: expected 0 or a UDIM number from 1001 on, got {self.tile}")
        if self.supersample is not None and not 1 <= self.supersample <= 16:
            raise ParameterError(f"supersample: expected 1 to 16 samples along a texel's side, got {self.supersample}")
        if self.filter == "nearest" and (self.supersample or 1) > 1:
            raise ParameterError(f"supersample: expected 1 with filter nearest (labels), got {self.supersample}")
        if self.dilation is not None and self.dilation < 0:
            raise ParameterError(f"dilation: expected 0 or more texels, got {self.dilation}")
        if self.filter not in get_args(Filter):
            raise ParameterError(f"filter: expected {', '.join(get_args(Filter))}, got {self.filter!r}")


@kinds_checked
def prepare_transfer(
    target: Level,
    source: Level,
    point_map: PointMap,
    masks: Masks = WHOLE,
    holes: NDArray[np.bool_] | None = None,
) -> Transfer:
    """Prepare a match for bakes.

    Parameters
    ----------
    target, source : Level
        Refined levels of the point map.
    point_map : PointMap
    masks : Masks
        Weights of both surfaces' vertices.
    holes : (m1,) bool, optional
        Target faces that get no texels, see `Refinement.holes`.

    Raises
    ------
    ParameterError
        If the map or the masks do not fit the two levels.
    """
    target_surface, source_surface = TexturedSurface.from_level(target, holes), TexturedSurface.from_level(source)
    expected, sides = (target_surface, source_surface), (point_map.target, point_map.source)
    sizes = [[(len(side.positions), len(side.triangles)) for side in both] for both in (expected, sides)]
    if sizes[0] != sizes[1]:
        raise ParameterError(
            f"expected a map between surfaces of {sizes[0]} vertices and triangles, those of the two levels, got "
            f"{sizes[1]}; are target and source exchanged, or of other levels?"
        )
    mapped = map_surface(target_surface, source_surface, point_map)
    masks.require_fit(len(target_surface.positions), len(source_surface.positions))
    return Transfer(target_surface, source_surface, point_map, mapped, masks)


def target_tiles(target: TexturedSurface) -> list[int]:
    """UDIM numbers of the target layout's tiles, ascending; [0] for the unit square alone."""
    cells = layout_cells(target)
    return [int(tile) for tile in np.unique(udim_of(cells))] if cells.any() else [0]


def layout_cells(target: TexturedSurface) -> FloatArray:
    """(k, 2) lower left corners of the tiles of all triangles that are laid out; of all triangles if none is."""
    corners, laid = target.corner_uvs(), _is_laid_out(target)
    return tile_cells(corners[laid] if laid.any() else corners)


@kinds_checked
def bake_texture(
    transfer: Transfer,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the source's texture into the target's layout.

    Parameters
    ----------
    transfer : Transfer
    texture : (h, w, c) array, or such arrays by UDIM number
        Row 0 at the top (v = 1).
    size : int or (height, width)
        Of the image to bake, in texels.
    dtype : optional
        Number type of the result; by default the texture's. Integers stand for the range 0 to 1.
    options : BakeOptions, optional

    Returns
    -------
    (height, width, c) array

    Raises
    ------
    ParameterError
        If target or source have no texture coordinates, or the image or its size is invalid.
    """
    laid = lay_texture(texture, *transfer.source.layout())
    kept = output_dtype(dtype, laid.dtype)
    bake, mips = bake_of_texture(transfer, laid, size, kept, options)
    scale = unit(kept) / unit(laid.dtype)
    return bake.run(mips.look_up, laid.channels, lambda values: scale * values)


def make_layout(transfer: Transfer, size: int | tuple[int, int], options: BakeOptions) -> Layout:
    """The target's UV triangles of one tile, on a raster ``supersample`` times finer than the image."""
    target = transfer.target
    sides: Any = (size, size) if np.ndim(size) == 0 else size
    try:
        height, width = map(operator.index, sides)
    except (TypeError, ValueError):
        raise ParameterError(
            f"size: expected a whole number of texels a side, or (height, width), got {shown(size)}"
        ) from None
    if not (0 < height <= LARGEST_SIDE and 0 < width <= LARGEST_SIDE):
        raise ParameterError(f"size: expected 1 to {LARGEST_SIDE} texels a side, got {height} x {width}")
    corner_uvs = target.corner_uvs() - udim_origin(options.tile)
    neighbors = triangle_neighbors(target.layout()[1])
    if target.holes is not None:
        # Triangles of holes shrink to a point, so that they cover no texel; their edges become island borders.
        corner_uvs[target.holes] = corner_uvs[target.holes, :1]
        neighbors = np.where(target.holes[neighbors], -1, neighbors)
    _require_covered(target, corner_uvs, options.tile)
    supersample = options.supersample or (1 if options.filter == "nearest" else _supersample(target, height, width))
    band_rows = max(1, _BAND_TEXELS // (width * supersample * supersample)) * supersample
    return lay_out(
        corner_uvs,
        neighbors,
        height * supersample,
        width * supersample,
        masked_corners(transfer) if transfer.masks.any else None,
        band_rows=band_rows,
        gutter=GUTTER_RADIUS * supersample,
        supersample=supersample,
    )


def masked_corners(transfer: Transfer) -> IndexArray:
    """(t1,) number of corners of target triangles to which the masks give the weight 0."""
    weights = transfer.masks.joint(transfer.point_map)
    return np.asarray(np.count_nonzero(weights[transfer.target.triangles] == 0.0, axis=1))


def masked_faces(transfer: Transfer) -> NDArray[np.bool_] | None:
    """(m1,) whether the masks give all of a target's control face the weight 0; None without masks."""
    target = transfer.target
    if not transfer.masks.any:
        return None
    masked = np.ones(int(target.face_parents.max()) + 1, dtype=np.bool_)
    masked[target.face_parents[target.triangle_faces[masked_corners(transfer) < 3]]] = False
    return masked


def _is_laid_out(target: TexturedSurface) -> NDArray[np.bool_]:
    """(t1,) whether a triangle has an area in the layout, and is no hole."""
    laid = np.asarray(triangle_areas(*target.layout()) > MIN_UV_AREA)
    return laid if target.holes is None else laid & ~target.holes


def _require_covered(target: TexturedSurface, corner_uvs: FloatArray, tile: int) -> None:
    """Require that some triangle covers a part of the tile: otherwise its image would be black."""
    laid = _is_laid_out(target)
    outside = (corner_uvs.max(axis=1) <= 0.0).any(axis=1) | (corner_uvs.min(axis=1) >= 1.0).any(axis=1)
    if not np.any(laid & ~outside):
        place = f"UDIM tile {tile}" if tile else "the unit square"
        n_flat, n_outside = np.count_nonzero(~laid), np.count_nonzero(laid & outside)
        raise ParameterError(
            f"expected texture coordinates of the target that cover a part of {place}, got {len(laid)} triangles, "
            f"{n_flat} of them in one point, on a line or in hole faces and {n_outside} outside. Move the layout "
            "there, or make another one (`unwrap`)."
        )


@dataclass(frozen=True, eq=False)
class Bake:
    """An image that is baked: its layout, its samples and its number type."""

    transfer: Transfer
    layout: Layout
    options: BakeOptions
    dtype: np.dtype[Any]  # integers are rounded and clipped
    counts: NDArray[np.int32]  # (t1, 2) samples along x and y in every raster cell of a target triangle
    # (t1,) whether a texel spans at most one texel of the source: its centre alone is sampled
    crisp: NDArray[np.bool_] | None = None

    def run(self, shade: Shade, channels: int, encode: Callable[[FloatArray], FloatArray] = np.asarray) -> Pixels:
        """Rasterise, locate and shade band by band, then fill the background.

        ``shade``, called from several threads, gives values (k, channels) of the k cells of samples, which are averaged
        over each texel; ``encode`` stored values of these means.
        """
        layout, finer = self.layout, self.layout.supersample
        image = np.zeros((layout.height // finer, layout.width // finer, channels), dtype=self.dtype)
        covered = np.zeros(image.shape[:2], dtype=np.bool_)
        rows = layout.band_rows // finer

        def bake_band(band: int) -> None:
            cells = rasterize_band(layout, band)
            if self.crisp is not None and finer % 2 == 1:
                _keep_centres(cells, finer, self.crisp)
            part = slice(band * rows, band * rows + cells.shape[0] // finer)
            texels = np.flatnonzero(cells.ravel() >= 0)
            if len(texels) == 0:
                return
            values = self._shade_cells(shade, cells.ravel()[texels], texels, band * layout.band_rows)
            if finer > 1:
                texels, values = _average_cells(texels, values, cells.shape, finer)
            image[part].reshape(-1, channels)[texels] = to_dtype(encode(values), image.dtype)
            covered[part].reshape(-1)[texels] = True

        in_threads(bake_band, range(len(layout.band_triangles)))
        dilate(image, covered, distance=self.options.dilation)
        return image

    def _shade_cells(self, shade: Shade, triangle: NDArray[np.int32], cells: IndexArray, top: int) -> FloatArray:
        """(k, c) values of raster cells, given by their flat index in a band that starts at row ``top``."""
        layout, along = self.layout, self.counts[triangle]
        most = int((along[:, 0] * along[:, 1]).max())
        rows = max(1, _SAMPLE_BUDGET // (layout.width * most))
        starts = np.arange(0, cells[-1] + 1, rows * layout.width)
        values = []
        for begin, end in pairwise(np.append(np.searchsorted(cells, starts), len(cells))):
            if begin == end:
                continue
            part = slice(begin, end)
            samples = locate_samples(
                self.transfer.mapped, layout.corners, cells[part], layout.width, top, triangle[part], self.counts
            )
            values.append(shade(samples))
        return np.concatenate(values) if len(values) > 1 else values[0]


def bake_of_texture(
    transfer: Transfer,
    laid: Texture,
    size: int | tuple[int, int],
    dtype: np.dtype[Any],
    options: BakeOptions | None,
    *,
    exact: bool = False,
) -> tuple[Bake, MipMaps]:
    """The bake of a texture of the source, and the texture's mip maps; ``exact`` is as of `MipMaps.build`."""
    options = options or BakeOptions()
    layout = make_layout(transfer, size, options)
    mips, counts, crisp = plan_lookups(transfer.mapped, layout, laid, exact=exact, kind=options.filter)
    return Bake(transfer, layout, options, dtype, counts, crisp), mips


def single_samples(transfer: Transfer) -> NDArray[np.int32]:
    """(t1, 2) one sample in every raster cell."""
    return np.ones((len(transfer.target.triangles), 2), dtype=np.int32)


def _keep_centres(cells: TriangleImage, finer: int, crisp: NDArray[np.bool_]) -> None:
    """Remove all but the middle cell of texels whose middle cell lies in a crisp triangle."""
    blocks = cells.reshape(cells.shape[0] // finer, finer, -1, finer)
    middle = blocks[:, finer // 2, :, finer // 2].copy()
    enough = (middle >= 0) & crisp[middle]
    blocks[np.broadcast_to(enough[:, None, :, None], blocks.shape)] = -1
    blocks[:, finer // 2, :, finer // 2] = middle


def _average_cells(
    cells: IndexArray, values: FloatArray, shape: tuple[int, ...], finer: int
) -> tuple[IndexArray, FloatArray]:
    """Texels with a covered cell, and mean values of their covered cells."""
    rows, columns = np.divmod(cells, shape[1])
    texel_of_cell = (rows // finer) * (shape[1] // finer) + columns // finer
    texels, inverse, counts = np.unique(texel_of_cell, return_inverse=True, return_counts=True)
    return texels, grouped_sums(inverse, values, len(texels)) / counts[:, None]


def to_dtype(values: FloatArray, dtype: np.dtype[Any]) -> Pixels:
    """Convert values to a number type; integers are rounded and clipped to its range."""
    if dtype.kind != "u":
        return values.astype(dtype)
    rounded = np.rint(values)
    np.clip(rounded, 0, np.iinfo(dtype).max, out=rounded)
    return rounded.astype(dtype)


def convert_dtype(pixels: Pixels, dtype: np.dtype[Any]) -> Pixels:
    """Pixels of another number type, of the same intensities."""
    return pixels if pixels.dtype == dtype else to_dtype(pixels * (unit(dtype) / unit(pixels.dtype)), dtype)


def output_dtype(dtype: Any, given: np.dtype[Any] | None = None) -> np.dtype[Any]:
    """Dtype that was asked for; if None, the dtype of the pixels that are given."""
    return np.dtype(given if dtype is None else dtype)


def unit(dtype: np.dtype[Any]) -> float:
    """Value of full intensity: the largest integer, or 1 for floats."""
    return float(np.iinfo(dtype).max) if dtype.kind == "u" else 1.0


def _supersample(target: TexturedSurface, height: int, width: int) -> int:
    """Raster samples along a texel's side, so that a typical triangle holds at least one."""
    areas = width * height * triangle_areas(*target.layout())
    areas = areas[areas > 0]
    typical = float(np.median(areas)) if len(areas) else 1.0
    return 1 if typical >= 1.0 else 3 if typical >= 1.0 / 9.0 else 5
