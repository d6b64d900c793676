"""From fitted points of one level to the map of the finest ones: they become a subdivision surface, projected once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.mesh import FloatArray, IndexArray
from cagemap.point_map.elastic import ElasticConfig, FitShapes
from cagemap.point_map.elastic_data import Sheet
from cagemap.point_map.elastic_graph import ElasticGraph, mesh_graph
from cagemap.point_map.folds import unfold
from cagemap.point_map.point_map import PointMap
from cagemap.point_map.surface_points import build_tree, closest_points, vertex_normals
from cagemap.refinement import Refinement, level_triangles

# Vertices from which a level of the source is fine enough to lie on while fitting.
SHEET_VERTICES = 15_000


def fit_shapes(
    target: Refinement,
    source: Refinement,
    scales: tuple[float, float],
    level: int,
    landmarks: IndexArray,
    config: ElasticConfig = ElasticConfig(),
) -> FitShapes:
    """Both surfaces as the elastic fit sees them: the target's mesh of one level, a coarse level of the source.

    Vertices of both stand where they are on the finest level.

    Parameters
    ----------
    target, source : Refinement
    scales : (float, float)
        Factors from each mesh's lengths to those of unit area.
    level : int
        Of the target.
    landmarks : (p,) int64
        Control vertices of the target.
    """
    graph, split = level_graph(target, scales[0], level)
    lain_on = next((i for i, at in enumerate(source.levels) if at.n_vertices >= SHEET_VERTICES), source.n_levels)
    positions = scales[1] * source.finest.positions[: source.levels[lain_on].n_vertices]
    sheet = Sheet.build(positions, level_faces(source, lain_on)[1])
    return FitShapes.build(graph, split, sheet, landmarks, config)


def level_graph(target: Refinement, scale: float, level: int) -> tuple[ElasticGraph, IndexArray]:
    """Graph of the target's mesh of one level at unit area, vertices where the finest level has them; its triangles."""
    faces, split = level_faces(target, level)
    return mesh_graph(scale * target.finest.positions[: target.levels[level].n_vertices], faces, split), split


def finest_map(
    target: Refinement,
    source: Refinement,
    source_scale: float,
    level: int,
    fitted: FloatArray,
    landmarks: tuple[IndexArray, IndexArray],
    config: ElasticConfig = ElasticConfig(),
) -> PointMap:
    """Map of the finest levels from fitted points.

    Parameters
    ----------
    target, source : Refinement
    source_scale : float
        Factor from the source's lengths to those of unit area.
    level : int
        Level of the target that was fitted.
    fitted : (n1_l, 3) float64
        Points near the source, at unit area: points of the surface, not control points.
    landmarks : pair of (p,) int64
        Control vertices of target and source.

    Returns
    -------
    PointMap
        Landmarks are met exactly.
    """
    sampling = target.product(target.n_levels, level)
    finest = sampling @ control_points(sparse.csr_array(sampling[: len(fitted)]), fitted)
    target_triangles = level_triangles(target, target.n_levels)
    source_triangles = level_triangles(source, source.n_levels)
    return project(
        finest, target_triangles, source_scale * source.finest.positions, source_triangles, landmarks, config
    )


def control_points(sampling: sparse.csr_array, points: FloatArray, steps: int = 12) -> FloatArray:
    """Control points whose refined vertices pass through given points: ``E c = y`` by Richardson steps.

    ``E`` (n, n) holds the rows of S^{f,l} of the level's own vertices. Its spectrum lies in (0, 1], low frequencies at
    1, so that a few steps of ``c <- c + (y - E c)`` leave only high frequencies of an already smooth field.
    """
    control = points
    for _ in range(steps):
        control = control + (points - sampling @ control)
    return control


def level_faces(refinement: Refinement, level: int) -> tuple[IndexArray, IndexArray]:
    """Faces of a level for its stiffness, and their triangles; n-gons of the control mesh are fans."""
    faces = refinement.levels[level].faces
    split = level_triangles(refinement, level)
    return (split if faces is None else faces), split


def project(
    positions: FloatArray,
    target_triangles: IndexArray,
    source_positions: FloatArray,
    source_triangles: IndexArray,
    landmarks: tuple[IndexArray, IndexArray],
    config: ElasticConfig,
) -> PointMap:
    """Closest points of the source in position and normal, landmarks on their vertices exactly, folds removed."""
    normals = vertex_normals(positions, target_triangles)
    tree = build_tree(source_positions, source_triangles)
    triangle, barycentric, _ = closest_points(tree, positions, normals, normal_weight=config.projection_normal_weight)
    holder = np.zeros(len(source_positions), dtype=np.int64)
    holder[source_triangles.ravel()] = np.repeat(np.arange(len(source_triangles)), 3)
    triangle[landmarks[0]] = holder[landmarks[1]]
    barycentric[landmarks[0]] = source_triangles[triangle[landmarks[0]]] == landmarks[1][:, None]
    triangle, barycentric = unfold(
        triangle,
        barycentric,
        target_triangles,
        source_positions,
        source_triangles,
        tree,
        landmarks[0],
        normal_weight=config.projection_normal_weight,
    )
    return PointMap(triangle, barycentric)
