"""Orientation of a model in pictures: up axis and front, from its file or its shape.

Files mostly have +Y up and face +Z, or +Z up and face -Y. A shape says otherwise where it has a mirror plane across
another axis, or stands on its feet along one axis alone; where it is not clear, the usual axes are taken. Bounds were
chosen on the animals and neutral humans of the test data.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.camera import turn_between
from cagemap.surface.triangles import triangle_areas

# From a file's axes to Y up, for rows.
Y_UP = np.eye(3)
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
UP_AXES = {"y": Y_UP, "z": Z_UP}
BY_SHAPE, USUAL = "as its shape shows", "as usual, its shape does not tell"
# From a model that faces +X to one that faces +Z, Y up.
_FROM_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_ABOUT = np.diag([-1.0, 1.0, -1.0])  # half a turn about Y
_SAMPLES = 4000
# Mean distance to the mirror image, of the diagonal, of what has a mirror plane; and by how much other axes miss more.
_SYMMETRIC, _LESS = 0.015, 0.5
# The lowest part of the height is what a model stands on. How far its centre lies inside that, of the diagonal, where
# it stands, and how much less it stands along the other axis.
_SOLE, _STANDS, _WORSE = 0.04, 0.03, 0.01
_TALL = 1.5  # times as high as long: shows its front by its toes
_FLAT = 0.8  # less high than this, of its width, is rather a relief that faces the eye
# Feet stand left and right: share of what a model stands on that may lie within so much of its half width in between.
_BETWEEN_FEET, _FEW = 0.12, 0.1
# How far toes lie before the ankles and the head before the middle, of the diagonal, where they show the front.
_TOES, _HEAD = 0.025, 0.1
# By how much better (cosine) a source fits the target in other axes than the target's.
_FITS_BETTER = 0.1


@dataclass(frozen=True, eq=False)
class Orientation:
    """How a model is turned for pictures.

    Attributes
    ----------
    turn : (3, 3) float64
        Rotation for rows: ``positions @ turn`` has +Y up and faces +Z.
    reason : str
        Where that is known from.
    """

    turn: FloatArray
    reason: str

    def __str__(self) -> str:
        """What is up and in front in the file's axes, and why."""
        up, front = (_axis_name(self.turn[:, k]) for k in (1, 2))
        return f"{up} is up and {front} in front, {self.reason}"


def orientation(
    positions: FloatArray, triangles: IndexArray, upright: FloatArray | None = None, reason: str = ""
) -> Orientation:
    """Up axis and front of a model.

    Parameters
    ----------
    positions : (n, 3) float64
    triangles : (t, 3) int64
    upright : (3, 3) float64, optional
        Rotation for rows after which +Y is up, where that is known, and ``reason`` says from where.
    """
    points = _spread(positions, triangles)
    points = (points - points.mean(0)) / (float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0)
    if upright is None:
        shown = _shown_up(points)
        upright, reason = (Y_UP, USUAL) if shown is None else (shown, BY_SHAPE)
    seen = points @ upright
    sideways = _mirrored_across(seen) == 2
    turn = upright @ _FROM_X if sideways else upright
    if reason != USUAL and _faces_away(points @ turn):  # what may lie down has its head anywhere
        turn = turn @ _ABOUT
    if not np.array_equal(turn, upright):
        reason = reason if reason in (BY_SHAPE, USUAL) else f"{reason}, the front {BY_SHAPE}"
        reason = BY_SHAPE if reason == USUAL else reason
    return Orientation(turn, reason)


def matching_turn(images: FloatArray, positions: FloatArray, turn: FloatArray) -> FloatArray:
    """(3, 3) rotation for rows after which the source is seen as the target is, from where the map takes points.

    Of the turns between axes the one that fits best, and what then is left about the vertical. Where none fits clearly
    better, both models have the same axes.

    Parameters
    ----------
    images, positions : (p, 3) float64
        Points of the target on the source and where they are on the target.
    turn : (3, 3) float64
        Of the target.
    """
    a, b = images - images.mean(0), (positions - positions.mean(0)) @ turn
    both = a.T @ b
    rotations = np.array([turn, *_rotations()])
    fits = np.einsum("rij,ij->r", rotations, both)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    best = rotations[np.argmax(fits)] if fits.max() > fits[0] + _FITS_BETTER * size else turn
    angle = np.radians(turn_between(b, a @ best))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(best @ np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]))


