"""The elastic fit: carry the target's shape onto the source surface, starting from a rough map.

Where the functional map has found the right basin, an elastic energy finishes: the target's mesh is deformed, as
affinely as possible (`cagemap.point_map.elastic_graph`), until it lies on the source. Positions answer a point-to-plane
data term, so that tangential motion is left to the energy; landmarks are held. Two stages, first on a coarse graph that
moves whole limbs, then on the mesh of a level. The fitted points then become a subdivision surface whose finest
vertices are projected once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.mesh import FloatArray, IndexArray
from cagemap.operators.laplacian import vertex_areas
from cagemap.point_map.elastic_graph import DifferentialField, ElasticGraph, cluster_graph, extrapolate, mesh_graph
from cagemap.point_map.elastic_system import PositionSystem
from cagemap.point_map.folds import unfold
from cagemap.point_map.point_map import PointMap
from cagemap.point_map.surface_points import (
    TriangleTree,
    build_tree,
    closest_points,
    normalized,
    triangle_normals,
    vertex_normals,
)
from cagemap.refinement import Refinement, level_triangles

LANDMARK_ITERATIONS = 20
COST_STIFFNESS = 1e-3  # alpha at which coarse fits from different starts are compared


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
    """

    iterations: int
    stiffness: tuple[float, float]
    smoothing: float
    ramp: float = 0.7


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
    landmark_weight : float
        Of a landmark, against a data weight of 1 for the whole surface.
    """

    coarse_vertices: int = 1500
    coarse: Stage = Stage(40, (5e-2, 2e-4), 1e-2)
    fine: Stage = Stage(10, (2e-4, 1e-5), 3e-4)
    normal_weight: float = 0.03
    projection_normal_weight: float = 0.02
    landmark_weight: float = 1e2


@dataclass(frozen=True)
class Sheet:
    """The source as the fit sees it: a surface to lie on.

    Attributes
    ----------
    positions : (n2, 3) float64, at unit area
    triangles : (t2, 3) int64
    normals : (n2, 3) float64
    areas : (n2,) float64
        Shares of the surface's area, sum 1.
    tree : TriangleTree
    """

    positions: FloatArray
    triangles: IndexArray
    normals: FloatArray
    areas: FloatArray
    tree: TriangleTree

    @classmethod
    def build(cls, positions: FloatArray, faces: IndexArray) -> Sheet:
        """Prepare a surface for closest points; ``faces`` are triangles."""
        areas = vertex_areas(positions, faces)
        return cls(
            positions, faces, vertex_normals(positions, faces), areas / areas.sum(), build_tree(positions, faces)
        )


def fit(
    graph: ElasticGraph,
    target_triangles: IndexArray,
    source: Sheet,
    start: FloatArray,
    landmarks: IndexArray,
    landmark_positions: FloatArray,
    config: ElasticConfig = ElasticConfig(),
) -> FloatArray:
    """Deform a target mesh onto the source.

    Parameters
    ----------
    graph : ElasticGraph
        Of the target's mesh.
    target_triangles : (t1, 3) int64
    source : Sheet
    start : (n1, 3) float64
        Rough positions on the source.
    landmarks : (p,) int64
        Vertices of the graph.
    landmark_positions : (p, 3) float64
        Where they belong.

    Returns
    -------
    (n1, 3) float64
        Positions near the source; project them for a map.
    """
    if start.shape != graph.positions.shape:
        raise ParameterError(f"start: expected {graph.positions.shape} positions, got {start.shape}")
    coarse, vertices = cluster_graph(graph, min(config.coarse_vertices, graph.n), landmarks)
    held = np.arange(len(landmarks))
    starts = [start[vertices], landmark_start(coarse, held, landmark_positions, config)]
    runs = [run_stage(coarse, None, source, x, held, landmark_positions, config.coarse, config) for x in starts]
    costs = [coarse_cost(coarse, source, x, maps, config) for x, maps in runs]
    positions = extrapolate(coarse, *runs[int(np.argmin(costs))], graph)
    return run_stage(graph, target_triangles, source, positions, landmarks, landmark_positions, config.fine, config)[0]


def landmark_start(
    graph: ElasticGraph, landmarks: IndexArray, landmark_positions: FloatArray, config: ElasticConfig
) -> FloatArray:
    """(n, 3) the rest shape carried by its landmarks alone: a similarity, then the elastic energy without data.

    It knows the twist of limbs, which coordinates on the surface do not: a hand with one landmark keeps its turn.
    """
    rotation, scale, shift = similarity(graph.positions[landmarks], landmark_positions)
    positions = scale * graph.positions @ rotation.T + shift
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, config.coarse.smoothing)
    blocks = np.zeros((graph.n, 3, 3))
    blocks[landmarks] = config.landmark_weight * np.eye(3)
    factors = PositionSystem.build(laplacian).factor(1.0, blocks, None)
    for _ in range(LANDMARK_ITERATIONS):
        right = field.divergence(field.solve(positions))
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
    normals = _deformed_normals(graph, positions, maps, None)
    found, _, distance = closest_points(source.tree, positions, normals, normal_weight=config.normal_weight)
    turned = 2.0 - 2.0 * np.einsum(
        "nd,nd->n", normalized(triangle_normals(source.positions, source.triangles[found])), normals
    )
    data = graph.areas @ (distance**2 + config.normal_weight**2 * turned)
    return float(data + COST_STIFFNESS * graph.energy(positions, maps, config.coarse.smoothing))


def run_stage(
    graph: ElasticGraph,
    target_triangles: IndexArray | None,
    source: Sheet,
    start: FloatArray,
    landmarks: IndexArray,
    landmark_positions: FloatArray,
    stage: Stage,
    config: ElasticConfig,
) -> tuple[FloatArray, FloatArray]:
    """Alternate closest points, differentials and positions; returns positions (n, 3) and maps (n, 3, 3).

    Where the graph has triangles the data term works both ways: every deformed vertex lies on the source, and every
    source vertex on the deformed target, which is what fills fingers, ears and lips. Normals of the deformed surface
    come from its triangles, or, on a graph without them, from the differentials' cofactors.
    """
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, stage.smoothing)
    system = PositionSystem.build(laplacian)
    positions, guess, factors = start, None, None
    maps = field.solve(positions)
    for alpha in _ramp(stage):
        normals = _deformed_normals(graph, positions, maps, target_triangles)
        guess, blocks, right = _pulled_to_source(graph, source, positions, normals, guess, config)
        if target_triangles is not None:
            more, pull = _pulled_by_source(target_triangles, source, positions, config)
            blocks, right = blocks + more, right + pull
        blocks[landmarks] = config.landmark_weight * np.eye(3)
        right[landmarks] = config.landmark_weight * landmark_positions
        right += alpha * field.divergence(maps)
        factors = system.factor(alpha, blocks, factors)
        positions = factors.solve(right.ravel()).reshape(-1, 3)
        maps = field.solve(positions)
    return positions, maps


def _pulled_to_source(
    graph: ElasticGraph,
    source: Sheet,
    positions: FloatArray,
    normals: FloatArray,
    guess: IndexArray | None,
    config: ElasticConfig,
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Point-to-plane term of the deformed vertices: triangles found, blocks m n n^T, right side."""
    found, barycentric, _ = closest_points(
        source.tree, positions, normals, normal_weight=config.normal_weight, guess=guess
    )
    corners = source.triangles[found]
    foot = np.einsum("nk,nkd->nd", barycentric, source.positions[corners])
    plane = normalized(np.einsum("nk,nkd->nd", barycentric, source.normals[corners]))
    weights = graph.areas * np.clip(np.einsum("nd,nd->n", plane, normals), 0.0, 1.0)
    blocks = weights[:, None, None] * plane[:, :, None] * plane[:, None, :]
    return found, blocks, np.einsum("nab,nb->na", blocks, foot)


