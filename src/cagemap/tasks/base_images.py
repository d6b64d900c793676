"""`--base` of a bake: the target's own image outside the masks, or alpha without it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.images.image import Image, read_image, read_image_form, texture_files, udim_path, unpremultiply
from cagemap.maps.result import MatchResult
from cagemap.tasks.requests.transfer import TransferRequest, base_of
from cagemap.transfer import BakeOptions, Transfer
from cagemap.transfer.baking import convert_dtype
from cagemap.transfer.masks import bake_mask, blend, require_base_form, with_alpha

_log = logging.getLogger(__name__)
ImageSize = int | tuple[int, int]  # width and height, or height and width


def mask_function(
    request: TransferRequest, transfer: Transfer, name: str = ""
) -> Callable[[Image, BakeOptions], Image]:
    """Function that applies masks to a baked image: blend over the base image, or add alpha."""
    base = base_of(request, name)
    if not transfer.masks.any:
        return lambda image, _: image
    # Other bakes of a detailed mesh are interpolated between vertices.
    used = request.filter if name == "texture" or not request.bake else "smooth"
    return lambda image, options: _apply_mask(image, transfer, base, replace(options, filter=used))


def _apply_mask(image: Image, transfer: Transfer, base: Path | None, options: BakeOptions) -> Image:
    """A baked image blended over its tile's base image, or with weights as alpha."""
    weight = bake_mask(transfer, size=image.size, options=options)
    if base is None:
        image = unpremultiply(image)
        return replace(image, pixels=with_alpha(image.pixels, weight), channel_names=())
    under = read_image(udim_path(base, options.tile))
    if under.associated != image.associated:
        image, under = unpremultiply(image), unpremultiply(under)
    # Floats without a stated colour space are linear, as in EXR.
    spaces = [p.color_space or ("linear" if p.pixels.dtype.kind == "f" else "") for p in (under, image)]
    if all(spaces) and spaces[0] != spaces[1]:
        text = "--base %s is %s, what is baked over it %s: their numbers are mixed as they are. Convert one of them."
        _log.warning(text, base, *spaces)
    below = convert_dtype(under.pixels, image.pixels.dtype)
    if options.filter == "nearest":  # labels are not mixed
        weight = (weight >= 0.5).astype(weight.dtype)
    return replace(image, pixels=blend(image.pixels, below, weight))


def written_channels(request: TransferRequest, result: MatchResult, channels: int, name: str = "") -> int:
    """Channels of the image to write: one more if masks become alpha."""
    opaque = channels in (1, 3)
    return channels + 1 if result.masks.any and opaque and base_of(request, name) is None else channels


def base_size(request: TransferRequest, name: str = "") -> ImageSize | None:
    """Size of the base image; None without one."""
    base = base_of(request, name)
    if base is None or not texture_files(base):
        return None
    height, width = read_image_form(base)[2]
    return height if height == width else (height, width)


def base_scale_warnings(
    request: TransferRequest, result: MatchResult, dtype: np.dtype[Any], midlevel: float, name: str = ""
) -> list[str]:
    """A warning if the heights or offsets of a base image have another scale or midlevel than those over it.

    ``dtype``: of the image to write. Integers get a scale of their own; floats keep that of the source.
    ``midlevel``: its value of no displacement; of the base it is taken as usual.
    """
    base = base_of(request, name)
    if base is None or not result.masks.any:
        return []
    usual = 0.5 if read_image_form(base)[0].kind == "u" else 0.0
    if dtype.kind == "f" and midlevel == usual:
        return []
    units = "in the target's units" if request.bake else "with the scale of the source's image"
    return [
        f"--base {base} keeps its values: it and the baked heights may have different scales or midlevels in one "
        f"image. Write floats (.exr) over a base of floats, {units}"
    ]


def require_base(
    request: TransferRequest, result: MatchResult, size: ImageSize, channels: Sequence[int], name: str = ""
) -> None:
    """Refuse a base image of another size than that of the bake, or of other channels than one of ``channels``."""
    base = base_of(request, name)
    if base is None or not result.masks.any:
        return
    _, found, found_size = read_image_form(base)
    height, width = np.broadcast_to(size, 2).tolist()
    require_base_form(f"--base {base}", ((height, width), channels), (found_size, found))
