"""Limbs of a graph: their tips, and positions that keep the ends of limbs."""

from __future__ import annotations

import numpy as np

from cagemap.deform.config import RefitConfig, SearchConfig
from cagemap.deform.graph import ElasticGraph
from cagemap.numerics.arrays import FloatArray, IndexArray


def tip_vertices(graph: ElasticGraph, least: float = SearchConfig.tip_height) -> IndexArray:
    """(e,) local maxima of the mean geodesic distance, most prominent first.

    Mean geodesic distance: Hilaga et al. 2001. Prominence: Edelsbrunner et al. 2002, see `prominences`.
    """
    heights = mean_distances(graph)
    peaks, above = prominences(heights, graph.heads, graph.tails)
    kept = above >= least
    return peaks[kept][np.argsort(-above[kept], kind="stable")]


def mean_distances(graph: ElasticGraph) -> FloatArray:
    """(n,) mean geodesic distance of every vertex to its connected piece; 0 on small pieces."""
    distances = graph.station_distances
    reached = np.isfinite(distances)
    large = reached.any(axis=0)
    shares = np.bincount(distances.argmin(axis=0), graph.areas * large, len(distances))
    return np.asarray((shares @ np.where(reached, distances, 0.0)) / np.where(large, shares @ reached, 1.0))


def prominences(heights: FloatArray, heads: IndexArray, tails: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Local maxima (q,) of heights (n,), and their persistence: the height above the pass to a higher maximum."""
    order = np.argsort(heights, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    best = rank.copy()
    np.maximum.at(best, heads, rank[tails])
    up = order[best]
    while not np.array_equal(up[up], up):  # every vertex climbs to its peak
        up = up[up]
    peaks, basin = np.unique(up, return_inverse=True)
    across = basin[heads] < basin[tails]
    basins, passes = np.column_stack([basin[heads], basin[tails]])[across], np.minimum(rank[heads], rank[tails])[across]
    descending = np.argsort(-passes, kind="stable")
    _, highest = np.unique(basins[descending], axis=0, return_index=True)  # the highest pass between any two basins
    above, joined = np.full(len(peaks), np.inf), np.arange(len(peaks))
    for edge in descending[np.sort(highest)].tolist():
        a, b = joined[basins[edge]].tolist()
        if a != b:
            lower, higher = (a, b) if rank[peaks[a]] < rank[peaks[b]] else (b, a)
            above[lower] = heights[peaks[lower]] - heights[order[passes[edge]]]
            joined[joined == lower] = higher
    lowest, highest_ones = np.full(len(peaks), np.inf), np.isinf(above)
    np.minimum.at(lowest, joined[basin], heights)
    above[highest_ones] = (heights[peaks] - lowest)[highest_ones]
    return peaks, above


def with_ends(
    graph: ElasticGraph, positions: FloatArray, of_ends: FloatArray, search: SearchConfig, config: RefitConfig
) -> FloatArray:
    """(n, 3) positions, with those ``of_ends`` (n, 3) near the tips of limbs, such as on hands."""
    tips = tip_vertices(graph, search.limb_height)[: search.max_limbs]
    beyond = graph.distances(tips).min(axis=0, initial=np.inf) / config.end_length - 1.0
    weights = np.clip(1.0 - beyond / config.end_fade, 0.0, 1.0)
    return np.asarray(positions + weights[:, None] * (of_ends - positions))
