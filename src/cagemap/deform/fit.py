"""Fit the target to the source: a coarse stage for whole limbs, then a fine stage for a level's mesh.

The target's mesh is deformed until it is on the source, everywhere as close to affinely as possible
(`cagemap.deform.graph`). Data terms are point-to-plane, so that only the energy resists tangential motion. Landmarks
and curves are constraints.
"""

from __future__ import annotations

from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import ElasticConfig
from cagemap.deform.data import (
    PlacementConstraints,
    SurfaceSamples,
    received_weights,
    source_to_clusters,
    source_to_target,
    target_to_source,
)
from cagemap.deform.energy import Differentials, Terms, VertexTerms, deformed_normals, minimise
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.errors import ParameterError
from cagemap.maps.masks import Masks
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral.surface import Surface
from cagemap.surface.alignment import fit_similarity
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import vertex_normals


def coarse_fit(
    problem: Problem, start: FloatArray, clusters: Clusters | None = None, samples: SurfaceSamples | None = None
) -> Placement:
    """Placement of clusters by their coarse stage, from positions (k, 3), such as those of `landmark_start`.

    The ``clusters`` are the problem's coarse ones by default. Source ``samples`` give source-to-target terms, with
    which limbs reach the ends of the source's limbs. ParameterError if the start has another number of positions.
    """
    clusters = problem.coarse_clusters if clusters is None else clusters
    prepared, energy, graph = problem.prepared, clusters.energy, clusters.energy.graph
    expected = graph.positions.shape
    if start.shape != expected:
        raise ParameterError(f"start: expected {expected} positions, one for each coarse vertex, got {start.shape}")
    terms = cluster_terms(prepared, clusters, samples)
    return evaluate_clusters(prepared, clusters, minimise(graph, energy.differentials, terms, start, clusters.stage))


def cluster_terms(prepared: PreparedPair, clusters: Clusters, samples: SurfaceSamples | None) -> Terms:
    """Data terms and constraints of clusters; source-to-target terms only if there are samples."""
    graph, masks, source, config = clusters.energy.graph, clusters.masks, prepared.source_surface, prepared.elastic

    def terms(
        positions: FloatArray, differentials: Future[Differentials], alpha: float, before: VertexTerms | None
    ) -> VertexTerms:
        guess = None if before is None else before.guesses[0]
        normals = deformed_normals(graph.normals, differentials.result()[0])
        nearest = SurfacePoints.nearest(source, positions, normals, normal_weight=config.normal_weight, guess=guess)
        blocks, right, _ = target_to_source(graph.areas, nearest, normals, masks, beyond=True)
        if samples is not None:
            source_blocks, source_right = source_to_clusters(samples, positions, normals, masks, config)
            blocks, right = blocks + source_blocks, right + source_right
        clusters.constraints.add(blocks, right, positions, config)
        return VertexTerms(clusters.energy, blocks, right, guesses=(nearest.triangle, None))

    return terms


def fine_fit(problem: Problem, start: Placement | FloatArray) -> FloatArray:
    """(n, 3) positions of the target's mesh by the fine stage, from a coarse placement or from positions (n, 3)."""
    prepared, energy, config = problem.prepared, problem.prepared.energy, problem.prepared.elastic
    first = start.extrapolate_to(energy.graph, config.graph) if isinstance(start, Placement) else start
    terms = mesh_terms(prepared, problem.constraints)
    return minimise(energy.graph, energy.differentials, terms, first, config.fine)


def mesh_terms(prepared: PreparedPair, constraints: PlacementConstraints) -> Terms:
    """Data terms in both directions, and constraints, of a mesh.

    Source-to-target terms pull the mesh into fingers, ears and lips.
    """
    mesh, source, masks, config = prepared.mesh, prepared.source_surface, prepared.level_masks, prepared.elastic
    energy, samples, received = prepared.energy, prepared.source_samples, prepared.received_smoother
    of_parts = mesh.is_open or source.is_open

    def terms(
        positions: FloatArray, differentials: Future[Differentials], alpha: float, before: VertexTerms | None
    ) -> VertexTerms:
        guesses = (None, None) if before is None else before.guesses
        normals = vertex_normals(positions, mesh.triangles)
        nearest = SurfacePoints.nearest(
            source, positions, normals, normal_weight=config.fine_normal_weight, guess=guesses[0]
        )
        blocks, right, closest = target_to_source(energy.graph.areas, nearest, normals, masks)
        source_blocks, source_right, weights, triangles = source_to_target(
            mesh, samples, positions, normals, closest, alpha, guesses[1], masks, config
        )
        shares = received_weights(received, weights, config.data, of_parts=of_parts)
        blocks = shares[:, None, None] * blocks + source_blocks
        right = shares[:, None] * right + source_right
        constraints.add(blocks, right, positions, config)
        return VertexTerms(energy, blocks, right, (nearest.triangle, triangles))

    return terms


