"""Limbs: their tips, which ones of two surfaces may correspond, and fits that tips lead.

Between species the energy leaves an ear or a hoof beside its counterpart, and drags what is around it along; a short
leg lies within a long one. So tips that lie near each other lead a fit, whose coarse stage has data terms of the source
too. Limbs assigned to limbs by intrinsic measures are starts that do not depend on the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.config import SearchConfig
from cagemap.deform.data import SourceSamples
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement
from cagemap.deform.problem import CoarseShape, Problem
from cagemap.maps.hypotheses.rigid_starts import units_of_larger
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import thread_limit

# Least length of a limb, of sqrt(area).
LEAST_LENGTH = 0.01
# Of e limbs beside p landmarks, lengths of sqrt(area): geodesic distances (p + e, p + e) between the places where limbs
# join, landmarks first, which are limbs too; and girths (e,), area by length.
LimbMeasures = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Tips:
    """Tips of both surfaces."""

    vertices: IndexArray  # (e,) of the target's level that is deformed
    source_vertices: IndexArray  # (e2,) of the source's level that is searched
    places: FloatArray  # (e2, 3) of these

    @classmethod
    def of(cls, problem: Problem, least: float | None = None, units: tuple[float, float] = (1.0, 1.0)) -> Tips:
        """Tips of a least height in ``units``, neither masked, nor at a landmark, nor at a boundary; highest first."""
        (target, source), landmarks = problem.prepared.graphs, problem.pair.landmarks
        prepared, found = problem.prepared, []
        config = prepared.elastic.search
        least = config.tip_height if least is None else least
        searched = prepared.source.hierarchy.on_finest(prepared.levels[1])
        masks = prepared.masks.at(prepared.vertices, searched)
        meshes = prepared.mesh, prepared.source.triangles(prepared.levels[1])
        for graph, mesh, counts, given, unit in (
            (target, meshes[0], masks.of_target(target.n), landmarks.target.positions, units[0]),
            (source, meshes[1], masks.of_source(source.n), landmarks.source.positions, units[1]),
        ):
            vertices = tip_vertices(graph, least / unit)
            away = np.linalg.norm(graph.positions[vertices, None] - given, axis=2).min(axis=1, initial=np.inf)
            kept = (counts[vertices] > 0) & (away > config.tip_taken) & ~mesh.boundary_vertices[vertices]
            found.append(vertices[kept])
        return cls(found[0], found[1], source.positions[found[1]])

    def pairs(self, positions: FloatArray, config: SearchConfig) -> IndexArray:
        """(q, 2) tips of target and source that are each other's nearest where a fit puts the target's vertices."""
        images = positions[self.vertices]
        if not len(images) or not len(self.places):
            return np.zeros((0, 2), dtype=np.int64)
        distance, there = (np.asarray(found) for found in cKDTree(self.places).query(images))
        back = np.asarray(cKDTree(images).query(self.places)[1])
        mutual = (distance < config.tips_near) & (back[there] == np.arange(len(images)))
        if not np.any(distance[mutual] > config.tips_met):
            return np.zeros((0, 2), dtype=np.int64)
        return np.column_stack([np.flatnonzero(mutual), there[mutual]])


def refit_to_tips(problem: Problem, tips: Tips, placed: Placement) -> Placement:
    """Refit from a placement with the tips held in the coarse stage; the placement itself where it is much cheaper.

    The fine stage holds landmarks only: tips that are no counterparts slip away.
    """
    prepared, config = problem.prepared, problem.prepared.elastic.search
    pairs = tips.pairs(placed.positions, config)
    if not len(pairs):
        return placed
    stiff = problem.staged(config.led)
    shape = stiff.holding(tips.vertices[pairs[:, 0]], tips.places[pairs[:, 1]])
    leading = SourceSamples.choose(prepared.source_surface, config.led_samples, prepared.rest.masks)
    with thread_limit(1):
        led = coarse_fit(stiff, placed.positions[shape.vertices], shape, leading)
    again = replace(evaluate_placement(prepared, fine_fit(problem, led)), name=placed.name, doubt=placed.doubt)
    return again if again.cost <= prepared.elastic.search.as_cheap * placed.cost else placed


def tip_vertices(graph: ElasticGraph, least: float = SearchConfig.tip_height) -> IndexArray:
    """(e,) vertices that are farther from the whole surface than all around them, highest first.

    Mean geodesic distance (Hilaga et al. 2001), over the highest pass to a higher one (Edelsbrunner et al. 2002).
    """
    heights = mean_distances(graph)
    peaks, above = prominences(heights, graph.heads, graph.tails)
    kept = above >= least
    return peaks[kept][np.argsort(-above[kept], kind="stable")]


def mean_distances(graph: ElasticGraph) -> FloatArray:
    """(n,) mean distance along the edges to the whole of a vertex' piece; 0 on small pieces."""
    distances = graph.station_distances
    reached = np.isfinite(distances)
    large = reached.any(axis=0)
    shares = np.bincount(distances.argmin(axis=0), graph.areas * large, len(distances))
    return np.asarray((shares @ np.where(reached, distances, 0.0)) / np.where(large, shares @ reached, 1.0))


