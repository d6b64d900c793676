"""Viewpoints of source and target in pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Y_UP, Orientation, find_orientation, matching_turn
from cagemap.subdivision import level_triangles


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Rotations, for rows, after which target and source face the same way with +Y up."""

    target: Orientation
    source_turn: FloatArray  # (3, 3)


def choose_viewpoints(
    result: MatchResult, upright: FloatArray | None = None, reason: str = "", usual: FloatArray = Y_UP
) -> Viewpoints:
    """Orient the target by its file or shape, the source by the map.

    ``upright``: (3, 3) rotation for rows after which the target's up is +Y, if known.
    ``reason``: where ``upright`` comes from.
    ``usual``: the rotation if ``upright`` is not known and the shape does not tell.
    """
    refinement = result.target.refinement
    positions = np.asarray(refinement.finest.positions)
    target = find_orientation(positions, level_triangles(refinement, refinement.finest_level), upright, reason, usual)
    return Viewpoints(target, matching_turn(result.image(), positions, target.turn))
