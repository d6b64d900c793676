"""The elastic fit: carry the target's shape onto the source surface, starting from a rough map.

Where the functional map has found the right basin, an elastic energy finishes: the target's mesh is deformed, as
affinely as possible (`cagemap.maps.elastic.graph`), until it lies on the source. Positions answer a point-to-plane
data term, so that tangential motion is left to the energy; landmarks are held. Two stages, first on a coarse graph that
moves whole limbs, then on the mesh of a level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic.config import ElasticConfig, Stage
from cagemap.maps.elastic.constants import COST_STIFFNESS, LANDMARK_ITERATIONS, LYING, STIFFENING, STIFFEST, UNSETTLED
from cagemap.maps.elastic.counterparts import received_weights
from cagemap.maps.elastic.data import Pullers, deformed_normals, pull_by_source, pull_on_clusters, pull_to_source
from cagemap.maps.elastic.graph import ElasticGraph, extrapolate
from cagemap.maps.elastic.prepared import CoarseShape, RestShape
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.elastic.ties import Ties
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.factorization import factor
from cagemap.numerics.threads import ThreadPool


@dataclass(frozen=True, eq=False)
class CoarseFit:
    """Where a coarse stage ended.

    Attributes
    ----------
    cost : float
        Sum of `vertex_costs`.
    positions, maps : (k, 3), (k, 3, 3) float64
    graph : ElasticGraph
        Whose clusters these are.
    """

    cost: float
    positions: FloatArray
    maps: FloatArray
    graph: ElasticGraph

    def on(self, graph: ElasticGraph) -> FloatArray:
        """(n, 3) where it takes the vertices of another graph of the same shape."""
        return extrapolate(self.graph, self.positions, self.maps, graph)


def coarse_fit(
    problem: FitProblem,
    start: FloatArray | None,
    shape: CoarseShape | None = None,
    pullers: Pullers | None = None,
) -> CoarseFit:
    """The coarse stage from rough positions, or from the landmarks alone.

    Parameters
    ----------
    problem : FitProblem
    start : (k, 3) float64 or None
        Rough positions on the source; None to start from the landmarks.
    shape : CoarseShape, optional
        Clusters with other ties or smoothing than the problem's own.
    pullers : Pullers, optional
        Points of the source that pull at the shape too, where limbs are to reach the ends of the source's.

    Raises
    ------
    ParameterError
        If the start has not one position for every vertex of the coarse graph.
    """
    shape = problem.shape if shape is None else shape
    rest, sheet, config = shape.rest, problem.prepared.sheet, problem.prepared.elastic
    expected = rest.graph.positions.shape
    if start is not None and start.shape != expected:
        raise ParameterError(f"start: expected {expected} positions, one for each coarse vertex, got {start.shape}")
    first = landmark_start(shape, config) if start is None else start
    positions = run_stage(rest, sheet, first, shape.ties, config.coarse, config, pullers)
    maps, _ = rest.differentials(positions)
    cost = float(vertex_costs(rest, sheet, positions, maps, config).sum())
    return CoarseFit(cost, positions, maps, rest.graph)


def fine_fit(problem: FitProblem, coarse: CoarseFit) -> FloatArray:
    """(n, 3) positions near the source of the target's mesh, deformed from where a coarse fit ended."""
    return fine_stage(problem, coarse.on(problem.prepared.rest.graph))


def fine_stage(problem: FitProblem, start: FloatArray) -> FloatArray:
    """(n, 3) where the target's mesh ends that starts at some positions (n, 3)."""
    prepared, elastic = problem.prepared, problem.prepared.elastic
    return run_stage(prepared.rest, prepared.sheet, start, problem.ties, elastic.fine, elastic)


def landmark_start(shape: CoarseShape, config: ElasticConfig) -> FloatArray:
    """(k, 3) the clusters carried by their landmarks alone: a similarity, then the elastic energy without data.

    It knows the twist of limbs, which coordinates on the surface do not: a hand with one landmark keeps its turn.
    """
    graph, field, places = shape.rest.graph, shape.rest.field, shape.ties.places
    held = np.arange(len(places))
    rotation, scale, shift = similarity(graph.positions[held], places)
    positions = scale * graph.positions @ rotation.T + shift
    blocks = np.zeros((graph.n, 3, 3))
    blocks[held] = config.landmark_weight * np.eye(3)
    factors = field.system.factor(1.0, blocks, field.factors)
    for _ in range(LANDMARK_ITERATIONS):
        right = field.divergence(shape.rest.differentials(positions)[0])
        right[held] += config.landmark_weight * places
        positions = factors.solve(right.ravel()).reshape(-1, 3)
    return positions