def _pulled_by_source(
    target_triangles: IndexArray, source: Sheet, positions: FloatArray, config: ElasticConfig
) -> tuple[FloatArray, FloatArray]:
    """Point-to-plane term of the source vertices: blocks (n, 3, 3), right side (n, 3).

    The residual r = n . (q - sum_k b_k x_k) of a source vertex q is asked of each corner of the triangle that holds
    its closest point, n . x_k -> n . x_k + r with weight b_k: an upper bound of the true term (Jensen), equal at the
    current positions, that keeps the blocks apart.
    """
    n = len(positions)
    held_by, barycentric, _ = closest_points(
        build_tree(positions, target_triangles), source.positions, source.normals, normal_weight=config.normal_weight
    )
    corners = target_triangles[held_by]
    foot = np.einsum("nk,nkd->nd", barycentric, positions[corners])
    residual = np.einsum("nd,nd->n", source.normals, source.positions - foot)
    facing = normalized(triangle_normals(positions, target_triangles))[held_by]
    shares = source.areas * np.clip(np.einsum("nd,nd->n", facing, source.normals), 0.0, 1.0)
    weights = (shares[:, None] * barycentric).ravel()  # one row per corner
    normals = np.repeat(source.normals, 3, axis=0)
    wanted = np.einsum("nd,nd->n", normals, positions[corners.ravel()]) + np.repeat(residual, 3)
    gather = sparse.csr_array((weights, (corners.ravel(), np.arange(len(weights)))), shape=(n, len(weights)))
    blocks = gather @ (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)
    return blocks.reshape(n, 3, 3), gather @ (wanted[:, None] * normals)


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


