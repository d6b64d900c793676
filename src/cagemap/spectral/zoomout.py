"""Functional maps from point matches, and ZoomOut: alternate both with more functions [Melzi et al. 2019].

A target sample x has the embedding Phi~1(x, :), a source sample y the embedding Phi~2(y, :) C12^T; x is matched with
the y of nearest embedding (paper, sections 2.1.2 and 5.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, row_slices

Embedding = NDArray[np.float32]

# Number of samples to which a functional map is fitted: 20 rows for each of 300 unknowns in a column of C.
FIT_SAMPLES = 6000
# Queries in one block of `nearest_rows`; each takes 4 bytes per point for its distances.
QUERY_BLOCK = 512


@dataclass(frozen=True, eq=False)
class Samples:
    """Vertices of one surface with basis rows, areas, and coordinates shared with the other surface."""

    rows: FloatArray  #: (b, k) basis rows Phi~(x, :)
    areas: FloatArray  #: (b,) areas, the weights in the inner product
    #: (b, c) extra coordinates shared by both surfaces, already weighted; c may be 0. They are scaled by sqrt(k), so
    #: that their share of a distance does not decrease with the number of spectral coordinates.
    coordinates: FloatArray


@dataclass(frozen=True)
class ZoomOutSchedule:
    """Numbers of functions in ZoomOut: from ``first`` to ``last``, times ``factor`` (at least 1 more) in every step."""

    first: int = 20
    last: int = 150
    factor: float = 1.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (1 <= self.first <= self.last and self.factor > 1.0):
            raise ParameterError(
                f"ZoomOut: expected 1 function or more at first, no fewer at last and a factor above 1, got {self}"
            )

    def sizes(self, most: int) -> list[int]:
        """All numbers of functions, at most ``most`` (the size of the larger basis)."""
        last = min(self.last, most)
        sizes = [min(self.first, last)]
        while sizes[-1] < last:
            sizes.append(min(last, max(sizes[-1] + 1, round(self.factor * sizes[-1]))))
        return sizes


def zoomout(target: Samples, source: Samples, match: IndexArray, schedule: ZoomOutSchedule) -> IndexArray:
    """(b1,) refined match of target with source samples: fit C12, search, repeat with more functions."""
    counts = target.rows.shape[1], source.rows.shape[1]
    for size in schedule.sizes(max(counts)):
        k1, k2 = min(size, counts[0]), min(size, counts[1])
        match = nearest_samples(target, source, fit_functional_map(target, source.rows[match][:, :k2], k1))
    return match


def fit_functional_map(target: Samples, source_rows: FloatArray, k1: int) -> FloatArray:
    """Least-squares fit C12 = Phi~1^+ P12 Phi~2 (k1, k2) over the target's samples (paper, section 2.1.2).

    Row i of ``source_rows`` (b, k2) is Phi~2 at the match of target sample i, (P12 Phi~2)(x_i).
    """
    rows = target.rows[:, :k1]
    weighted = rows * target.areas[:, None]
    gram = weighted.T @ rows
    gram[np.diag_indices(k1)] += 1e-9 * np.trace(gram) / k1
    return np.asarray(linalg.solve(gram, weighted.T @ source_rows, assume_a="pos"))


def nearest_samples(target: Samples, source: Samples, functional_map: FloatArray) -> IndexArray:
    """(b1,) nearest source sample of every target sample in the embedding of C12 (paper, 5.4)."""
    k1, k2 = functional_map.shape
    spectral = target.rows[:, :k1], source.rows[:, :k2] @ functional_map.T
    embedded = (
        np.hstack([rows, np.sqrt(k1) * side.coordinates]).astype(np.float32)
        for rows, side in zip(spectral, (target, source), strict=True)
    )
    return nearest_rows(*embedded)


def nearest_coordinates(target: Samples, source: Samples) -> IndexArray:
    """(b1,) nearest source sample of every target sample, by shared coordinates only."""
    return nearest_rows(target.coordinates.astype(np.float32), source.coordinates.astype(np.float32))


def nearest_rows(queries: Embedding, points: Embedding) -> IndexArray:
    """(b,) index of the nearest point (n, k) to every query (b, k), by blocked matrix products.

    A k-d tree is slow while a map is inaccurate (6k vertices, 200 coordinates: 2 s instead of 0.3 s).
    """
    half_norms = 0.5 * np.einsum("ij,ij->i", points, points)
    transposed = np.ascontiguousarray(points.T)
    nearest = np.empty(len(queries), dtype=np.int64)

    def one_block(part: slice) -> None:
        scores = queries[part] @ transposed
        scores -= half_norms
        nearest[part] = np.argmax(scores, axis=1)

    in_threads(one_block, row_slices(len(queries), QUERY_BLOCK))
    return nearest


def evenly_spaced_vertices(n: int, count: int) -> IndexArray:
    """At most ``count`` vertices at equal steps of the numbering.

    Consecutive vertices of a refined mesh are near each other, so that samples are dense where the mesh is dense, as at
    hands and faces; weight them by area. Steps of equal area leave too few samples on hands.
    """
    return np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.int64))
