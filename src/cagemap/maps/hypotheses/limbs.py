"""Starts that do not depend on the pose: limbs of the target assigned to limbs of the source by intrinsic measures."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.deform.config import HypothesisConfig
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.prepared import CoarseShape
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.part_starts import units_of_larger
from cagemap.maps.hypotheses.tips import Tips
from cagemap.numerics.arrays import FloatArray, IndexArray

# Least length of a limb, of sqrt(area).
LEAST_LENGTH = 0.01


@dataclass(frozen=True, eq=False)
class Limbs:
    """Landmarks and limbs of one surface; lengths are of sqrt(area).

    Attributes
    ----------
    tips : (e,) int64
        Vertices of the graph, without the landmarks.
    between : (p + e, p + e) float64
        Geodesic distances between the places where limbs join; landmarks first, which are limbs too.
    girths : (e,) float64
        Area by length.
    """

    tips: IndexArray
    between: FloatArray
    girths: FloatArray

    @classmethod
    def of(
        cls,
        graph: ElasticGraph,
        landmarks: IndexArray,
        tips: IndexArray,
        unit: float = 1.0,
        girth_part: float = HypothesisConfig.girth_part,
    ) -> Limbs:
        """Measure the limbs that end at some vertices (e,), beside landmarks (p,); three at least, of one piece.

        A limb's length is that of its leaf in the tree of all ends, ``min_jk (d_ij + d_ik - d_jk) / 2`` (the Gromov
        product, as in neighbour joining).
        """
        ends = np.concatenate([landmarks, tips])
        lengths = np.linalg.norm(graph.edges, axis=1)
        edges = sparse.csr_array((lengths, (graph.heads, graph.tails)), shape=(graph.n, graph.n))
        distances = dijkstra(edges, indices=ends)
        apart = distances[:, ends]
        products = 0.5 * (apart[:, :, None] + apart[:, None, :] - apart)
        every = np.arange(len(ends))
        products[every, every, :] = products[every, :, every] = products[:, every, every] = np.inf
        own = np.maximum(products.min(axis=(1, 2)), LEAST_LENGTH)
        between = apart - own[:, None] - own
        between[every, every] = 0.0
        part, limbs = girth_part * own[len(landmarks) :], distances[len(landmarks) :]
        return cls(tips, unit * between, unit * ((limbs < part[:, None]) @ graph.areas / part))


def assignments(
    target: Limbs, source: Limbs, config: HypothesisConfig = HypothesisConfig()
) -> list[tuple[IndexArray, IndexArray]]:
    """Numbers (k,) of limbs of target and source that may correspond; the likeliest assignments first.

    Ranked by how far the joints' distances differ, and the girths. Lengths of limbs do not count: a hippo has short
    legs and a cougar a long tail.
    """
    if len(target.tips) > len(source.tips):
        return [(i, j) for j, i in assignments(source, target, config)]
    count, landmarks = len(target.tips), len(target.between) - len(target.tips)
    to = np.array(list(permutations(range(len(source.tips)), count)))
    ends = np.hstack([np.tile(np.arange(landmarks), (len(to), 1)), landmarks + to])
    apart = np.abs(source.between[ends[:, :, None], ends[:, None, :]] - target.between).sum(axis=(1, 2))
    ratios = np.log(source.girths[to] / target.girths)
    ratios -= np.median(ratios, axis=1, keepdims=True)
    ranked = np.argsort(apart + config.girth_weight * np.abs(ratios).sum(axis=1), kind="stable")
    return [(np.arange(count), to[row]) for row in ranked[: config.max_assignments]]


@dataclass(frozen=True, eq=False)
class Assignment:
    """Limbs of the target on limbs of the source.

    Attributes
    ----------
    vertices : (p + k,) int64, (p + k,) int64
        Landmarks and tips, of the levels of target and source that are searched.
    places : (k, 3) float64
        Of the tips on the source.
    """

    vertices: tuple[IndexArray, IndexArray]
    places: FloatArray

    def shape(self, problem: Problem) -> CoarseShape:
        """Clusters of a problem's coarse stage that hold the landmarks and the tips."""
        return problem.holding(self.vertices[0][len(self.vertices[0]) - len(self.places) :], self.places)


def assigned_limbs(problem: Problem) -> list[Assignment]:
    """Likely assignments of a pair's limbs, the likeliest first; none where one of the surfaces has too few."""
    units, config = units_of_larger(problem.prepared), problem.prepared.elastic.hypotheses
    landmarks, tips = problem.landmark_vertices, Tips.of(problem, config.limb_height, units)
    ends = tips.vertices[: config.max_limbs], tips.source_vertices[: config.max_limbs]
    fewest = min(map(len, ends))
    needed = config.fewest_points if units == (1.0, 1.0) else config.fewest_of_part
    if fewest < 1 or len(landmarks[0]) + fewest < needed:
        return []
    sides = zip(problem.prepared.graphs, landmarks, ends, units, strict=True)
    target, source = (Limbs.of(*side, config.girth_part) for side in sides)
    return [
        Assignment(
            (np.concatenate([landmarks[0], ends[0][i]]), np.concatenate([landmarks[1], ends[1][j]])), tips.places[j]
        )
        for i, j in assignments(target, source, config)
    ]
