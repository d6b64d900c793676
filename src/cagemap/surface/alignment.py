"""Rotations between axes, and similarities between point sets: principal frames, and the best fit to given images."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from cagemap.numerics.arrays import FloatArray

# Rotations, for rows, from a file's axes to Y up.
Y_UP = np.eye(3)
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def axis_rotations() -> list[FloatArray]:
    """The 24 rotations of coordinate axes to coordinate axes, sorted by angle; the identity first."""
    rotations = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[np.arange(3), order] = signs
            if np.linalg.det(matrix) > 0:
                rotations.append(matrix)
    return sorted(rotations, key=lambda matrix: -np.trace(matrix))


def nearest_axis_rotation(rotation: FloatArray) -> FloatArray:
    """The one of `axis_rotations` nearest to a matrix (3, 3)."""
    return max(axis_rotations(), key=lambda axes: float((axes * rotation).sum()))


def principal_frame(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre (3,) of weighted points, right-handed axes (3, 3) in columns, longest first, and deviations (3,)."""
    shares = weights / weights.sum()
    centre = shares @ points
    away = points - centre
    variances, axes = np.linalg.eigh((shares[:, None] * away).T @ away)
    axes = axes[:, ::-1]
    axes[:, 2] *= np.sign(np.linalg.det(axes)) or 1.0
    return centre, axes, np.sqrt(np.maximum(variances[::-1], 0.0))


def rotations_onto(axes: FloatArray, others: FloatArray) -> list[FloatArray]:
    """The four rotations (3, 3) of axes onto others: axes have no sign."""
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    return [others @ (axes * [first, second, first * second]).T for first, second in signs]


def fit_similarity(points: FloatArray, images: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Rotation R, scale s and shift t that bring s R p + t nearest to images (Umeyama 1991); no reflection."""
    centre, image_centre = points.mean(axis=0), images.mean(axis=0)
    u, singular, vt = np.linalg.svd((images - image_centre).T @ (points - centre))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = (u * signs) @ vt
    spread = float(((points - centre) ** 2).sum())
    scale = float((singular * signs).sum()) / spread if spread > 0 else 1.0
    return rotation, scale, image_centre - scale * rotation @ centre
