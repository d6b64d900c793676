"""A skeleton: named joints in a hierarchy, as a value."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints with a head and a tail each.

    Attributes
    ----------
    names, parents : tuple of str
        A parent of '' is none.
    heads, tails : (j, 3) float64
    axes : (j, 3, 3) float64 or None
        Rows are the directions of each joint's own axes, where the file has them.
    """

    names: tuple[str, ...]
    parents: tuple[str, ...]
    heads: FloatArray
    tails: FloatArray
    axes: FloatArray | None = None
