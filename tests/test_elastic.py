"""The elastic fit: what its energy forgives, what it holds, and that it finds a known map."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.basis import BasisConfig, Surface, hierarchical_basis
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.geometry.closest import build_tree, closest_points
from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import normalized, triangle_normals, vertex_normals
from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.config import ElasticConfig, Stage
from cagemap.maps.elastic.counterparts import round_trip_weights
from cagemap.maps.elastic.data import Pullers, curved_points, pull_by_source
from cagemap.maps.elastic.fit import coarse_fit, fine_fit, run_stage
from cagemap.maps.elastic.graph import (
    FLAT,
    LEAST_STRETCH,
    DifferentialField,
    ElasticGraph,
    bounded_maps,
    cluster_graph,
    extrapolate,
    mesh_graph,
)
from cagemap.maps.elastic.prepared import PreparedPair, RestShape, level_graph
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.elastic.system import BlockSystem
from cagemap.maps.elastic.ties import Ties
from cagemap.maps.elastic.update import landmark_response
from cagemap.maps.pair import Pair, PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection import relax as folds
from cagemap.maps.projection.project import control_points, project, unfold
from cagemap.maps.projection.relax import relax_folds
from cagemap.maps.quality import flipped_triangles, measure_quality
from cagemap.maps.spectral.hierarchical import HierarchyConfig
from cagemap.maps.spectral.landmark_coordinates import interpolants, landmark_coordinates
from cagemap.mesh import ControlMesh
from cagemap.mesh.shapes import creature
from cagemap.numerics.factorization import factor
from cagemap.operators import build_operators
from cagemap.refinement import Refinement, level_triangles, refine


def unit_refinement(control: ControlMesh, level: int) -> tuple[Refinement, float]:
    refinement = refine(control, level)
    return refinement, build_operators(refinement).scale


@pytest.fixture(scope="module")
def shape() -> tuple[Refinement, float]:
    return unit_refinement(creature(), 3)


def mesh_of(refinement: Refinement, scale: float, level: int) -> TriangleSurface:
    n = refinement.levels[level].n_vertices
    return TriangleSurface(scale * refinement.finest.positions[:n], level_triangles(refinement, level), scale)


def graph_of(refinement: Refinement, scale: float, level: int) -> tuple[ElasticGraph, TriangleSurface]:
    mesh, faces = mesh_of(refinement, scale, level), refinement.levels[level].faces
    return mesh_graph(mesh, mesh.triangles if faces is None else faces), mesh


def surface_of(refinement: Refinement) -> Surface:
    """A surface with few basis functions: the fit does not ask for any."""
    operators = build_operators(refinement)
    return Surface.of(refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(count=4)))


def prepared_at(target: Surface, source: Surface, level: int, config: ElasticConfig) -> PreparedPair:
    """A prepared pair that deforms a level of the target; both surfaces are small, so the sheet is the finest."""
    rest = RestShape.build(level_graph(target, level), target.triangles(level), config.fine.smoothing)
    sheet = source.triangles(source.finest)
    return PreparedPair(target, source, HierarchyConfig(), config, (level, source.finest), rest, sheet)


def fitted_map(
    target: Refinement,
    source: Refinement,
    level: int,
    match: np.ndarray,
    landmarks: np.ndarray,
    config: ElasticConfig = ElasticConfig(),
) -> PointMap:
    """The whole fit, from a source vertex for every target vertex of a level; landmarks have the same numbers."""
    pair = Pair.of_vertices(surface_of(target), surface_of(source), landmarks, landmarks)
    prepared = prepared_at(pair.target, pair.source, level, config)
    problem = FitProblem(prepared, pair)
    start = prepared.on_source.positions[match[problem.shape.vertices]]
    started = [coarse_fit(problem, first) for first in (start, None)]
    fitted = fine_fit(problem, min(started, key=lambda ended: ended.cost))
    return unfold(project(prepared, fitted, pair.landmarks), landmarks, config)


def affine(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.eye(3) + 0.4 * rng.standard_normal((3, 3)), rng.standard_normal(3)


@pytest.mark.parametrize("clustered", [False, True])
def test_an_affine_deformation_costs_nothing(shape: tuple[Refinement, float], clustered: bool) -> None:
    graph, _ = graph_of(*shape, 2)
    if clustered:
        graph, _ = cluster_graph(graph, 200, np.array([3, 5]))
    matrix, shift = affine(np.random.default_rng(11))
    positions = graph.positions @ matrix.T + shift
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, 1e-2)
    maps = field.solve(positions)
    np.testing.assert_allclose(maps, np.broadcast_to(matrix, maps.shape), atol=1e-6)  # ridge of 1e-9
    # The positions are then a solution of the energy's position equations.
    np.testing.assert_allclose(laplacian @ positions, field.divergence(maps), atol=1e-6 * abs(laplacian.data).max())


def test_both_right_sides_are_those_of_the_energy(shape: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*shape, 1)
    rng = np.random.default_rng(19)
    positions, maps = rng.standard_normal((graph.n, 3)), rng.standard_normal((graph.n, 3, 3))
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, 1e-2)
    blocks, moments, divergence = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3))
    for i, j, weight, edge in zip(graph.heads, graph.tails, graph.weights, graph.edges, strict=True):
        blocks[i] += weight * np.outer(edge, edge)
        moments[i] += weight * np.outer(edge, positions[i] - positions[j])
        divergence[i] += weight * 0.5 * (maps[i] + maps[j]) @ edge
    np.testing.assert_allclose((field.moments @ positions).reshape(-1, 3, 3), moments, atol=1e-12)
    np.testing.assert_allclose(field.divergence(maps), divergence, atol=1e-12)
    # (G_i + epsilon L) A_i^T = c_i, up to the ridge.
    transposed = field.solve(positions).transpose(0, 2, 1)
    left = blocks @ transposed + 1e-2 * (laplacian @ transposed.reshape(graph.n, 9)).reshape(-1, 3, 3)
    np.testing.assert_allclose(left, moments, atol=1e-6)


def test_maps_that_flatten_or_mirror_are_bounded_and_no_others() -> None:
    rng = np.random.default_rng(21)
    normals = normalized(rng.standard_normal((400, 3)))
    maps = rng.standard_normal((400, 3, 3))
    found, bounded = bounded_maps(maps, normals)
    expected = []
    for i, (before, after, normal) in enumerate(zip(maps, found, normals, strict=True)):
        tangents = np.linalg.svd(normal[None])[2][1:]
        across, along = np.linalg.svd(before @ tangents.T)[1]
        if np.linalg.det(before) > 0 and along >= FLAT * across:
            np.testing.assert_array_equal(after, before)
            continue
        expected.append(i)
        largest, _, least = np.linalg.svd(after)[1]
        assert np.linalg.det(after) > 0
        assert least > (1 - 1e-9) * LEAST_STRETCH * largest
        sizes = np.linalg.svd(before)[1]
        assert largest == pytest.approx(sizes[0])
        # No farther from the map before than that takes: only the two smaller stretches change.
        assert np.linalg.norm(after - before) <= np.hypot(LEAST_STRETCH * sizes[0], LEAST_STRETCH * sizes[0] + sizes[2])
    assert 100 < len(expected) < 300  # half are mirrored, and some flat
    np.testing.assert_array_equal(bounded, expected)


def test_a_part_that_is_thin_along_its_normal_is_not_bounded() -> None:
    flat = np.diag([1.0, 0.8, 0.001])[None]
    assert len(bounded_maps(flat, np.array([[0.0, 0.0, 1.0]]))[1]) == 0
    assert len(bounded_maps(flat, np.array([[1.0, 0.0, 0.0]]))[1]) == 1


def test_flat_maps_come_out_upright_whatever_the_factorisation_says() -> None:
    rng = np.random.default_rng(22)
    maps = rng.standard_normal((50, 3, 2)) @ rng.integers(-3, 4, (50, 2, 3))
    found, bounded = bounded_maps(maps, normalized(rng.standard_normal((50, 3))))
    assert np.all(np.linalg.det(found[bounded]) > 0)
    # Rounding decides which of them have a positive determinant and pass as thin along the normal.
    assert len(bounded) > 10


def test_a_map_that_shrinks_everything_to_a_point_stays_finite() -> None:
    found, bounded = bounded_maps(np.zeros((1, 3, 3)), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(found, 0.0)
    assert len(bounded) == 1


def test_extrapolation_is_exact_for_affine_deformations(shape: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*shape, 2)
    coarse, _ = cluster_graph(graph, 150, np.array([7]))
    matrix, shift = affine(np.random.default_rng(12))
    maps = np.broadcast_to(matrix, (coarse.n, 3, 3))
    found = extrapolate(coarse, coarse.positions @ matrix.T + shift, maps, graph)
    np.testing.assert_allclose(found, graph.positions @ matrix.T + shift, atol=1e-12)


def test_clusters_keep_area_landmarks_and_energy(shape: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*shape, 3)
    kept = np.array([20, 4, 11])
    coarse, vertices = cluster_graph(graph, 300, kept)
    assert 150 < coarse.n < 500
    np.testing.assert_array_equal(vertices[:3], kept)
    np.testing.assert_array_equal(coarse.positions, graph.positions[vertices])
    assert len(np.unique(vertices)) == coarse.n
    assert coarse.areas.sum() == pytest.approx(1)
    assert (coarse.weights > 0).all()
    for g in (graph, coarse):  # the Dirichlet energy of the coordinates is twice the area, which is 1
        assert (g.weights * (g.edges**2).sum(axis=1)).sum() / 2 == pytest.approx(2, rel=0.05)


def test_control_points_interpolate(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    n = refinement.levels[1].n_vertices
    sampling = sparse.csr_array(refinement.product(3, 1)[:n])
    points = scale * refinement.finest.positions[:n]
    control = control_points(sampling, points)
    spacing = np.sqrt(1 / n)
    assert abs(sampling @ control - points).max() < 0.02 * spacing
    assert abs(sampling @ points - points).max() > 0.05 * spacing  # what not solving would leave


def test_a_surface_fits_itself_from_a_shaken_start(shape: tuple[Refinement, float]) -> None:
    refinement, _ = shape
    surface = surface_of(refinement)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 3)
    config = ElasticConfig(coarse_vertices=400)
    pair, prepared = Pair.of_vertices(surface, surface, landmarks, landmarks), prepared_at(surface, surface, 2, config)
    graph, problem = prepared.rest.graph, FitProblem(prepared, pair)
    start = graph.positions + 0.03 * np.random.default_rng(13).standard_normal((graph.n, 3))
    started = [coarse_fit(problem, first) for first in (start[problem.shape.vertices], None)]
    found = fine_fit(problem, min(started, key=lambda ended: ended.cost))
    error = np.linalg.norm(found - graph.positions, axis=1)
    assert error.mean() < 0.003  # ten times less than the noise; tangentially only landmarks and the energy hold it
    assert error[landmarks].max() < 1e-4


def test_same_shape_other_cage_gives_the_identity(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    # The same surface from its own first level as a cage: other connectivity level by level, same refined vertices.
    level = refinement.levels[1]
    other, _ = unit_refinement(ControlMesh.from_faces(level.positions, level.faces), 2)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 2)
    n = refinement.levels[2].n_vertices
    rng = np.random.default_rng(14)
    edges = refinement.matrices[1][:n].tocsr()
    match = np.array([rng.choice(edges.indices[edges.indptr[i] : edges.indptr[i + 1]]) for i in range(n)])
    found = fitted_map(refinement, other, 2, match, landmarks, ElasticConfig(400))
    error = np.linalg.norm(found.images.positions - scale * refinement.finest.positions, axis=1)
    assert error.mean() < 0.0015  # the bar of issue 3
    pairs = PointPairs.of_vertices(found.target, found.source, landmarks, landmarks)
    figures = measure_quality(found, pairs)
    assert figures.landmark_errors.max() < 1e-12
    assert figures.flipped_area < 2e-3
    assert figures.coverage > 0.99


def test_what_source_vertices_ask_is_the_sum_over_their_triangles_corners(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    graph, mesh = graph_of(refinement, scale, 1)
    sheet, split = mesh_of(refinement, scale, 3), mesh.triangles
    pullers = Pullers.choose(sheet, 300)
    assert pullers.areas.sum() == pytest.approx(1)
    rng = np.random.default_rng(20)
    positions = graph.positions + 0.01 * rng.standard_normal((graph.n, 3))
    normals = vertex_normals(positions, split)
    feet = graph.positions
    pull = pull_by_source(split, pullers, positions, normals, None, 0.03, feet, 1e-4)
    found, weights, _ = closest_points(build_tree(positions, split), pullers.points, pullers.planes, normal_weight=0.03)
    facing = normalized(triangle_normals(positions, split))[found]
    blocks, right, received = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3)), np.zeros(graph.n)
    for j, corners in enumerate(split[found]):
        plane, foot = (
            pullers.planes[j],
            curved_points(positions[corners][None], normals[corners][None], weights[[j]])[0],
        )
        residual = plane @ (pullers.points[j] - foot)
        trip = weights[[j]] @ feet[corners] - pullers.points[j]
        trust = round_trip_weights(trip, np.array([residual]), 1e-4)[0]
        share = pullers.areas[j] * max(facing[j] @ plane, 0.0) * trust
        for corner, weight in zip(corners, share * weights[j], strict=True):
            blocks[corner] += weight * np.outer(plane, plane)
            right[corner] += weight * (plane @ positions[corner] + residual) * plane
            received[corner] += weight
    assert received.max() > 0
    np.testing.assert_allclose(pull.blocks, blocks, atol=1e-14)
    np.testing.assert_allclose(pull.right, right, atol=1e-14)
    np.testing.assert_allclose(pull.weights, received, atol=1e-14)


def test_curved_points_are_exact_on_quadratic_surfaces() -> None:
    rng = np.random.default_rng(18)
    # Corners on z = h (a x^2 + b x y + c y^2); normals to first order in h, so that errors are of its third order.
    for height in (1e-2, 1e-3):
        a, b, c = rng.standard_normal(3)
        flat = rng.standard_normal((40, 3, 2))
        x, y = flat[..., 0], flat[..., 1]
        corners = np.dstack([x, y, height * (a * x * x + b * x * y + c * y * y)])
        normals = normalized(np.dstack([-height * (2 * a * x + b * y), -height * (b * x + 2 * c * y), np.ones_like(x)]))
        weights = rng.dirichlet(np.ones(3), 40)
        x, y, z = curved_points(corners, normals, weights).T
        sag = height * (a * x * x + b * x * y + c * y * y) - np.einsum("mk,mk->m", weights, corners[..., 2])
        error = height * (a * x * x + b * x * y + c * y * y) - z
        assert abs(sag).max() > 0.1 * height
        assert abs(error).max() < 200 * height**3


def test_momentum_gets_as_far_in_half_the_iterations(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    graph, sheet = graph_of(refinement, scale, 2)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 6)
    # Slide the surface along itself, smoothly: only the energy and the landmarks can bring it back.
    x, y, z = graph.positions.T
    slide = 0.04 * np.column_stack([np.sin(5 * y), np.sin(5 * z), np.sin(5 * x)])
    slide -= np.einsum("nd,nd->n", slide, graph.normals)[:, None] * graph.normals

    def error(iterations: int, momentum: float) -> float:
        stage = Stage(iterations, (1e-4, 1e-4), 3e-4, momentum=momentum)
        start = graph.positions + slide
        held = graph.positions[landmarks]
        rest = RestShape.build(graph, sheet, stage.smoothing)
        found = run_stage(rest, sheet, start, Ties(Anchors.at_vertices(landmarks), held), stage, ElasticConfig())
        return float(np.linalg.norm(found - graph.positions, axis=1).mean())

    assert error(8, 0.8) < error(16, 0.0) < np.linalg.norm(slide, axis=1).mean()


def test_steps_with_the_factors_of_an_earlier_iteration_end_at_the_same_place(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    graph, sheet = graph_of(refinement, scale, 2)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 6)
    start = graph.positions + 0.02 * np.sin(7 * graph.positions[:, [1, 2, 0]])

    def ended(factored: int) -> np.ndarray:
        stage = Stage(12, (1e-3, 1e-4), 3e-4, momentum=0.8, factored=factored)
        rest = RestShape.build(graph, sheet, stage.smoothing)
        ties = Ties(Anchors.at_vertices(landmarks), graph.positions[landmarks])
        return run_stage(rest, sheet, start, ties, stage, ElasticConfig())

    exact = ended(1)
    moved = np.linalg.norm(exact - start, axis=1).mean()
    # Measured 0.12 %; with one gradient a step 2.1 %.
    assert np.linalg.norm(ended(4) - exact, axis=1).mean() < 0.01 * moved


def test_a_step_ends_where_nothing_is_left_to_miss() -> None:
    """Factors of the matrix itself: one gradient solves it, and the next would divide by zero."""
    system = BlockSystem.build(sparse.csr_array(2.0 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1)))
    matrix, right = sparse.csc_array(2.0 * sparse.eye_array(15)), np.ones(15)
    np.testing.assert_allclose(system.step(matrix, right, factor(matrix)), 0.5 * right, rtol=1e-12)
    np.testing.assert_array_equal(system.step(matrix, 0.0 * right, factor(matrix)), 0.0)


def test_counts_of_a_stage_are_checked() -> None:
    for wrong in ({"iterations": 0}, {"iterations": 3, "factored": 0}, {"iterations": 3, "patience": -1}):
        with pytest.raises(ParameterError, match="a stage of the elastic fit"):
            Stage(**{"stiffness": (1e-3, 1e-4), "smoothing": 1e-3} | wrong)


def test_patience_ends_as_soon_as_nothing_folds(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    graph, sheet = graph_of(refinement, scale, 2)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 6)
    start = graph.positions + 0.01 * graph.normals

    def found(patience: int) -> np.ndarray:
        stage = Stage(3, (1e-3, 1e-4), 3e-4, patience=patience)
        rest = RestShape.build(graph, sheet, stage.smoothing)
        ties = Ties(Anchors.at_vertices(landmarks), graph.positions[landmarks])
        return run_stage(rest, sheet, start, ties, stage, ElasticConfig())

    np.testing.assert_array_equal(found(5), found(0))
    np.testing.assert_array_equal(Stage(3, (1e-3, 1e-4), 3e-4, patience=2).ramped()[3:], 1e-4)


def test_long_thin_legs_do_not_fold_on_short_thick_ones() -> None:
    # A landmark at each hoof's front lies higher on the source, as an artist would not notice: the shanks then have to
    # shrink to a third, and without bounded maps 2 % of the surface folded.
    source = creature()
    x, y, z = source.positions.T
    height = np.where(y < 1.6, 1.5 + 3.0 * (y - 1.5), y)
    thin, foot = y < 1.4, np.where(z > 2.5, 5.0, 0.0)
    side = np.sign(x)
    positions = np.column_stack(
        [np.where(thin, side + 0.3 * (x - side), x), height, np.where(thin, foot + 0.3 * (z - foot), z)]
    )

    def leg_fronts(at: float) -> np.ndarray:
        """Inner front edge of every leg at a height, leg by leg."""
        found = np.flatnonzero((y == at) & (abs(x) == 0.5) & (z - foot == 0.5))
        assert len(found) == 4
        return found[np.lexsort((z[found], x[found]))]

    body = np.flatnonzero((y > 1.6) & (np.arange(len(y)) % 9 == 0))
    pair = Pair.of_vertices(
        surface_of(refine(source.with_positions(positions), 2)),
        surface_of(refine(source, 2)),
        np.concatenate([body, leg_fronts(-0.5)]),
        np.concatenate([body, leg_fronts(0.5)]),
    )
    config = ElasticConfig()
    prepared = prepared_at(pair.target, pair.source, 2, config)
    problem = FitProblem(prepared, pair)
    fitted = fine_fit(problem, coarse_fit(problem, None))
    found = unfold(project(prepared, fitted, pair.landmarks), pair.target_landmarks)
    assert measure_quality(found).flipped_area < 1e-4


def test_the_response_to_landmarks_is_linear_and_keeps_what_is_held(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    graph, _ = graph_of(refinement, scale, 1)
    rng = np.random.default_rng(16)
    held = np.arange(0, refinement.levels[0].n_vertices, 15)
    offsets = np.zeros((len(held), 3))
    offsets[0] = 0.05 * np.cross(graph.normals[held[0]], rng.standard_normal(3))
    moved, maps = landmark_response(graph, graph.normals, held, offsets)
    twice, _ = landmark_response(graph, graph.normals, held, 2 * offsets)
    still, flat = landmark_response(graph, graph.normals, held, 0 * offsets)
    np.testing.assert_allclose(twice, 2 * moved, atol=1e-12)
    assert abs(still).max() == 0.0
    assert abs(flat).max() == 0.0
    size = np.linalg.norm(offsets[0])
    np.testing.assert_allclose(moved[held], offsets, atol=1e-3 * size)  # weight 1e2 against a stiffness of 2e-4
    lengths = np.linalg.norm(moved, axis=1)
    distance = np.linalg.norm(graph.positions - graph.positions[held[0]], axis=1)
    near = distance < np.quantile(distance, 0.05)
    assert lengths[near].mean() > 0.2 * size  # the surroundings come along
    normal_part = abs(np.einsum("nd,nd->n", moved, graph.normals))
    assert np.median(normal_part[near] / lengths[near]) < 0.5  # along the surface
    assert maps.shape == (graph.n, 3, 3)


def test_landmark_coordinates_alone_lead_to_the_map_of_a_bent_twin(shape: tuple[Refinement, float]) -> None:
    target, _ = shape
    cage = target.control
    # Swell and bend the shape smoothly: every vertex keeps its meaning, so the true map is the identity.
    x, y, z = (cage.positions / np.ptp(cage.positions)).T
    bent = np.column_stack([x * (1 + 0.5 * z), y + 0.2 * z**2, z * (1 + 0.3 * x)])
    source, source_scale = unit_refinement(cage.with_positions(bent), 3)
    landmarks = np.arange(0, cage.n_vertices, 8)
    coordinates = []
    for refinement in (target, source):
        operators = build_operators(refinement)
        coordinates.append(landmark_coordinates(operators.stiffness[2], operators.mass[2], landmarks))
    match = cKDTree(coordinates[1]).query(coordinates[0])[1]
    np.testing.assert_array_equal(match[landmarks], landmarks)
    found = fitted_map(target, source, 2, match, landmarks)
    truth = source_scale * source.finest.positions
    error = np.linalg.norm(found.images.positions - truth, axis=1)
    assert error[landmarks].max() < 1e-12
    started = np.linalg.norm(truth[match] - truth[: len(match)], axis=1)
    assert error.mean() < 0.3 * started.mean()
    assert error.mean() < 0.008


@pytest.mark.parametrize("rings", [0, 1, 3])
def test_rings_around_triangles_are_those_of_their_neighbours(rings):
    faces = level_triangles(refine(creature(), 1), 1)
    flipped = np.zeros(len(faces), dtype=bool)
    flipped[[3, 400]] = True
    expected = set(faces[flipped].ravel().tolist())
    for _ in range(rings):
        expected |= {vertex for face in faces.tolist() if expected & set(face) for vertex in face}
    assert set(np.flatnonzero(folds.around(faces, flipped, rings, faces.max() + 1)).tolist()) == expected


def test_unfolding_repairs_folds_and_leaves_the_rest_alone(shape: tuple[Refinement, float]) -> None:
    refinement, scale = shape
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    rng = np.random.default_rng(15)
    pulled = rng.choice(len(positions), 12, replace=False)
    held = np.setdiff1d(np.arange(0, len(positions), 50), pulled)
    wanted = positions.copy()
    spacing = np.sqrt(1 / len(positions))
    wanted[pulled] += 3 * spacing * normalized(rng.standard_normal((12, 3)))
    images = SurfacePoints.nearest(surface, wanted)
    before = flipped_triangles(images, faces).sum()
    assert before > 10
    again, still = relax_folds(images, faces, held, normal_weight=0.02)
    assert flipped_triangles(again, faces).sum() == still.sum() <= before // 5
    moved = np.linalg.norm(again.positions - images.positions, axis=1)
    assert (moved[held] == 0).all()
    assert (moved > 0).mean() < 0.05


@pytest.mark.parametrize("seed", [3, 4])
def test_unfolding_knows_what_still_folds_however_far_folds_spread(
    shape: tuple[Refinement, float], seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    refinement, scale = shape
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    # A patch sent to another, upside down, cannot be unfolded; where every sweep is kept, folds spread to its border.
    centre, other = positions[np.random.default_rng(seed).choice(len(positions), 2, replace=False)]
    near = np.linalg.norm(positions - centre, axis=1) < 0.12
    wanted = np.where(near[:, None], other - (positions - centre), positions)
    images = SurfacePoints.nearest(surface, wanted)
    monkeypatch.setattr(folds, "_improved", lambda near, inside, before, after: inside)
    again, still = relax_folds(images, faces, np.zeros(0, dtype=np.int64), normal_weight=0.02, rings=(1, 2))
    assert still.sum() > 100
    np.testing.assert_array_equal(still, flipped_triangles(again, faces))


def test_projection_meets_landmarks_wherever_the_fit_left_them(shape: tuple[Refinement, float]) -> None:
    surface = surface_of(shape[0])
    prepared = prepared_at(surface, surface, surface.finest, ElasticConfig())
    pair = Pair.of_vertices(surface, surface, landmarks := np.array([3, 40, 90]), landmarks)
    positions = prepared.on_source.positions
    fitted = positions.copy()
    fitted[landmarks] = positions[np.array([500, 700, 900])]  # far off: the closest triangle does not hold the landmark
    found = project(prepared, fitted, pair.landmarks)
    np.testing.assert_allclose(found.images.positions[landmarks], positions[landmarks], atol=1e-12)
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-12)


def test_interpolants_have_unit_values_and_are_harmonic(shape: tuple[Refinement, float]) -> None:
    refinement, _ = shape
    operators = build_operators(refinement)
    stiffness, mass = operators.stiffness[2], operators.mass[2]
    landmarks = np.array([0, 9, 30, 17])
    harmonic, biharmonic = interpolants(stiffness, mass, landmarks)
    areas = np.asarray(mass.sum(axis=1)).ravel()
    free = np.setdiff1d(np.arange(stiffness.shape[0]), landmarks)
    for values in (harmonic, biharmonic):
        np.testing.assert_allclose(values[landmarks], np.eye(4), atol=1e-8)
        np.testing.assert_allclose(values.sum(axis=1), 1, atol=1e-8)  # constants are reproduced
    scale = abs(stiffness.data).max()
    assert abs(stiffness @ harmonic)[free].max() < 1e-9 * scale
    laplacian = (stiffness @ biharmonic) / areas[:, None]
    assert abs(stiffness @ laplacian)[free].max() < 1e-7 * scale * abs(laplacian).max()
    assert harmonic.min() > -0.05  # the maximum principle, up to the few negative cotangents
    assert landmark_coordinates(stiffness, mass, landmarks).shape == (stiffness.shape[0], 8)


def test_what_cannot_be_fitted_is_refused(shape: tuple[Refinement, float]) -> None:
    refinement, _ = shape
    operators, surface, one = build_operators(refinement), surface_of(refinement), np.array([0])
    with pytest.raises(InvalidLandmarksError, match="repeated"):
        interpolants(operators.stiffness[1], operators.mass[1], np.array([4, 4, 5]))
    prepared = prepared_at(surface, surface, 1, ElasticConfig(coarse_vertices=200))
    problem = FitProblem(prepared, Pair.of_vertices(surface, surface, one, one))
    with pytest.raises(ParameterError, match="one for each coarse vertex"):
        coarse_fit(problem, prepared.rest.graph.positions)
