"""Fit the target to the source: a coarse stage for whole limbs, then a fine stage for a level's mesh.

The target's mesh is deformed as affinely as possible (`cagemap.deform.graph`) until it is on the source. Data terms are
point-to-plane, so that only the energy resists tangential motion. Landmarks are held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.deform.config import ElasticConfig
from cagemap.deform.constraints import Constraints
from cagemap.deform.data import SourceSamples, received_weights, source_to_clusters, source_to_target, target_to_source
from cagemap.deform.energy import VertexTerms, deformed_normals
from cagemap.deform.minimise import Differentials, minimise
from cagemap.deform.placement import Placement
from cagemap.deform.problem import CoarseShape, PreparedPair, Problem, RestShape
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals

# Triangles of closest points of the previous iteration, both ways.
Guesses = tuple[IndexArray | None, IndexArray | None]


@dataclass(frozen=True, eq=False)
class SurfaceTerms:
    """Data terms and constraints of a rest shape on the source.

    A mesh has data terms both ways: source-to-target terms extend it into fingers, ears and lips. Clusters have
    source-to-target terms only if samples are given.
    """

    rest: RestShape
    source: TriangleSurface
    constraints: Constraints
    config: ElasticConfig
    samples: SourceSamples | None

    def at(self, positions: FloatArray, found: Differentials, alpha: float, before: VertexTerms | None) -> VertexTerms:
        """Terms at the closest points of positions."""
        guesses = (None, None) if before is None else before.guesses
        if self.rest.mesh is None:
            terms = self._on_clusters(positions, found.result()[0], guesses[0])
        else:
            terms = self._on_mesh(self.rest.mesh, positions, alpha, guesses)
        self.constraints.add(terms.blocks, terms.right, positions, self.config)
        return terms

    def _on_clusters(self, positions: FloatArray, maps: FloatArray, guess: IndexArray | None) -> VertexTerms:
        rest, config, weight = self.rest, self.config, self.config.normal_weight
        normals = deformed_normals(rest.graph.normals, maps)
        term = target_to_source(
            rest.graph.areas, self.source, positions, normals, guess, weight, rest.masks, beyond=True
        )
        blocks, right = term.blocks, term.right
        if self.samples is not None:
            back = source_to_clusters(self.samples, positions, normals, weight, term.closest, rest.masks, config.data)
            blocks, right = blocks + back.blocks, right + back.right
        return VertexTerms(rest.energy, blocks, right, guesses=(term.triangles, None))

    def _on_mesh(self, mesh: TriangleSurface, positions: FloatArray, alpha: float, guesses: Guesses) -> VertexTerms:
        rest, config, normals = self.rest, self.config, vertex_normals(positions, mesh.triangles)
        assert rest.received is not None
        assert self.samples is not None
        term = target_to_source(
            rest.graph.areas, self.source, positions, normals, guesses[0], config.fine_normal_weight, rest.masks
        )
        back = source_to_target(
            mesh,
            self.samples,
            positions,
            normals,
            guesses[1],
            config.normal_weight,
            term.closest,
            alpha,
            rest.masks,
            config.data,
        )
        distance = term.distance(positions)
        of_parts = mesh.is_open or self.source.is_open
        term = term.scaled(received_weights(rest.received, back.weights, config.data, of_parts=of_parts))
        blocks, right = term.blocks + back.blocks, term.right + back.right
        return VertexTerms(rest.energy, blocks, right, distance, (term.triangles, back.triangles))


def coarse_fit(
    problem: Problem,
    start: FloatArray | None,
    shape: CoarseShape | None = None,
    samples: SourceSamples | None = None,
) -> Placement:
    """Placement of the clusters by the coarse stage, from positions (k, 3), or from landmarks if None.

    ``shape`` replaces the problem's clusters, with other constraints or smoothing. Source ``samples`` give
    source-to-target terms, with which limbs reach the ends of the source's limbs.

    Raises
    ------
    ParameterError
        If the start has not one position for every vertex of the coarse graph.
    """
    shape = problem.shape if shape is None else shape
    rest, source, config = shape.rest, problem.prepared.source_surface, problem.prepared.elastic
    expected = rest.graph.positions.shape
    if start is not None and start.shape != expected:
        raise ParameterError(f"start: expected {expected} positions, one for each coarse vertex, got {start.shape}")
    first = landmark_start(shape, config) if start is None else start
    terms = SurfaceTerms(rest, source, shape.constraints, config, samples)
    positions = minimise(rest.energy, terms, first, config.coarse)
    maps, _ = rest.energy.differentials(positions)
    costs = vertex_costs(rest, source, positions, maps, config)
    return Placement(positions, float(costs.sum()), costs, maps=maps, graph=rest.graph)


def fine_fit(problem: Problem, coarse: Placement) -> FloatArray:
    """(n, 3) positions of the target's mesh near the source, by the fine stage from a coarse placement."""
    prepared = problem.prepared
    return fine_stage(problem, coarse.on(prepared.rest.graph, prepared.elastic.graph))


