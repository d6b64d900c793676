"""The researcher's page runs, and the short names of `cagemap.research` do what they say."""

import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from examples import shapes
from tensor import Tensor

from cagemap import research
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.example import ExamplePair
from cagemap.files.result.folder import read_result, write_result
from cagemap.maps.pair import Pair, PointPairs, locate
from cagemap.maps.point_map import PointMap
from cagemap.mesh import Plain
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.spectral import BasisConfig
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

from locations import ROOT
from plain_meshes import far_apart, marks_at
from refusals import refuses

PAGE = ROOT / "docs" / "researchers.md"
BASIS = BasisConfig(schedule=(20, 10))


@pytest.mark.slow
def test_every_block_of_the_page_runs(tmp_path, monkeypatch, quick_fit):
    """In order, in one namespace, as a reader would paste them; on a smaller pair."""
    monkeypatch.chdir(tmp_path)
    mesh = shapes.creature()
    marks = far_apart(mesh.positions, 8)
    landmarks = marks_at(marks)
    pair = ExamplePair(mesh, mesh.with_positions(mesh.positions * (1.0, 1.2, 1.0)), landmarks, np.zeros((8, 8, 3)))
    monkeypatch.setattr("cagemap.example.example_pair", lambda size: pair)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"researchers.md, block {number}", "exec"), names)
    assert len(blocks) == 6
    assert read_result(tmp_path / "RESULT").functional_map.shape == (80, 80)


@pytest.mark.slow
def test_the_commands_of_table_1_run(shared_data, tmp_path, run):
    block = re.search(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL).group(1)
    commands = re.findall(r"^cagemap (.*)$", block.replace("\\\n", ""), re.MULTILINE)
    places = {path.name: str(path) for path in [*shared_data.rglob("*.obj"), *shared_data.rglob("*.json")]}
    assert len(commands) == 3
    for number, command in enumerate(commands):
        words = [places.get(word, word) for word in shlex.split(re.sub(r"level([ =])[34]", r"level\g<1>1", command))]
        words = [re.sub(r"(schedule=\d+,\d+),.*", r"\1", word) for word in words]
        words[words.index("--output") + 1] = str(tmp_path / str(number))
        run.done(*words)
        assert [one.levels for one in read_result(tmp_path / str(number)).level_maps] == [(0, 0), (1, 1)]


@pytest.fixture(scope="module")
def itself():
    """The creature and itself: every map is the identity."""
    surface = research.prepare(shapes.creature(), 1, BASIS)
    chosen = np.arange(0, surface.control.n_vertices, 7)
    return research.make_pair(surface, surface, np.column_stack([chosen, chosen]))


def test_meshes_come_in_many_forms():
    mesh = shapes.cube()
    faces = [mesh.face(i) for i in range(mesh.n_faces)]

    class Trimesh:
        vertices, faces = mesh.positions, np.array([mesh.face(i) for i in range(mesh.n_faces)])

    for given in (mesh, (mesh.positions, faces), Trimesh()):
        np.testing.assert_array_equal(research.control_mesh(given).face_indices, mesh.face_indices)
    with pytest.raises(ParameterError, match="object with vertices and faces or triangles, got int"):
        research.control_mesh(3)


def test_the_identity_is_found_from_constraints_and_transports_functions(itself):
    constraints = research.gather_constraints(itself)
    found = research.functional_map(itself, constraints, research.ConstraintConfig(decay=0.0))
    np.testing.assert_allclose(found, np.eye(30), atol=1e-6)
    values = itself.source.basis.at(1) @ np.arange(30.0)
    np.testing.assert_allclose(research.transport(itself, found, values, 1, 1), values, atol=1e-4)
    points = research.point_map(itself, found)
    away = np.linalg.norm(points.images.positions - itself.source.triangles(1).positions, axis=1)
    assert away.max() < 1e-3
    np.testing.assert_allclose(research.functional_map_of(itself, points), np.eye(30), atol=1e-2)


def test_landmark_functions_are_columns_of_the_descriptor_matrix(itself):
    """K~ delta_v with K~ = Phi~ rho(Lambda~) Phi~^T, which is never made otherwise (Definition 3)."""
    surface = itself.target
    filters = research.heat_and_wave_filters(surface, surface, heat=2, wave=0)
    phi, eigenvalues = research.eigenfunctions(surface, 1)
    found = research.landmark_functions(surface, filters, [4], 1)
    for j, rho in enumerate(filters.at(eigenvalues).T):
        np.testing.assert_allclose(found[:, j], (phi * rho) @ phi[4], rtol=1e-9, atol=1e-12)


def test_a_level_without_functions_has_descriptors_of_zero():
    surface = research.prepare(shapes.cube(), 2, BasisConfig(schedule=(0, 0, 8)))
    filters = research.heat_and_wave_filters(surface, surface, heat=2, wave=1)
    coarse, count = surface.refinement.levels[0].n_vertices, 3
    np.testing.assert_array_equal(research.signature_functions(surface, filters, 0), np.zeros((coarse, count)))
    found = research.landmark_functions(surface, filters, [1, 4], 0)
    np.testing.assert_array_equal(found, np.zeros((coarse, 2 * count)))