def elastic_map(
    target: Refinement,
    source: Refinement,
    scales: tuple[float, float],
    levels: tuple[int, int],
    match: IndexArray,
    landmarks: tuple[IndexArray, IndexArray],
    config: ElasticConfig = ElasticConfig(),
) -> PointMap:
    """Map of the finest levels from a rough map of coarse ones.

    Parameters
    ----------
    target, source : Refinement
    scales : (float, float)
        Factors from each mesh's lengths to those of unit area.
    levels : (int, int)
        Level of the target and of the source that ``match`` belongs to; the target is fitted at its level.
    match : (n1_l,) int64
        Source vertex of every target vertex of those levels.
    landmarks : pair of (p,) int64
        Control vertices of target and source.

    Returns
    -------
    PointMap
        Landmarks are met exactly.
    """
    fitted = fit_level(target, source, scales, levels, match, landmarks, config)
    sampling = target.product(target.n_levels, levels[0])
    control = control_points(sparse.csr_array(sampling[: len(fitted)]), fitted)
    finest = sampling @ control
    _, target_triangles = level_faces(target, target.n_levels)
    _, source_triangles = level_faces(source, source.n_levels)
    return project(finest, target_triangles, scales[1] * source.finest.positions, source_triangles, landmarks, config)


def fit_level(
    target: Refinement,
    source: Refinement,
    scales: tuple[float, float],
    levels: tuple[int, int],
    match: IndexArray,
    landmarks: tuple[IndexArray, IndexArray],
    config: ElasticConfig,
) -> FloatArray:
    """(n1_l, 3) fitted points of the target level's vertices: points of the finest surface, not control points."""
    n_target = target.levels[levels[0]].n_vertices
    if match.shape != (n_target,):
        raise ParameterError(
            f"match: expected {n_target} rows, one per vertex of target level {levels[0]}, got {match.shape}"
        )
    faces, split = level_faces(target, levels[0])
    graph = mesh_graph(scales[0] * target.finest.positions[:n_target], faces, split)
    sheet_level = sheet_of(source)
    n_sheet = source.levels[sheet_level].n_vertices
    positions = scales[1] * source.finest.positions[:n_sheet]
    sheet = Sheet.build(positions, level_faces(source, sheet_level)[1])
    finest = scales[1] * source.finest.positions
    return fit(graph, split, sheet, finest[match], landmarks[0], finest[landmarks[1]], config)


def sheet_of(source: Refinement, enough: int = 15_000) -> int:
    """Coarsest level of the source that is fine enough to lie on while fitting."""
    return next((i for i, level in enumerate(source.levels) if level.n_vertices >= enough), source.n_levels)


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


def _ramp(stage: Stage) -> FloatArray:
    """Stiffness of every iteration."""
    first, last = stage.stiffness
    steps = np.minimum(np.arange(stage.iterations) / max(stage.ramp * stage.iterations, 1e-9), 1.0)
    return np.asarray(first * (last / first) ** steps)


def _deformed_normals(
    graph: ElasticGraph, positions: FloatArray, maps: FloatArray, target_triangles: IndexArray | None
) -> FloatArray:
    """(n, 3) unit normals of the deformed surface."""
    if target_triangles is not None:
        return vertex_normals(positions, target_triangles)
    # Normals transform with the cofactor matrix, whose rows are cross products of the map's rows.
    cofactors = np.stack([np.cross(maps[:, (k + 1) % 3], maps[:, (k + 2) % 3]) for k in range(3)], axis=1)
    return normalized(np.einsum("nab,nb->na", cofactors, graph.normals))
