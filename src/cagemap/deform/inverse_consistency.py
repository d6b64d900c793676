"""Inverse consistency: average a placement with the inverse of the reverse fit (Christensen and Johnson 2001).

Where a joint bends, the energy has its minimum beside the truth: it would rather let a shin slide towards the knee
than stretch the skin over it. Fitted the other way round from there, and in the target's pose where that is another
one (`cagemap.deform.pose`), the same energy lets the skin slide back; the average leaves half of either slide out.
"""

from __future__ import annotations

import numpy as np

from cagemap.deform.fit import fine_stage
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.pose import fit_in_pose, pose_difference
from cagemap.deform.problem import Problem
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface


def inverse_consistent(problem: Problem, positions: FloatArray) -> FloatArray:
    """Positions (n, 3) half-way between a fine placement and the inverse of the reverse fit that starts there.

    Positions as they are where the source has no counterpart of much of the target: there the inverse knows nothing.
    """
    prepared, back = problem.prepared, problem.prepared.reversed
    mesh, graph, config = prepared.mesh, prepared.rest.graph, prepared.elastic.inverse
    start, _ = inverse(mesh, positions, back.mesh, config.normal_weight)
    if pose_difference(back.rest, start) > prepared.elastic.pose.difference:
        returned = fit_in_pose(problem.reversed, start, times=1)
    else:
        returned = fine_stage(problem.reversed, start)
    places, gaps = inverse(back.mesh, returned, mesh, config.normal_weight)
    if graph.areas[gaps > config.far].sum() > config.max_far * graph.areas.sum():
        return positions
    trust = 1.0 / (1.0 + (gaps / config.gap) ** 2) ** 2
    return positions + smoothed(graph, 0.5 * (places - positions), trust, config.smoothing)


def inverse(
    mesh: TriangleSurface, deformed: FloatArray, other: TriangleSurface, normal_weight: float
) -> tuple[FloatArray, FloatArray]:
    """Places (n2, 3) of another mesh's vertices by the inverse of a deformation (n, 3) onto it, and gaps (n2,).

    The gaps are their distances from the deformed mesh.
    """
    tree = build_tree(deformed, mesh.triangles)
    at, barycentric, gaps = closest_points(tree, other.positions, other.vertex_normals, normal_weight=normal_weight)
    return np.einsum("mk,mkd->md", barycentric, mesh.positions[mesh.triangles[at]]), gaps


def smoothed(graph: ElasticGraph, shifts: FloatArray, trust: FloatArray, length: float) -> FloatArray:
    """(n, 3) shifts of a mesh smoothed over a length; where trust (n,) is 0 they follow their surroundings."""
    masses = graph.areas * np.maximum(trust, 1e-6)
    return graph.smoother(length, masses).solve(masses[:, None] * shifts)
