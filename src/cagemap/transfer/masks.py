"""Masks in transfer: masks from images, the weight of every texel, and blending over a base image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, array_of
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import row_slices
from cagemap.subdivision import Level
from cagemap.transfer.baking import BakeOptions, Transfer, make_canvas, run_bake, to_dtype, unit
from cagemap.transfer.locate import TexelSamples, target_barycentric
from cagemap.transfer.texture import Pixels, lay_texture, look_up
from cagemap.transfer.textured_surface import TexturedSurface

# Rows of an image that are blended at a time.
_ROWS = 256


def painted_mask(level: Level, image: Pixels | Mapping[int, Pixels]) -> FloatArray:
    """(n,) mask of a level's vertices from an image painted over its UVs.

    The image's first channel, or the mean of its colours, times its alpha; where a seam gives a vertex several values,
    their mean.

    Parameters
    ----------
    level : Level
    image : (h, w) or (h, w, c) array, or such arrays by UDIM number
        Integers stand for 0 to 1.

    Raises
    ------
    ParameterError
        If the level has no texture coordinates, or the image has none of its tiles.
    """
    surface = TexturedSurface.from_level(level)
    laid = lay_texture(image, *surface.layout())
    count = len(surface.triangles)
    corners = np.tile(np.eye(3), (count, 1))
    triangle = np.repeat(np.arange(count), 3)
    each = TexelSamples(triangle.astype(np.int32), triangle, 1, 0, np.arange(3 * count + 1), triangle, corners)
    values = look_up(laid, each) / unit(laid.dtype)
    colors = values.shape[1] - (1 if values.shape[1] in (2, 4) else 0)
    grey = values[:, :colors].mean(axis=1) * (values[:, -1] if colors < values.shape[1] else 1.0)
    sums = np.bincount(surface.triangles.ravel(), grey, minlength=level.n_vertices)
    times = np.bincount(surface.triangles.ravel(), minlength=level.n_vertices)
    return np.clip(np.divide(sums, times, out=np.zeros(level.n_vertices), where=times > 0), 0.0, 1.0)


@kinds_checked
def bake_mask(transfer: Transfer, *, size: int | tuple[int, int], options: BakeOptions | None = None) -> Pixels:
    """Weight of every texel of the target: the product of both masks, linear in the triangles.

    Parameters
    ----------
    transfer : Transfer
    size : int or (height, width)
    options : BakeOptions, optional
        Those of the bake that it is for.

    Returns
    -------
    (height, width, 1) float32
    """
    options = options or BakeOptions()
    canvas = make_canvas(transfer, size, options)
    target, source = transfer.target, transfer.source
    mine = transfer.masks.of_target(len(target.positions))
    theirs = transfer.masks.of_source(len(source.positions))

    def shade(samples: TexelSamples) -> FloatArray:
        inside = target_barycentric(canvas.corners, samples)
        own = np.einsum("kc,kc->k", inside, mine[target.triangles[samples.target_triangle]])
        there = np.einsum("sc,sc->s", samples.barycentric, theirs[source.triangles[samples.triangle]])
        return own[:, None] * samples.mean(there[:, None])

    once = np.ones((len(target.triangles), 2), dtype=np.int32)
    return run_bake(transfer, canvas, once, shade, 1, np.float32, options)


def blend(baked: Pixels, base: Pixels, weight: Pixels) -> Pixels:
    """Blend a baked image over a base: ``base + weight (baked - base)``; exactly the base where the weight is 0.

    Parameters
    ----------
    baked, base : (h, w, c) arrays
        Of one number type.
    weight : (h, w, 1) float array

    Raises
    ------
    ParameterError
        If the images have other sizes, channels or number types.
    """
    baked, base, weight = array_of(baked), array_of(base), array_of(weight)
    if baked.shape != base.shape or baked.dtype != base.dtype:
        raise ParameterError(
            f"base image: expected {baked.shape[0]} x {baked.shape[1]} texels of {baked.shape[2]} channels, "
            f"{baked.dtype}, as what is baked, got {base.shape[0]} x {base.shape[1]} of {base.shape[2]}, {base.dtype}"
        )
    result = base.copy()
    for rows in row_slices(len(base), _ROWS):
        below = base[rows].astype(np.float64)
        mixed = to_dtype(below + weight[rows] * (baked[rows].astype(np.float64) - below), baked.dtype)
        result[rows] = np.where(weight[rows] > 0, mixed, base[rows])
    return result


def with_alpha(baked: Pixels, weight: Pixels) -> Pixels:
    """A baked image with the weight as alpha, multiplied into the alpha that it has.

    Parameters
    ----------
    baked : (h, w, c) array
        Of one to four channels.
    weight : (h, w, 1) float array

    Raises
    ------
    ParameterError
        If the weight has another size.
    """
    baked, weight = array_of(baked), array_of(weight)
    if np.ndim(baked) != 3 or np.shape(weight) != (*np.shape(baked)[:2], 1):
        raise ParameterError(
            f"expected an image (h, w, c) and a weight (h, w, 1) of its size, got {np.shape(baked)} and "
            f"{np.shape(weight)}"
        )
    one = unit(baked.dtype)
    has_alpha = baked.shape[2] in (2, 4)
    alpha = weight * (baked[..., -1:].astype(np.float64) if has_alpha else one)
    colors = baked[..., :-1] if has_alpha else baked
    return np.concatenate([colors, to_dtype(alpha, baked.dtype)], axis=2)
