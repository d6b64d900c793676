"""A fit whose rest shape has the source's pose: what bends a joint is no strain then.

The elastic energy counts the turn of a bent joint as a change of differentials, and less of it where the skin is
squeezed: its minimum has shins slid towards bent knees. So a fit that found the pose is used to bring the target there,
as rigidly as possible, and the target in that pose is fitted again. Then two bodies stand alike, for which the stiffer
coarse stage is the right one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from cagemap.maps.elastic.constants import (
    JOINT_SMOOTHING,
    JOINTS_FOUND,
    LIMB,
    LOOSEST,
    POSES_FOUND,
    POSING_ROUNDS,
    POSING_SMOOTHING,
    POSING_STIFFNESS,
)
from cagemap.maps.elastic.fit import coarse_fit, fine_fit
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph
from cagemap.maps.elastic.prepared import RestShape
from cagemap.maps.elastic.problem import FitProblem
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import factor
from cagemap.numerics.rotations import nearest_rotations


def fit_in_pose(problem: FitProblem, positions: FloatArray, times: int = POSES_FOUND) -> FloatArray:
    """Places (n, 3) by the coarse and the fine stage of the target in the pose that a fit has found.

    Parameters
    ----------
    problem : FitProblem
    positions : (n, 3) float64
        Where a fine stage ended.
    times : int
        The better the fit, the better the pose: both are found again, so often in all.
    """
    settled, rest = problem.staged(problem.prepared.elastic.settled), problem.prepared.rest
    for _ in range(times):
        there = rest.at(posed(rest, positions), settled.prepared.elastic.fine.smoothing)
        alike = replace(settled, prepared=replace(settled.prepared, rest=there))
        positions = fine_fit(alike, coarse_fit(alike, there.graph.positions[alike.shape.vertices]))
    return positions


def turn(rest: RestShape, positions: FloatArray) -> float:
    """How far poses differ: mean of `turns`."""
    return float(rest.graph.areas @ turns(rest, positions)) / float(rest.graph.areas.sum())


def limb_turn(rest: RestShape, positions: FloatArray) -> float:
    """How far single limbs are posed otherwise: what `turns` are at least on `LIMB` of the area that is not masked."""
    angles = turns(rest, positions)
    order = np.argsort(-angles)
    covered = np.cumsum((rest.graph.areas * rest.masks.of_target(rest.graph.n))[order])
    return float(angles[order[np.searchsorted(covered, LIMB * covered[-1])]])


def turns(rest: RestShape, positions: FloatArray) -> FloatArray:
    """(n,) angles, in radians, between the turn of every vertex of a fit (n, 3) and that of all."""
    areas, rotations = rest.graph.areas, nearest_rotations(rest.field.solve(positions))
    common = nearest_rotations(np.einsum("n,nab->ab", areas, rotations)[None])[0]
    cosines = 0.5 * (np.einsum("nab,ab->n", rotations, common) - 1.0)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def posed(rest: RestShape, positions: FloatArray) -> FloatArray:
    """(n, 3) the rest shape near some positions (n, 3), as rigid as possible (Sorkine and Alexa 2007) but at joints.

    Minimises ``sum_i a_i |x_i - y_i|^2 + alpha sum_ij c_ij w_ij |x_i - x_j - R_ij (p_i - p_j)|^2``, R the rotations of
    smoothed differentials: limbs keep their lengths and girths, and turn where c is small. It is, where they turn
    already: bodies bend at joints, and a thigh does not twist from end to end.
    """
    graph, places = rest.graph, positions
    pull, blocks = graph.areas[:, None] * positions, graph.areas[:, None, None] * np.eye(3)
    field = DifferentialField.build(graph, graph.laplacian(), POSING_SMOOTHING)
    for _ in range(JOINTS_FOUND):
        loose = replace(graph, weights=graph.weights * edge_stiffness(graph, nearest_rotations(field.solve(places))))
        field = DifferentialField.build(loose, loose.laplacian(), POSING_SMOOTHING)
        factors = field.system.factor(POSING_STIFFNESS, blocks, field.factors)
        for _ in range(POSING_ROUNDS):
            turned = field.divergence(nearest_rotations(field.solve(places)))
            places = factors.solve((pull + POSING_STIFFNESS * turned).ravel()).reshape(-1, 3)
    return places


def edge_stiffness(graph: ElasticGraph, rotations: FloatArray) -> FloatArray:
    """(2 m,) weights c of the edges, from 1 where nothing turns to `LOOSEST` at joints: ``1 / (1 + k^2 / mean k^2)``.

    Parameters
    ----------
    graph : ElasticGraph
    rotations : (n, 3, 3) float64
        Of every vertex; k is the length of their gradient, smoothed.
    """
    changes = ((rotations[graph.heads] - rotations[graph.tails]) ** 2).sum(axis=(1, 2))
    covered = np.bincount(graph.heads, graph.weights * (graph.edges**2).sum(axis=1), graph.n)
    covered = np.maximum(covered, 1e-12 * covered.mean())  # where faces are points nothing is seen to turn
    squared = np.bincount(graph.heads, graph.weights * changes, graph.n) / covered
    smooth = sparse.csc_array(sparse.diags_array(graph.areas) + JOINT_SMOOTHING**2 * graph.laplacian())
    squared = np.maximum(factor(smooth).solve(graph.areas * squared), 0.0)
    stiff = 1.0 / (1.0 + squared / max(float(graph.areas @ squared), 1e-12))
    return np.asarray(np.maximum(np.sqrt(stiff[graph.heads] * stiff[graph.tails]), LOOSEST))
