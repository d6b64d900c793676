"""Joints of a skeleton carried by the surface around them."""

from __future__ import annotations

import numpy as np

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, nearest_rotations

# Weights fall with the fourth power of the distance: a joint in a limb follows the ring of surface around it.
_POWER = 2
# Least distance in the weights, in units of sqrt(area).
_MIN_DISTANCE = 1e-3
# Vertices at a time: their weights stay in the processor's cache.
_BLOCK = 1024


def carry_joints(point_map: PointMap, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Carry joints, or other points inside or near the source, to the target.

    Every joint is moved by the affine map that fits the surface around it best (moving least squares, Schaefer et al.
    2006), from images on the source to vertices of the target. Affine deformations are reproduced exactly.

    Parameters
    ----------
    point_map : PointMap
    joints : (j, 3) float64
        In the source's file units.

    Returns
    -------
    places : (j, 3) float64
        In the target's file units.
    rotations : (j, 3, 3) float64
        Rotation of each map: a direction of the source as a row vector, times it, is that of the target.
    """
    source = point_map.images.positions
    target = point_map.target.positions
    count = len(source)
    # Moments about a common place: one product gives those of many joints.
    center = source.mean(axis=0), target.mean(axis=0)
    source, target = source - center[0], target - center[1]
    products = [np.einsum("na,nb->nab", source, side).reshape(count, 9) for side in (source, target)]
    table = np.concatenate([np.ones((count, 1)), source, target, *products], axis=1)
    squares = np.einsum("nd,nd->n", source, source)
    places = np.asarray(joints, dtype=np.float64) * point_map.source.scale - center[0]
    floors = np.einsum("jd,jd->j", places, places)[:, None] + _MIN_DISTANCE**2
    sums = np.zeros((len(places), table.shape[1]))
    for start in range(0, count, _BLOCK):
        block = slice(start, start + _BLOCK)
        squared = (-2 * places) @ source[block].T
        squared += squares[block]
        squared += floors
        np.maximum(squared, _MIN_DISTANCE**2, out=squared)
        sums += (point_map.target.vertex_areas[block] / squared**_POWER) @ table[block]
    sums /= sums[:, :1]
    before, after = sums[:, 1:4], sums[:, 4:7]
    moments = sums[:, 7:16].reshape(-1, 3, 3) - before[:, :, None] * before[:, None]
    mixed = sums[:, 16:].reshape(-1, 3, 3) - before[:, :, None] * after[:, None]
    # A flat neighbourhood leaves its normal direction open: the trace makes the map a scaled rotation there.
    moments += 1e-9 * np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    linear = np.linalg.solve(moments, mixed)
    carried = center[1] + after + np.einsum("ja,jab->jb", places - before, linear)
    return carried / point_map.target.scale, nearest_rotations(np.asarray(linear))