def prominences(heights: FloatArray, heads: IndexArray, tails: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Local maxima (q,) of heights (n,), and how far each stands over its highest pass to a higher one."""
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


def limb_measures(
    graph: ElasticGraph,
    landmarks: IndexArray,
    tips: IndexArray,
    unit: float = 1.0,
    girth_part: float = SearchConfig.girth_part,
) -> LimbMeasures:
    """Measure the limbs that end at tips (e,), beside landmarks (p,), in a unit; three at least, of one piece.

    A limb is as long as its leaf in the tree of all ends, ``min_jk (d_ij + d_ik - d_jk) / 2`` (Gromov product).
    """
    ends = np.concatenate([landmarks, tips])
    distances = graph.distances(ends)
    apart = distances[:, ends]
    products = 0.5 * (apart[:, :, None] + apart[:, None, :] - apart)
    every = np.arange(len(ends))
    products[every, every, :] = products[every, :, every] = products[:, every, every] = np.inf
    own = np.maximum(products.min(axis=(1, 2)), LEAST_LENGTH)
    between = apart - own[:, None] - own
    between[every, every] = 0.0
    part, limbs = girth_part * own[len(landmarks) :], distances[len(landmarks) :]
    return unit * between, unit * ((limbs < part[:, None]) @ graph.areas / part)


def rank_assignments(
    target: LimbMeasures, source: LimbMeasures, config: SearchConfig = SearchConfig()
) -> list[tuple[IndexArray, IndexArray]]:
    """Numbers (k,) of limbs of target and source that may correspond; the likeliest assignments first.

    Joints' distances count, and girths. Lengths do not: a hippo has short legs and a cougar a long tail.
    """
    (between, girths), (source_between, source_girths) = target, source
    if len(girths) > len(source_girths):
        return [(i, j) for j, i in rank_assignments(source, target, config)]
    count, landmarks = len(girths), len(between) - len(girths)
    to = np.array(list(permutations(range(len(source_girths)), count)))
    ends = np.hstack([np.tile(np.arange(landmarks), (len(to), 1)), landmarks + to])
    apart = np.abs(source_between[ends[:, :, None], ends[:, None, :]] - between).sum(axis=(1, 2))
    ratios = np.log(source_girths[to] / girths)
    ratios -= np.median(ratios, axis=1, keepdims=True)
    ranked = np.argsort(apart + config.girth_weight * np.abs(ratios).sum(axis=1), kind="stable")
    return [(np.arange(count), to[row]) for row in ranked[: config.max_assignments]]


@dataclass(frozen=True, eq=False)
class Assignment:
    """Limbs of the target on limbs of the source."""

    # (p + k,) Landmarks and tips, of the levels of target and source that are searched
    vertices: tuple[IndexArray, IndexArray]
    places: FloatArray  # (k, 3) of the tips on the source

    def shape(self, problem: Problem) -> CoarseShape:
        """Clusters of a problem's coarse stage that hold the landmarks and the tips."""
        return problem.holding(self.vertices[0][len(self.vertices[0]) - len(self.places) :], self.places)


def assigned_limbs(problem: Problem) -> list[Assignment]:
    """Likely assignments of a pair's limbs, the likeliest first; none where one of the surfaces has too few."""
    units, config = units_of_larger(problem.prepared), problem.prepared.elastic.search
    landmarks, tips = problem.landmark_vertices, Tips.of(problem, config.limb_height, units)
    ends = tips.vertices[: config.max_limbs], tips.source_vertices[: config.max_limbs]
    fewest = min(map(len, ends))
    needed = config.fewest_points if units == (1.0, 1.0) else config.fewest_of_part
    if fewest < 1 or len(landmarks[0]) + fewest < needed:
        return []
    sides = zip(problem.prepared.graphs, landmarks, ends, units, strict=True)
    target, source = (limb_measures(*side, config.girth_part) for side in sides)
    return [
        Assignment(
            (np.concatenate([landmarks[0], ends[0][i]]), np.concatenate([landmarks[1], ends[1][j]])), tips.places[j]
        )
        for i, j in rank_assignments(target, source, config)
    ]
