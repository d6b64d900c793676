"""Project fitted points of one level onto the source: the point map of the finest levels."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.deform.config import ElasticConfig, ProjectionConfig
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.errors import ParameterError
from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.flatten import flatten_folded_parts
from cagemap.maps.projection.relax import relax_folds
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers, whole_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import vertex_normals


def map_of_places(problem: Problem, places: FloatArray) -> PointMap:
    """Point map T12 of the finest levels: project places (n, 3) of the deformed level, then remove folds."""
    prepared, landmarks = problem.prepared, problem.landmarks
    return unfold(project(prepared, places, landmarks), held_vertices(landmarks), prepared.elastic)


@kinds_checked
def project(prepared: PreparedPair, fitted: FloatArray, landmarks: PointPairs) -> PointMap:
    """Point map of the finest levels: closest points to the subdivision surface through fitted points.

    ``fitted`` (n, 3) are positions near the source (of area 1) of the vertices of the target's deformed level;
    ParameterError if they are not finite, or others. Landmarks are met exactly (`snap_landmarks`). The map may fold.
    """
    count = prepared.mesh.n
    fitted = real_numbers(fitted, "fitted")
    if fitted.shape != (count, 3) or not np.all(np.isfinite(fitted)):
        raise ParameterError(f"fitted: expected finite places ({count}, 3), as `fit` gives them, got {fitted.shape}")
    target = prepared.target.finest_triangles
    positions = carried_to_finest(prepared, fitted)
    normals = vertex_normals(positions, target.triangles)
    config = prepared.elastic
    images = facing_points(
        prepared.source.finest_triangles, positions, normals, config.projection_normal_weights, config.projection
    )
    return PointMap(target, snap_landmarks(images, landmarks, config.projection))


def carried_to_finest(prepared: PreparedPair, fitted: FloatArray) -> FloatArray:
    """(n_f, 3) positions of the target's finest vertices, from fitted positions of its deformed level.

    A subdivision surface passes through the fitted points. Details of a plain mesh follow the deformation's
    differentials, blended by the rows of S^{f,l}: ``y_v = sum_k S_vk (x_k + A_k (p_v - p_k))``.
    """
    refinement, level = prepared.target.hierarchy, prepared.levels[0]
    if not refinement.is_plain:
        sampling = refinement.rows(slice(len(fitted)), refinement.finest_level, level)
        return refinement.prolong(control_points(sampling, fitted), level, refinement.finest_level)
    maps, _ = prepared.energy.differentials(fitted)
    rest = prepared.target.finest_triangles.positions
    shifts = fitted - np.einsum("nab,nb->na", maps, rest[prepared.vertices])
    blended = refinement.prolong(np.hstack([shifts, maps.reshape(-1, 9)]), level, refinement.finest_level)
    return np.asarray(blended[:, :3] + np.einsum("nab,nb->na", blended[:, 3:].reshape(-1, 3, 3), rest))


def control_points(sampling: sparse.csr_array, points: FloatArray, steps: int = 12) -> FloatArray:
    """Control points whose refined vertices pass through given points: ``E c = y`` by Richardson steps.

    The spectrum of ``E`` (n, n), rows of S^{f,l}, is in (0, 1]: the residual of a few steps is of high frequency.
    """
    control = points
    for _ in range(steps):
        control = control + (points - sampling @ control)
    return control


def facing_points(
    surface: TriangleSurface,
    points: FloatArray,
    normals: FloatArray,
    weights: tuple[float, float],
    config: ProjectionConfig = ProjectionConfig(),
) -> SurfacePoints:
    """Closest points of a surface; searched again with more weight on normals where normals disagree.

    Weights are small: a normal that differs from the source's moves the closest point sideways.
    """
    near = SurfacePoints.nearest(surface, points, normals, normal_weight=weights[0])
    away = np.flatnonzero(np.einsum("md,md->m", near.normals, normals) < config.min_cosine)
    if not len(away):
        return near
    guess = near.triangle[away]
    again = SurfacePoints.nearest(surface, points[away], normals[away], normal_weight=weights[1], guess=guess)
    return near.replaced(away, again)


def snap_landmarks(images: SurfacePoints, landmarks: PointPairs, config: ProjectionConfig) -> SurfacePoints:
    """Change images of target vertices so that landmarks are met exactly.

    A landmark at a vertex replaces the vertex's image. For a landmark between vertices, the corners of its triangle
    move by its error and are projected again, until the error is small. Normals, weighted less in each step, keep the
    corners on their side of a thin part.
    """
    vertices = landmarks.target.vertices
    at_vertex, between = np.flatnonzero(vertices >= 0), np.flatnonzero(vertices < 0)
    images = images.replaced(vertices[at_vertex], landmarks.source.at(at_vertex))
    if not len(between):
        return images
    inside, aims = landmarks.target.at(between), landmarks.source.at(between)
    free = np.unique(np.setdiff1d(inside.corners, vertices[at_vertex]))
    gather = inside.matrix()[:, free].T
    for step in range(config.landmark_steps):
        means = inside.interpolate(images.positions)
        missed = aims.positions - SurfacePoints.nearest(images.surface, means, guess=aims.triangle).positions
        if np.linalg.norm(missed, axis=1).max() < config.landmark_tolerance:
            break
        # Every corner moves by the weighted mean error of the landmarks in its triangles.
        moved = (gather @ missed) / np.maximum(np.asarray(gather.sum(axis=1)).reshape(-1, 1), 1e-12)
        at = images.at(free)
        weight = config.landmark_normal_weight / 4.0**step
        near = SurfacePoints.nearest(
            images.surface, at.positions + moved, at.normals, normal_weight=weight, guess=at.triangle
        )
        images = images.replaced(free, near)
    return images


def held_vertices(landmarks: PointPairs) -> IndexArray:
    """Target vertices whose images landmarks fix: at landmarks, or in triangles that contain one."""
    vertices = landmarks.target.vertices
    return np.unique(np.concatenate([vertices[vertices >= 0], landmarks.target.corners[vertices < 0].ravel()]))


@kinds_checked
def unfold(point_map: PointMap, held: IndexArray, config: ElasticConfig = ElasticConfig()) -> PointMap:
    """Remove most folds of a map: relax small ones, flatten large ones.

    The images of target vertices ``held`` (p,) stay (landmarks); ParameterError if the target lacks one.
    """
    held = whole_numbers(held, "held")
    if held.size and not 0 <= held.min() <= held.max() < point_map.target.n:
        raise ParameterError(f"held: expected vertices 0 to {point_map.target.n - 1}, got {held.min()} to {held.max()}")
    weight, target = config.projection_normal_weights[0], point_map.target
    images, flipped = relax_folds(
        point_map.images, target.triangles, held, normal_weight=weight, config=config.projection
    )
    return PointMap(target, flatten_folded_parts(images, flipped, target, held, config.projection))
