"""Joints of a skeleton carried by the surface around them."""

from __future__ import annotations

import numpy as np

from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.rotations import nearest_rotations

# Weights fall with the fourth power of the distance: a joint in a limb is carried by the ring of surface around it.
_POWER = 2.0
# No closer than this, in units of sqrt(area), counts as closer.
_CLOSEST = 1e-3


def carry_joints(point_map: PointMap, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where points inside or near the source belong in the target.

    Every joint gets the affine map that suits the surface around it best (moving least squares, Schaefer et al. 2006),
    from images on the source to vertices of the target. Affine deformations are met exactly.

    Parameters
    ----------
    point_map : PointMap
    joints : (j, 3) float64
        In the source's file units.

    Returns
    -------
    places : (j, 3) float64
        In the target's file units.
    turns : (j, 3, 3) float64
        Rotation of each map: directions as rows, times it, point in the target as they do in the source.
    """
    source = point_map.images.positions
    target = point_map.target.positions
    carried, linear = np.empty((len(joints), 3)), np.empty((len(joints), 3, 3))
    for row, joint in enumerate(np.asarray(joints, dtype=np.float64) * point_map.source.scale):
        offsets = source - joint
        squared = np.einsum("nd,nd->n", offsets, offsets) + _CLOSEST**2
        weights = point_map.target.vertex_areas / squared**_POWER
        weights /= weights.sum()
        before, after = weights @ source, weights @ target
        moved = source - before
        moments = np.einsum("n,na,nb->ab", weights, moved, moved)
        # A flat neighbourhood says nothing across it: there, the map is a scaled rotation's.
        moments += 1e-9 * np.trace(moments) * np.eye(3)
        mixed = np.einsum("n,na,nb->ab", weights, moved, target - after)
        linear[row] = np.linalg.solve(moments, mixed)
        carried[row] = after + (joint - before) @ linear[row]
    return carried / point_map.target.scale, nearest_rotations(linear)
