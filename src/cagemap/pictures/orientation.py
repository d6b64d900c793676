"""Orientation of a model: up axis and front, from its file or shape.

Files mostly have +Y up and face +Z, or +Z up and face -Y. A mirror plane, or feet that are stable along one axis only,
can show other axes; otherwise +Y is up. Bounds were chosen on the animals and neutral humans of the test data.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal
from cagemap.pictures.camera import turn_angle
from cagemap.surface.alignment import Y_UP, Z_UP, axis_rotations
from cagemap.surface.triangles import triangle_areas

UP_AXES = {"y": Y_UP, "z": Z_UP}
SHAPE_REASON, DEFAULT_REASON = "as its shape shows", "as usual, its shape does not tell"
# Rotation from facing +X to facing +Z, Y up.
X_FRONT_TO_Z = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about Y
SAMPLE_COUNT = 4000
# Mean distance to the mirror image of a symmetric model, of the diagonal; and its ratio to that of the next best axis.
MAX_MIRROR_DISTANCE, MAX_MIRROR_RATIO = 0.015, 0.5
# Share of the height that is the sole; least stability of a standing model, of the diagonal, and its lead over the
# other axis: see `_stability`.
SOLE_HEIGHT, MIN_STABILITY, MIN_STABILITY_GAIN = 0.04, 0.03, 0.01
MIN_TALL_RATIO = 1.5  # height over length from which toes, not the head, show the front
MIN_HEIGHT_RATIO = 0.8  # height over width of a standing model; flatter ones are reliefs
# Feet are left and right of a gap: its width, of the sole's half width, and the largest share of the sole inside it.
GAP_WIDTH, MAX_GAP_SHARE = 0.12, 0.1
# Least distances of toes from ankles, and of the head from the middle, that show the front; of the diagonal.
MIN_TOE_OFFSET, MIN_HEAD_OFFSET = 0.025, 0.1
# Least gain, as a cosine, for which a source gets other axes than the target.
MIN_FIT_GAIN = 0.1


@dataclass(frozen=True, eq=False)
class Orientation:
    """Rotation of a model for pictures."""

    turn: FloatArray  # rotation for rows: ``positions @ turn`` has +Y up and faces +Z
    reason: str  # how it was found, for users

    def __str__(self) -> str:
        """Up axis and front in the file's axes, and the reason."""
        up, front = (_axis_name(self.turn[:, k]) for k in (1, 2))
        return f"{up} is up and {front} in front, {self.reason}"


def usual_turn(path: Path | None) -> FloatArray:
    """(3, 3) rotation of positions (rows) to Y up by a file's format: most STL files have Z up, others Y."""
    return Z_UP if path is not None and path.suffix.lower() == ".stl" else Y_UP


def stated_turn(path: Path, upright: FloatArray | None) -> FloatArray | None:
    """(3, 3) rotation of positions (rows) to Y up that a file states, its mesh's ``upright``; STL states none."""
    return None if path.suffix.lower() == ".stl" else upright


def shape_turn(positions: FloatArray, triangles: IndexArray) -> FloatArray | None:
    """(3, 3) rotation of positions (rows) that makes a shape stand with Y up; None if the shape is ambiguous."""
    return _upright_turn(_unit_points(positions, triangles))


def find_orientation(
    positions: FloatArray,
    triangles: IndexArray,
    upright: FloatArray | None = None,
    reason: str = "",
    usual: FloatArray = Y_UP,
) -> Orientation:
    """Find the up axis and the front of a model.

    ``upright``: (3, 3) rotation for rows after which +Y is up, if known; ``reason`` says where it comes from.
    ``usual``: the rotation if the shape does not tell.
    """
    points = _unit_points(positions, triangles)
    if upright is None:
        found = _upright_turn(points)
        upright, reason = (usual, DEFAULT_REASON) if found is None else (found, SHAPE_REASON)
    points_upright = points @ upright
    faces_x = _mirror_axis(points_upright) == 2
    turn = upright @ X_FRONT_TO_Z if faces_x else upright
    if reason != DEFAULT_REASON and _faces_away(points @ turn):  # without a known up axis the head may be anywhere
        turn = turn @ HALF_TURN
    if not np.array_equal(turn, upright):
        reason = reason if reason in (SHAPE_REASON, DEFAULT_REASON) else f"{reason}, the front {SHAPE_REASON}"
        reason = SHAPE_REASON if reason == DEFAULT_REASON else reason
    return Orientation(turn, reason)