def _rotations() -> list[FloatArray]:
    """The 24 rotations that take axes to axes."""
    signed = (
        np.eye(3)[list(order)] * np.array(signs)
        for order in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    )
    return [matrix for matrix in signed if np.linalg.det(matrix) > 0]


def _axis_name(direction: FloatArray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[axis] < 0 else '+'}{'xyz'[axis]}"


def _spread(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(p, 3) points spread evenly over a surface."""
    cumulative = np.cumsum(triangle_areas(positions, triangles))
    steps = np.arange(_SAMPLES) + 0.5
    chosen = triangles[np.searchsorted(cumulative, steps * (cumulative[-1] / _SAMPLES)).clip(max=len(triangles) - 1)]
    # Roberts' sequence, folded into the triangle.
    s, t = np.modf(np.outer([0.7548776662466927, 0.5698402909980532], steps))[0]
    outside = s + t > 1
    s, t = np.where(outside, 1 - s, s)[:, None], np.where(outside, 1 - t, t)[:, None]
    a, b, c = (positions[chosen[:, k]] for k in range(3))
    return np.asarray(a + s * (b - a) + t * (c - a))


def _shown_up(points: FloatArray) -> FloatArray | None:
    """The turn of the axis, y or z, that a shape shows to be up; None where it is not clear."""
    across = _mirrored_across(points)
    if across == 1:
        return Z_UP  # left and right are mirrored, not top and bottom
    if across == 2:
        return Y_UP
    for turn, other in ((Y_UP, Z_UP), (Z_UP, Y_UP)):
        width, height, _ = _extents(points @ turn)
        if _firmness(points @ turn) > max(_STANDS, _firmness(points @ other) + _WORSE) and height > _FLAT * width:
            return turn
    return None


def _extents(points: FloatArray) -> FloatArray:
    return np.asarray(np.ptp(points, axis=0))


def _mirrored_across(points: FloatArray) -> int | None:
    """The axis across which a shape is clearly more symmetric than across the others."""
    middle = (points.min(0) + points.max(0)) / 2
    tree = cKDTree(points)
    misses = np.empty(3)
    for axis in range(3):
        image = points[::2].copy()
        image[:, axis] = 2 * middle[axis] - image[:, axis]
        misses[axis] = np.mean(tree.query(image)[0])
    best = int(np.argmin(misses))
    clear = misses[best] < min(_SYMMETRIC, _LESS * np.delete(misses, best).min())
    return best if clear else None


def _firmness(points: FloatArray) -> float:
    """How far inside what its feet span, Y up, a shape's centre lies; negative where it would fall over."""
    height = points[:, 1]
    sole = points[height < height.min() + _SOLE * np.ptp(height)][:, [0, 2]]
    across = np.abs(sole[:, 0] - (points[:, 0].min() + points[:, 0].max()) / 2)
    if np.mean(across < _BETWEEN_FEET * across.max()) > _FEW:
        return -1.0
    try:
        sides = ConvexHull(sole).equations
    except (QhullError, ValueError):  # a point or an edge
        return -1.0
    return float(-(sides @ [*points[:, [0, 2]].mean(0), 1.0]).max())


def _faces_away(points: FloatArray) -> bool:
    """Whether toes, or a head that is far from the middle, show that a shape with Y up faces -Z."""
    _, height, length = _extents(points)
    part = (points[:, 1] - points[:, 1].min()) / (height or 1.0)
    forward: FloatArray = points[:, 2] - (points[:, 2].min() + points[:, 2].max()) / 2

    def mean(low: float, high: float) -> float:
        inside = (part >= low) & (part <= high)
        return float(forward[inside].mean()) if inside.any() else 0.0

    if height > _TALL * length:
        return mean(0.0, 0.04) - mean(0.06, 0.15) < -_TOES
    return mean(0.85, 1.0) - mean(0.0, 1.0) < -_HEAD
