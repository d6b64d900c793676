"""Suggest landmarks: where answers differ, where the map is doubtful, far from other landmarks."""

from __future__ import annotations

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray

# Radius within which a landmark is taken to decide between answers, of sqrt(area).
LANDMARK_REACH = 0.2
# Weight of the distance from all landmarks, added to the doubt.
DISTANCE_SHARE = 0.5


def suggested_vertices(
    places: FloatArray, images: FloatArray, others: FloatArray, trust: FloatArray, known: IndexArray, count: int
) -> IndexArray:
    """Control vertices of the target for further landmarks, most useful first.

    The score of a vertex is the distance of its image in other answers, less near landmarks, plus its distance to the
    nearest landmark times its doubt. Each suggestion counts as a landmark for the next. At unit area: places and images
    (n_0, 3) of the control vertices on target and source, and images (r, n_0, 3) by other answers or by the reverse
    map. ParameterError if there are fewer control vertices without a landmark than ``count``; those with one are
    ``known`` (p,).
    """
    if not 1 <= count <= len(places) - len(known):
        raise ParameterError(f"count: expected 1 to {len(places) - len(known)} further landmarks, got {count}")
    apart = np.linalg.norm(others - images, axis=2).max(axis=0, initial=0.0)
    gap = np.full(len(places), 1.0)
    chosen: list[int] = []

    def near(vertex: int) -> FloatArray:
        return np.asarray(np.linalg.norm(places - places[vertex], axis=1))

    for vertex in known:
        gap = np.minimum(gap, near(int(vertex)))
    for _ in range(count):
        score = apart * np.minimum(gap / LANDMARK_REACH, 1.0) + gap * (DISTANCE_SHARE + 1.0 - trust)
        score[[*known.tolist(), *chosen]] = -1.0
        chosen.append(int(np.argmax(score)))
        gap = np.minimum(gap, near(chosen[-1]))
    return np.array(chosen, dtype=np.int64)
