"""Paints the pony: every feature is a soft-edged region of space or of the anatomy's scalars, laid over the last."""

from __future__ import annotations

import numpy as np
from examples.creatures.brushes import lay_over, rgb, rise, star
from examples.creatures.canvas import Anatomy, Float32Array, Samples, fill_texture
from examples.creatures.modelling import Creature
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray

STRIPE_SPACING = 0.205
BADGE_RADIUS = 0.215
EYE_RADIUS = 0.122
SIDES = (("L", 1.0), ("R", -1.0))


def paint_texture(creature: Creature, size: int = 2048) -> NDArray[np.uint8]:
    """Paint the pony's texture.

    One sees at a glance whether a map is right: eyes, nostrils, mouth, stripes that run on across the seams, a light
    belly, dark hooves; and left (blue socks, star) from right (orange socks, round badge).

    Returns
    -------
    (size, size, 3) uint8 sRGB
        Row 0 is v = 1; the coat's colour outside the islands.
    """
    color = fill_texture(creature, size, 3, _color)
    color[~color.any(axis=2)] = rgb("coat")
    return (color * 255 + 0.5).astype(np.uint8)


def paint_displacement(creature: Creature, size: int = 2048) -> Float32Array:
    """Paint the pony's scalar displacement: locks of mane and tail, raised badges, domed eyes, nostrils, ribs.

    Returns
    -------
    (size, size) float32
        Along the normal, in the mesh's length unit; between -0.02 and 0.03. Row 0 is v = 1; 0 outside the islands.
    """
    return fill_texture(creature, size, 1, _relief)[:, :, 0]