def fine_stage(problem: Problem, start: FloatArray) -> FloatArray:
    """(n, 3) positions of the target's mesh after the fine stage, from start positions (n, 3)."""
    prepared, elastic = problem.prepared, problem.prepared.elastic
    terms = SurfaceTerms(prepared.rest, prepared.source_surface, problem.constraints, elastic, prepared.source_samples)
    return minimise(prepared.rest.energy, terms, start, elastic.fine)


def landmark_start(shape: CoarseShape, config: ElasticConfig) -> FloatArray:
    """(k, 3) clusters placed by held ones alone: a similarity, then the energy, which resolves twisted limbs."""
    graph, places, held = shape.rest.graph, shape.constraints.places, shape.constraints.anchors.corners[:, 0]
    rotation, scale, shift = fit_similarity(graph.positions[held], places)
    blocks, right = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3))
    start = scale * graph.positions @ rotation.T + shift
    shape.constraints.anchors.hold(blocks, right, start, places, config.landmark_weight)
    energy = shape.rest.energy
    return minimise(energy, VertexTerms(energy, blocks, right, constant=True), start, config.landmark_start)


def fit_similarity(points: FloatArray, images: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Rotation R, scale s and shift t that bring s R p + t nearest to images (Umeyama 1991); no reflection."""
    centre, image_centre = points.mean(axis=0), images.mean(axis=0)
    u, singular, vt = np.linalg.svd((images - image_centre).T @ (points - centre))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = (u * signs) @ vt
    spread = float(((points - centre) ** 2).sum())
    scale = float((singular * signs).sum()) / spread if spread > 0 else 1.0
    return rotation, scale, image_centre - scale * rotation @ centre


def evaluate_placement(prepared: PreparedPair, positions: FloatArray) -> Placement:
    """Placement of the mesh with its costs: `vertex_costs`, distances of source samples, `stretch_costs` if open."""
    rest, config, triangles = prepared.rest, prepared.elastic, prepared.mesh.triangles
    samples = prepared.source_samples
    costs = vertex_costs(rest, prepared.source_surface, positions, rest.energy.maps(positions), config)
    tree = build_tree(positions, triangles)
    at, barycentric, distance = closest_points(tree, samples.points, samples.planes, normal_weight=config.normal_weight)
    squared = _capped(distance**2, prepared.mesh, config)
    missed = barycentric * (samples.areas * squared)[:, None]
    costs = costs + np.bincount(triangles[at].ravel(), missed.ravel(), rest.graph.n)
    if prepared.mesh.is_open or prepared.source_surface.is_open:
        costs = costs + stretch_costs(rest, positions, config)
    return Placement(positions, float(costs.sum()), costs)


def vertex_costs(
    rest: RestShape, source: TriangleSurface, positions: FloatArray, maps: FloatArray, config: ElasticConfig
) -> FloatArray:
    """(n,) cost by vertex: squared distance in position and normal, plus the energy at a fixed stiffness."""
    graph = rest.graph
    normals = deformed_normals(graph.normals, maps)
    nearest = SurfacePoints.nearest(source, positions, normals, normal_weight=config.normal_weight)
    areas = graph.areas * rest.masks.of_target(graph.n) * rest.masks.at_source(nearest)
    squared = ((nearest.positions - positions) ** 2).sum(axis=1)
    turned = 2.0 - 2.0 * np.einsum("nd,nd->n", nearest.normals, normals)
    data = areas * _capped(squared + config.normal_weight**2 * turned, source, config)
    return np.asarray(data + config.cost_stiffness * graph.energies(positions, maps, config.coarse.smoothing))


def _capped(squared: FloatArray, other: TriangleSurface, config: ElasticConfig) -> FloatArray:
    """(n,) squared distances from another surface; at most `DataConfig.uncovered` squared if it is open."""
    return np.minimum(squared, config.data.uncovered**2) if other.is_open else squared


def stretch_costs(rest: RestShape, positions: FloatArray, config: ElasticConfig) -> FloatArray:
    """(n,) variance of log stretches, so that a part does not fit anywhere by stretching."""
    graph = rest.graph
    stretches = np.linalg.svd(rest.energy.maps(positions), compute_uv=False)[:, :2]
    logs = np.log(np.maximum(stretches, config.graph.min_stretch**4))
    return np.asarray(config.stretch_weight * graph.areas * ((logs - (graph.areas @ logs).mean()) ** 2).mean(axis=1))
