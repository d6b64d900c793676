"""Colours of landmarks: the same number has the same colour on both models and in the list."""

from __future__ import annotations

from cagemap.pictures.colors import distinct_colors

_COUNT = 64
_PALETTE = [tuple(round(255 * channel) for channel in color) for color in distinct_colors(_COUNT).tolist()]

Color = tuple[int, int, int]


def landmark_color(number: int) -> Color:
    """SRGB colour of a landmark."""
    red, green, blue = _PALETTE[(number - 1) % _COUNT]
    return red, green, blue


def css(color: Color) -> str:
    """The same for a style sheet."""
    return "#{:02x}{:02x}{:02x}".format(*color)