def test_what_does_not_fit_is_refused(itself):
    filters = research.heat_and_wave_filters(itself.target, itself.source)
    assert (len(filters.times), len(filters.energies)) == (10, 20)
    with pytest.raises(ParameterError, match="expected a level from 0 to 1, got 2"):
        research.signature_functions(itself.target, filters, 2)
    with pytest.raises(ParameterError, match="at most"):
        research.point_map(itself, np.eye(40))
    with pytest.raises(ParameterError, match="has 20 of 30 functions"):
        research.transport(itself, np.eye(30), itself.source.basis.at(1)[:, 0], 1, 0)
    with pytest.raises(ParameterError, match="expected whole numbers"):
        research.make_pair(itself.target, itself.source, ((1, 2), (1,)))
    for start in (
        np.arange(7),
        np.full((5, 5), np.nan),
        np.zeros((0, 0)),
        np.full(itself.target.control.n_vertices, -1),
    ):
        with pytest.raises(ParameterError, match="map: expected"):
            research.paper_map(itself, start=start)
    backwards = np.arange(itself.target.control.n_vertices)[::-1]
    with pytest.raises(ParameterError, match="pairs of arrays"):
        research.make_pair(itself.target, itself.source, symmetries=(backwards,))
    with pytest.raises(ParameterError, match="image of each of the"):
        research.make_pair(itself.target, itself.source, symmetries=((backwards, backwards[:-1]),))
    plain = research.prepare(replace(shapes.cube(), scheme=Plain()), 0, BasisConfig(count=4, vertices=None))
    with pytest.raises(ParameterError, match="symmetries: a plain mesh"):
        research.make_pair(plain, plain, symmetries=((np.arange(8), np.arange(8)),))
    coarse = itself.source.triangles(0)
    other = PointMap.from_vertices(itself.target.finest_triangles, coarse, np.zeros(len(itself.target.vertices), int))
    with pytest.raises(ParameterError, match=r"the finest of the pair, got .* belongs to another level"):
        research.result_of_map(itself, other)


def test_arrays_of_another_shape_and_nan_are_refused_by_name(itself):
    target, constraints = itself.target, research.gather_constraints(itself)
    vertices, values = target.control.n_vertices, target.basis.at(1)
    nan, eye = np.nan, np.eye(30)
    refuses(InvalidLandmarksError, "array .2, 3.*Transpose", research.make_pair, target, target, np.zeros((2, 3), int))
    assert TriangleSurface.from_faces(np.eye(3).tolist(), [[0, 1, 2]]).n == 3
    for given in (np.ones(30), np.ones((29, 2)), np.ones((30, 2)) * nan):
        refuses(ParameterError, "^target descriptors: expected", constraints.with_descriptors, given, np.ones((30, 2)))
    refuses(ParameterError, "^operators: expected finite", constraints.with_operators, eye * nan, eye)
    refuses(ParameterError, "map: expected", research.transport, itself, np.ones(30), values[:, 0], 1, 1)
    refuses(ParameterError, "map: expected", research.to_bases, itself, np.eye(31), values, values)
    refuses(ParameterError, "map: expected finite", research.from_bases, itself, eye * nan, values, values)
    refuses(ParameterError, "functions: expected finite", research.from_bases, itself, eye, values * nan, values)
    refuses(ParameterError, "functions: expected finite", target.basis.project, np.full(vertices, nan), 0)
    for chosen in (np.arange(vertices) < 3, [0.5]):
        refuses(ParameterError, "vertices: expected whole numbers", target.basis.rows, 0, chosen)
    np.testing.assert_array_equal(target.basis.rows(0, [1, 2]), target.basis.at(0)[1:3])


@pytest.mark.parametrize("kind", ["array of pairs", "list of pairs", "Landmarks"])
def test_make_pair_takes_the_landmarks_that_match_takes(itself, kind):
    sides = np.array([3, 9]), np.array([4, 8])  # also where (2, p) and (p, 2) have one shape
    given = {
        "array of pairs": np.column_stack(sides),
        "list of pairs": np.column_stack(sides).tolist(),
        "Landmarks": Landmarks(("a", "b"), *sides),
    }
    pair = research.make_pair(itself.target, itself.source, given[kind])
    np.testing.assert_array_equal(pair.target_landmarks, sides[0])
    np.testing.assert_array_equal(pair.source_landmarks, sides[1])
    assert pair.landmarks.names == (("a", "b") if kind == "Landmarks" else ("point 0", "point 1"))


