"""The measurements of the two creatures: nothing but numbers, in lengths of about half a metre, ground at y = 0.

Measurements are those of the smooth surface: `creatures` widens the control rings, and subdivision shrinks them back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.mesh import FloatArray


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
        Name to (ring, side) of the spine.
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
            [-0.93, 1.96, -0.93, 1.76, 0.15, 0.00],
            [-0.84, 2.10, -0.87, 1.62, 0.25, 0.00],
            [-0.64, 2.16, -0.68, 1.50, 0.30, -0.05],
            [-0.40, 2.14, -0.42, 1.46, 0.30, -0.05],
            [-0.12, 2.11, -0.14, 1.44, 0.30, -0.08],
            [0.16, 2.13, 0.14, 1.41, 0.31, -0.08],
            [0.38, 2.21, 0.40, 1.42, 0.29, -0.08],
            [0.50, 2.34, 0.62, 1.55, 0.25, -0.05],
            [0.56, 2.50, 0.76, 1.85, 0.19, 0.00],
            [0.61, 2.70, 0.82, 2.19, 0.150, 0.00],
            [0.67, 2.94, 0.87, 2.48, 0.130, 0.00],
            [0.73, 3.18, 0.90, 2.76, 0.122, 0.00],
            [0.80, 3.40, 0.95, 2.98, 0.135, 0.00],
            [0.93, 3.59, 1.05, 3.01, 0.190, 0.05],
            [1.14, 3.63, 1.21, 2.99, 0.220, 0.08],
            [1.37, 3.48, 1.38, 2.97, 0.195, 0.06],
            [1.56, 3.30, 1.52, 2.93, 0.155, 0.00],
            [1.70, 3.20, 1.63, 2.92, 0.145, 0.00],
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
            [0.19, 1.30, 0.42, 0.115, 0.15],
            [0.18, 1.09, 0.42, 0.090, 0.11],
            [0.17, 0.86, 0.43, 0.072, 0.08],
            [0.17, 0.72, 0.43, 0.075, 0.085],
            [0.17, 0.58, 0.42, 0.055, 0.060],
            [0.17, 0.34, 0.42, 0.048, 0.050],
            [0.17, 0.17, 0.42, 0.055, 0.060],
            [0.17, 0.13, 0.43, 0.070, 0.080],
            [0.17, 0.02, 0.46, 0.085, 0.115],
            [0.17, 0.00, 0.46, 0.080, 0.105],
        ]
    ),
    hind_leg=np.array(
        [
            [0.20, 1.38, -0.62, 0.130, 0.20],
            [0.19, 1.18, -0.65, 0.104, 0.15],
            [0.18, 0.98, -0.72, 0.078, 0.095],
            [0.17, 0.79, -0.80, 0.068, 0.082],
            [0.17, 0.62, -0.78, 0.056, 0.062],
            [0.17, 0.36, -0.745, 0.048, 0.050],
            [0.17, 0.17, -0.725, 0.055, 0.060],
            [0.17, 0.13, -0.715, 0.070, 0.080],
            [0.17, 0.02, -0.685, 0.085, 0.115],
            [0.17, 0.00, -0.685, 0.080, 0.105],
        ]
    ),
    polygon_soles=False,
    tail_rows=1,
    tail=np.array(
        [
            [2.01, -1.03, 0.075, 0.07, 15.0],
            [1.95, -1.13, 0.110, 0.10, 50.0],
            [1.81, -1.20, 0.105, 0.10, 75.0],
        ]
    ),
    tail_tip=np.array([1.66, -1.22]),
    ear=np.array(
        [
            [0.19, 3.51, 0.92, 0.060, 0.045, 0.0],
            [0.31, 3.58, 0.91, 0.105, 0.045, 0.0],
            [0.45, 3.66, 0.90, 0.100, 0.035, 0.0],
            [0.55, 3.72, 0.89, 0.055, 0.022, 0.0],
        ]
    ),
    ear_tip=np.array([0.61, 3.755, 0.885]),
    ear_front=np.array([0.1, -0.15, 1.0]),
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
    },
    knee=3,
    hock=3,
    halves=True,
    islands={"muzzle": "head", "rump": "body", "torso": "body", "belly": "body", "neck": "body"},
)
