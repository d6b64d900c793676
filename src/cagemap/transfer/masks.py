"""Masks in bakes: masks from images, weights of texels, and blending over a base image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, array_of
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import row_slices
from cagemap.subdivision import Level
from cagemap.transfer.baking import Bake, BakeOptions, Transfer, make_layout, single_samples, to_dtype, unit
from cagemap.transfer.locate import TexelSamples, target_barycentric
from cagemap.transfer.lookups import plain_lookups
from cagemap.transfer.texture import Pixels, as_pixels, lay_texture
from cagemap.transfer.textured_surface import TexturedSurface

# Rows of an image that are blended at a time.
_ROWS = 256


def painted_mask(level: Level, image: Pixels | Mapping[int, Pixels]) -> FloatArray:
    """(n,) mask of a level's vertices from an image painted over its UVs.

    The image's first channel, or the mean of its colours, times its alpha. Vertices on seams get the mean of their
    values.

    Parameters
    ----------
    level : Level
    image : (h, w) or (h, w, c) array, or such arrays by UDIM number
        Integers stand for 0 to 1.

    Raises
    ------
    ParameterError
        If the level has no texture coordinates, or a tile of the image is missing.
    """
    surface = TexturedSurface.from_level(level)
    laid = lay_texture(image, *surface.layout())
    triangle = np.repeat(np.arange(len(surface.triangles)), 3)
    corners = np.tile(np.eye(3), (len(surface.triangles), 1))
    lookups = plain_lookups(laid, "linear")
    values = lookups.look_up(TexelSamples.of_points(triangle, triangle, corners)) / unit(laid.dtype)
    colors = values.shape[1] - (1 if values.shape[1] in (2, 4) else 0)
    grey = values[:, :colors].mean(axis=1) * (values[:, -1] if colors < values.shape[1] else 1.0)
    sums = np.bincount(surface.triangles.ravel(), grey, minlength=level.n_vertices)
    counts = np.bincount(surface.triangles.ravel(), minlength=level.n_vertices)
    return np.clip(sums / counts, 0.0, 1.0)


@kinds_checked
def bake_mask(transfer: Transfer, *, size: int | tuple[int, int], options: BakeOptions | None = None) -> Pixels:
    """Weight of every texel of the target: the product of both masks, linear in the triangles.

    Parameters
    ----------
    transfer : Transfer
    size : int or (height, width)
    options : BakeOptions, optional
        Options of the bake that the mask is for.

    Returns
    -------
    (height, width, 1) float32
    """
    options = options or BakeOptions()
    layout = make_layout(transfer, size, options)
    target, source = transfer.target, transfer.source
    target_mask = transfer.masks.of_target(len(target.positions))
    source_mask = transfer.masks.of_source(len(source.positions))

    def shade(samples: TexelSamples) -> FloatArray:
        inside = target_barycentric(layout.corners, samples)
        target_weight = np.einsum("kc,kc->k", inside, target_mask[target.triangles[samples.target_triangle]])
        source_weight = np.einsum("sc,sc->s", samples.barycentric, source_mask[source.triangles[samples.triangle]])
        return target_weight[:, None] * samples.mean(source_weight[:, None])

    return Bake(transfer, layout, options, np.dtype(np.float32), single_samples(transfer)).run(shade, 1)


def blend(baked: Pixels, base: Pixels, weight: Pixels) -> Pixels:
    """Blend a baked image over a base: ``base + weight (baked - base)``; weight 0 is exactly the base.

    Parameters
    ----------
    baked, base : (h, w, c) arrays
        Of one number type.
    weight : (h, w, 1) float array

    Raises
    ------
    ParameterError
        If sizes, channels or number types differ, or the images are of signed integers.
    """
    baked, weight = _image_and_weight(baked, weight)
    base = as_pixels(base)
    require_base_form("base image", (baked.shape[:2], baked.shape[2:]), (base.shape[:2], base.shape[2]))
    if baked.dtype != base.dtype:
        raise ParameterError(f"base image: expected {baked.dtype}, as what is baked, got {base.dtype}. Convert it.")
    result = base.copy()
    for rows in row_slices(len(base), _ROWS):
        below = base[rows].astype(np.float64)
        mixed = to_dtype(below + weight[rows] * (baked[rows].astype(np.float64) - below), baked.dtype)
        result[rows] = np.where(weight[rows] > 0, mixed, base[rows])
    return result


def require_base_form(
    name: str, baked: tuple[tuple[int, ...], Sequence[int]], base: tuple[tuple[int, ...], int]
) -> None:
    """Refuse a base image of another size or of other channels than what is baked.

    ``baked``: its (height, width), and the numbers of channels that a base may have.
    ``base``: (height, width) and channels.
    """
    ((height, width), channels), (size, found) = baked, base
    if size != (height, width) or found not in channels:
        raise ParameterError(
            f"{name}: expected {width} x {height} texels of {' or '.join(map(str, channels))} channels, as what is "
            f"baked, got {size[1]} x {size[0]} of {found}. Give the target's own image."
        )


def with_alpha(baked: Pixels, weight: Pixels) -> Pixels:
    """A baked image with the weight as alpha; an existing alpha is multiplied by it.

    Parameters
    ----------
    baked : (h, w, c) array
        Of one to four channels.
    weight : (h, w, 1) float array

    Raises
    ------
    ParameterError
        If the weight has another size, or the image is of signed integers.
    """
    baked, weight = _image_and_weight(baked, weight)
    full = unit(baked.dtype)
    has_alpha = baked.shape[2] in (2, 4)
    alpha = weight * (baked[..., -1:].astype(np.float64) if has_alpha else full)
    colors = baked[..., :-1] if has_alpha else baked
    return np.concatenate([colors, to_dtype(alpha, baked.dtype)], axis=2)


def _image_and_weight(baked: Pixels, weight: Pixels) -> tuple[Pixels, Pixels]:
    """An image (h, w, c) and its weight (h, w, 1) as arrays; refused if their sizes differ."""
    shapes = np.shape(array_of(baked)), np.shape(array_of(weight))
    if len(shapes[0]) != 3 or shapes[1] != (*shapes[0][:2], 1):
        raise ParameterError(
            f"expected an image (h, w, c) and a weight (h, w, 1) of its size, got {shapes[0]} and {shapes[1]}. "
            "Bake the mask with the size of the image."
        )
    return as_pixels(baked), array_of(weight)