def test_operators_are_taken_where_coarse_levels_have_no_functions(recwarn):
    surface = research.prepare(shapes.creature(), 1, BasisConfig(count=12))
    vertices = np.arange(0, 40, 5)
    pair = research.make_pair(surface, surface, np.column_stack([vertices, vertices]))
    constraints = research.gather_constraints(pair).with_operators(np.eye(12), np.eye(12))
    found = research.functional_map(pair, constraints, research.ConstraintConfig(decay=0.0))
    np.testing.assert_allclose(found, np.eye(12), atol=1e-6)
    assert not recwarn.list


def test_a_result_with_landmarks_between_vertices_is_written_and_read(itself, tmp_path):
    surface = itself.target
    finest = surface.triangles(1)
    triangle, weights = np.array([3, 40, 3, 3]), np.full((4, 3), 1 / 3)
    weights[2:] = [[0.6, 0.4, 0.0], [1.0, 0.0, 0.0]]
    points = SurfacePoints(finest, triangle, weights)
    fine_vertex, control_vertex = (SurfacePoints.from_vertices(finest, [v]) for v in (finest.n - 1, 5))
    points = SurfacePoints(
        finest,
        np.concatenate([points.triangle, fine_vertex.triangle, control_vertex.triangle]),
        np.vstack([points.barycentric, fine_vertex.barycentric, control_vertex.barycentric]),
    )
    pair = Pair(surface, surface, PointPairs(points, points))
    identity = PointMap.from_vertices(finest, finest, np.arange(finest.n))
    write_result(tmp_path / "RESULT", research.result_of_map(pair, identity))
    read = read_result(tmp_path / "RESULT")
    for side in (read.landmarks.target_points, read.landmarks.source_points):
        # The inverse of `locate` is iterated; 2e-3 of sqrt(area) is a fortieth of an edge of the control mesh.
        np.testing.assert_allclose(locate(surface.finest_triangles, side).positions, points.positions, atol=2e-3)
        assert side.vertices[-1] == 5
    np.testing.assert_allclose(read.landmark_errors, 0.0, atol=1e-12)
    assert len(research.result_of_map(research.make_pair(surface, surface), identity).landmarks) == 0
    with pytest.raises(ParameterError, match="one for each of the pair's 6 landmarks, got 2"):
        research.result_of_map(pair, identity, ("nose", "ear"))


@pytest.mark.parametrize("method", [research.paper_map, research.hfm_map])
def test_a_start_may_be_of_any_size_or_a_vertex_map(itself, method):
    """The creature and itself: every start is the identity, of few functions, of all, or of vertices."""
    finest = itself.target.triangles(1)
    level_0 = itself.target.control.n_vertices
    for start in (np.eye(10), np.eye(12, 15), np.eye(30), np.arange(finest.n), list(range(level_0))):
        _, found = method(itself, start=start)
        away = np.linalg.norm(found.images.positions - finest.positions, axis=1)
        assert np.median(away) < 1e-3
    rolled = np.roll(np.arange(level_0), 5)  # another map gives another answer
    maps, _ = research.paper_map(itself, research.PaperConfig(rounds=0), start=rolled)
    assert np.abs(maps[0].functional_map - np.eye(20)).max() > 0.3


def test_symmetries_of_a_pair_are_kept(itself):
    image = mirror_symmetries(itself.target.control)[0].image
    pair = research.make_pair(itself.target, itself.source, symmetries=[[Tensor(image), image.tolist()]])
    for kept in pair.symmetries[0]:
        np.testing.assert_array_equal(kept, image)
    assert len(research.gather_constraints(pair).target.operators) > 0


def test_tensors_are_taken_as_arrays_are(itself):
    mesh = shapes.cube()
    faces = np.array([mesh.face(i) for i in range(mesh.n_faces)])
    built = research.control_mesh((Tensor(mesh.positions), Tensor(faces)))
    np.testing.assert_array_equal(built.face_indices, mesh.face_indices)
    surface, n = itself.source, itself.source.triangles(1).n
    values, matrix = surface.basis.at(1)[:, :4], np.eye(30)
    constraints = research.gather_constraints(itself)
    columns = surface.basis.project(values, level=1)
    calls = (
        lambda of: surface.basis.project(of(values), level=1),
        lambda of: research.transport(itself, of(matrix), of(values), 1, 1),
        lambda of: research.point_map(itself, of(matrix)).barycentric,
        lambda of: PointMap.from_vertices(surface.triangles(1), surface.triangles(1), of(np.arange(n))).triangle,
        lambda of: research.point_map(itself, matrix).pull_back(of(values)),
        lambda of: constraints.with_descriptors(of(columns), of(columns)).target.descriptors,
        lambda of: constraints.with_operators(of(matrix), of(matrix)).source.operators[-1],
        lambda of: research.paper_map(itself, start=of(matrix))[1].barycentric,
        lambda of: research.make_pair(surface, surface, of([[1, 1], [5, 5]])).target_landmarks,
    )
    for call in calls:
        np.testing.assert_array_equal(call(Tensor), call(np.asarray))
