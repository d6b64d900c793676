"""Whether landmarks surround each other in the same sense on both surfaces: all of them, and two that were exchanged.

Distances hardly tell the left fore foot from the right one, which is as far from everything in the middle. The sense in
which landmarks lie around each other does.
"""

from __future__ import annotations

import numpy as np

from cagemap.deform.config import LandmarkConfig
from cagemap.maps.landmarks.distances import MOST_TERMS, LandmarkDistances, exchange_gains
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import normalized

# Positions and unit normals (p, 3) of landmarks on one surface.
Marks = tuple[FloatArray, FloatArray]


def orientation_agreement(target: Marks, source: Marks, config: LandmarkConfig = LandmarkConfig()) -> float:
    """Whether landmarks surround each other in the same sense on both surfaces: 1 the same, -1 mirrored, 0 not known.

    Every triple (i; j, k) votes with the product of ``n_i . (e_ij x e_ik)`` on both surfaces, e the unit vectors to j
    and k, so that three landmarks in a line with the surface's normal say nothing. Hands exchange their sides where
    arms are crossed: so triples vote once more, those the less whose distances in space differ, and the larger result
    counts.
    """
    p, changed = len(target[0]), _changed_squared(target[0], source[0], config.short)
    agreed, counted = np.zeros(2), np.zeros(2)
    for i in range(p):
        votes = _turns(i, *target) * _turns(i, *source)
        alike = np.exp(-(changed[i, :, None] + changed[i] + changed) / config.posed**2)
        both = np.stack([votes, alike * votes])
        agreed += both.sum(axis=(1, 2))
        counted += np.abs(both).sum(axis=(1, 2))
    return float((agreed / np.maximum(counted, max(config.flat * p * (p - 1) * (p - 2), 1e-12))).max())


def exchanged_sides(
    distances: tuple[LandmarkDistances, LandmarkDistances], target: Marks, source: Marks
) -> tuple[int, int] | None:
    """The two pairs around which orientations disagree and, with their source points exchanged, agree well; if any.

    Only exchanges that distances hardly mind are asked about, those first that gain most.
    """
    p, config = len(target[0]), distances[0].config
    apart = np.minimum(*(side.between for side in distances)) > config.side_apart
    gains = np.triu(np.where(apart, exchange_gains(*distances, np.arange(p)) - config.side_min_gain, 0.0), 1).ravel()
    asked = np.argsort(-gains)[: max(1, MOST_TERMS // p**2)]
    near, best, most = 1.0 / (distances[0].between + config.short), None, config.side_rise
    np.fill_diagonal(near, 0.0)
    for place in asked[gains[asked] > 0.0]:
        both = int(place) // p, int(place) % p
        given = agreement_around(both, target, source, near, config.flat)
        exchanged = agreement_around(both, target, _exchanged(source, both), near, config.flat)
        if given < config.side_disagreed and exchanged > config.side_agreed and exchanged - given > most:
            best, most = both, exchanged - given
    return best


def agreement_around(places: tuple[int, int], target: Marks, source: Marks, near: FloatArray, flat: float) -> float:
    """`orientation_agreement` of the triples that have one of two landmarks among them.

    A triple (i; j, k) weighs as much as j and k are near i (p, p): far ones turn where bodies bend.
    """
    agreed = counted = asked = 0.0
    for i in places:
        for turns, weights in ((_turns, near[i, :, None] * near[i]), (_turns_to, near[:, i, None] * near)):
            votes = turns(i, *target) * turns(i, *source) * weights
            agreed += float(votes.sum())
            counted += float(np.abs(votes).sum())
            asked += float(weights.sum())
    return agreed / max(counted, flat * asked, 1e-12)


def _changed_squared(positions: FloatArray, others: FloatArray, short: float) -> FloatArray:
    """(p, p) squared log ratios of distances in space, the common scale taken out.

    Their median counts the diagonal's zeros, which say that surfaces of unit area have one scale: without them as many
    correct sets of 6 to 30 landmarks are called mirrored (9 of 1500, docs/lab/accuracy.md), and 6 mirrored ones fewer.
    """
    apart = (np.linalg.norm(places[:, None] - places, axis=2) + short for places in (positions, others))
    ratios = np.log(np.divide(*apart))
    return np.asarray((ratios - np.median(ratios)) ** 2)


def _turns(i: int, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """(p, p) ``n_i . (e_ij x e_ik)`` for one landmark i."""
    units = normalized(positions - positions[i])
    return np.asarray(np.cross(normals[i], units) @ units.T)


def _turns_to(j: int, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """(p, p) ``n_i . (e_ij x e_ik)`` for one landmark j."""
    units = normalized(positions[None] - positions[:, None])
    return np.asarray(np.einsum("id,ikd->ik", np.cross(normals, units[:, j]), units))


def _exchanged(marks: Marks, places: tuple[int, int]) -> Marks:
    """Marks with those at two places exchanged."""
    order: IndexArray = np.arange(len(marks[0]))
    order[list(places)] = places[::-1]
    return marks[0][order], marks[1][order]
