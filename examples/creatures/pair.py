"""Points that both creatures name."""

from __future__ import annotations

import numpy as np
from examples.creatures.modelling import Creature

from cagemap.mesh.landmarks import Landmarks


def creature_landmarks(target: Creature, source: Creature) -> Landmarks:
    """Pair the points that both creatures name."""
    names = tuple(name for name in target.landmarks if name in source.landmarks)
    return Landmarks(
        names,
        np.array([target.landmarks[name] for name in names], dtype=np.int64),
        np.array([source.landmarks[name] for name in names], dtype=np.int64),
        target.mesh.name,
        source.mesh.name,
    )