def landmark_start(problem: Problem, clusters: Clusters) -> FloatArray:
    """(k, 3) clusters placed by the constrained ones alone: a similarity, then the energy, which bends limbs."""
    graph, constraints, config = clusters.energy.graph, clusters.constraints, problem.prepared.elastic
    places, constrained = constraints.places, constraints.anchors.corners[:, 0]
    rotation, scale, shift = fit_similarity(graph.positions[constrained], places)
    blocks, right = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3))
    start = scale * graph.positions @ rotation.T + shift
    constraints.add_points(blocks, right, start, config)
    terms = VertexTerms(clusters.energy, blocks, right, constant=True)
    return minimise(graph, clusters.energy.differentials, terms, start, config.landmark_start)


def evaluate_clusters(prepared: PreparedPair, clusters: Clusters, positions: FloatArray) -> Placement:
    """Placement of clusters with its costs: `vertex_costs`."""
    graph, (maps, _) = clusters.energy.graph, clusters.energy.differentials(positions)
    costs = vertex_costs(prepared, graph, clusters.masks, positions, maps, clusters.stage.smoothing)
    return Placement(positions, float(costs.sum()), costs, maps=maps, graph=graph)


def evaluate_placement(prepared: PreparedPair, positions: FloatArray) -> Placement:
    """Placement of the mesh with its costs: `vertex_costs`, distances of source samples, `stretch_costs` if open."""
    energy, config, triangles = prepared.energy, prepared.elastic, prepared.mesh.triangles
    samples, maps = prepared.source_samples, energy.maps(positions)
    costs = vertex_costs(prepared, energy.graph, prepared.level_masks, positions, maps, config.coarse.smoothing)
    tree = build_tree(positions, triangles)
    at, barycentric, distance = closest_points(
        tree, samples.points, samples.normals, normal_weight=config.normal_weight
    )
    squared = _capped(distance**2, prepared.mesh, config)
    missed = barycentric * (samples.areas * squared)[:, None]
    costs = costs + np.bincount(triangles[at].ravel(), missed.ravel(), energy.graph.n)
    if prepared.mesh.is_open or prepared.source_surface.is_open:
        costs = costs + stretch_costs(energy.graph.areas, maps, config)
    return Placement(positions, float(costs.sum()), costs)


def vertex_costs(
    prepared: PreparedPair, graph: ElasticGraph, masks: Masks, positions: FloatArray, maps: FloatArray, smoothing: float
) -> FloatArray:
    """(n,) cost by vertex: squared distance in position and normal, plus the energy at ``cost_stiffness``."""
    source, config, normals = prepared.source_surface, prepared.elastic, deformed_normals(graph.normals, maps)
    nearest = SurfacePoints.nearest(source, positions, normals, normal_weight=config.normal_weight)
    areas = graph.areas * masks.of_target(graph.n) * masks.at_source(nearest)
    squared = ((nearest.positions - positions) ** 2).sum(axis=1)
    turned = 2.0 - 2.0 * np.einsum("nd,nd->n", nearest.normals, normals)
    data = areas * _capped(squared + config.normal_weight**2 * turned, source, config)
    return np.asarray(data + config.cost_stiffness * graph.energies(positions, maps, smoothing))


def _capped(squared: FloatArray, other: TriangleSurface, config: ElasticConfig) -> FloatArray:
    """(n,) squared distances from another surface; at most `DataConfig.uncovered` squared if it is open."""
    return np.minimum(squared, config.data.uncovered**2) if other.is_open else squared


def stretch_costs(areas: FloatArray, maps: FloatArray, config: ElasticConfig) -> FloatArray:
    """(n,) variance of log stretches, so that a part does not fit anywhere by stretching."""
    logs = np.log(np.maximum(np.linalg.svd(maps, compute_uv=False)[:, :2], config.graph.min_stretch**4))
    return np.asarray(config.stretch_weight * areas * ((logs - (areas @ logs).mean()) ** 2).mean(axis=1))


def shared_area(prepared: PreparedPair, places: FloatArray) -> Masks | None:
    """Masks of the area with a counterpart, of a fit with the target's vertices at places (n, 3); None if both closed.

    A vertex has a counterpart, 1, where the closest point that faces the same way is near and not on a boundary.
    Squeezed area has none.
    """
    mesh, source, config = prepared.mesh, prepared.source_surface, prepared.elastic
    if not (mesh.is_open or source.is_open):
        return None

    def on_finest(side: Surface, level: int, near: NDArray[np.bool_]) -> FloatArray:
        return np.clip(side.hierarchy.prolong(near.astype(np.float64), level, side.finest_level), 0.0, 1.0)

    moved = TriangleSurface(places, mesh.triangles)
    shrunk = moved.vertex_areas / np.maximum(mesh.vertex_areas, 1e-12)
    kept = shrunk >= config.data.received[0] * (moved.vertex_areas @ shrunk)
    on_target = on_finest(prepared.target, prepared.levels[0], _near(moved, source, config) & kept)
    return Masks(on_target, on_finest(prepared.source, prepared.source_level, _near(source, moved, config)))


def _near(surface: TriangleSurface, other: TriangleSurface, config: ElasticConfig) -> NDArray[np.bool_]:
    """(n,) which vertices have another surface near them."""
    at, barycentric, gaps = closest_points(
        other.tree, surface.positions, surface.vertex_normals, normal_weight=config.normal_weight
    )
    near = ~other.at_boundary(at, barycentric) | (gaps <= config.data.at_boundary)
    return np.asarray((gaps <= config.data.shared_gap) & near)
