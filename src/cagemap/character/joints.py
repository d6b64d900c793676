"""Named joints in a hierarchy, as files have them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Named joints, each with a parent, a head and a tail."""

    names: tuple[str, ...]
    parents: tuple[str, ...]  #: name of every joint's parent, '' for a root
    heads: FloatArray  #: (j, 3)
    tails: FloatArray  #: (j, 3)
    #: (j, 3, 3) rows are the axes of each joint; None if the file has none
    axes: FloatArray | None = None

    def transformed(self, matrix: FloatArray) -> Skeleton:
        """The skeleton transformed by a (4, 4) matrix for points as rows; axes are turned, not scaled."""
        linear, shift = matrix[:3, :3], matrix[3, :3]
        turn = linear / np.cbrt(abs(np.linalg.det(linear)))
        axes = None if self.axes is None else self.axes @ turn
        return replace(self, heads=self.heads @ linear + shift, tails=self.tails @ linear + shift, axes=axes)


def tails_of(heads: FloatArray, parents: IndexArray) -> FloatArray:
    """Tails (j, 3) of joints with heads (j, 3) and parents (j,) (root: -1): means of children's heads.

    A joint without children is half as long as its parent, in the same direction.
    """
    tails = heads.copy()
    for number, parent in enumerate(parents):
        children = np.flatnonzero(parents == number)
        if len(children):
            tails[number] = heads[children].mean(axis=0)
        elif parent >= 0:
            tails[number] = heads[number] + 0.5 * (heads[number] - heads[parent])
    return tails
