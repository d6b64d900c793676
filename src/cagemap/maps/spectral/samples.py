"""Samples of a surface, their embeddings, and the functional map of a match (paper, 2.1.2 and 5.4).

Numbers of functions grow as in [ZoomOut: Melzi et al. 2019]. Extra coordinates that both surfaces share (such as
harmonic landmark coordinates) may stand beside the spectral ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cagemap.maps.spectral.search import Embedding
from cagemap.numerics.arrays import FloatArray, IndexArray

# Samples of either surface while k grows: some twenty rows for each of the 300 unknowns of a column of C.
FIT_SAMPLES = 6000


@dataclass(frozen=True, eq=False)
class Samples:
    """Vertices of one surface as the alternation sees them.

    Attributes
    ----------
    rows : (b, k) array
        Basis rows Phi~(x, :).
    areas : (b,) array
        Weights in the inner product.
    coordinates : (b, c) array
        Extra coordinates shared by both surfaces, already weighted; c may be 0. They count in proportion to sqrt(k),
        so that their share of a distance does not fade as spectral coordinates are added.
    """

    rows: FloatArray
    areas: FloatArray
    coordinates: FloatArray


def sizes_between(start: int, stop: int, factor: float = 1.25) -> list[int]:
    """Numbers of basis functions from start to stop, growing by a factor (at least 1 a step)."""
    sizes = [min(start, stop)]
    while sizes[-1] < stop:
        sizes.append(min(stop, max(sizes[-1] + 1, round(factor * sizes[-1]))))
    return sizes


def fit_functional_map(target: Samples, source_rows: FloatArray, k1: int) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 in the least-squares sense over the target's samples (paper, section 2.1.2).

    Parameters
    ----------
    target : Samples
    source_rows : (b, k2) array
        Row i is Phi~2 at the match of target sample i, (P12 Phi~2)(x_i).
    k1 : int
        Leading target basis functions to use.

    Returns
    -------
    (k1, k2) array
    """
    rows = target.rows[:, :k1]
    weighted = rows * target.areas[:, None]
    gram = weighted.T @ rows
    gram[np.diag_indices(k1)] += 1e-9 * np.trace(gram) / k1
    return np.asarray(linalg.solve(gram, weighted.T @ source_rows, assume_a="pos"))


def fit_both_ways(
    target: Samples, source: Samples, matches: tuple[IndexArray, IndexArray], sizes: tuple[int, int]
) -> FloatArray:
    """C12 of the pairs that two matches make, each surface's samples counting as much as the other's.

    A limb of the source that no target sample is matched to says nothing to C12 = Phi~1^+ P12 Phi~2; its own samples,
    matched to the target, do (docs/accuracy.md).

    Parameters
    ----------
    target, source : Samples
    matches : ((b1,), (b2,)) arrays
        Source sample of every target sample, target sample of every source sample.
    sizes : (int, int)
        Leading basis functions (k1, k2).

    Returns
    -------
    (k1, k2) array
    """
    forward, backward = matches
    rows = np.vstack([target.rows[:, : sizes[0]], target.rows[backward, : sizes[0]]])
    values = np.vstack([source.rows[forward, : sizes[1]], source.rows[:, : sizes[1]]])
    areas = np.concatenate([target.areas / target.areas.sum(), source.areas / source.areas.sum()])
    return fit_functional_map(Samples(rows, areas, np.zeros((len(rows), 0))), values, sizes[0])


def spread(n: int, count: int) -> IndexArray:
    """Choose samples at equal steps of the numbering; all of them if there are no more than `count`.

    Vertices of a refined mesh are stored in a spatially coherent order within each of their kinds, so equal steps are
    dense where the mesh is, at hands and faces; their areas then weigh them. (Steps of equal area, weighted by area
    again, lose the hands.)
    """
    return np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.int64))


def embed_target(samples: Samples, k: int) -> Embedding:
    """Target embedding: Phi~1(x, :) beside the extra coordinates."""
    return np.hstack([samples.rows[:, :k], np.sqrt(k) * samples.coordinates]).astype(np.float32)


def embed_source(samples: Samples, functional_map: FloatArray) -> Embedding:
    """Source embedding: Phi~2(y, :) C12^T beside the extra coordinates."""
    k1, k2 = functional_map.shape
    spectral = samples.rows[:, :k2] @ functional_map.T
    return np.hstack([spectral, np.sqrt(k1) * samples.coordinates]).astype(np.float32)


def subset(samples: Samples, chosen: IndexArray) -> Samples:
    """Some of the samples."""
    return Samples(samples.rows[chosen], samples.areas[chosen], samples.coordinates[chosen])