def _color(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """(q, 3) sRGB in [0, 1]."""
    channels = samples.channels
    color = np.tile(rgb("coat"), (len(samples.points), 1))
    lay_over(color, rise(-channels["girth"], 0.62, 0.16) * (1 - rise(channels["leg"], 0.1, 0.1)), "cream")
    lay_over(color, _stripes(samples, anatomy), "stripe")
    mane = _mane(samples, anatomy)
    lay_over(color, mane, "mane")
    lay_over(color, 0.5 * mane * rise(_locks(samples), 0.55, 0.2), "shine")
    _paint_legs(color, samples)
    _paint_tail(color, samples)
    _paint_ears(color, samples)
    _paint_face(color, samples, anatomy)
    _paint_badges(color, samples, anatomy)
    return color


def _angle(samples: Samples) -> Float32Array:
    """(q,) angle from the back: 0 on top, pi under the belly."""
    return np.asarray(np.arccos(np.clip(samples.channels["girth"], -1, 1)), dtype=np.float32)


def _stripes(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """Bold stripes round the body and neck, tapering to a point towards the belly and above the legs."""
    channels = samples.channels
    spine, angle = channels["spine"], _angle(samples)
    phase = (spine + 0.05 * angle + 0.018 * np.sin(3.1 * angle + 7 * spine)) / STRIPE_SPACING
    distance = np.abs(phase - np.round(phase)) * STRIPE_SPACING
    limbs = channels["leg"] + channels["tail"] + channels["ear"]
    taper = np.clip((channels["girth"] + 0.62) / 1.1, -0.2, 1) - 1.3 * limbs
    ends = np.minimum(spine - 0.12, anatomy.spine["throat"] + 0.28 - spine) / 0.1
    return rise(0.052 * np.minimum(taper, ends) - distance, 0, samples.softness)


def _mane(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """A scalloped strip along the neck's back, from a point at the withers to a forelock between the eyes."""
    spine = samples.channels["spine"]
    begin, end = anatomy.spine["withers"] - 0.12, anatomy.spine["eye_L"] + 0.16
    half_width = 0.065 + 0.016 * np.abs(np.sin(spine * np.pi / 0.12)) + 0.05 * rise(spine, anatomy.spine["poll"], 0.15)
    half_width *= np.minimum(1, np.sqrt(np.clip(np.minimum((spine - begin) / 0.3, (end - spine) / 0.40), 0, None)))
    hair = rise(half_width - np.abs(samples.points[:, 0]), 0, samples.softness) * (spine > begin) * (spine < end)
    return hair * (samples.channels["girth"] > 0) * (1 - rise(samples.channels["ear"], 0.05, 0.03))


def _locks(samples: Samples) -> Float32Array:
    """(q,) strands of hair in [0, 1]: fine waves along the mane."""
    spine, angle = samples.channels["spine"], _angle(samples)
    wave = np.sin(2 * np.pi * spine / 0.06 + 9 * angle)
    return np.asarray(0.5 + 0.5 * wave, dtype=np.float32)


def _paint_legs(color: Float32Array, samples: Samples) -> None:
    """Socks with a light hem, blue on the left and orange on the right, and hooves."""
    here = np.flatnonzero(samples.channels["leg"] > 0.25)
    paint, leg = color[here], samples.channels["leg"][here]
    left = (samples.points[here, 0] > 0).astype(np.float32)
    lay_over(paint, rise(leg, 0.295, 0.006), "cream")
    sock = rise(leg, 0.335, 0.006)
    lay_over(paint, sock * left, "blue")
    lay_over(paint, sock * (1 - left), "orange")
    lay_over(paint, rise(leg, 0.66, 0.01), "hoof")
    color[here] = paint


def _tail_strands(samples: Samples) -> tuple[Float32Array, Float32Array]:
    """Return how much of a point is tail hair, and its strands in [0, 1]."""
    tail = samples.channels["tail"]
    strands = 0.5 + 0.5 * np.sin(8 * _angle(samples) + 5 * tail)
    return rise(tail + 0.05 * strands, 0.22, 0.01), strands.astype(np.float32)


def _paint_tail(color: Float32Array, samples: Samples) -> None:
    here = np.flatnonzero(samples.channels["tail"] > 0.1)
    paint = color[here]
    hair, strands = _tail_strands(samples.select(here))
    lay_over(paint, hair, "mane")
    lay_over(paint, 0.7 * hair * rise(strands, 0.62, 0.2), "shine")
    color[here] = paint


def _paint_ears(color: Float32Array, samples: Samples) -> None:
    """Pink inside, dark at the tip."""
    here = np.flatnonzero(samples.channels["ear"] > 0.1)
    paint, ear = color[here], samples.channels["ear"][here]
    lay_over(paint, rise(samples.channels["cup"][here], 0.3, 0.1) * rise(ear, 0.28, 0.05), "pink")
    lay_over(paint, rise(ear, 0.82, 0.03), "mane")
    color[here] = paint


def _paint_face(color: Float32Array, samples: Samples, anatomy: Anatomy) -> None:
    """Light muzzle with nostrils and a smile, two eyes, blushing cheeks."""
    nose = anatomy.points["nose_tip"]
    here, face = samples.near(nose, 0.45)
    paint = color[here]
    lay_over(paint, rise(-np.linalg.norm(face.points - nose, axis=1).astype(np.float32), -0.36, 0.05), "cream")
    for _, sign in SIDES:
        lay_over(paint, _nostril(face, nose, sign), "nostril")
    lay_over(paint, _mouth(face, nose), "nostril")
    color[here] = paint
    for side, sign in SIDES:
        here, face = samples.near(anatomy.points[f"eye_{side}"], 0.35)
        paint = color[here]
        _paint_eye(paint, face, anatomy, f"eye_{side}", sign)
        color[here] = paint


def _nostril(samples: Samples, nose: FloatArray, sign: float) -> Float32Array:
    """(q,) inside of an ellipsoid beside the tip of the nose."""
    centre = nose + np.array([sign * 0.10, 0.075, -0.02])
    hole = np.linalg.norm((samples.points - centre) / [0.034, 0.045, 0.06], axis=1)
    return rise(1 - hole.astype(np.float32), 0, samples.softness / 0.04)


def _mouth(samples: Samples, nose: FloatArray) -> Float32Array:
    """(q,) a smile: a line around the muzzle that rises towards its ends."""
    _, up, ahead = (samples.points - nose.astype(np.float32)).T
    away = np.linalg.norm(samples.points - nose, axis=1).astype(np.float32)
    line = 0.011 - np.abs(up + 0.115 - 1.6 * ahead * ahead)
    return rise(line, 0, samples.softness) * rise(-away, -0.27, 2 * samples.softness)


def _tangent_coordinates(samples: Samples, anatomy: Anatomy, name: str) -> tuple[Float32Array, Float32Array]:
    """(q,) forward and up from a landmark, in the tangent plane there."""
    normal = anatomy.normals[name]
    forward = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    forward /= np.linalg.norm(forward)
    up = np.cross(forward, normal) * np.sign(normal[0])
    offset = samples.points - anatomy.points[name].astype(np.float32)
    return offset @ forward.astype(np.float32), offset @ up.astype(np.float32)


def _paint_eye(color: Float32Array, samples: Samples, anatomy: Anatomy, name: str, sign: float) -> None:
    """Rim, white, iris, pupil and two highlights; a blush under it."""
    forward, up = _tangent_coordinates(samples, anatomy, name)
    this_side = (samples.points[:, 0] * sign > 0.02).astype(np.float32)
    cheek = np.hypot((forward + 0.02) / 1.25, up + 0.21)
    lay_over(color, 0.6 * rise(0.062 - cheek, 0, 0.045) * this_side, "pink")
    lid = rise(EYE_RADIUS - np.hypot(forward / 0.92, up), 0, samples.softness) * this_side
    for color_name, radius, x, y in (
        ("pupil", EYE_RADIUS, 0.0, 0.0),
        ("white", EYE_RADIUS - 0.016, 0.002, -0.006),
        ("iris", 0.080, 0.014, -0.004),
        ("iris light", 0.050, 0.014, -0.030),
        ("pupil", 0.052, 0.018, -0.002),
        ("white", 0.024, 0.042, 0.032),
        ("white", 0.011, -0.010, -0.030),
    ):
        disc = np.hypot((forward - x) / 0.92, up - y)
        lay_over(color, rise(radius - disc, 0, samples.softness) * lid, color_name)


def _badge_frame(samples: Samples, anatomy: Anatomy) -> tuple[NDArray[np.int64], Samples, Float32Array, Float32Array]:
    """Return the samples on both shoulders, and their offsets (forward, up) from the middle of the badges."""
    centre = anatomy.points["withers"] + np.array([0.0, -0.42, -0.02])
    offset = samples.points - centre.astype(np.float32)
    here = np.flatnonzero((np.hypot(offset[:, 1], offset[:, 2]) < 0.3) & (samples.channels["leg"] < 0.3))
    return here, samples.select(here), offset[here, 2], offset[here, 1]


def _paint_badges(color: Float32Array, samples: Samples, anatomy: Anatomy) -> None:
    """A golden star on the left shoulder, a red target on the right one, both on a light disc."""
    here, shoulder, forward, up = _badge_frame(samples, anatomy)
    paint, soft = color[here], samples.softness
    left = (shoulder.points[:, 0] > 0).astype(np.float32)
    radius = np.hypot(forward, up)
    lay_over(paint, rise(BADGE_RADIUS - radius, 0, soft), "cream")
    inside = np.float32(0.19) * star(forward / 0.19, (up + 0.008) / 0.19)
    lay_over(paint, rise(inside, -0.016, soft) * left, "mane")
    lay_over(paint, rise(inside, 0, soft) * left, "star")
    for size, name in ((0.165, "badge"), (0.115, "cream"), (0.07, "badge")):
        lay_over(paint, rise(size - radius, 0, soft) * (1 - left), name)
    color[here] = paint


def _relief(samples: Samples, anatomy: Anatomy) -> Float32Array:
    """(q, 1) displacement, in length units."""
    hair, strands = _tail_strands(samples)
    hair *= 1 - rise(samples.channels["tail"], 0.85, 0.12)
    height = _mane(samples, anatomy) * (0.008 + 0.010 * _locks(samples)) + hair * 0.014 * strands
    ribs = rise(-np.abs(samples.channels["girth"]), -0.55, 0.25) * (1 - rise(samples.channels["leg"], 0.05, 0.05))
    barrel = rise(samples.channels["spine"], 0.45, 0.15) * rise(-samples.channels["spine"], -1.25, 0.15)
    height += 0.004 * ribs * barrel * np.sin(2 * np.pi * samples.channels["spine"] / 0.11)
    here, shoulder, forward, up = _badge_frame(samples, anatomy)
    left = shoulder.points[:, 0] > 0
    inside = np.where(left, 0.19 * star(forward / 0.19, (up + 0.008) / 0.19), 0.165 - np.hypot(forward, up))
    height[here] += 0.012 * rise(inside.astype(np.float32), 0, 0.008)
    for side, sign in SIDES:
        here, face = samples.near(anatomy.points[f"eye_{side}"], 0.2)
        radius = np.hypot(*_tangent_coordinates(face, anatomy, f"eye_{side}"))
        height[here] += 0.025 * np.sqrt(np.clip(1 - (radius / EYE_RADIUS) ** 2, 0, 1))
        height -= 0.018 * _nostril(samples, anatomy.points["nose_tip"], sign)
    return np.asarray(height[:, None], dtype=np.float32)
