"""Checks and corrections of image files: several parts or pages, display windows, orientation, LAB colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError

Pixels = NDArray[Any]

_LARGEST_WINDOW = 1 << 16
# Numbers of "photometric interpretation" in TIFF files.
_LAB = (8, 9, 10)


def require_one_picture(file: Path, opened: Any) -> None:
    """Refuse an EXR of several parts or without a window, a TIFF of several pages, and LAB colours.

    Later pages that are smaller are thumbnails or reduced copies of the first one, and accepted.
    """
    spec, kind = opened.spec(), str(opened.format_name())
    if kind == "openexr":
        if opened.seek_subimage(1, 0) or not opened.seek_subimage(0, 0):
            raise FormatError(
                f"{file}: expected one picture, found an EXR of several parts. Export the one that is meant."
            )
        if not (0 < spec.full_width <= _LARGEST_WINDOW and 0 < spec.full_height <= _LARGEST_WINDOW):
            raise FormatError(
                f"{file}: expected a display window of 1 to {_LARGEST_WINDOW} texels a side, found {spec.full_width} x "
                f"{spec.full_height}. Export it again."
            )
    if kind == "tiff":
        if spec.getattribute("tiff:PhotometricInterpretation") in _LAB:
            raise FormatError(f"{file}: expected RGB or grey, found a TIFF of LAB colours. Convert it to RGB first.")
        page, smaller = 1, True
        while smaller and opened.seek_subimage(page, 0):
            next_page = opened.spec()
            page, smaller = page + 1, next_page.width < spec.width and next_page.height < spec.height
        if not smaller:
            raise FormatError(
                f"{file}: expected one picture, found a TIFF of several pages. Export the one that is meant."
            )
        opened.seek_subimage(0, 0)


def fit_to_display_window(pixels: Pixels, spec: Any) -> Pixels:
    """Pixels in the display window of an EXR, 0 outside its data window, which may be smaller or larger."""
    x, y, size = spec.x - spec.full_x, spec.y - spec.full_y, (spec.full_height, spec.full_width)
    if pixels.shape[:2] == size and x == y == 0:
        return pixels
    shown = np.zeros((*size, pixels.shape[2]), dtype=pixels.dtype)
    top, left = max(y, 0), max(x, 0)
    bottom, right = max(top, min(y + spec.height, size[0])), max(left, min(x + spec.width, size[1]))
    shown[top:bottom, left:right] = pixels[top - y : bottom - y, left - x : right - x]
    return shown


def apply_orientation(pixels: Pixels, orientation: int) -> Pixels:
    """Pixels rotated and mirrored by the orientation (1 to 8) of EXIF and TIFF, for display."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return np.ascontiguousarray(pixels[::rows, ::columns])


def shown_size(spec: Any, form: str) -> tuple[int, int]:
    """(height, width) of an image after `fit_to_display_window` and `apply_orientation`; ``form``: its format."""
    size = (spec.full_height, spec.full_width) if form == "openexr" else (spec.height, spec.width)
    return size[::-1] if int(spec.getattribute("Orientation") or 1) in (5, 6, 7, 8) else size
