"""The whole method: levels chosen, identity found again, landmarks met, ground truth on real humans."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.truth import compare_with_truth, true_map
from examples import shapes
from tests.fixtures.vertex_pairs import pair_at

from cagemap import (
    BasisConfig,
    ControlMesh,
    ElasticConfig,
    Landmarks,
    Masks,
    MatchConfig,
    choose_level,
    match,
    match_pair,
    prepare_pair,
    prepare_surface,
    read_landmarks,
    read_mesh,
    refine,
    research,
    update_match,
)
from cagemap.deform.config import StartConfig
from cagemap.errors import InvalidLandmarksError, InvalidMeshError, ParameterError
from cagemap.maps.pair import near_vertices
from cagemap.mesh import CatmullClark, Loop, Plain
from cagemap.paper.method import finer_level_pairs, search_levels
from cagemap.pipeline import pair_of
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

from example_once import example_pair
from plain_meshes import marks_at, renumbered
from quick_match import QUICK
from refusals import refuses

BASIS = BasisConfig(count=60)


@pytest.fixture(scope="module")
def pony():
    return example_pair(texture_size=64).source


def landmarks_of(mesh: ControlMesh, new_number: np.ndarray, count: int = 12) -> Landmarks:
    vertices = np.linspace(0, mesh.n_vertices - 1, count).astype(np.int64)
    names = tuple(f"point {i}" for i in range(count))
    return Landmarks(names, new_number[vertices], vertices, "target.obj", "source.obj")


@pytest.mark.parametrize("shape", [shapes.creature, shapes.icosahedron, lambda: shapes.grid(4, 3), shapes.pyramid])
def test_chosen_level_is_the_first_with_enough_vertices(shape):
    """`choose_level` counts vertices without refining; refining must agree."""
    mesh = shape()
    refinement = refine(mesh, 4)
    for wanted in (1, 60, 300, 1500):
        enough = [i for i, level in enumerate(refinement.levels) if i > 0 and level.n_vertices >= 0.75 * wanted]
        if enough:
            assert choose_level(mesh, wanted) == enough[0]
    refuses(ParameterError, "vertices: expected", choose_level, mesh, 0)


def test_chosen_level_depends_on_the_scheme():
    """Catmull-Clark makes a quad of every corner of a triangle, Loop a quarter of the triangle."""
    mesh = shapes.icosahedron()
    for scheme in (CatmullClark(), Loop()):
        sizes = [level.n_vertices for level in refine(mesh, 4, scheme).levels]
        for level in (1, 2, 3, 4):
            assert choose_level(replace(mesh, scheme=scheme), sizes[level]) == level
    assert choose_level(replace(mesh, scheme=CatmullClark()), 60) < choose_level(mesh, 60)


@pytest.mark.slow
def test_a_relabelled_copy_is_found_again(pony):
    """Vertices in another order: the map is the relabelling, as the spectral embeddings agree up to rounding."""
    copy, new_number = renumbered(pony, 61)
    source = prepare_surface(pony, 2, BASIS)
    target = prepare_surface(copy, 2, BASIS)
    found = match(target, source, landmarks_of(pony, new_number), MatchConfig(method="hfm"))
    image = found.point_map.pull_back(source.refinement.finest.positions)
    errors = np.linalg.norm(image - target.refinement.finest.positions, axis=1) * source.operators.scale
    spacing = 1.0 / np.sqrt(source.refinement.finest.n_vertices)
    assert errors.mean() < 0.1 * spacing
    assert found.quality.flipped_area < 0.003  # nearest points are not unfolded
    assert found.quality.coverage > 0.99
    np.testing.assert_allclose(found.functional_map[:8, :8].T @ found.functional_map[:8, :8], np.eye(8), atol=0.05)


@pytest.mark.slow
def test_added_landmarks_move_the_map_to_them_at_once():
    cage = shapes.creature()
    x, y, z = (cage.positions / np.ptp(cage.positions)).T
    bent = cage.with_positions(np.column_stack([x * (1 + 0.4 * z), y + 0.3 * z**2, z * (1 + 0.4 * x)]))
    target, source = prepare_surface(cage, 1, BASIS), prepare_surface(bent, 1, BASIS)
    truth = source.refinement.finest.positions

    def errors(result):
        image = result.point_map.pull_back(truth)
        return np.linalg.norm(image - truth, axis=1) * source.operators.scale

    few = np.linspace(0, cage.n_vertices - 1, 6).astype(np.int64)
    config = MatchConfig()
    before = match(target, source, marks_at(few), config)
    worst = np.argsort(-errors(before)[: cage.n_vertices])[:3]
    more = np.append(few, np.setdiff1d(worst, few))
    updated = update_match(before, marks_at(more), config)
    again = match(target, source, marks_at(more), config)
    assert updated.quality.landmark_errors.max() < 1e-12
    assert errors(updated)[more].max() < 1e-12
    assert errors(updated).mean() < 0.9 * errors(before).mean()
    assert errors(updated).mean() < 1.3 * errors(again).mean()  # it bends the map that is there: 1.15 measured
    assert updated.quality.flipped_area < before.quality.flipped_area + 2e-3
    same = update_match(before, marks_at(few), config)
    assert abs(errors(same) - errors(before)).mean() < 0.05 * errors(before).mean()  # projected once more, no more


@pytest.mark.slow
def test_a_prepared_pair_is_matched_as_it_was_prepared_or_not_at_all():
    surface = prepare_surface(shapes.creature(), 1, BASIS)
    marks = landmarks_of(surface.control, np.arange(surface.control.n_vertices))
    own = MatchConfig(
        start=StartConfig(search_vertices=100),
        elastic=ElasticConfig(coarse_vertices=100),
        masks=Masks(target=np.linspace(0.5, 1.0, len(surface.vertices))),
    )
    plain, masked = prepare_pair(surface, surface), prepare_pair(surface, surface, own)
    for prepared, config, fault in (
        (plain, MatchConfig(method="paper"), "expected the method elastic, got 'paper'; use cagemap.match"),
        (masked, MatchConfig(method="hfm"), "expected the method elastic"),
        (plain, replace(own, masks=Masks()), "start and elastic that the pair was prepared with"),
        (plain, MatchConfig(masks=own.masks), "the masks that"),
        (masked, replace(own, masks=own.masks.reversed()), "the masks that"),
        (masked, replace(own, elastic=ElasticConfig(coarse_vertices=50)), "the elastic that"),
    ):
        refuses(ParameterError, fault, match_pair, prepared, marks, config)
    found = match_pair(masked, marks, own)
    for config in (MatchConfig(), replace(own, masks=Masks(target=own.masks.target.copy()))):
        np.testing.assert_array_equal(match_pair(masked, marks, config).image(), found.image())


@pytest.mark.slow
def test_levels_are_walked_down_together(pony):
    """Each step moves each side by at most one level, ends at both finest levels, and never backwards."""
    source, target = prepare_surface(pony, 3, BASIS), prepare_surface(shapes.creature(), 2, BasisConfig(count=20))
    nothing = np.zeros(0, dtype=np.int64)
    steps = [(0, 0), *finer_level_pairs(pair_at(target, source, nothing, nothing), (0, 0))]
    assert steps[-1] == (2, 3)
    moves = np.diff(steps, axis=0)
    assert moves.min() >= 0
    assert moves.max() == 1
    assert np.all(moves.sum(axis=1) > 0)


@pytest.mark.slow
def test_levels_without_functions_are_not_searched():
    """A level may have vertices enough and yet no functions: a tight tolerance leaves them to finer levels."""
    surface = prepare_surface(shapes.creature(), 2, BasisConfig(schedule=(1, 2, 57)))
    assert search_levels(surface, surface, 100) == (2, 2)
    usual = prepare_surface(shapes.creature(), 2, BasisConfig(schedule=(50, 10)))
    assert search_levels(usual, surface, 100) == (0, 2)
    assert search_levels(usual, usual, 100, 10**6) == (0, usual.finest_level)


def test_wrong_input_is_refused_before_anything_expensive(pony):
    with pytest.raises(InvalidMeshError):
        prepare_surface(ControlMesh.from_faces(pony.positions, [[0, 1, 2]] * 3), 2)
    refuses(ParameterError, "level: expected 1 to", prepare_surface, pony, 0)
    refuses(ParameterError, "method: expected one of elastic, hfm, paper, got 'magic'", MatchConfig, method="magic")
    surface = prepare_surface(shapes.creature(), 1, BasisConfig(count=10))
    outside = Landmarks(("a", "b", "c"), np.array([0, 1, 9999]), np.array([0, 1, 2]), "t.obj", "s.obj")
    refuses(InvalidLandmarksError, "9999", match, surface, surface, outside)


def test_landmarks_that_leave_no_vertex_free_are_refused():
    surface = prepare_surface(shapes.cube(), 1, BasisConfig(count=5))
    finest, count = surface.finest_triangles, 4 * len(surface.vertices)
    between = np.random.default_rng(2).dirichlet(np.ones(3), count)
    points = SurfacePoints(finest, np.arange(count) % len(finest.triangles), between)
    words = "landmarks: expected at most 26 on a level of as many vertices, got 104. Give fewer, or refine once"
    refuses(ParameterError, words, near_vertices, points, surface)


def test_symmetries_of_a_plain_mesh_are_refused():
    plain = prepare_surface(replace(shapes.icosahedron(), scheme=Plain()), 0, BasisConfig(count=5))
    config = MatchConfig(method="paper", symmetries=((np.arange(12), np.arange(12)),))
    words = r"symmetries: a plain mesh \(scheme none\) takes no symmetries.*Leave them out"
    refuses(ParameterError, words, pair_of, plain, plain, Landmarks.none(), config)


@pytest.mark.slow
def test_ground_truth_on_humans(shared_data):
    """Mean error x100 of sqrt(area) of `hfm`, 25k vertices; promises/test_accuracy_guards.py has the usual method."""
    humans, names = shared_data / "humans", ("male1591", "female1605")
    landmarks, _ = read_landmarks(humans / "landmarks" / "female1605__male1591_fps14.json", *names)
    shapes_of = zip(names, ("female_old_heavy", "male_young"), strict=True)
    target, source = (prepare_surface(read_mesh(humans / f"{name}_{shape}.obj"), 2) for name, shape in shapes_of)
    neutral = (refine(read_mesh(humans / f"{name}_neutral.obj"), 2).finest for name in names)
    truth = true_map(*(TriangleSurface.from_faces(one.positions, one.faces) for one in neutral))
    found = match(target, source, landmarks, MatchConfig(method="hfm"))
    assert 100 * compare_with_truth(found.point_map, truth).mean <= 3.1  # 1.59 with all improvements of the paper's


@pytest.mark.slow
def test_a_result_can_be_pickled_and_copied():
    """Worker processes return results by pickle: factorisations stay behind, and are made again where needed."""
    mesh = shapes.creature()
    marks = landmarks_of(mesh, np.arange(mesh.n_vertices))
    taller = mesh.with_positions(mesh.positions * [1.0, 1.2, 1.0])
    found = match(prepare_surface(mesh, 1), prepare_surface(taller, 1), marks, QUICK)
    for other in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert np.array_equal(other.point_map.triangle, found.point_map.triangle)
        assert np.array_equal(other.spectral.functional_map, found.spectral.functional_map)
        assert update_match(other, marks).landmark_errors.max() < 1e-9


def test_a_pair_can_be_pickled_and_copied():
    """In a worker process a step meets landmarks and triangles that are equal, not the same."""
    mesh = shapes.creature()
    surface = prepare_surface(mesh, 1)
    pair = pair_of(surface, surface, np.repeat(np.arange(0, mesh.n_vertices, 9)[:, None], 2, axis=1))
    start = np.arange(len(surface.vertices))
    expected = research.elastic(pair, start)
    for other in (pickle.loads(pickle.dumps(pair)), copy.deepcopy(pair)):
        found = research.elastic(other, start)
        np.testing.assert_array_equal(found.triangle, expected.triangle)
        np.testing.assert_array_equal(found.barycentric, expected.barycentric)
    moved = TriangleSurface(2.0 * surface.finest_triangles.positions, surface.finest_triangles.triangles)
    others = SurfacePoints.from_vertices(moved, np.array([3]))
    refuses(ParameterError, "points of another surface", expected.images.replaced, np.array([0]), others)
