"""The elastic fit: carry the target's shape onto the source surface, starting from a rough map.

Where the functional map has found the right basin, an elastic energy finishes: the target's mesh is deformed, as
affinely as possible (`cagemap.maps.elastic.graph`), until it lies on the source. Positions answer a point-to-plane
data term, so that tangential motion is left to the energy; landmarks are held. Two stages, first on a coarse graph that
moves whole limbs, then on the mesh of a level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.geometry.closest import closest_points
from cagemap.geometry.triangles import normalized, triangle_normals, vertex_normals
from cagemap.maps.elastic.counterparts import ReceivedArea
from cagemap.maps.elastic.data import PULLERS, Pullers, Sheet, deformed_normals, pull_by_source, pull_to_source
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph, bounded_maps, cluster_graph, extrapolate
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import factor
from cagemap.numerics.threads import ThreadPool

LANDMARK_ITERATIONS = 20
COST_STIFFNESS = 1e-3  # alpha at which coarse fits from different starts are compared
# Share of the vertices with bounded differentials above which a stage goes on.
UNSETTLED = 0.005


@dataclass(frozen=True)
class Stage:
    """One run of iterations on one graph.

    Attributes
    ----------
    iterations : int
    stiffness : (float, float)
        Weight alpha of the energy against the data, first and last; it falls geometrically over the first ``ramp`` of
        the iterations. sqrt(alpha) is the length, of sqrt(area), below which the energy outweighs the data.
    smoothing : float
        epsilon: its square root is the length over which differentials are smoothed.
    ramp : float
        See ``stiffness``.
    momentum : float
        Every iteration but the last goes on by this share of its change: x <- x + momentum (x - x_before).
    patience : int
        At most this many iterations more, at the last stiffness, while the deformation would still fold or flatten more
        than `UNSETTLED` of the surface.
    """

    iterations: int
    stiffness: tuple[float, float]
    smoothing: float
    ramp: float = 0.7
    momentum: float = 0.0
    patience: int = 0

    def ramped(self) -> FloatArray:
        """(iterations + patience,) stiffness alpha of every iteration."""
        first, last = self.stiffness
        steps = np.minimum(np.arange(self.iterations + self.patience) / max(self.ramp * self.iterations, 1e-9), 1.0)
        return np.asarray(first * (last / first) ** steps)


@dataclass(frozen=True)
class ElasticConfig:
    """Parameters of the fit; the defaults are the measured ones (docs/accuracy.md).

    Attributes
    ----------
    coarse_vertices : int
        Size of the coarse graph.
    coarse, fine : Stage
    normal_weight : float
        Closest points count position and this length times the normal.
    fine_normal_weight : float
        The same for those of the fine stage's vertices.
    projection_normal_weights : (float, float)
        The same in the last projection, see `facing_points`.
    landmark_weight : float
        Of a landmark, against a data weight of 1 for the whole surface.
    """

    coarse_vertices: int = 1500
    coarse: Stage = Stage(10, (5e-2, 2e-4), 1e-2, momentum=0.6)
    fine: Stage = Stage(12, (2e-4, 1e-5), 1e-4, momentum=0.8, patience=12)
    normal_weight: float = 0.03
    fine_normal_weight: float = 0.01
    projection_normal_weights: tuple[float, float] = (0.002, 0.02)
    landmark_weight: float = 1e2


@dataclass(frozen=True)
class FitShapes:
    """The two shapes as the fit sees them, both at unit area.

    Attributes
    ----------
    graph : ElasticGraph
        Of the target's mesh of n vertices.
    triangles : (t1, 3) int64
        Of that mesh.
    sheet : Sheet
        The source.
    coarse : ElasticGraph
        Of k clusters of the target's vertices.
    vertices : (k,) int64
        Vertex of the mesh that stands for each cluster; the landmarks come first.
    """

    graph: ElasticGraph
    triangles: IndexArray
    sheet: Sheet
    coarse: ElasticGraph
    vertices: IndexArray

    @classmethod
    def build(
        cls, graph: ElasticGraph, triangles: IndexArray, sheet: Sheet, landmarks: IndexArray, config: ElasticConfig
    ) -> FitShapes:
        """Cluster the target's mesh, every landmark (p,) a cluster of its own."""
        coarse, vertices = cluster_graph(graph, min(config.coarse_vertices, graph.n), landmarks)
        return cls(graph, triangles, sheet, coarse, vertices)


@dataclass(frozen=True)
class RestShape:
    """A graph with all that its rest shape alone decides: built before it is known where the shape goes.

    Attributes
    ----------
    graph : ElasticGraph
    field : DifferentialField
    triangles : (t, 3) int64 or None
        Of a mesh; None for clusters of one.
    received : ReceivedArea or None
        Of a mesh.
    """

    graph: ElasticGraph
    field: DifferentialField
    triangles: IndexArray | None
    received: ReceivedArea | None

    @classmethod
    def build(cls, graph: ElasticGraph, triangles: IndexArray | None, smoothing: float) -> RestShape:
        """Factor the matrices that stay the same in all iterations of a stage."""
        laplacian = graph.laplacian()
        field = DifferentialField.build(graph, laplacian, smoothing)
        return cls(graph, field, triangles, None if triangles is None else ReceivedArea.build(graph, laplacian))

    def differentials(self, positions: FloatArray) -> tuple[FloatArray, IndexArray]:
        """(n, 3, 3) maps A for positions x (n, 3), none of which folds or flattens, and which of them were bounded."""
        return bounded_maps(self.field.solve(positions), self.graph.normals)


