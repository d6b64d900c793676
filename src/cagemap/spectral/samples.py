"""Samples of a surface, their spectral embeddings, and the functional map of a match (paper, 2.1.2 and 5.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral.nearest import Embedding

# Samples that a functional map is fitted to: some twenty rows for each of 300 unknowns of a column of C.
FIT_SAMPLES = 6000


@dataclass(frozen=True, eq=False)
class Samples:
    """Vertices of one surface with their basis rows and their coordinates in common with the other surface.

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


def evenly_spaced(n: int, count: int) -> IndexArray:
    """Vertices at equal steps of the numbering; all of them if there are no more than ``count``.

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
