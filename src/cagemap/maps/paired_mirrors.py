"""Mirror planes that both surfaces of a pair have."""

from __future__ import annotations

import numpy as np

from cagemap.maps.pair import Pair, SymmetryPair
from cagemap.mesh.mirrors import Mirror, mirror_symmetries
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads

# Share of landmarks that two mirror planes must take to the same landmarks.
AGREEMENT = 0.5


def paired_mirrors(pair: Pair) -> tuple[SymmetryPair, ...]:
    """Mirror planes that both control meshes have and that the landmarks agree with.

    A plane takes landmark i near landmark j on either side, or it is another plane. Where too few landmarks tell planes
    of one side apart, these are left; where each side has one plane only, the two belong together unless landmarks say
    otherwise. A plain mesh has none.
    """
    if pair.target.refinement.is_plain or pair.source.refinement.is_plain:
        return ()  # the vertices of a scan mirror no vertices
    sides = [(pair.target.control, pair.landmarks.target), (pair.source.control, pair.landmarks.source)]
    mirrors = in_threads(lambda side: mirror_symmetries(side[0]), sides)
    partners = [
        [(mirror, _partners(mirror, landmarks.positions / landmarks.surface.scale)) for mirror in planes]
        for planes, (_, landmarks) in zip(mirrors, sides, strict=True)
    ]
    found: list[SymmetryPair] = []
    taken: set[int] = set()
    for target, at_target in partners[0]:
        if sum(np.array_equal(at_target, others) for _, others in partners[0]) > 1:
            continue
        agreement = [np.mean(at_target == at_source) if len(at_target) else 1.0 for _, at_source in partners[1]]
        order = [int(i) for i in np.argsort(agreement)[::-1] if int(i) not in taken]
        told = len(order) == 1 or (len(order) > 1 and agreement[order[0]] > agreement[order[1]])
        if told and agreement[order[0]] >= AGREEMENT:
            taken.add(order[0])
            found.append((target.image, partners[1][order[0]][0].image))
    return tuple(found)


def _partners(mirror: Mirror, places: FloatArray) -> IndexArray:
    """Which landmark every landmark's mirror image is nearest to; (p,)."""
    squared = np.sum((mirror.reflect(places)[:, None] - places[None, :]) ** 2, axis=2)
    return np.asarray(np.argmin(squared, axis=1)) if len(places) else np.zeros(0, dtype=np.int64)
