"""Refit a placement in the source's pose, and average it with the inverse of the reverse fit.

The elastic energy counts the rotation of a bent joint as a change of differentials, and less of it where the skin is
squeezed: its minimum has shins slid towards bent knees. So a placement that found the pose is used to bring the target
there, as rigidly as possible, and the target in that pose is fitted again. Then two bodies stand alike, for which the
stiff coarse stage is the right one.

What sliding is left, the same energy does the other way round in the reverse fit: the average of a fit and the inverse
of that leaves half of either out (inverse consistency, Christensen and Johnson 2001).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.deform.config import RefitConfig
from cagemap.deform.energy import ElasticEnergy, VertexTerms, rotations
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit, fine_stage
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.minimise import minimise
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem, RestShape
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface


def finish_placement(problem: Problem, placed: Placement) -> Placement:
    """The placement refitted in the source's pose, and made inverse consistent where that costs hardly more.

    Not under masks: what is masked would be fitted back as well, and drag what is not with it.
    """
    prepared, posed, config = problem.prepared, placed, problem.prepared.elastic
    if prepared.rest.masks.any:
        return placed
    if pose_difference(prepared.rest, placed.positions) > config.refit.difference:
        posed = evaluate_placement(prepared, fit_in_pose(problem, placed.positions))
    both_ways = evaluate_placement(prepared, inverse_consistent(problem, posed.positions))
    cheap = both_ways.cost <= config.search.as_cheap * posed.cost
    return replace(placed, final=(both_ways if cheap else posed).positions)


def fit_in_pose(problem: Problem, positions: FloatArray, times: int | None = None) -> FloatArray:
    """Positions (n, 3) by the coarse and the fine stage of the target in the pose of a placement, so many times."""
    stiff, rest, config = problem.stiff, problem.prepared.rest, problem.prepared.elastic
    for _ in range(config.refit.rounds if times is None else times):
        there = rest.at(rigid_pose(rest, positions, config.refit), config.fine.smoothing)
        alike = replace(stiff, prepared=replace(stiff.prepared, rest=there))
        positions = fine_fit(alike, coarse_fit(alike, there.graph.positions[alike.shape.vertices]))
    return positions


def pose_difference(rest: RestShape, positions: FloatArray) -> float:
    """How far poses differ, in radians: mean of `rotation_angles`."""
    return float(rest.graph.areas @ rotation_angles(rest, positions)) / float(rest.graph.areas.sum())


def largest_limb_rotation(rest: RestShape, positions: FloatArray, share: float) -> float:
    """Least of `rotation_angles`, in radians, on the most rotated share of the area that is not masked."""
    angles = rotation_angles(rest, positions)
    order = np.argsort(-angles)
    covered = np.cumsum((rest.graph.areas * rest.masks.of_target(rest.graph.n))[order])
    return float(angles[order[np.searchsorted(covered, share * covered[-1])]])


def rotation_angles(rest: RestShape, positions: FloatArray) -> FloatArray:
    """(n,) angles, in radians, between the rotation of every vertex of a placement (n, 3) and that of all."""
    areas, own = rest.graph.areas, nearest_rotations(rest.energy.maps(positions))
    common = common_rotation(areas, own)
    cosines = 0.5 * (np.einsum("nab,ab->n", own, common) - 1.0)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def common_rotation(areas: FloatArray, rotations: FloatArray) -> FloatArray:
    """(3, 3) rotation nearest to some (n, 3, 3), by area (n,)."""
    return nearest_rotations(np.einsum("n,nab->ab", areas, rotations)[None])[0]


def rigid_pose(rest: RestShape, positions: FloatArray, config: RefitConfig = RefitConfig()) -> FloatArray:
    """(n, 3) the rest shape near some positions (n, 3), as rigid as possible (Sorkine and Alexa 2007) but at joints.

    Minimises ``sum_i a_i |x_i - y_i|^2 + alpha sum_ij c_ij w_ij |x_i - x_j - R_ij (p_i - p_j)|^2``, R the rotations of
    smoothed differentials, c small where they turn already: bodies bend at joints.
    """
    graph, stage, found = rest.graph, config.stage, positions
    blocks, right = graph.areas[:, None, None] * np.eye(3), graph.areas[:, None] * positions
    energy = ElasticEnergy.build(graph, stage.smoothing, rotations)
    for _ in range(config.joint_rounds):
        stiffness = edge_stiffness(graph, energy.differentials(found)[0], config)
        energy = ElasticEnergy.build(replace(graph, weights=graph.weights * stiffness), stage.smoothing, rotations)
        found = minimise(energy, VertexTerms(energy, blocks, right, constant=True), found, stage)
    return found


def edge_stiffness(graph: ElasticGraph, turns: FloatArray, config: RefitConfig = RefitConfig()) -> FloatArray:
    """(2 m,) ``1 / (1 + k^2 / mean k^2)`` of edges, k the smoothed gradient of rotations (n, 3, 3): least at joints."""
    changes = ((turns[graph.heads] - turns[graph.tails]) ** 2).sum(axis=(1, 2))
    covered = np.bincount(graph.heads, graph.weights * (graph.edges**2).sum(axis=1), graph.n)
    covered = np.maximum(covered, 1e-12 * covered.mean())  # where faces are points nothing is seen to turn
    squared = np.bincount(graph.heads, graph.weights * changes, graph.n) / covered
    squared = np.maximum(graph.smoother(config.joint_smoothing).solve(graph.areas * squared), 0.0)
    stiff = 1.0 / (1.0 + squared / max(float(graph.areas @ squared), 1e-12))
    return np.asarray(np.maximum(np.sqrt(stiff[graph.heads] * stiff[graph.tails]), config.min_stiffness))


def inverse_consistent(problem: Problem, positions: FloatArray) -> FloatArray:
    """Positions (n, 3) half-way between a fine placement and the inverse of the reverse fit that starts there.

    As they are where the source has no counterpart of much of the target: there the inverse knows nothing.
    """
    prepared, back = problem.prepared, problem.prepared.reversed
    mesh, graph, config = prepared.mesh, prepared.rest.graph, prepared.elastic.refit
    start, _ = inverse_positions(mesh, positions, back.mesh, config.normal_weight)
    posed = pose_difference(back.rest, start) > config.difference
    returned = fit_in_pose(problem.reversed, start, times=1) if posed else fine_stage(problem.reversed, start)
    places, gaps = inverse_positions(back.mesh, returned, mesh, config.normal_weight)
    if graph.areas[gaps > config.far].sum() > config.max_far * graph.areas.sum():
        return positions
    trust = 1.0 / (1.0 + (gaps / config.gap) ** 2) ** 2
    return positions + smooth_shifts(graph, 0.5 * (places - positions), trust, config.smoothing)


def inverse_positions(
    mesh: TriangleSurface, deformed: FloatArray, other: TriangleSurface, normal_weight: float
) -> tuple[FloatArray, FloatArray]:
    """Places (n2, 3) of another mesh by the inverse of a deformation (n, 3) onto it, and distances (n2,) from that."""
    tree = build_tree(deformed, mesh.triangles)
    at, barycentric, gaps = closest_points(tree, other.positions, other.vertex_normals, normal_weight=normal_weight)
    return np.einsum("mk,mkd->md", barycentric, mesh.positions[mesh.triangles[at]]), gaps


def smooth_shifts(graph: ElasticGraph, shifts: FloatArray, trust: FloatArray, length: float) -> FloatArray:
    """(n, 3) shifts of a mesh smoothed over a length; where trust (n,) is 0 they follow their surroundings."""
    masses = graph.areas * np.maximum(trust, 1e-6)
    return graph.smoother(length, masses).solve(masses[:, None] * shifts)
