"""Paints the pony: every feature is a soft-edged region of space or of the anatomy's scalars, laid over the last."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.example.canvas import Anatomy, Float32Array, Samples, fill_texture
from cagemap.example.modelling import Creature

COLORS = {
    "coat": "#EFC48D",
    "cream": "#FFF1D9",
    "stripe": "#6B3A4C",
    "mane": "#3C2A4D",
    "shine": "#6A4E7E",
    "hoof": "#3B2F36",
    "pink": "#F0A39B",
    "muzzle": "#E9A895",
    "nostril": "#6E3640",
    "white": "#FFFDF7",
    "iris": "#2B7C85",
    "pupil": "#1C1522",
    "blue": "#3C7DBE",
    "orange": "#EE8233",
    "star": "#FFCB3D",
    "badge": "#D2453E",
}
STRIPE_SPACING = 0.205
PAINT_RADIUS = 0.43
"""Radius of the barrel: what one radian of girth is worth in length."""


def paint_texture(creature: Creature, size: int = 2048) -> NDArray[np.uint8]:
    """Paint the pony's texture.

    One sees at a glance whether a map is right: eyes, nostrils, mouth, stripes that run on across the seams, a light
    belly, dark hooves; and left (blue socks, star) from right (orange socks, round badge).

    Returns
    -------
    (size, size, 3) uint8 sRGB
        Row 0 is v = 1; neutral outside the islands.
    """
    color = fill_texture(creature, size, 3, _skin)
    outside = ~color.any(axis=2)
    color[outside] = _rgb("coat")
    return np.round(np.clip(color, 0, 1) * 255).astype(np.uint8)


def paint_displacement(creature: Creature, size: int = 2048) -> Float32Array:
    """Paint the pony's scalar displacement: mane and tail ridges, raised badges and stripes, eyeballs, nostrils.

    Returns
    -------
    (size, size) float32
        Along the normal, in the mesh's length unit; at most about 0.02. Row 0 is v = 1.
    """
    return fill_texture(creature, size, 1, _relief)[:, :, 0]


def _rgb(name: str) -> Float32Array:
    code = COLORS[name]
    return np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.float32) / 255


def step(x: Float32Array, edge: float | Float32Array, softness: float) -> Float32Array:
    """0 below the edge, 1 above it, smooth over ``2 softness``."""
    t = np.clip((x - edge) / (2 * softness) + 0.5, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def _over(color: Float32Array, mask: Float32Array, name: str) -> None:
    """Lay a colour over, in place."""
    color += mask[:, None] * (_rgb(name) - color)


def _spot(samples: Samples, anatomy: Anatomy, name: str) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return coordinates (forward, up, distance off the plane) around a landmark, in its tangent plane."""
    normal = anatomy.normals[name]
    forward = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    forward /= np.linalg.norm(forward)
    up = np.cross(forward, normal) * np.sign(normal[0])
    offset = samples.points - anatomy.points[name].astype(np.float32)
    return tuple(offset @ axis.astype(np.float32) for axis in (forward, up, normal))  # type: ignore[return-value]


def _stripes(samples: Samples) -> Float32Array:
    """Bold stripes round the body and neck, thinning out towards the belly."""
    spine, girth = samples.channels["spine"], samples.channels["girth"]
    angle = np.arccos(np.clip(girth, -1, 1))
    phase = (spine + 0.05 * angle + 0.018 * np.sin(3.1 * angle + 7 * spine)) / STRIPE_SPACING
    distance = np.abs(phase - np.round(phase)) * STRIPE_SPACING
    width = 0.052 * np.clip((girth + 0.62) / 1.1, -0.2, 1)
    body = step(spine, 0.10, 0.01) * step(-spine, -2.62, 0.01)
    limbs = 1 - step(samples.channels["leg"] + samples.channels["ear"] + samples.channels["tail"], 0.08, 0.04)
    return step(width - distance, 0, samples.softness) * body * limbs


def _mane(samples: Samples) -> Float32Array:
    """A strip along the neck's back, scalloped, from withers to forelock."""
    spine, girth = samples.channels["spine"], samples.channels["girth"]
    scallop = 0.02 * np.abs(np.sin(spine * np.pi / 0.11))
    half_width = 0.17 + scallop
    away = np.arccos(np.clip(girth, -1, 1)) * 0.30
    along = step(spine, 1.50, 0.05) * step(-spine, -3.05, 0.05)
    return step(half_width * along - away, 0.02, samples.softness) * (1 - step(samples.channels["ear"], 0.05, 0.03))


def _star(x: Float32Array, y: Float32Array) -> Float32Array:
    """Signed distance-like function of a five-pointed star of radius 1, positive inside."""
    angle = np.arctan2(x, y)
    sector = np.abs(np.mod(angle + np.pi / 5, 2 * np.pi / 5) - np.pi / 5)
    radius = np.hypot(x, y)
    # In a sector the outline is the segment from the tip (radius 1) to the notch (radius 0.5, turned by 36 degrees).
    notch = 0.5 * np.array([np.sin(np.pi / 5), np.cos(np.pi / 5)])
    edge = notch - [0.0, 1.0]
    normal = np.array([-edge[1], edge[0]]) / np.linalg.norm(edge)
    return np.asarray(-(radius * np.sin(sector) * normal[0] + (radius * np.cos(sector) - 1) * normal[1]), np.float32)


