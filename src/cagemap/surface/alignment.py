"""Similarities between point sets: principal frames, and the best fit to given images."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray


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