def _unit_points(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """Points of a surface about their mean, of a diagonal of 1."""
    points = _sample_points(positions, triangles)
    return np.asarray((points - points.mean(0)) / (box_diagonal(points) or 1.0))


def matching_turn(images: FloatArray, positions: FloatArray, turn: FloatArray) -> FloatArray:
    """(3, 3) rotation for rows that aligns the source with the target turned by ``turn``, from mapped points.

    The best of the 24 rotations between axes, then the best rotation about the vertical. Without a clear gain both
    models have the same axes.
    """
    a, b = images - images.mean(0), (positions - positions.mean(0)) @ turn
    covariance = a.T @ b
    rotations = np.array([turn, *axis_rotations()])
    fits = np.einsum("rij,ij->r", rotations, covariance)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    best = rotations[np.argmax(fits)] if fits.max() > fits[0] + MIN_FIT_GAIN * size else turn
    angle = np.radians(turn_angle(b, a @ best))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(best @ np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]))


def _axis_name(direction: FloatArray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[axis] < 0 else '+'}{'xyz'[axis]}"


def _sample_points(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(p, 3) points distributed evenly over a surface."""
    cumulative = np.cumsum(triangle_areas(positions, triangles))
    steps = np.arange(SAMPLE_COUNT) + 0.5
    numbers = np.searchsorted(cumulative, steps * (cumulative[-1] / SAMPLE_COUNT))
    corners = triangles[numbers.clip(max=len(triangles) - 1)]
    # Roberts' sequence, folded into the triangle.
    s, t = np.modf(np.outer([0.7548776662466927, 0.5698402909980532], steps))[0]
    outside = s + t > 1
    s, t = np.where(outside, 1 - s, s)[:, None], np.where(outside, 1 - t, t)[:, None]
    a, b, c = (positions[corners[:, k]] for k in range(3))
    return np.asarray(a + s * (b - a) + t * (c - a))


def _upright_turn(points: FloatArray) -> FloatArray | None:
    """Rotation for the up axis, y or z, that the shape shows; None if unclear."""
    mirror_axis = _mirror_axis(points)
    if mirror_axis == 1:
        return Z_UP  # left and right are mirrored, not top and bottom
    if mirror_axis == 2:
        return Y_UP
    for turn, other_turn in ((Y_UP, Z_UP), (Z_UP, Y_UP)):
        width, height, _ = np.ptp(points @ turn, axis=0)
        min_stability = max(MIN_STABILITY, _stability(points @ other_turn) + MIN_STABILITY_GAIN)
        if _stability(points @ turn) > min_stability and height > MIN_HEIGHT_RATIO * width:
            return turn
    return None


def _mirror_axis(points: FloatArray) -> int | None:
    """The axis of the mirror plane's normal; None without a clear mirror plane."""
    middle = (points.min(0) + points.max(0)) / 2
    tree = cKDTree(points)
    misses = np.empty(3)
    for axis in range(3):
        image = points[::2].copy()
        image[:, axis] = 2 * middle[axis] - image[:, axis]
        misses[axis] = np.mean(tree.query(image)[0])
    best = int(np.argmin(misses))
    clear = misses[best] < min(MAX_MIRROR_DISTANCE, MAX_MIRROR_RATIO * np.delete(misses, best).min())
    return best if clear else None


def _stability(points: FloatArray) -> float:
    """Distance of the centre inside the feet's convex hull, Y up; negative if unstable."""
    height = points[:, 1]
    sole = points[height < height.min() + SOLE_HEIGHT * np.ptp(height)][:, [0, 2]]
    offsets = np.abs(sole[:, 0] - (points[:, 0].min() + points[:, 0].max()) / 2)
    if np.mean(offsets < GAP_WIDTH * offsets.max()) > MAX_GAP_SHARE:
        return -1.0
    try:
        hull_edges = ConvexHull(sole).equations
    except (QhullError, ValueError):  # a point or an edge
        return -1.0
    return float(-(hull_edges @ [*points[:, [0, 2]].mean(0), 1.0]).max())


def _faces_away(points: FloatArray) -> bool:
    """Whether toes or head show that a shape with Y up faces -Z."""
    _, height, length = np.ptp(points, axis=0)
    part = (points[:, 1] - points[:, 1].min()) / (height or 1.0)

    def mean(low: float, high: float) -> float:
        inside = (part >= low) & (part <= high)
        return float(points[inside, 2].mean()) if inside.any() else 0.0

    if height > MIN_TALL_RATIO * length:
        return mean(0.0, 0.04) - mean(0.06, 0.15) < -MIN_TOE_OFFSET
    return mean(0.85, 1.0) - mean(0.0, 1.0) < -MIN_HEAD_OFFSET
