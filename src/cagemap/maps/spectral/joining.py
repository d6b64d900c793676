"""One map from several: each part on which they disagree is taken from the one that fits it best.

Growths differ in which hand or foot they turn the right way, and no growth turns all. Parts are connected pieces of the
target on which two maps lie apart; outside of them the maps agree, so that what is put in fits at its border.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.graphs import components

logger = logging.getLogger(__name__)

# Maps lie apart where their images do by this, of sqrt(area).
APART = 0.01
# Vertices of the smallest part that is asked about.
SMALLEST = 10


def joined_match(
    matches: Sequence[IndexArray],
    places: FloatArray,
    triangles: IndexArray,
    merit: Callable[[IndexArray], float],
) -> IndexArray:
    """The best of several matches, with those parts of the others that make it better.

    Parameters
    ----------
    matches : sequence of (n1,) arrays
        Source vertex of every target vertex.
    places : (n2, 3) array
        Source vertices, unit area.
    triangles : (t1, 3) array
        Of the target.
    merit : callable
        Of a match; larger is better.

    Returns
    -------
    (n1,) array
    """
    merits = [merit(match) for match in matches]
    logger.info("merits of the maps to join: %s", merits)
    order = np.argsort(merits)[::-1]
    best, most = matches[order[0]], merits[order[0]]
    for other in order[1:]:
        for part in parts_apart(best, matches[other], places, triangles):
            changed = best.copy()
            changed[part] = matches[other][part]
            gained = merit(changed)
            if gained > most:
                best, most = changed, gained
    return best


def parts_apart(one: IndexArray, other: IndexArray, places: FloatArray, triangles: IndexArray) -> list[IndexArray]:
    """Vertices of each connected part of the target whose images under two matches lie apart."""
    inside = np.linalg.norm(places[one] - places[other], axis=1) > APART
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[inside[edges].all(axis=1)]
    label = components(edges[:, 0], edges[:, 1], len(one))
    members = np.flatnonzero(inside)
    order = members[np.argsort(label[members], kind="stable")]
    borders = np.flatnonzero(np.diff(label[order])) + 1
    return [part for part in np.split(order, borders) if len(part) >= SMALLEST]
