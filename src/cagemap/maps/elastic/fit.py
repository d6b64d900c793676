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
from cagemap.maps.elastic.anchors import Anchors as Anchors
from cagemap.maps.elastic.config import ElasticConfig, Stage
from cagemap.maps.elastic.constants import COST_STIFFNESS, LANDMARK_ITERATIONS, LYING, STIFFENING, STIFFEST, UNSETTLED
from cagemap.maps.elastic.curves import NO_CURVES, CurvePull
from cagemap.maps.elastic.data import Pullers, deformed_normals, pull_by_source, pull_on_clusters, pull_to_source
from cagemap.maps.elastic.graph import extrapolate
from cagemap.maps.elastic.prepared import CoarseShape, PreparedPair, RestShape
from cagemap.maps.pair import PointPairs
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.numerics.threads import ThreadPool


@dataclass(frozen=True, eq=False)
class CoarseFit:
    """Where a coarse stage ended.

    Attributes
    ----------
    cost : float
        See `coarse_cost`.
    positions, maps : (k, 3), (k, 3, 3) float64
    """

    cost: float
    positions: FloatArray
    maps: FloatArray


def coarse_fit(
    shape: CoarseShape,
    sheet: TriangleSurface,
    start: FloatArray | None,
    landmark_positions: FloatArray,
    config: ElasticConfig = ElasticConfig(),
    pullers: Pullers | None = None,
) -> CoarseFit:
    """The coarse stage from rough positions, or from the landmarks alone.

    Parameters
    ----------
    shape : CoarseShape
        The landmarks its first vertices.
    sheet : TriangleSurface
        The source.
    start : (k, 3) float64 or None
        Rough positions on the source; None to start from the landmarks.
    landmark_positions : (p, 3) float64
        Where they belong.
    pullers : Pullers, optional
        Points of the source that pull at the shape too, where limbs are to reach the ends of the source's.

    Raises
    ------
    ParameterError
        If the start has not one position for every vertex of the coarse graph.
    """
    rest = shape.rest
    expected = rest.graph.positions.shape
    if start is not None and start.shape != expected:
        raise ParameterError(f"start: expected {expected} positions, one for each coarse vertex, got {start.shape}")
    held = np.arange(len(landmark_positions))
    first = landmark_start(rest, held, landmark_positions, config) if start is None else start
    anchors = Anchors.at_vertices(held)
    positions = run_stage(rest, sheet, first, anchors, landmark_positions, config.coarse, config, shape.curves, pullers)
    maps, _ = rest.differentials(positions)
    return CoarseFit(coarse_cost(rest, sheet, positions, maps, config), positions, maps)


def fine_fit(prepared: PreparedPair, shape: CoarseShape, coarse: CoarseFit, landmarks: PointPairs) -> FloatArray:
    """Deform the target's mesh onto the source, from where a coarse fit ended.

    Parameters
    ----------
    prepared : PreparedPair
    shape : CoarseShape
    coarse : CoarseFit
        Of the shape.
    landmarks : PointPairs

    Returns
    -------
    (n, 3) float64
        Positions near the source; project them for a map.
    """
    start = extrapolate(shape.rest.graph, coarse.positions, coarse.maps, prepared.rest.graph)
    return fine_stage(prepared, start, landmarks)


def fine_stage(prepared: PreparedPair, start: FloatArray, landmarks: PointPairs) -> FloatArray:
    """(n, 3) where the target's mesh, or its stand-in and the mesh with it, ends that starts at positions (n, 3)."""
    places, elastic, rest = landmarks.source.positions, prepared.elastic, prepared.rest
    stand_in = rest.stand_in
    deformed, numbers = (rest, None) if stand_in is None else (stand_in.rest, stand_in.numbers)
    first = start if stand_in is None else start[stand_in.vertices]
    mesh = prepared.mesh if deformed.mesh is None else deformed.mesh
    held = Anchors.on_mesh(mesh, landmarks.target, numbers)
    curves = CurvePull.on_mesh(mesh, landmarks.curves, numbers)
    ended = run_stage(deformed, prepared.sheet, first, held, places, elastic.fine, elastic, curves)
    return ended if stand_in is None else stand_in.followed(ended, rest.graph)


def landmark_start(
    rest: RestShape, landmarks: IndexArray, landmark_positions: FloatArray, config: ElasticConfig
) -> FloatArray:
    """(n, 3) the rest shape carried by its landmarks alone: a similarity, then the elastic energy without data.

    It knows the twist of limbs, which coordinates on the surface do not: a hand with one landmark keeps its turn.
    """
    graph, field = rest.graph, rest.field
    rotation, scale, shift = similarity(graph.positions[landmarks], landmark_positions)
    positions = scale * graph.positions @ rotation.T + shift
    blocks = np.zeros((graph.n, 3, 3))
    blocks[landmarks] = config.landmark_weight * np.eye(3)
    factors = field.system.factor(1.0, blocks, field.factors)
    for _ in range(LANDMARK_ITERATIONS):
        right = field.divergence(rest.differentials(positions)[0])
        right[landmarks] += config.landmark_weight * landmark_positions
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


def coarse_cost(
    rest: RestShape, sheet: TriangleSurface, positions: FloatArray, maps: FloatArray, config: ElasticConfig
) -> float:
    """What a coarse fit costs: mean squared distance in position and normal, and the energy at a fixed stiffness."""
    return float(vertex_costs(rest, sheet, positions, maps, config).sum())


def vertex_costs(
    rest: RestShape, sheet: TriangleSurface, positions: FloatArray, maps: FloatArray, config: ElasticConfig
) -> FloatArray:
    """(n,) shares of `coarse_cost` that every vertex has."""
    graph = rest.graph
    normals = deformed_normals(graph, maps)
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
    landmarks: Anchors,
    landmark_positions: FloatArray,
    stage: Stage,
    config: ElasticConfig,
    curves: CurvePull = NO_CURVES,
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
            if triangles is None:
                differentials = aside.submit(rest.differentials, positions)
                normals = deformed_normals(graph, differentials.result()[0])
            else:
                normals = vertex_normals(positions, triangles)
            pull = pull_to_source(graph, sheet, positions, normals, guess, normal_weight, rest.masks)
            blocks, right, guess = pull.blocks, pull.right, pull.triangles
            if triangles is None and pullers is not None:
                back = pull_on_clusters(graph, pullers, positions, normals, config.normal_weight, pull.feet, rest.masks)
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
                pull = pull.scaled(rest.received.weights(back.weights))
                blocks, right, guess_back = pull.blocks + back.blocks, pull.right + back.right, back.triangles
                # Only the residual asks for them here: beside the factorisation, which keeps to one core.
                differentials = aside.submit(rest.differentials, positions)
            curves.add(blocks, right, positions, config.curve_weight)
            landmarks.hold(blocks, right, positions, landmark_positions, config.landmark_weight)
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
