"""Refit a placement in the source's pose, and average it with the inverse of the reverse fit.

The elastic energy counts the rotation of a bent joint as a change of differentials, and less of it where the skin is
squeezed: at its minimum, shins slide towards bent knees. So the target is moved into the pose of a placement, as
rigidly as possible, and fitted again from there. Then both bodies have the same pose, for which the stiff coarse stage
is best.

The sliding that remains has the opposite direction in the reverse fit: averaging the fit with the inverse of the
reverse fit reduces it (inverse consistency, Christensen and Johnson 2001).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.deform.config import RefitConfig
from cagemap.deform.energy import ElasticEnergy, VertexTerms, deformed_normals, minimise, rotations
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement, best_parts
from cagemap.deform.problem import Clusters, Problem
from cagemap.maps.masks import Masks
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.numerics.threads import in_threads
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals


def finish_placement(problem: Problem, placed: Placement) -> Placement:
    """Refit a placement in the source's pose; make it inverse consistent if not much costlier.

    Unchanged under masks: the reverse fit would fit masked area too, and displace its surroundings.
    """
    prepared, posed, config = problem.prepared, placed, problem.prepared.elastic
    if prepared.masks.any:
        return placed
    if pose_difference(prepared.energy, placed.positions) > config.refit.min_pose_difference:
        shape = rigid_pose(prepared.energy.graph, placed.positions, config.refit)
        posed = evaluate_placement(prepared, fit_from_shape(problem, shape, placed.positions))
    both_ways = evaluate_placement(prepared, inverse_consistent(problem, posed.positions))
    cheap = both_ways.cost <= config.search.max_equal_cost * posed.cost
    return replace(placed, finished_positions=(both_ways if cheap else posed).positions)


def pose_difference(energy: ElasticEnergy, positions: FloatArray) -> float:
    """Difference of poses in radians: mean of `rotation_angles`."""
    areas = energy.graph.areas
    return float(areas @ rotation_angles(energy, positions)) / float(areas.sum())


def rotation_angles(energy: ElasticEnergy, positions: FloatArray) -> FloatArray:
    """(n,) angles in radians between the rotation of every vertex of a placement (n, 3) and their mean."""
    areas, turns = energy.graph.areas, nearest_rotations(energy.maps(positions))
    common = common_rotation(areas, turns)
    cosines = 0.5 * (np.einsum("nab,ab->n", turns, common) - 1.0)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def common_rotation(areas: FloatArray, rotations: FloatArray) -> FloatArray:
    """(3, 3) mean rotation: nearest to rotations (n, 3, 3), weighted by area (n,)."""
    return nearest_rotations(np.einsum("n,nab->ab", areas, rotations)[None])[0]


def largest_limb_rotation(energy: ElasticEnergy, masks: Masks, positions: FloatArray, share: float) -> float:
    """Least of `rotation_angles`, in radians, on the most rotated share of the unmasked area."""
    angles = rotation_angles(energy, positions)
    order = np.argsort(-angles)
    covered = np.cumsum((energy.graph.areas * masks.of_target(energy.graph.n))[order])
    return float(angles[order[np.searchsorted(covered, share * covered[-1])]])


def fit_from_shape(problem: Problem, shape: FloatArray, placed: FloatArray | None = None) -> FloatArray:
    """(n, 3) target's mesh after the coarse and fine stages, with positions ``shape`` as rest shape and start.

    The clusters do not show fingers. So the fine stage has a second start if there is a placement on the same source,
    ``placed`` (n, 3): it is moved by its shifts to the coarse placement, which are smoothed, so that it keeps its
    fingers. Parts of this fit that cost less by more than ``max_equal_cost`` are taken, and fitted once more.
    """
    prepared, normals = problem.prepared, vertex_normals(shape, problem.prepared.mesh.triangles)
    energy, config = prepared.energy.with_rest_shape(shape, normals, prepared.elastic.fine.smoothing), prepared.elastic
    alike = replace(problem, prepared=replace(prepared, energy=energy))
    clusters = alike.clusters_with(stage=config.stiff_coarse)
    coarse = coarse_fit(alike, shape[clusters.vertices], clusters).extrapolate_to(energy.graph, config.graph)
    if placed is None:
        return fine_fit(alike, coarse)
    graph = prepared.energy.graph
    moved = placed + smooth_shifts(graph, coarse - placed, np.ones(graph.n), config.refit.start_smoothing)
    fits = in_threads(lambda start: evaluate_placement(alike.prepared, fine_fit(alike, start)), (coarse, moved))
    mixed = best_parts(graph, fits, config.search, config.search.max_equal_cost)
    return fits[0].positions if mixed is None else fine_fit(alike, mixed)


def rigid_pose(graph: ElasticGraph, positions: FloatArray, config: RefitConfig = RefitConfig()) -> FloatArray:
    """(n, 3) rest shape moved to positions (n, 3), as rigidly as possible (Sorkine and Alexa 2007) except at joints.

    Minimises ``sum_i a_i |x_i - y_i|^2 + alpha sum_ij c_ij w_ij |x_i - x_j - R_ij (p_i - p_j)|^2``, R the rotations of
    smoothed differentials, c small where they turn already: bodies bend at joints.
    """
    stage, posed = config.stage, positions
    blocks, right = graph.areas[:, None, None] * np.eye(3), graph.areas[:, None] * positions
    energy = ElasticEnergy(graph, stage.smoothing, rotations)
    for _ in range(config.joint_rounds):
        stiffness = edge_stiffness(graph, energy.differentials(posed)[0], config)
        energy = ElasticEnergy(replace(graph, weights=graph.weights * stiffness), stage.smoothing, rotations)
        terms = VertexTerms(energy, blocks, right, constant=True)
        posed = minimise(energy.graph, energy.differentials, terms, posed, stage)
    return posed


def edge_stiffness(graph: ElasticGraph, turns: FloatArray, config: RefitConfig = RefitConfig()) -> FloatArray:
    """(2 m,) ``1 / (1 + k^2 / mean k^2)`` of edges, k the smoothed gradient of rotations (n, 3, 3): least at joints."""
    changes = ((turns[graph.heads] - turns[graph.tails]) ** 2).sum(axis=(1, 2))
    covered = np.bincount(graph.heads, graph.weights * (graph.edges**2).sum(axis=1), graph.n)
    covered = np.maximum(covered, 1e-12 * covered.mean())  # degenerate faces show no rotation
    squared = np.bincount(graph.heads, graph.weights * changes, graph.n) / covered
    squared = np.maximum(graph.smoother(config.smoothing).solve(graph.areas * squared), 0.0)
    stiff = 1.0 / (1.0 + squared / max(float(graph.areas @ squared), 1e-12))
    return np.asarray(np.maximum(np.sqrt(stiff[graph.heads] * stiff[graph.tails]), config.min_stiffness))


def inverse_consistent(problem: Problem, positions: FloatArray) -> FloatArray:
    """(n, 3) mean of a fine placement and the inverse of the reverse fit from it.

    Vertices far from the reverse fit have no inverse; they move with their neighbours.
    """
    prepared, back = problem.prepared, problem.prepared.reverse_pair
    mesh, graph, config = prepared.mesh, prepared.energy.graph, prepared.elastic.refit
    start, _ = inverse_positions(mesh, positions, back.mesh, config.normal_weight)
    if pose_difference(back.energy, start) > config.min_pose_difference:
        returned = fit_from_shape(problem.reverse_problem, rigid_pose(back.energy.graph, start, config), start)
    else:
        returned = fine_fit(problem.reverse_problem, start)
    places, gaps = inverse_positions(back.mesh, returned, mesh, config.normal_weight)
    trust = 1.0 / (1.0 + (gaps / config.gap) ** 2) ** 2
    return positions + smooth_shifts(graph, 0.5 * (places - positions), trust, config.smoothing)


def inverse_positions(
    mesh: TriangleSurface, deformed: FloatArray, other: TriangleSurface, normal_weight: float
) -> tuple[FloatArray, FloatArray]:
    """Positions (n2, 3) of another mesh by the inverse of a deformation (n, 3), and distances (n2,) from it."""
    tree = build_tree(deformed, mesh.triangles)
    at, barycentric, gaps = closest_points(tree, other.positions, other.vertex_normals, normal_weight=normal_weight)
    return np.einsum("mk,mkd->md", barycentric, mesh.positions[mesh.triangles[at]]), gaps


def smooth_shifts(graph: ElasticGraph, shifts: FloatArray, trust: FloatArray, length: float) -> FloatArray:
    """(n, 3) shifts of a mesh smoothed over a length, weighted by trust (n,)."""
    masses = graph.areas * np.maximum(trust, 1e-6)
    return graph.smoother(length, masses).solve(masses[:, None] * shifts)


def clusters_in_pose(clusters: Clusters, positions: FloatArray, config: RefitConfig = RefitConfig()) -> Clusters:
    """Clusters whose rest shape is moved to a placement (k, 3), as rigidly as possible."""
    energy, shape = clusters.energy, rigid_pose(clusters.energy.graph, positions, config)
    normals = deformed_normals(energy.graph.normals, energy.differentials(shape)[0])
    return replace(clusters, energy=energy.with_rest_shape(shape, normals, clusters.stage.smoothing))
