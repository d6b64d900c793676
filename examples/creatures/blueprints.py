"""The measurements of the two creatures: nothing but numbers, in lengths of about half a metre, ground at y = 0.

Measurements are those of the smooth surface: `creatures` widens the control rings, and subdivision shrinks them back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Patch:
    """A block of body faces, from spine ring ``k0`` to ``k1`` and from side ``j0`` to ``j1``, that a limb replaces."""

    k0: int
    k1: int
    j0: int
    j1: int


@dataclass(frozen=True)
class Blueprint:
    """One four-legged creature.

    Attributes
    ----------
    sides : int
        Vertices of a spine ring; side 0 is the back, side ``sides / 4`` the left flank, ``sides / 2`` the belly.
    spine : (k, 6) float64
        From rump to muzzle: top z, top y, bottom z, bottom y, half width, and egg (> 0: wider towards the top).
    rump_bulge, muzzle_bulge : float
        How far the end caps bulge, as a share of half the ring's height.
    pentagon_muzzle : bool
        Close the muzzle with two pentagons and two quads instead of a grid of quads.
    front_patch, hind_patch, ear_patch : Patch
        Where the left limbs grow.
    front_leg, hind_leg : (r, 5) float64
        Downwards: x, y, z of the centre, radius across, radius along.
    tail_rows : int
        Rows of the rump's cap that the tail grows from.
    tail : (r, 5) float64
        Outwards: y, z of the centre, radius across, radius up, angle below the horizontal (degrees).
    tail_tip : (2,) float64
        y, z of the end of the tail.
    ear : (r, 6) float64
        Upwards: x, y, z of the centre, half width, half thickness, depth of the cup.
    ear_tip : (3,) float64
    ear_front : (3,) float64
        Where the opening of the left ear looks.
    landmarks : dict
        Name to (ring, side) of the spine; of a pair, the left one.
    knee, hock : int
        Leg ring of the joint landmarks.
    halves : bool
        Cut the body island along the back into a left and a right one.
    islands : dict
        Part name (without side) to the name of its texture island; parts that are not listed have one of their own.
    """

    name: str
    sides: int
    spine: FloatArray
    rump_bulge: float
    muzzle_bulge: float
    pentagon_muzzle: bool
    front_patch: Patch
    hind_patch: Patch
    ear_patch: Patch
    front_leg: FloatArray
    hind_leg: FloatArray
    polygon_soles: bool
    tail_rows: int
    tail: FloatArray
    tail_tip: FloatArray
    ear: FloatArray
    ear_tip: FloatArray
    ear_front: FloatArray
    landmarks: dict[str, tuple[int, int]]
    knee: int
    hock: int
    halves: bool
    islands: dict[str, str]


PONY = Blueprint(
    name="pony",
    sides=12,
    spine=np.array(
        [
            # top z, y     bottom z, y    width  egg
            [-1.00, 1.24, -1.00, 0.98, 0.21, 0.00],
            [-0.90, 1.41, -0.93, 0.80, 0.36, 0.00],
            [-0.70, 1.49, -0.76, 0.64, 0.43, -0.05],
            [-0.44, 1.48, -0.48, 0.55, 0.45, -0.08],
            [-0.18, 1.42, -0.20, 0.52, 0.45, -0.10],
            [0.05, 1.39, 0.03, 0.50, 0.45, -0.12],
            [0.27, 1.42, 0.24, 0.52, 0.44, -0.10],
            [0.45, 1.53, 0.50, 0.56, 0.42, -0.08],
            [0.53, 1.66, 0.78, 0.70, 0.37, -0.08],
            [0.57, 1.80, 0.94, 0.96, 0.30, -0.08],
            [0.61, 1.96, 1.00, 1.22, 0.25, -0.05],
            [0.68, 2.13, 1.02, 1.44, 0.235, 0.00],
            [0.83, 2.30, 1.06, 1.53, 0.26, 0.02],
            [1.07, 2.35, 1.19, 1.50, 0.315, 0.05],
            [1.32, 2.23, 1.36, 1.47, 0.285, 0.06],
            [1.50, 2.00, 1.48, 1.43, 0.218, 0.00],
            [1.67, 1.88, 1.60, 1.38, 0.205, -0.05],
            [1.80, 1.78, 1.71, 1.38, 0.188, -0.05],
        ]
    ),
    rump_bulge=0.35,
    muzzle_bulge=0.35,
    pentagon_muzzle=False,
    front_patch=Patch(6, 8, 3, 5),
    hind_patch=Patch(1, 3, 3, 5),
    ear_patch=Patch(11, 12, 1, 3),
    front_leg=np.array(
        [
            [0.27, 0.48, 0.50, 0.160, 0.19],
            [0.27, 0.38, 0.49, 0.135, 0.15],
            [0.27, 0.29, 0.49, 0.120, 0.13],
            [0.27, 0.18, 0.48, 0.110, 0.11],
            [0.27, 0.115, 0.485, 0.122, 0.125],
            [0.27, 0.095, 0.49, 0.140, 0.145],
            [0.27, 0.015, 0.50, 0.165, 0.175],
            [0.27, 0.00, 0.50, 0.155, 0.165],
        ]
    ),
    hind_leg=np.array(
        [
            [0.29, 0.51, -0.66, 0.170, 0.20],
            [0.28, 0.40, -0.68, 0.145, 0.165],
            [0.28, 0.31, -0.70, 0.125, 0.135],
            [0.28, 0.18, -0.69, 0.110, 0.115],
            [0.28, 0.115, -0.675, 0.122, 0.125],
            [0.28, 0.095, -0.665, 0.140, 0.145],
            [0.28, 0.015, -0.655, 0.165, 0.175],
            [0.28, 0.00, -0.655, 0.155, 0.165],
        ]
    ),
    polygon_soles=True,
    tail_rows=2,
    tail=np.array(
        [
            [1.31, -1.12, 0.105, 0.10, 20.0],
            [1.27, -1.24, 0.130, 0.12, 50.0],
            [1.12, -1.36, 0.160, 0.14, 75.0],
            [0.88, -1.41, 0.170, 0.15, 90.0],
            [0.64, -1.40, 0.125, 0.12, 97.0],
        ]
    ),
    tail_tip=np.array([0.42, -1.35]),
    ear=np.array(
        [
            [0.17, 2.32, 0.85, 0.095, 0.060, 0.00],
            [0.20, 2.43, 0.85, 0.120, 0.055, 0.050],
            [0.23, 2.55, 0.86, 0.100, 0.045, 0.045],
            [0.25, 2.65, 0.87, 0.052, 0.028, 0.020],
        ]
    ),
    ear_tip=np.array([0.26, 2.71, 0.875]),
    ear_front=np.array([0.35, 0.0, 1.0]),
    landmarks={
        "chin": (16, 6),
        "poll": (13, 0),
        "withers": (7, 0),
        "back": (5, 0),
        "croup": (2, 0),
        "chest": (8, 6),
        "throat": (11, 6),
        "belly": (5, 6),
        "eye_L": (14, 3),
        "shoulder_L": (7, 3),
        "hip_L": (2, 3),
    },
    knee=2,
    hock=2,
    halves=False,
    islands={},
)

DEER = Blueprint(
    name="deer",
    sides=8,
    spine=np.array(
        [
            # top z, y     bottom z, y    width  egg
            [-0.984, 1.664, -0.984, 1.431, 0.182, 0.000],
            [-0.887, 1.821, -0.918, 1.269, 0.308, 0.000],
            [-0.683, 1.892, -0.733, 1.127, 0.368, -0.050],
            [-0.428, 1.876, -0.458, 1.063, 0.378, -0.064],
            [-0.151, 1.831, -0.172, 1.038, 0.378, -0.089],
            [0.112, 1.828, 0.091, 1.012, 0.383, -0.098],
            [0.337, 1.886, 0.333, 1.027, 0.367, -0.089],
            [0.488, 2.010, 0.577, 1.117, 0.336, -0.064],
            [0.558, 2.159, 0.787, 1.348, 0.279, -0.036],
            [0.605, 2.336, 0.895, 1.658, 0.224, -0.036],
            [0.657, 2.543, 0.951, 1.940, 0.190, -0.023],
            [0.723, 2.755, 0.977, 2.198, 0.178, 0.000],
            [0.832, 2.957, 1.023, 2.362, 0.197, 0.009],
            [1.017, 3.085, 1.140, 2.364, 0.253, 0.050],
            [1.251, 3.050, 1.308, 2.339, 0.256, 0.071],
            [1.462, 2.859, 1.458, 2.309, 0.210, 0.033],
            [1.647, 2.703, 1.592, 2.264, 0.182, -0.023],
            [1.786, 2.601, 1.704, 2.258, 0.169, -0.023],
        ]
    ),
    rump_bulge=0.35,
    muzzle_bulge=0.35,
    pentagon_muzzle=True,
    front_patch=Patch(5, 7, 2, 3),
    hind_patch=Patch(1, 3, 2, 3),
    ear_patch=Patch(12, 13, 1, 2),
    front_leg=np.array(
        [
            [0.232, 0.942, 0.467, 0.139, 0.172],
            [0.227, 0.790, 0.464, 0.116, 0.136],
            [0.221, 0.629, 0.468, 0.099, 0.110],
            [0.221, 0.516, 0.466, 0.096, 0.105],
            [0.221, 0.401, 0.458, 0.083, 0.086],
            [0.221, 0.245, 0.460, 0.083, 0.086],
            [0.221, 0.142, 0.462, 0.094, 0.098],
            [0.221, 0.100, 0.470, 0.110, 0.119],
            [0.221, 0.017, 0.489, 0.124, 0.145],
            [0.221, 0.000, 0.489, 0.117, 0.136],
        ]
    ),
    hind_leg=np.array(
        [
            [0.247, 1.000, -0.653, 0.152, 0.205],
            [0.238, 0.850, -0.677, 0.128, 0.164],
            [0.231, 0.704, -0.723, 0.106, 0.122],
            [0.226, 0.561, -0.769, 0.094, 0.106],
            [0.226, 0.423, -0.754, 0.083, 0.089],
            [0.226, 0.256, -0.729, 0.083, 0.086],
            [0.226, 0.142, -0.715, 0.094, 0.098],
            [0.226, 0.100, -0.705, 0.110, 0.119],
            [0.226, 0.017, -0.686, 0.124, 0.145],
            [0.226, 0.000, -0.686, 0.117, 0.136],
        ]
    ),
    polygon_soles=False,
    tail_rows=1,
    tail=np.array(
        [
            [1.629, -1.118, 0.096, 0.091, 18.000],
            [1.486, -1.309, 0.145, 0.128, 65.000],
            [1.127, -1.362, 0.121, 0.116, 88.200],
        ]
    ),
    tail_tip=np.array([0.929, -1.339]),
    ear=np.array(
        [
            [0.185, 3.080, 0.909, 0.076, 0.052, 0.000],
            [0.270, 3.169, 0.903, 0.113, 0.050, 0.021],
            [0.367, 3.267, 0.901, 0.102, 0.040, 0.019],
            [0.435, 3.345, 0.899, 0.055, 0.025, 0.008],
        ]
    ),
    ear_tip=np.array([0.475, 3.391, 0.899]),
    ear_front=np.array([0.200, -0.090, 1.000]),
    landmarks={
        "chin": (16, 4),
        "poll": (13, 0),
        "withers": (7, 0),
        "back": (4, 0),
        "croup": (2, 0),
        "chest": (7, 4),
        "throat": (12, 4),
        "belly": (4, 4),
        "eye_L": (14, 2),
        "shoulder_L": (6, 2),
        "hip_L": (2, 2),
    },
    knee=3,
    hock=3,
    halves=True,
    islands={"muzzle": "head", "rump": "body", "torso": "body", "belly": "body", "neck": "body"},
)
