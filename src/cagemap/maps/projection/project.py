"""From fitted points of one level to the map of the finest ones: they become a subdivision surface, projected once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.basis import Surface
from cagemap.geometry.closest import TriangleTree, closest_points
from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic.data import Sheet
from cagemap.maps.elastic.fit import ElasticConfig, FitShapes
from cagemap.maps.elastic.graph import ElasticGraph, mesh_graph
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.lay_out import lay_out_parts
from cagemap.maps.projection.unfold import Images, Sides, unfold
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Refinement, level_triangles

# Vertices from which a level of the source is fine enough to lie on while fitting.
SHEET_VERTICES = 15_000
# A projected point whose normal makes a smaller cosine with its own is on the wrong side, or far from the source.
LEAST_COSINE = 0.15


def fit_shapes(pair: Pair, level: int, config: ElasticConfig = ElasticConfig()) -> FitShapes:
    """Both surfaces as the elastic fit sees them: the target's mesh of one level, a coarse level of the source."""
    graph, triangles = level_graph(pair.target, level)
    source = pair.source.refinement
    lain_on = source.coarsest_level(SHEET_VERTICES)
    positions = pair.source.operators.scale * source.finest.positions[: source.levels[lain_on].n_vertices]
    sheet = Sheet.build(positions, level_triangles(source, lain_on))
    return FitShapes.build(graph, triangles, sheet, pair.target_landmarks, config)


def level_graph(surface: Surface, level: int) -> tuple[ElasticGraph, IndexArray]:
    """Graph of a level's vertices at their places on the finest surface, at unit area, and the level's triangles."""
    faces, triangles = level_faces(surface.refinement, level)
    positions = surface.operators.scale * surface.refinement.finest.positions
    return mesh_graph(positions[: surface.refinement.levels[level].n_vertices], faces, triangles), triangles


def finest_surface(surface: Surface) -> tuple[FloatArray, IndexArray]:
    """Finest vertices at unit area, and triangles."""
    finest = surface.triangles(surface.finest)
    return finest.positions, finest.triangles


def refined_positions(refinement: Refinement, level: int, points: FloatArray) -> FloatArray:
    """(n_f, 3) finest vertices of the subdivision surface that passes through points of the vertices of one level.

    Parameters
    ----------
    refinement : Refinement
    level : int
    points : (n_l, 3) float64
        Points of the finest surface, not control points.
    """
    chosen = sparse.csr_array(sparse.eye_array(len(points), refinement.finest.n_vertices, format="csr"))
    for matrix in reversed(refinement.matrices[level:]):
        chosen = sparse.csr_array(chosen @ matrix)
    return refinement.prolong(control_points(chosen, points), level, refinement.n_levels)


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


def project(positions: FloatArray, pair: Pair, tree: TriangleTree, config: ElasticConfig = ElasticConfig()) -> PointMap:
    """Closest points of the source in position and normal, landmarks on their vertices exactly, folds removed.

    Parameters
    ----------
    positions : (n1, 3) float64
        Of the target's finest vertices, near the source at unit area.
    pair : Pair
    tree : TriangleTree
        Of the source's finest level at unit area.
    config : ElasticConfig

    Returns
    -------
    PointMap
        Of the finest levels.
    """
    on_target, target_triangles = finest_surface(pair.target)
    on_source, source_triangles = finest_surface(pair.source)
    weights = config.projection_normal_weights
    triangle, barycentric = facing_points(tree, positions, vertex_normals(positions, target_triangles), weights)
    landmarks = pair.target_landmarks, pair.source_landmarks
    wanted = np.zeros(len(on_source), dtype=bool)
    wanted[landmarks[1]] = True
    at_landmarks = np.flatnonzero(wanted[source_triangles.ravel()])
    holder = np.zeros(len(on_source), dtype=np.int64)
    holder[source_triangles.ravel()[at_landmarks]] = at_landmarks // 3
    triangle[landmarks[0]] = holder[landmarks[1]]
    barycentric[landmarks[0]] = source_triangles[triangle[landmarks[0]]] == landmarks[1][:, None]
    sides = Sides(on_target, target_triangles, on_source, source_triangles, tree)
    images = Images.of(triangle, barycentric, sides)
    images, flipped = unfold(images, sides, landmarks[0], normal_weight=weights[0])
    images = lay_out_parts(images, flipped, sides, landmarks[0])
    surfaces = pair.target.triangles(pair.target.finest), pair.source.triangles(pair.source.finest)
    return PointMap.from_arrays(*surfaces, images.triangle, images.barycentric)


def facing_points(
    tree: TriangleTree, points: FloatArray, normals: FloatArray, weights: tuple[float, float]
) -> tuple[IndexArray, FloatArray]:
    """Closest points of a surface; where they do not face the same way, those that weigh normals more.

    On the surface, a normal that differs from the source's moves the closest point sideways: where the surface bends
    little, by far, and neighbours by different amounts. Normals are only to tell the sides of thin parts apart.

    Parameters
    ----------
    tree : TriangleTree
    points, normals : (m, 3) float64
    weights : (float, float)
        Normal weights of the first search, and of the second.

    Returns
    -------
    triangle, barycentric : (m,), (m, 3)
    """
    triangle, barycentric, _ = closest_points(tree, points, normals, normal_weight=weights[0])
    cosine = np.einsum("md,md->m", tree.normals_of(triangle), normals)
    away = np.flatnonzero(cosine < LEAST_COSINE)
    if len(away):
        triangle[away], barycentric[away], _ = closest_points(
            tree, points[away], normals[away], normal_weight=weights[1], guess=triangle[away]
        )
    return triangle, barycentric
