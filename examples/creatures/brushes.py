"""Soft-edged shapes and colours: what the pony is painted with."""

from __future__ import annotations

import numpy as np
from examples.creatures.canvas import Float32Array

from cagemap.numerics.arrays import FloatArray

PALETTE = {
    "coat": "#F0C88F",
    "cream": "#FFF3DD",
    "stripe": "#6B3A4C",
    "mane": "#3D2B50",
    "shine": "#5B4573",
    "hoof": "#3B2F36",
    "pink": "#F0A39B",
    "nostril": "#6E3640",
    "white": "#FFFDF7",
    "iris": "#2B7C85",
    "iris light": "#63B8B4",
    "pupil": "#1C1522",
    "blue": "#3C7DBE",
    "orange": "#EE8233",
    "star": "#FFCB3D",
    "badge": "#D2453E",
}
"""sRGB. Left is blue and gold, right is orange and red."""


def rgb(name: str) -> Float32Array:
    """(3,) sRGB in [0, 1] of a palette entry."""
    code = PALETTE[name]
    return (np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255).astype(np.float32)


def rise(x: Float32Array | FloatArray, edge: float, softness: float) -> Float32Array:
    """(q,) 0 well below the edge, 1 well above it; a cubic in between, over ``2 softness``."""
    t = np.clip((x - np.float32(edge)) / np.float32(2 * softness) + np.float32(0.5), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def lay_over(color: Float32Array, mask: Float32Array, name: str) -> None:
    """Lay a palette colour over (q, 3) colours, in place, where the (q,) mask is not zero."""
    here = np.flatnonzero(mask)
    color[here] += mask[here, None] * (rgb(name) - color[here])


def star(x: Float32Array, y: Float32Array) -> Float32Array:
    """(q,) distance inside (> 0) a five-pointed star of radius 1 on two feet, to the nearest side's line."""
    sector = np.abs(np.mod(np.arctan2(x, y) + np.pi / 5, 2 * np.pi / 5) - np.pi / 5)
    radius = np.hypot(x, y)
    # In a sector the outline is one segment, from the tip (radius 1) to the notch (radius 0.5, turned by 36 degrees).
    tip, notch = np.array([0.0, 1.0]), 0.5 * np.array([np.sin(np.pi / 5), np.cos(np.pi / 5)])
    inward = np.array([(notch - tip)[1], -(notch - tip)[0]]) / np.linalg.norm(notch - tip)
    return np.asarray(inward[0] * (radius * np.sin(sector)) + inward[1] * (radius * np.cos(sector) - 1), np.float32)