def similarity(points: FloatArray, images: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Rotation R, scale s and shift t with s R p + t nearest to the images (Umeyama 1991); no reflection."""
    centre, image_centre = points.mean(axis=0), images.mean(axis=0)
    u, singular, vt = np.linalg.svd((images - image_centre).T @ (points - centre))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = (u * signs) @ vt
    spread = float(((points - centre) ** 2).sum())
    scale = float((singular * signs).sum()) / spread if spread > 0 else 1.0
    return rotation, scale, image_centre - scale * rotation @ centre


def vertex_costs(
    rest: RestShape, sheet: TriangleSurface, positions: FloatArray, maps: FloatArray, config: ElasticConfig
) -> FloatArray:
    """(n,) what a fit costs, by vertex: squared distance in position and normal, and the energy at one stiffness."""
    graph = rest.graph
    normals = deformed_normals(graph.normals, maps)
    found = SurfacePoints.nearest(sheet, positions, normals, normal_weight=config.normal_weight)
    areas = graph.areas * rest.masks.of_target(graph.n) * rest.masks.at_source(found)
    squared = ((found.positions - positions) ** 2).sum(axis=1)
    turned = 2.0 - 2.0 * np.einsum("nd,nd->n", found.normals, normals)
    data = areas * (squared + config.normal_weight**2 * turned)
    return np.asarray(data + COST_STIFFNESS * graph.energies(positions, maps, config.coarse.smoothing))


def run_stage(
    rest: RestShape,
    sheet: TriangleSurface,
    start: FloatArray,
    ties: Ties,
    stage: Stage,
    config: ElasticConfig,
    pullers: Pullers | None = None,
) -> FloatArray:
    """Alternate closest points, positions and differentials; returns positions (n, 3).

    Where the graph has triangles the data term works both ways: every deformed vertex lies on the source, and every
    source vertex on the deformed target, which is what fills fingers, ears and lips; parts of either that have no
    counterpart do not pull (`cagemap.maps.elastic.counterparts`). Clusters are pulled at by the pullers that are given.
    The alternation creeps along the surface, where only the energy pulls; momentum makes it three times faster.

    Where the mesh lies on the source, softening would only let it slide: the stiffness is then the largest that keeps
    it there (Morozov's discrepancy principle). That is so between cages of one shape.
    """
    graph, field = rest.graph, rest.field
    triangles = None if rest.mesh is None else rest.mesh.triangles
    pullers = pullers if triangles is None else rest.pullers(sheet)
    normal_weight = config.normal_weight if triangles is None else config.fine_normal_weight
    positions, before = start, start
    guess, guess_back = None, None
    alpha, miss = 0.0, np.inf
    with ThreadPool(1) as aside:
        for iteration, ramped in enumerate(stage.ramped(), start=1):
            alpha = float(ramped) if miss > LYING else float(max(ramped, min(STIFFENING * alpha, STIFFEST)))
            differentials = aside.submit(rest.differentials, positions)
            if triangles is None:
                normals = deformed_normals(graph.normals, differentials.result()[0])
            else:
                normals = vertex_normals(positions, triangles)
            pull = pull_to_source(graph.areas, sheet, positions, normals, guess, normal_weight, rest.masks)
            blocks, right, guess = pull.blocks, pull.right, pull.triangles
            if triangles is None and pullers is not None:
                back = pull_on_clusters(pullers, positions, normals, config.normal_weight, pull.feet, rest.masks)
                blocks, right = blocks + back.blocks, right + back.right
            elif triangles is not None and pullers is not None and rest.received is not None:
                miss = pull.distance(positions)
                back = pull_by_source(
                    triangles,
                    pullers,
                    positions,
                    normals,
                    guess_back,
                    config.normal_weight,
                    pull.feet,
                    alpha,
                    rest.masks,
                )
                pull = pull.scaled(received_weights(rest.received, back.weights))
                blocks, right, guess_back = pull.blocks + back.blocks, pull.right + back.right, back.triangles
            ties.add(blocks, right, positions, config)
            matrix = field.system.at(alpha, blocks)
            exact = (iteration - 1) % stage.factored == 0
            if exact:
                # Single precision: what a step misses, the next one finds in its residual, which is in double.
                factors = factor(matrix, like=field.factors, dtype=np.float32)
            maps, bounded = differentials.result()
            residual = (right + alpha * field.divergence(maps)).ravel()
            residual -= matrix @ positions.ravel()
            step = factors.solve(residual) if exact else field.system.step(matrix, residual, factors)
            after = positions + step.reshape(-1, 3)
            if iteration >= stage.iterations and len(bounded) <= UNSETTLED * graph.n:
                return after
            positions = after + stage.momentum * (after - before) if iteration > 1 else after
            before = after
    return before
