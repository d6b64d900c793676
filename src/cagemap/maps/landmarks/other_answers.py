"""The other answer of landmarks that are mirrored: with left and right exchanged."""

from __future__ import annotations

from dataclasses import replace

from scipy.spatial import cKDTree

from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.confidence import TWO, Confidence, cost_signs
from cagemap.maps.hypotheses.limbs import mutually_nearest
from cagemap.maps.hypotheses.search import search
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.pair import PointPairs, Progress, no_progress
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangle_surface import TriangleSurface

MIRRORED_NOTE = (
    "the landmarks surround each other in the opposite sense on the two surfaces: left and right seem exchanged in all "
    "pairs, or one mesh is mirrored. Exchange them in the landmark file, or mirror one of the meshes"
)


def mirrored_answers(
    problem: Problem, given: Placement, check: LandmarkCheck, progress: Progress = no_progress
) -> tuple[Confidence | None, LandmarkCheck]:
    """Two answers for landmarks that are mirrored (`landmarks_mirrored`): as given, and exchanged; and the check.

    The exchange is that of the best map without landmarks. None if this map exchanges too few, or if the landmarks
    cost hardly more than it. Unless they do, the check gets a note.
    """
    prepared, landmarks = problem.prepared, problem.landmarks
    best = search(problem.without(range(len(landmarks))), progress)[0]
    config = prepared.elastic.landmarks
    if given.cost < config.min_mirrored_cost * best.cost:
        return None, check
    check = replace(check, notes=(*check.notes, MIRRORED_NOTE))
    exchange = exchanged_pairs(prepared.mesh, landmarks, best.map_positions, config.exchange_distance)
    if len(exchange) < FEWEST_LANDMARKS:
        return None, check
    answers = (
        Placement(given.map_positions, given.cost, name="as the landmarks are given"),
        Placement(
            best.map_positions,
            best.cost,
            name="with left and right of the landmarks exchanged",
            exchange=tuple(map(tuple, exchange.tolist())),
        ),
    )
    return Confidence(TWO, answers, cost_signs(answers)), check


def exchanged_pairs(mesh: TriangleSurface, landmarks: PointPairs, images: FloatArray, within: float) -> IndexArray:
    """(q, 2) landmarks i, j with the image of i near the source point of j, one-to-one."""
    near = cKDTree(mesh.positions).query(landmarks.target.positions)[1]
    return mutually_nearest(images[near], landmarks.source.positions, within)[0]
