"""The fit: what it is given, data terms, constraints, coarse graphs, and that a known map is found."""

from collections.abc import Callable

import numpy as np
import pytest
from examples.shapes import creature
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from tests.fixtures.vertex_pairs import pair_at, points_at

from cagemap.deform.config import ElasticConfig, GraphConfig, LandmarkConfig, Stage
from cagemap.deform.data import (
    PlacementConstraints,
    SurfaceSamples,
    curved_points,
    round_trip_weights,
    source_to_target,
)
from cagemap.deform.energy import conjugate_gradients
from cagemap.deform.fit import coarse_fit, fine_fit, landmark_start
from cagemap.deform.graph import ElasticGraph, cluster_graph, connected_cells, mesh_graph
from cagemap.deform.problem import Problem
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.maps.projection.project import map_of_places
from cagemap.maps.quality import measure_quality
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.sparse_algebra import factor
from cagemap.operators import build_operators
from cagemap.pipeline import MatchConfig, prepare_pair, prepare_surface
from cagemap.spectral.zoomout import landmark_coordinates
from cagemap.subdivision import Refinement, refine
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows, triangle_normals, vertex_normals

from elastic_shapes import fitted_map, graph_of, mesh_of, minimised, prepared_at, surface_of, unit_refinement


def test_a_surface_fits_itself_from_a_shaken_start(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, _ = creature_at_3
    surface = surface_of(refinement)
    landmarks = np.arange(0, refinement.levels[0].n_vertices, 3)
    config = ElasticConfig(coarse_vertices=400)
    pair, prepared = pair_at(surface, surface, landmarks, landmarks), prepared_at(surface, surface, 2, config)
    graph, problem = prepared.energy.graph, Problem(prepared, pair.landmarks)
    start = graph.positions + 0.03 * np.random.default_rng(13).standard_normal((graph.n, 3))
    starts = start[problem.coarse_clusters.vertices], landmark_start(problem, problem.coarse_clusters)
    started = [coarse_fit(problem, first) for first in starts]
    found = fine_fit(problem, min(started, key=lambda ended: ended.cost))
    error = np.linalg.norm(found - graph.positions, axis=1)
    assert error.mean() < 0.003  # ten times less than the noise; tangentially only landmarks and the energy hold it
    assert error[landmarks].max() < 1e-4


@pytest.mark.slow
def test_same_shape_other_cage_gives_the_identity(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
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
    pairs = points_at(found.target, found.source, landmarks, landmarks)
    figures = measure_quality(found, pairs)
    assert figures.landmark_errors.max() < 1e-12
    assert figures.flipped_area < 2e-3
    assert figures.coverage > 0.99


def test_what_source_vertices_ask_is_the_sum_over_their_triangles_corners(creature_at_3):
    refinement, scale = creature_at_3
    graph, mesh = graph_of(refinement, scale, 1)
    sheet, split = mesh_of(refinement, scale, 3), mesh.triangles
    samples = SurfaceSamples.at_vertices(sheet, 300)
    assert samples.areas.sum() == pytest.approx(1)
    rng = np.random.default_rng(20)
    positions = graph.positions + 0.01 * rng.standard_normal((graph.n, 3))
    normals = vertex_normals(positions, split)
    closest = graph.positions
    *term, _ = source_to_target(mesh, samples, positions, normals, closest=closest, alpha=1e-4)
    tree = build_tree(positions, split)
    found, weights, _ = closest_points(tree, samples.points, samples.normals, normal_weight=0.03)
    facing = normalize_rows(triangle_normals(positions, split))[found]
    blocks, right, received = np.zeros((graph.n, 3, 3)), np.zeros((graph.n, 3)), np.zeros(graph.n)
    for j, corners in enumerate(split[found]):
        plane, foot = (
            samples.normals[j],
            curved_points(positions[corners][None], normals[corners][None], weights[[j]])[0],
        )
        residual = plane @ (samples.points[j] - foot)
        trip = weights[[j]] @ closest[corners] - samples.points[j]
        trust = round_trip_weights(trip, np.array([residual]), 1e-4)[0]
        share = samples.areas[j] * max(facing[j] @ plane, 0.0) * trust
        for corner, weight in zip(corners, share * weights[j], strict=True):
            blocks[corner] += weight * np.outer(plane, plane)
            right[corner] += weight * (plane @ positions[corner] + residual) * plane
            received[corner] += weight
    assert received.max() > 0
    for found_part, expected in zip(term, (blocks, right, received), strict=True):
        np.testing.assert_allclose(found_part, expected, atol=1e-14)


def test_curved_points_are_exact_on_quadratic_surfaces() -> None:
    rng = np.random.default_rng(18)
    # Corners on z = h (a x^2 + b x y + c y^2); normals to first order in h, so that errors are of its third order.
    for height in (1e-2, 1e-3):
        a, b, c = rng.standard_normal(3)
        flat = rng.standard_normal((40, 3, 2))
        x, y = flat[..., 0], flat[..., 1]
        corners = np.dstack([x, y, height * (a * x * x + b * x * y + c * y * y)])
        normals = normalize_rows(
            np.dstack([-height * (2 * a * x + b * y), -height * (b * x + 2 * c * y), np.ones_like(x)])
        )
        weights = rng.dirichlet(np.ones(3), 40)
        x, y, z = curved_points(corners, normals, weights).T
        sag = height * (a * x * x + b * x * y + c * y * y) - np.einsum("mk,mk->m", weights, corners[..., 2])
        error = height * (a * x * x + b * x * y + c * y * y) - z
        assert abs(sag).max() > 0.1 * height
        assert abs(error).max() < 200 * height**3


def fitted_from(
    refined: tuple[Refinement, float], start: Callable[[ElasticGraph], FloatArray], stage: Stage
) -> FloatArray:
    """The creature's level 2 fitted onto itself from a start, with every sixth control vertex held."""
    graph, sheet = graph_of(*refined, 2)
    landmarks = np.arange(0, refined[0].levels[0].n_vertices, 6)
    held = PlacementConstraints(CagePoints.of_vertices(landmarks), graph.positions[landmarks])
    return minimised(graph, sheet, sheet, start(graph), held, stage)


@pytest.mark.slow
def test_momentum_gets_as_far_in_half_the_iterations(creature_at_3: tuple[Refinement, float]) -> None:
    graph, _ = graph_of(*creature_at_3, 2)
    # Slide the surface along itself, smoothly: only the energy and the landmarks can bring it back.
    x, y, z = graph.positions.T
    slide = 0.04 * np.column_stack([np.sin(5 * y), np.sin(5 * z), np.sin(5 * x)])
    slide -= np.einsum("nd,nd->n", slide, graph.normals)[:, None] * graph.normals

    def error(iterations: int, momentum: float) -> float:
        stage = Stage(iterations, (1e-4, 1e-4), 3e-4, momentum=momentum)
        found = fitted_from(creature_at_3, lambda graph: graph.positions + slide, stage)
        return float(np.linalg.norm(found - graph.positions, axis=1).mean())

    assert error(8, 0.8) < error(16, 0.0) < np.linalg.norm(slide, axis=1).mean()


@pytest.mark.slow
def test_steps_with_the_factors_of_an_earlier_iteration_end_at_the_same_place(creature_at_3):
    def start(graph: ElasticGraph) -> np.ndarray:
        return graph.positions + 0.02 * np.sin(7 * graph.positions[:, [1, 2, 0]])

    def ended(factored: int) -> np.ndarray:
        return fitted_from(creature_at_3, start, Stage(12, (1e-3, 1e-4), 3e-4, momentum=0.8, factored=factored))

    exact = ended(1)
    moved = np.linalg.norm(exact - start(graph_of(*creature_at_3, 2)[0]), axis=1).mean()
    # Measured 0.12 %; with one gradient a step 2.1 %.
    assert np.linalg.norm(ended(4) - exact, axis=1).mean() < 0.01 * moved


def test_a_step_ends_where_nothing_is_left_to_miss() -> None:
    """Factors of the matrix itself: one gradient solves it, and the next would divide by zero."""
    matrix, right = sparse.csc_array(2.0 * sparse.eye_array(15)), np.ones(15)
    factors, stage = factor(matrix), Stage(1, (1.0, 1.0), 1.0)
    np.testing.assert_allclose(conjugate_gradients(matrix, factors, stage, right), 0.5 * right, rtol=1e-12)
    np.testing.assert_array_equal(conjugate_gradients(matrix, factors, stage, 0.0 * right), 0.0)


def test_a_step_with_factors_of_another_matrix_is_solved_all_the_same():
    """Four conjugate gradients leave nearly all of the residual, and the fit would go astray unseen."""
    rng = np.random.default_rng(5)
    chain = 2.0 * np.eye(120) - np.eye(120, k=3) - np.eye(120, k=-3)
    weights = np.repeat(10.0 ** rng.uniform(0, 6, 40), 3)
    matrix, other = (sparse.csc_array(chain + np.diag(diagonal)) for diagonal in (weights, weights[::-1]))
    right = matrix @ rng.standard_normal(120) / 10.0 ** rng.uniform(0, 6, 120)
    found = conjugate_gradients(matrix, factor(other), Stage(1, (1.0, 1.0), 1.0), right)
    np.testing.assert_allclose(matrix @ found, right, atol=1e-9 * np.abs(right).max())


def test_counts_of_a_stage_are_checked() -> None:
    for wrong in ({"iterations": 0}, {"iterations": 3, "factored": 0}, {"iterations": 3, "patience": -1}):
        with pytest.raises(ParameterError, match=f"{list(wrong)[-1]}: expected"):
            Stage(**{"stiffness": (1e-3, 1e-4), "smoothing": 1e-3} | wrong)


@pytest.mark.slow
def test_patience_ends_as_soon_as_nothing_folds(creature_at_3: tuple[Refinement, float]) -> None:
    def found(patience: int) -> np.ndarray:
        stage = Stage(3, (1e-3, 1e-4), 3e-4, patience=patience)
        return fitted_from(creature_at_3, lambda graph: graph.positions + 0.01 * graph.normals, stage)

    np.testing.assert_array_equal(found(5), found(0))
    np.testing.assert_array_equal(Stage(3, (1e-3, 1e-4), 3e-4, patience=2).ramped()[3:], 1e-4)


@pytest.mark.slow
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
    pair = pair_at(
        surface_of(refine(source.with_positions(positions), 2)),
        surface_of(refine(source, 2)),
        np.concatenate([body, leg_fronts(-0.5)]),
        np.concatenate([body, leg_fronts(0.5)]),
    )
    config = ElasticConfig()
    prepared = prepared_at(pair.target, pair.source, 2, config)
    problem = Problem(prepared, pair.landmarks)
    fitted = fine_fit(problem, coarse_fit(problem, landmark_start(problem, problem.coarse_clusters)))
    found = map_of_places(problem, fitted)
    assert measure_quality(found).flipped_area < 1e-4


def test_what_cannot_be_fitted_is_refused(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, _ = creature_at_3
    operators, surface, one = build_operators(refinement), surface_of(refinement), np.array([0])
    with pytest.raises(InvalidLandmarksError, match="repeated"):
        landmark_coordinates(operators.stiffness[1], operators.mass[1], np.array([4, 4, 5]))
    prepared = prepared_at(surface, surface, 1, ElasticConfig(coarse_vertices=200))
    problem = Problem(prepared, pair_at(surface, surface, one, one).landmarks)
    with pytest.raises(ParameterError, match="one for each coarse vertex"):
        coarse_fit(problem, prepared.energy.graph.positions)


TARGET, SOURCE = np.array([40, 3, 17]), np.array([41, 5, 16])


@pytest.fixture(scope="module")
def problem() -> Problem:
    body = prepare_surface(creature(), 2)
    return Problem(prepare_pair(body, body), pair_at(body, body, TARGET, SOURCE).landmarks)


def test_held_vertices_come_first_each_with_its_place(problem: Problem) -> None:
    places = problem.prepared.source.finest_triangles.positions
    clusters = problem.clusters_with((np.array([60, 9]), np.array([61, 8])))
    np.testing.assert_array_equal(clusters.vertices[:5], [*TARGET, 60, 9])
    np.testing.assert_array_equal(clusters.constraints.anchors.corners[:, 0], np.arange(5))
    np.testing.assert_array_equal(clusters.constraints.places, places[[*SOURCE, 61, 8]])
    np.testing.assert_array_equal(problem.coarse_clusters.vertices[:3], TARGET)
    np.testing.assert_array_equal(problem.constraints.anchors.corners[:, 0], TARGET)
    np.testing.assert_array_equal(problem.constraints.places, places[SOURCE])


def test_problems_made_of_one_keep_what_they_do_not_change(problem: Problem) -> None:
    few = problem.without([1])
    assert few.prepared is problem.prepared
    np.testing.assert_array_equal(few.landmark_vertices, (TARGET[[0, 2]], SOURCE[[0, 2]]))
    back = problem.reverse_problem
    assert back.prepared is problem.prepared.reverse_pair
    np.testing.assert_array_equal(back.landmark_vertices, (SOURCE, TARGET))
    stage = Stage(3, (1.0, 1e-2), 1e-2)
    small = problem.clusters_with(stage=stage, count=100)
    assert small.stage is stage
    assert 90 < small.energy.graph.n < 110 < problem.coarse_clusters.energy.graph.n
    assert problem.clusters_with(stage=stage).energy.graph.n == problem.coarse_clusters.energy.graph.n


def test_maps_of_clusters_are_factored_at_first_use(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """An update of a map has no use for them."""
    monkeypatch.setattr("cagemap.deform.energy.factor", lambda *_: pytest.fail("factored"))
    clusters = problem.clusters_with(count=100).with_stage(Stage(3, (1.0, 1e-2), 1e-2))
    with pytest.raises(pytest.fail.Exception, match="factored"):
        clusters.energy.maps(clusters.energy.graph.positions)


def test_distances_of_landmarks_are_measured_on_the_configured_graph(problem: Problem) -> None:
    body = problem.prepared.target
    # Tiny pieces of cells are not joined, so there are more clusters than asked for.
    config = ElasticConfig(landmarks=LandmarkConfig(distance_vertices=100), graph=GraphConfig(joining_rounds=0))
    own = Problem(prepare_pair(body, body, MatchConfig(elastic=config)), problem.landmarks)
    for distances in own.landmark_distances:
        assert distances.shape[0] == len(TARGET)
        assert 115 < distances.shape[1] < 130


TURNS = 4.0
PITCH = 0.004  # between the turns of the ramp, of sqrt(area): far below a cell's width, with like normals


def ramp() -> tuple[ElasticGraph, np.ndarray]:
    """A ribbon wound up like a spiral ramp, at unit area, and the angle of every vertex."""
    around, across = 161, 6
    angle, radius = np.meshgrid(np.linspace(0, TURNS * 2 * np.pi, around), np.linspace(1.0, 1.5, across), indexing="ij")
    area = np.pi * (1.5**2 - 1.0**2) * TURNS
    height = PITCH * np.sqrt(area) * angle / (2 * np.pi)
    positions = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).reshape(-1, 3)
    corner = (np.arange(around - 1)[:, None] * across + np.arange(across - 1)).ravel()
    quads = np.stack([corner, corner + across, corner + across + 1, corner + 1], axis=1)
    triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return mesh_graph(TriangleSurface(positions / np.sqrt(area), triangles), quads), angle.ravel()


def distances_from(graph: ElasticGraph, vertex: int) -> np.ndarray:
    lengths = np.linalg.norm(graph.edges, axis=1)
    edges = sparse.csr_array((lengths, (graph.heads, graph.tails)), shape=(graph.n, graph.n))
    return np.asarray(dijkstra(edges, indices=[vertex]))[0]


def test_ways_on_the_coarse_graph_do_not_jump_where_parts_touch() -> None:
    fine, angle = ramp()
    coarse, vertices = cluster_graph(fine, 150, np.array([0, fine.n - 1]))
    # The ends lie above each other, a hundredth apart, and four turns of radius 1 or more away from each other.
    assert distances_from(coarse, 0)[1] > 0.9 * distances_from(fine, 0)[-1]
    turned = np.abs(angle[vertices][coarse.heads] - angle[vertices][coarse.tails])
    assert turned.max() < np.pi / 2


def test_cells_are_connected_cover_all_and_none_is_tiny() -> None:
    fine, _ = ramp()
    rng = np.random.default_rng(5)
    given = rng.integers(0, 40, fine.n)  # cells that are anything but connected
    cell = connected_cells(fine, given)
    assert set(cell) == set(range(cell.max() + 1))
    inside = cell[fine.heads] == cell[fine.tails]
    within = sparse.coo_array((np.ones(inside.sum()), (fine.heads[inside], fine.tails[inside])), shape=(fine.n,) * 2)
    assert connected_components(within, directed=False)[0] == cell.max() + 1
    areas = np.bincount(cell, fine.areas)
    assert (areas < GraphConfig.min_cell * areas.mean()).mean() < 0.02


def test_cells_that_are_connected_and_large_stay_as_they_are() -> None:
    fine, angle = ramp()
    given = (angle / (TURNS * 2 * np.pi / 19.999)).astype(np.int64)
    cell = connected_cells(fine, given)
    assert len(np.unique(np.column_stack([given, cell]), axis=0)) == len(np.unique(given)) == cell.max() + 1
