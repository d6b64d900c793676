"""Every number that decides how a fitted mesh is projected and its folds are removed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProjectionConfig:
    """Closest points, landmarks, relaxation of folds; lengths are of sqrt(area), areas shares of the surface."""

    min_cosine: float = 0.15  #: smaller cosines between a point's normal and its own: on the wrong side of a thin part
    landmark_tolerance: float = 1e-12  #: a landmark is met when it is missed by less
    landmark_steps: int = 12  #: few suffice: the surface is nearly flat around a landmark
    landmark_normal_weight: float = 0.002  #: of the first step, which keeps to one side of a thin part
    rings: tuple[int, ...] = (1, 2, 3, 5, 8)  #: rings of triangles around small folds that are relaxed, round by round
    sweeps: int = 10  #: averages over neighbours before a patch is projected again
    min_gain: float = 0.02  #: share of the flipped triangles that a round must remove for another one
    min_part: float = 1e-3  #: folded area of a part that is flattened
    max_folded: float = 0.02  #: folded area in all, above which the map is wrong and nothing is flattened
    part_distance: float = 0.02  #: folded pieces closer than this, along edges of an even mesh, are one part
    growths: tuple[float, ...] = (1.1, 1.5, 2.0)  #: radii of the ball, in those of the part's image; the first fit wins
    margin: float = 1.15  #: radius of the source's disc, in those of the ball
    max_disc: float = 0.5  #: share of either surface's vertices in a disc
    min_unfolded: float = 0.5  #: share of the fold that must disappear
    max_move: float = 0.05  #: vertices that move farther count as displaced
    max_displaced: float = 5.0  #: displaced area in units of the folded area (fins and ears: 0 to 1.7; limbs: 25 to 45)
    disc_steps: int = 50  #: steps in which landmarks of a disc move to their places
