"""Scalar displacement maps: heights along the normal, scaled with the surfaces.

A displacement image defines height = (value - midlevel) * scale, in the length unit of its model; integer images hold
values from 0 to 1. A bump of the source keeps its shape on the target if its height is scaled like lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, array_of
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import row_slices
from cagemap.surface.triangles import triangle_areas
from cagemap.transfer.baking import BakeOptions, Transfer, bake_of_texture, output_dtype, unit
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.texture import Pixels, Texture, channel_range, each_tile, lay_texture

# Largest difference between the channels of a grey image saved in colour, as a share of the range: rounding.
_GREY = 1e-3
# Rows of an image whose channels are compared at a time.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Displacement:
    """A baked displacement: height = (value - midlevel) * scale in the target's length unit."""

    pixels: Pixels  #: (h, w, 1), or (h, w, 3) of vectors; integers stand for values from 0 to 1
    midlevel: float
    scale: float


@kinds_checked
def bake_displacement(
    transfer: Transfer,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    midlevel: float | None = None,
    scale: float = 1.0,
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Displacement:
    """Bake the source's displacement into the target's layout, scaled by the ratio of the surfaces.

    Heights are multiplied by sqrt(area of target / area of source). Float images get new values and keep the scale;
    integer images keep their values and get a new scale.

    Parameters
    ----------
    transfer : Transfer
    texture : (h, w, c) array, or such arrays by UDIM number
        Grey, also as equal colour channels; alpha is ignored.
    size : int or (height, width)
    midlevel : float, optional
        Value that means no displacement; by default 0.5 for integers and 0 for floats.
    scale : float
        Source height between the values 0 and 1, in the source's length unit.
    dtype : optional
        Number type of the result; by default the texture's.
    options : BakeOptions, optional

    Raises
    ------
    ParameterError
        If the image is not grey (see `bake_vector_displacement`), if its floats are not from 0 to 1 and ``dtype`` is
        of integers, or as `bake_texture`.
    """
    laid = lay_texture(each_tile(texture, to_grey), *transfer.source.layout())
    kept = output_dtype(dtype, laid.dtype)
    middle, factor, out_scale = stored_lengths(transfer, laid, kept, midlevel, scale)
    bake, mips = bake_of_texture(transfer, laid, size, kept, options)

    def shade(samples: TexelSamples) -> FloatArray:
        values = mips.look_up(samples) / unit(laid.dtype)
        if factor == 1.0:
            return np.asarray(values * unit(kept))
        return np.asarray((middle + (values - middle) * factor) * unit(kept))

    return Displacement(bake.run(shade, 1), middle, out_scale)


def stored_lengths(
    transfer: Transfer, laid: Texture, dtype: np.dtype[Any], midlevel: float | None, scale: float
) -> tuple[float, float, float]:
    """Midlevel of a displacement map, factor of its values relative to the midlevel, and scale of the result.

    Floats get new values, integers a new scale. Floats outside 0 to 1 are refused if integers are to hold them.
    """
    if scale == 0:
        raise ParameterError("scale: expected a number other than 0")
    if laid.dtype.kind == "f" and dtype.kind == "u":
        ends = [channel_range(pixels) for pixels in laid.tiles.values()]
        lowest, highest = min(float(low.min()) for low, _ in ends), max(float(high.max()) for _, high in ends)
        if lowest < 0.0 or highest > 1.0:
            raise ParameterError(
                f"displacement: expected values from 0 to 1 to store as integers, got {lowest:.4g} to {highest:.4g}. "
                "Write floats (.exr, .tif), or scale the values before."
            )
    middle = midlevel if midlevel is not None else 0.5 if laid.dtype.kind == "u" else 0.0
    return middle, *((1.0, scale * scale_ratio(transfer)) if dtype.kind == "u" else (scale_ratio(transfer), scale))


def scale_ratio(transfer: Transfer) -> float:
    """sqrt(area of target / area of source): factor from lengths of the source to lengths of the target."""
    areas = [triangle_areas(s.positions, s.triangles).sum() for s in (transfer.target, transfer.source)]
    return float(np.sqrt(areas[0] / areas[1]))


def to_grey(pixels: Pixels) -> Pixels:
    """One channel of a grey image; colour channels must be equal, alpha (channel 2 or 4) is ignored."""
    pixels = array_of(pixels)
    if pixels.ndim < 3 or pixels.shape[2] < 3:
        return pixels if pixels.ndim < 3 else pixels[:, :, :1]
    full, spread, largest = unit(pixels.dtype), 0.0, 0.0
    for rows in row_slices(len(pixels), _ROWS):
        colors = pixels[rows, :, :3].astype(np.float64)
        spread = max(spread, float(np.nanmax(np.ptp(colors, axis=2), initial=0.0)) / full)
        largest = max(largest, float(np.nanmax(np.abs(colors), initial=0.0)) / full)
    if spread > max(_GREY * largest, 2 / full if pixels.dtype.kind == "u" else 0.0):
        raise ParameterError(
            f"displacement: expected a grey image (heights along the normal), got channels that differ by up to "
            f"{spread:.3g}; vector displacement and normal maps cannot be baked as heights"
        )
    return pixels[:, :, :1]
