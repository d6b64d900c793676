"""Functional maps from point matches, and ZoomOut: alternate both with more functions [Melzi et al. 2019].

A target sample x has the embedding Phi~1(x, :), a source sample y the embedding Phi~2(y, :) C12^T; x is matched with
the y of nearest embedding (paper, sections 2.1.2 and 5.4).

Landmarks and curves extend both embeddings by coordinates that are equal at corresponding landmarks
(`landmark_coordinates`): harmonic and biharmonic interpolants, from Green's functions of the Laplacian with one
factorisation for all. Nearest neighbours are exact at landmarks, and give ZoomOut its first match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Config
from cagemap.numerics.sparse_algebra import factor
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.operators import lumped_areas

Embedding = NDArray[np.float32]

FIT_SAMPLES = 6000  # samples to fit a functional map: 20 for each of 300 unknowns in a column of C
QUERY_BLOCK = 512  # queries in one block of `nearest_rows`; each takes 4 bytes per point for its distances
HARMONIC_WEIGHT = 3.0  # weight of harmonic coordinates beside the others (docs/lab/spectral.md)


@dataclass(frozen=True)
class ZoomOutSchedule(Config):
    """Numbers of functions in ZoomOut: from ``first`` to ``last``, times ``factor`` (at least 1 more) in every step."""

    first: int = 20
    last: int = 150
    factor: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
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


def zoomout(
    target: FloatArray,
    areas: FloatArray,
    source: FloatArray,
    match: IndexArray,
    schedule: ZoomOutSchedule,
    shared: tuple[FloatArray, FloatArray] | None = None,
) -> IndexArray:
    """(b1,) refined match of target and source samples by their basis rows and areas: fit C12, search, repeat."""
    counts = target.shape[1], source.shape[1]
    for size in schedule.sizes(max(counts)):
        k1, k2 = min(size, counts[0]), min(size, counts[1])
        functional_map = fit_functional_map(target[:, :k1], areas, source[match][:, :k2])
        match = nearest_samples(target, source, functional_map, shared)
    return match


def fit_functional_map(rows: FloatArray, areas: FloatArray, values: FloatArray) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 (k1, k2) of rows (b, k1) and matched values (b, k2), by area (b,) (paper, 2.1.2)."""
    weighted = rows * areas[:, None]
    gram = weighted.T @ rows
    gram[np.diag_indices(len(gram))] += 1e-9 * np.trace(gram) / len(gram)
    return np.asarray(linalg.solve(gram, weighted.T @ values, assume_a="pos"))


def nearest_samples(
    target: FloatArray,
    source: FloatArray,
    functional_map: FloatArray,
    shared: tuple[FloatArray, FloatArray] | None = None,
) -> IndexArray:
    """(b1,) nearest source sample of every target sample in the embedding of C12 (paper, 5.4).

    ``shared`` are weighted coordinates (b1, c), (b2, c) of both surfaces that are added to the embedding. They are
    scaled by sqrt(k), so that their share of a distance does not decrease with the number of spectral coordinates.
    """
    k1, k2 = functional_map.shape
    embedded = [target[:, :k1], source[:, :k2] @ functional_map.T]
    if shared is not None:  # times sqrt(k): their share of distances does not fall with more spectral coordinates
        embedded = [np.hstack([rows, np.sqrt(k1) * more]) for rows, more in zip(embedded, shared, strict=True)]
    return nearest_rows(*(rows.astype(np.float32) for rows in embedded))


def nearest_rows(queries: Embedding, points: Embedding) -> IndexArray:
    """(b,) index of the nearest point (n, k) to every query (b, k), by products: k-d trees are slow for so many k."""
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
    """At most ``count`` vertices at equal steps of the numbering: weight by area, as equal areas leave few on hands."""
    return np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.int64))


def landmark_coordinates(
    stiffness: sparse.csr_array, mass: sparse.csr_array, landmarks: IndexArray, curves: Sequence[IndexArray] = ()
) -> FloatArray:
    """Weighted harmonic and biharmonic coordinates (n, 2 (p + c)) of every vertex, to extend spectral ones.

    Columns are 3 h_i of every landmark (p,) and curve (c arrays of vertices, none a landmark), then b_i. Both h_i and
    b_i are 1 on landmark i and 0 on the others. InvalidLandmarksError for fewer than two or repeated landmarks.
    """
    unique = np.unique(landmarks)
    if len(landmarks) < 2 or len(unique) != len(landmarks):
        raise InvalidLandmarksError(
            f"expected at least two different landmarks on a surface, got {len(landmarks)} of which {len(unique)} "
            "differ: add landmark pairs or remove the repeated ones"
        )
    sets = [*landmarks[:, None], *curves]
    units = np.repeat(np.eye(len(sets)), [len(vertices) for vertices in sets], axis=0)
    harmonic, biharmonic = interpolants(stiffness, mass, np.concatenate(sets), units)
    return np.hstack([HARMONIC_WEIGHT * harmonic, biharmonic])


def interpolants(
    stiffness: sparse.csr_array, mass: sparse.csr_array, vertices: IndexArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Harmonic and biharmonic interpolants (n, c) of values (q, c) at vertices (q,).

    They solve ``W h = 0`` and ``W D^{-1} W b = 0`` at all other vertices, with D the row sums of M. The solution is
    ``G[:, vertices] c + const`` with G = W^+, or W^+ D W^+ for b; c sums to zero and is chosen to fit the values.
    """
    n, q = stiffness.shape[0], len(vertices)
    areas = lumped_areas(mass)
    grounded = np.arange(n) != vertices[0]  # W is singular on constants only: fix the value at one vertex
    factors = factor(sparse.csc_array(stiffness[grounded][:, grounded]))

    def green(charges: FloatArray) -> FloatArray:
        """W^+ applied to charges that sum to zero, with mean 0."""
        potential = np.zeros((n, charges.shape[1]))
        potential[grounded] = factors.solve(np.ascontiguousarray(charges[grounded]))
        return potential - areas @ potential / areas.sum()

    charges = np.zeros((n, q))
    charges[vertices, np.arange(q)] = 1.0
    charges -= areas[:, None] / areas.sum()
    first = green(charges)
    second = green(areas[:, None] * first)
    return _interpolate(first, vertices, values), _interpolate(second, vertices, values)


def _interpolate(kernels: FloatArray, vertices: IndexArray, values: FloatArray) -> FloatArray:
    """Interpolate values by kernel columns and a constant, with coefficients that sum to zero."""
    q = len(vertices)
    system = np.ones((q + 1, q + 1))
    system[:q, :q], system[q, q] = kernels[vertices], 0.0
    coefficients = linalg.solve(system, np.vstack([values, np.zeros((1, values.shape[1]))]))
    return kernels @ coefficients[:q] + coefficients[q]