def _skin(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """(q, 3) sRGB."""
    channels, soft = samples.channels, samples.softness
    girth, leg = channels["girth"], channels["leg"]
    color = np.tile(_rgb("coat"), (len(samples.points), 1))
    _over(color, 0.9 * step(-girth, 0.62, 0.16) * (1 - step(leg, 0.1, 0.1)), "cream")
    _over(color, _stripes(samples), "stripe")
    _over(color, _mane(samples), "mane")
    _paint_legs(color, samples)
    _over(color, step(channels["tail"], 0.20, 0.03), "mane")
    cup = step(channels["cup"], 0.3, 0.1) * step(channels["ear"], 0.28, 0.05)
    _over(color, cup, "pink")
    _paint_face(color, samples, anatomy)
    _paint_badges(color, samples, anatomy)
    return color


def _paint_legs(color: Float32Array, samples: Samples) -> None:
    leg, left = samples.channels["leg"], samples.points[:, 0] > 0
    sock = step(leg, 0.33, 0.006)
    _over(color, step(leg, 0.30, 0.006), "cream")
    _over(color, sock * left, "blue")
    _over(color, sock * ~left, "orange")
    _over(color, step(leg, 0.66, 0.01), "hoof")


def _paint_face(color: Float32Array, samples: Samples, anatomy: Anatomy) -> None:
    soft = samples.softness
    nose = anatomy.points["nose_tip"].astype(np.float32)
    from_nose = np.linalg.norm(samples.points - nose, axis=1)
    _over(color, step(-from_nose, -0.36, 0.05), "cream")
    for side, sign in (("L", 1), ("R", -1)):
        forward, up, off = _spot(samples, anatomy, f"eye_{side}")
        near = (np.abs(off) < 0.12) * (samples.points[:, 0] * sign > 0)
        up = up - 0.03
        radius = np.hypot(forward / 0.9, up)
        for name, size, dx, dy in (
            ("pupil", 0.118, 0.0, 0.0),
            ("white", 0.104, 0.0, 0.0),
            ("iris", 0.080, 0.012, 0.0),
            ("pupil", 0.054, 0.016, 0.0),
            ("white", 0.022, 0.040, 0.030),
        ):
            disc = np.hypot((forward - dx) / 0.9, up - dy)
            _over(color, step(size - disc, 0, soft) * near * (radius < 0.118 + soft), name)
        blush = np.hypot((forward + 0.01) / 1.2, up + 0.20)
        _over(color, 0.55 * step(0.06 - blush, 0, 0.04) * near, "pink")
        nostril = nose + np.array([sign * 0.095, 0.07, -0.02], np.float32)
        hole = np.linalg.norm((samples.points - nostril) / np.array([0.034, 0.045, 0.06], np.float32), axis=1)
        _over(color, step(1 - hole, 0, soft / 0.04), "nostril")
    # The mouth: a smile, a line around the muzzle that rises at its ends.
    height = samples.points[:, 1] - (nose[1] - 0.115 + 0.9 * samples.points[:, 0] ** 2 + 0.0 * from_nose)
    mouth = (
        step(0.011 - np.abs(height), 0, soft) * step(0.24 - from_nose, 0, soft) * (samples.points[:, 2] > nose[2] - 0.2)
    )
    _over(color, mouth, "nostril")


def _paint_badges(color: Float32Array, samples: Samples, anatomy: Anatomy) -> None:
    soft = samples.softness
    centre = anatomy.points["withers"] + [0.0, -0.42, -0.02]
    forward, up = samples.points[:, 2] - np.float32(centre[2]), samples.points[:, 1] - np.float32(centre[1])
    body = 1 - step(samples.channels["leg"], 0.3, 0.05)
    left = (samples.points[:, 0] > 0) * body
    right = (samples.points[:, 0] < 0) * body
    radius = np.hypot(forward, up)
    _over(color, step(0.215 - radius, 0, soft) * (left + right), "cream")
    star = 0.19 * _star(forward / 0.19, (up + 0.005) / 0.19)
    _over(color, step(star, -0.016, soft) * left, "mane")
    _over(color, step(star, 0, soft) * left, "star")
    for size, name in ((0.165, "badge"), (0.115, "cream"), (0.07, "badge")):
        _over(color, step(size - radius, 0, soft) * right, name)


def _relief(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """(q, 1) displacement."""
    channels = samples.channels
    mane, tail = _mane(samples), step(channels["tail"], 0.20, 0.06)
    angle = np.arctan2(samples.points[:, 0], channels["girth"])
    height = 0.012 * mane * (1 + 0.5 * np.sin(2 * np.pi * channels["spine"] / 0.055))
    height += 0.010 * tail * np.sin(8 * angle + 20 * channels["tail"])
    height += 0.004 * _stripes(samples)
    return np.asarray(height[:, None], dtype=np.float32)
