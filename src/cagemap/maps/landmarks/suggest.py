"""Where one more landmark tells most: where answers differ, where the map is doubtful, far from the landmarks there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray

# A landmark is taken to decide as far as this around it, of sqrt(area).
REACH = 0.2
# What being far from all landmarks counts beside being doubtful.
DISTANCE_SHARE = 0.5


def suggested_vertices(
    places: FloatArray, images: FloatArray, others: FloatArray, trust: FloatArray, known: IndexArray, count: int
) -> IndexArray:
    """Control vertices of the target at which landmarks would tell most, the most telling first.

    A vertex counts by how far other answers put it, as far as no landmark is near, and by its distance to the nearest
    landmark times its doubt. Each suggestion counts as a landmark for the next. At unit area: places and images
    (n_0, 3) of the control vertices on target and source, and images (r, n_0, 3) by other answers, or the way back.

    Raises
    ------
    ParameterError
        If there are not so many vertices beside the known ones (p,).
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
        score = apart * np.minimum(gap / REACH, 1.0) + gap * (DISTANCE_SHARE + 1.0 - trust)
        score[[*known.tolist(), *chosen]] = -1.0
        chosen.append(int(np.argmax(score)))
        gap = np.minimum(gap, near(chosen[-1]))
    return np.array(chosen, dtype=np.int64)


def free_partners(places: FloatArray, wanted: FloatArray, taken: IndexArray) -> IndexArray:
    """(c,) different control vertices of the source nearest to places (c, 3), none of them taken."""
    tree, used = cKDTree(places), set(taken.tolist())
    found = []
    for place in wanted:
        _, order = tree.query(place, k=min(len(places), len(used) + 1))
        free = next(int(vertex) for vertex in np.atleast_1d(order) if int(vertex) not in used)
        used.add(free)
        found.append(free)
    return np.array(found, dtype=np.int64)
