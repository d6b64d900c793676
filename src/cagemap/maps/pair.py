"""Two prepared surfaces and what is known to correspond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cagemap.basis import Surface
from cagemap.numerics.arrays import IndexArray

Progress = Callable[[str], None]
LevelPair = tuple[int, int]
SymmetryPair = tuple[IndexArray, IndexArray]


@dataclass(frozen=True)
class Pair:
    """The two prepared surfaces and what is known to correspond.

    Attributes
    ----------
    target, source : Surface
    target_landmarks, source_landmarks : (p,) arrays
        Control vertices that correspond.
    symmetries : tuple of ((n_0 target,), (n_0 source,)) arrays
        Self-maps of the control meshes that correspond, each side's as the image of every control vertex, -1 where it
        is not known (see `cagemap.descriptors.check_symmetry`).
    """

    target: Surface
    source: Surface
    target_landmarks: IndexArray
    source_landmarks: IndexArray
    symmetries: tuple[SymmetryPair, ...] = ()
