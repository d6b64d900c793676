"""Viewpoints from which both surfaces of a result are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Orientation, matching_turn, orientation
from cagemap.subdivision import level_triangles


@dataclass(frozen=True, eq=False)
class Seen:
    """Rotations, for rows, after which target and source are seen from the same side, with +Y up.

    Attributes
    ----------
    target : Orientation
    source_turn : (3, 3) float64
    """

    target: Orientation
    source_turn: FloatArray


def seen(result: MatchResult, upright: FloatArray | None = None, reason: str = "") -> Seen:
    """How a result is seen: the target by its file or its shape, the source by the map.

    Parameters
    ----------
    result : MatchResult
    upright : (3, 3) float64, optional
        Rotation for rows after which the target's up is +Y, where it is known, and ``reason`` says from where.
    """
    refinement = result.target.refinement
    positions = np.asarray(refinement.finest.positions)
    target = orientation(positions, level_triangles(refinement, refinement.n_levels), upright, reason)
    return Seen(target, matching_turn(result.image(), positions, target.turn))