@dataclass(frozen=True)
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
    rest: RestShape,
    source: Sheet,
    start: FloatArray | None,
    landmark_positions: FloatArray,
    config: ElasticConfig = ElasticConfig(),
) -> CoarseFit:
    """The coarse stage from rough positions, or from the landmarks alone.

    Parameters
    ----------
    rest : RestShape
        Of the coarse graph, the landmarks its first vertices.
    source : Sheet
    start : (k, 3) float64 or None
        Rough positions on the source; None to start from the landmarks.
    landmark_positions : (p, 3) float64
        Where they belong.

    Raises
    ------
    ParameterError
        If the start has not one position for every vertex of the coarse graph.
    """
    expected = rest.graph.positions.shape
    if start is not None and start.shape != expected:
        raise ParameterError(f"start: expected {expected} positions, one for each coarse vertex, got {start.shape}")
    held = np.arange(len(landmark_positions))
    first = landmark_start(rest, held, landmark_positions, config) if start is None else start
    positions = run_stage(rest, source, first, held, landmark_positions, config.coarse, config)
    maps, _ = rest.differentials(positions)
    return CoarseFit(coarse_cost(rest.graph, source, positions, maps, config), positions, maps)


def fit(
    shapes: FitShapes,
    rest: RestShape,
    coarse: Sequence[CoarseFit],
    landmarks: IndexArray,
    landmark_positions: FloatArray,
    config: ElasticConfig = ElasticConfig(),
) -> FloatArray:
    """Deform the target's mesh onto the source, from the coarse fit that ended cheapest.

    Parameters
    ----------
    shapes : FitShapes
    rest : RestShape
        Of the mesh.
    coarse : sequence of CoarseFit
        From different starts.
    landmarks : (p,) int64
        Vertices of the mesh.
    landmark_positions : (p, 3) float64
        Where they belong.

    Returns
    -------
    (n, 3) float64
        Positions near the source; project them for a map.
    """
    best = min(coarse, key=lambda ended: ended.cost)
    start = extrapolate(shapes.coarse, best.positions, best.maps, shapes.graph)
    return run_stage(rest, shapes.sheet, start, landmarks, landmark_positions, config.fine, config)


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
    graph: ElasticGraph, source: Sheet, positions: FloatArray, maps: FloatArray, config: ElasticConfig
) -> float:
    """What a coarse fit costs: mean squared distance in position and normal, and the energy at a fixed stiffness."""
    normals = deformed_normals(graph, maps)
    found, _, distance = closest_points(source.tree, positions, normals, normal_weight=config.normal_weight)
    turned = 2.0 - 2.0 * np.einsum(
        "nd,nd->n", normalized(triangle_normals(source.positions, source.triangles[found])), normals
    )
    data = graph.areas @ (distance**2 + config.normal_weight**2 * turned)
    return float(data + COST_STIFFNESS * graph.energy(positions, maps, config.coarse.smoothing))


def run_stage(
    rest: RestShape,
    source: Sheet,
    start: FloatArray,
    landmarks: IndexArray,
    landmark_positions: FloatArray,
    stage: Stage,
    config: ElasticConfig,
) -> FloatArray:
    """Alternate closest points, positions and differentials; returns positions (n, 3).

    Where the graph has triangles the data term works both ways: every deformed vertex lies on the source, and every
    source vertex on the deformed target, which is what fills fingers, ears and lips; parts of either that have no
    counterpart do not pull (`cagemap.maps.elastic.counterparts`). The alternation creeps along the
    surface, where only the energy pulls; momentum makes it three times faster.
    """
    graph, field, triangles = rest.graph, rest.field, rest.triangles
    pullers = None if triangles is None else Pullers.choose(source, int(PULLERS * graph.n))
    normal_weight = config.normal_weight if triangles is None else config.fine_normal_weight
    positions, before = start, start
    guess, guess_back = None, None
    with ThreadPool(1) as aside:
        for iteration, alpha in enumerate(stage.ramped(), start=1):
            if triangles is None:
                differentials = aside.submit(rest.differentials, positions)
                normals = deformed_normals(graph, differentials.result()[0])
            else:
                normals = vertex_normals(positions, triangles)
            pull = pull_to_source(graph, source, positions, normals, guess, normal_weight)
            blocks, right, guess = pull.blocks, pull.right, pull.triangles
            if triangles is not None and pullers is not None and rest.received is not None:
                back = pull_by_source(
                    triangles, pullers, positions, normals, guess_back, config.normal_weight, pull.feet, alpha
                )
                pull = pull.scaled(rest.received.weights(back.weights))
                blocks, right, guess_back = pull.blocks + back.blocks, pull.right + back.right, back.triangles
                # Only the residual asks for them here: beside the factorisation, which keeps to one core.
                differentials = aside.submit(rest.differentials, positions)
            blocks[landmarks] = config.landmark_weight * np.eye(3)
            right[landmarks] = config.landmark_weight * landmark_positions
            # Single precision: what a step misses, the next one finds in its residual, which is in double.
            matrix = field.system.at(alpha, blocks)
            factors = factor(matrix, like=field.factors, dtype=np.float32)
            maps, bounded = differentials.result()
            residual = (right + alpha * field.divergence(maps)).ravel()
            residual -= matrix @ positions.ravel()
            after = positions + factors.solve(residual).reshape(-1, 3)
            if iteration >= stage.iterations and len(bounded) <= UNSETTLED * graph.n:
                return after
            positions = after + stage.momentum * (after - before) if iteration > 1 else after
            before = after
    return before
