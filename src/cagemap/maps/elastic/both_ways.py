"""The mean of a fit and of what its inverse becomes: what the elastic energy prefers one way it opposes the other way.

Where a joint bends, the energy has its minimum beside the truth: it would rather let a shin slide towards the knee
than stretch the skin over it. Fitted the other way round from where the first fit ended, and in the target's pose where
that is another one (`cagemap.maps.elastic.pose`), the same energy lets the skin slide back, so that half of either
slide is left out. Registration knows this as inverse consistency (Christensen and Johnson 2001); here one step of it
does.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.geometry.closest import build_tree, closest_points
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic.constants import (
    INVERSE_FACING,
    INVERSE_FAR,
    INVERSE_GAP,
    INVERSE_LOST,
    INVERSE_SMOOTHING,
    POSES_DIFFER,
)
from cagemap.maps.elastic.fit import fine_stage
from cagemap.maps.elastic.graph import ElasticGraph
from cagemap.maps.elastic.pose import fit_in_pose, turn
from cagemap.maps.elastic.problem import FitProblem
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import factor


def both_ways(problem: FitProblem, positions: FloatArray) -> FloatArray:
    """Places (n, 3) half-way between a fine fit's and those by the fit of the reversed pair that starts there.

    Places as they are where the source has no counterpart of much of the target: of that the way back knows nothing.

    Parameters
    ----------
    problem : FitProblem
        Its landmarks are held both ways.
    positions : (n, 3) float64
        Where a fine stage ended.
    """
    prepared, back = problem.prepared, problem.prepared.reversed
    mesh = prepared.mesh
    start, _ = inverse(mesh, positions, back.mesh)
    if turn(back.rest, start) > POSES_DIFFER:
        returned = fit_in_pose(problem.reversed, start, times=1)
    else:
        returned = fine_stage(problem.reversed, start)
    places, gaps = inverse(back.mesh, returned, mesh)
    areas = prepared.rest.graph.areas
    if areas[gaps > INVERSE_FAR].sum() > INVERSE_LOST * areas.sum():
        return positions
    met = 1.0 / (1.0 + (gaps / INVERSE_GAP) ** 2) ** 2
    return positions + smoothed_shifts(prepared.rest.graph, 0.5 * (places - positions), met)


def inverse(mesh: TriangleSurface, deformed: FloatArray, other: TriangleSurface) -> tuple[FloatArray, FloatArray]:
    """Where a deformation of a mesh onto another one takes the other's vertices, if it is read backwards.

    Parameters
    ----------
    mesh : TriangleSurface
    deformed : (n, 3) float64
        Its vertices near the other mesh.
    other : TriangleSurface

    Returns
    -------
    places : (n2, 3) float64
        On the mesh, of the other's vertices.
    gaps : (n2,) float64
        How far they are from the deformed mesh.
    """
    tree = build_tree(deformed, mesh.triangles)
    at, barycentric, gaps = closest_points(tree, other.positions, other.vertex_normals, normal_weight=INVERSE_FACING)
    return np.einsum("mk,mkd->md", barycentric, mesh.positions[mesh.triangles[at]]), gaps


def smoothed_shifts(graph: ElasticGraph, shifts: FloatArray, trust: FloatArray) -> FloatArray:
    """Shifts (n, 3) of a mesh, smoothed: ``(M T + l^2 L) d = M T d_0`` with trust T (n,) from 0 to 1.

    What is not trusted follows its surroundings.
    """
    masses = graph.areas * np.maximum(trust, 1e-6)
    matrix = sparse.csc_array(sparse.diags_array(masses) + INVERSE_SMOOTHING**2 * graph.laplacian())
    return factor(matrix).solve(masses[:, None] * shifts)
