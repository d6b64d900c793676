"""Values on cages and arrays of weights and shapes: exact under the identity, convex, shapes over whole triangles."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature, cube, grid, icosahedron, torus
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

import cagemap
from cagemap.deform.problem import Problem
from cagemap.errors import ParameterError
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import result_of_fit
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, merged_corners
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.plain import plain_mesh
from cagemap.pipeline import prepare_pair, prepare_surface
from cagemap.subdivision import Refinement, refine, triangles
from cagemap.subdivision.face_varying import corner_triangles, interpolate_linearly
from cagemap.subdivision.refinement import truncate_refinement
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.tasks.carry_arrays import trusted_vertices
from cagemap.transfer import carry_uvs, combine, control_weights, corner_weights, prepare_transfer
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes

from example_result import identity_result
from transfer_scenes import identity_map


def mixed() -> ControlMesh:
    """A pyramid with a square base on a prism: triangles and quads."""
    points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1), (0, 0, 2)]
    faces = [
        (3, 2, 1, 0),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
        (4, 5, 8),
        (5, 6, 8),
        (6, 7, 8),
        (7, 4, 8),
    ]
    return ControlMesh.from_faces(points, faces)


SHAPES = [cube, mixed, icosahedron]


@pytest.mark.parametrize("shape", SHAPES)
def test_identity_of_cages_gives_every_kind_of_value_back(shape) -> None:
    both = (truncate_refinement(refine(shape(), 0), 0),) * 2
    control = both[0].control
    transfer = prepare_transfer(both[0].finest, both[1].finest, identity_map(both[0].finest))
    rng = np.random.default_rng(7)
    weights = control_weights(transfer.point_map, *both)
    values = rng.random((control.n_vertices, 3))
    np.testing.assert_array_equal(combine(weights, values), values)
    labels = rng.integers(-5, 5, control.n_vertices)
    np.testing.assert_array_equal(combine(weights, labels), labels)
    rows = rng.integers(0, 255, (control.n_vertices, 3))
    np.testing.assert_array_equal(combine(weights, rows), rows)
    # Every corner with a value of its own: all edges are seams, and no face has one inside.
    corners = rng.random((len(control.face_indices), 2))
    node_values, nodes = merged_corners(control.face_indices, corners)
    weights, crossed = corner_weights(transfer, *both, nodes, len(node_values))
    np.testing.assert_allclose(combine(weights, node_values), corners, rtol=0, atol=1e-9)
    assert not crossed.any()


@pytest.mark.parametrize("shape", SHAPES)
def test_interpolated_values_are_convex_and_linear_functions_stay(shape) -> None:
    control = shape()
    refined = refine(control, 3)
    matrix, corners = interpolate_linearly(control, control.face_indices, control.n_vertices, 3, refined.scheme)
    assert matrix.data.min() > 0
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose((matrix @ control.positions)[: control.n_vertices], control.positions, atol=0)
    tips = corner_triangles(control, 3, refined.scheme)
    np.testing.assert_array_equal(corners[tips, 0], control.face_indices)
    matrix, corners = interpolate_linearly(control, control.face_indices, control.n_vertices, 0, refined.scheme)
    tips = corner_triangles(control, 0, refined.scheme)
    assert (corners[tips] == control.face_indices[:, None]).any(axis=1).all()
    np.testing.assert_array_equal(cage_triangles(control)[1][tips], control.corner_faces)


def test_bilinear_on_a_square() -> None:
    square = ControlMesh.from_faces([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    matrix, _ = interpolate_linearly(square, square.face_indices, 4, 3, refine(square, 1).scheme)
    x, y = (matrix @ square.positions)[:, :2].T
    np.testing.assert_allclose(matrix @ np.array([0.0, 0, 1, 0]), x * y, rtol=0, atol=1e-12)


def stacked(control: ControlMesh, rows: int) -> ControlMesh:
    """All faces on the same few texture coordinates, as mirrored and stacked halves of OBJ files are."""
    return control.with_uvs(np.random.default_rng(1).random((rows, 2)), np.arange(len(control.face_indices)) % rows)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_values_that_vertices_share_are_interpolated_on_each_of_their_faces(shape, level: int) -> None:
    control = stacked(shape(), 5)
    refined = refine(control, level)
    values, nodes = merged_corners(control.face_indices, control.uvs[control.uv_indices])
    matrix, _ = interpolate_linearly(control, nodes, len(values), level, refined.scheme)
    assert matrix.data.min() > 0
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=1e-12)
    if level:
        both = refined, refined
        transfer = prepare_transfer(both[0].finest, both[1].finest, identity_map(both[0].finest))
        carried = carry_uvs(transfer, *both)
        given = control.uvs[control.uv_indices]
        np.testing.assert_allclose(carried.uvs[carried.uv_indices], given, rtol=0, atol=1e-7)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_any_map_gives_convex_weights_and_labels_that_exist(seed: int) -> None:
    rng = np.random.default_rng(seed)
    both = refine(mixed(), 2), refine(cube(), 2)
    n, t = both[0].finest.n_vertices, 2 * both[1].finest.n_faces
    surfaces = (TriangleSurface.from_faces(side.finest.positions, side.finest.faces) for side in both)
    point_map = PointMap.from_arrays(*surfaces, rng.integers(0, t, n), rng.dirichlet(np.ones(3), n))
    transfer = prepare_transfer(both[0].finest, both[1].finest, point_map)
    weights = control_weights(transfer.point_map, *both)
    assert weights.shape == (9, 8)
    skin = rng.dirichlet(np.full(5, 0.4), 8)
    carried = combine(weights, skin)
    assert carried.min() >= 0
    np.testing.assert_allclose(carried.sum(axis=1), 1, rtol=0, atol=1e-12)
    labels = rng.integers(0, 3, 8)
    assert set(combine(weights, labels)) <= set(labels)


def test_the_heavier_label_wins_and_wrong_rows_are_refused() -> None:
    weights = sparse.csr_array(np.array([[0.3, 0.3, 0.4], [0.5, 0.0, 0.5]]))
    assert combine(weights, np.array([7, 7, 2])).tolist() == [7, 2]  # mean would be 5; the smaller where equal
    assert combine(weights, np.array([True, True, False])).tolist() == [True, False]
    with pytest.raises(ParameterError, match="3 rows"):
        combine(weights, np.arange(4))


def test_a_seam_within_a_face_is_listed() -> None:
    # Target: 3 columns over a source of 2 columns that are two islands; the seam runs through the middle column.
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    points = np.array([(x / 2, y, 0) for y in range(2) for x in range(3)])
    faces = [(0, 1, 4, 3), (1, 2, 5, 4)]
    source = ControlMesh.from_faces(points, faces).with_uvs(
        np.concatenate([0.4 * square, 0.5 + 0.4 * square]), np.arange(8)
    )
    target = ControlMesh.from_faces(
        [(x / 3, y, 0) for y in range(2) for x in range(4)], [(k, k + 1, k + 5, k + 4) for k in range(3)]
    )
    both = refine(target, 3), refine(source, 3)
    # Refined positions are smoothed, so the map is given on the parameters.
    parameters = [linear_points(side, 3) for side in (target, source)]
    transfer = prepare_transfer(both[0].finest, both[1].finest, closest_map(parameters, both))
    carried = carry_uvs(transfer, *both)
    assert carried.crossed.tolist() == [1]
    got = carried.uvs[carried.uv_indices].reshape(3, 4, 2)
    np.testing.assert_allclose(got[0], 0.4 * square * (2 / 3, 1), atol=0.02)
    np.testing.assert_allclose(got[2], 0.5 + 0.4 * ((1 / 3, 0) + square * (2 / 3, 1)), atol=0.02)


def test_mirrored_halves_that_share_texture_coordinates_keep_them_on_other_faces() -> None:
    def square(n: int) -> tuple[ControlMesh, np.ndarray]:
        mesh = grid(n, n)
        x, y = (mesh.positions[:, :2] / np.ptp(mesh.positions[:, 0])).T
        return mesh, np.column_stack([np.abs(x - (x.min() + x.max()) / 2), y])

    (source, given), (target, wanted) = square(2), square(6)
    values, numbers = np.unique(given, axis=0, return_inverse=True)
    assert len(values) < source.n_vertices
    source = source.with_uvs(values, numbers.ravel()[source.face_indices])
    source, target = (mesh.with_positions(mesh.positions / np.ptp(mesh.positions[:, 0])) for mesh in (source, target))
    both = refine(target, 2), refine(source, 2)
    parameters = [linear_points(side, 2) for side in (target, source)]
    carried = carry_uvs(prepare_transfer(both[0].finest, both[1].finest, closest_map(parameters, both)), *both)
    np.testing.assert_allclose(carried.uvs[carried.uv_indices], wanted[target.face_indices], rtol=0, atol=1e-6)


def linear_points(control: ControlMesh, level: int) -> np.ndarray:
    matrix, _ = interpolate_linearly(
        control, control.face_indices, control.n_vertices, level, refine(control, 1).scheme
    )
    return matrix @ control.positions


def closest_map(parameters: list[np.ndarray], both: tuple[Refinement, Refinement]) -> PointMap:
    target, source = (TriangleSurface(p, triangles(s.finest.faces)) for p, s in zip(parameters, both, strict=True))
    return PointMap(target, SurfacePoints.nearest(source, target.positions))


def test_a_loose_vertex_does_not_renumber_others() -> None:
    square = ControlMesh.from_faces([(9, 9, 9), (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(1, 2, 3, 4)])
    for level in (0, 2):
        matrix, _ = interpolate_linearly(square, square.face_indices, 5, level, refine(cube(), 1).scheme)
        np.testing.assert_array_equal((matrix @ square.positions)[1:5], square.positions[1:])


RANDOM = np.random.default_rng(3)


@pytest.fixture(scope="module")
def itself() -> cagemap.MatchResult:
    return identity_result(2, (creature(), creature()))


@pytest.mark.parametrize("shape", [(), (1,), (2,), (3, 3)])
@pytest.mark.parametrize("kind", [float, int, bool, np.float32])
def test_rows_of_any_shape_come_back(itself: cagemap.MatchResult, kind: type, shape: tuple[int, ...]) -> None:
    mesh = itself.source.control
    for count in (mesh.n_vertices, mesh.n_faces, len(mesh.face_indices), len(itself.source.vertices)):
        values = RANDOM.integers(0, 9, (count, *shape)).astype(kind)
        carried = cagemap.carry_values(itself, {"a": values})
        assert list(carried) == ["a"]
        np.testing.assert_allclose(carried["a"], values, atol=1e-12)


def test_as_many_vertices_as_faces_are_told_apart_by_word() -> None:
    """A torus of quads has as many vertices as faces; labels of faces are not those of vertices under a shifted map."""
    result = identity_result(1, (torus(6, 5), torus(6, 5)))
    count = result.source.control.n_faces
    assert count == result.source.control.n_vertices
    shifted = cagemap.PointMap.from_vertices(
        result.point_map.target, result.point_map.source, np.roll(np.arange(result.point_map.target.n), 1)
    )
    moved = replace(result, point_map=shifted)
    labels = np.arange(count)
    np.testing.assert_array_equal(cagemap.carry_values(result, labels.tolist(), "faces"), labels)
    np.testing.assert_array_equal(
        cagemap.carry_values(moved, labels), cagemap.carry_values(moved, labels, at="vertices")
    )
    assert not np.array_equal(cagemap.carry_values(moved, labels), cagemap.carry_values(moved, labels, at="faces"))


def test_weights_and_shapes_come_back(itself: cagemap.MatchResult) -> None:
    count = itself.source.control.n_vertices
    pruned = cagemap.carry_weights(itself, RANDOM.dirichlet(np.ones(6), count))
    assert ((pruned > 0).sum(axis=1) == 4).all()
    lifted = np.tile([0.0, 0.3, 0.0], (count, 1))
    shapes = cagemap.carry_shapes(itself, {"up": lifted, "still": 0 * lifted})
    assert isinstance(shapes, dict)
    np.testing.assert_allclose(shapes["up"], lifted, atol=1e-6)
    np.testing.assert_allclose(shapes["still"], 0.0, atol=1e-9)
    np.testing.assert_array_equal(cagemap.carry_shapes(itself, lifted), shapes["up"])


def test_a_small_part_takes_the_weights_of_its_place() -> None:
    """A glove on a body: 1 % of the source's area."""
    part, whole = (prepare_surface(mesh, 1) for mesh in (grid(2, 2), grid(20, 20)))
    target, source = part.finest_triangles, whole.finest_triangles
    places = target.positions / target.scale * source.scale
    found = PointMap(target, SurfacePoints.nearest(source, places))
    on_source = (whole.vertices[:, :2] <= 2).all(axis=1).astype(np.float64)
    problem = Problem.of_landmarks(prepare_pair(part, whole), Landmarks.none())
    shared = Masks(np.ones(target.n), on_source)
    result = result_of_fit(problem, found, Landmarks.none(), LandmarkCheck(), {}, shared)
    assert trusted_vertices(result).all()
    given = RANDOM.dirichlet(np.ones(3), whole.control.n_vertices)
    same = [np.flatnonzero((whole.control.positions == at).all(axis=1))[0] for at in part.control.positions]
    np.testing.assert_allclose(cagemap.carry_weights(result, given), given[same], atol=1e-6)


def test_arrays_that_do_not_fit_are_refused(itself: cagemap.MatchResult) -> None:
    count = itself.source.control.n_vertices
    for wrong, message in (
        (lambda: cagemap.carry_values(itself, np.zeros(3)), "values has 3 rows; expected one for each"),
        (lambda: cagemap.carry_values(itself, 3.0), "values has 0 rows"),
        (lambda: cagemap.carry_values(itself, np.zeros(count), at="faces"), "and at='faces' was asked for"),
        (lambda: cagemap.carry_values(itself, np.zeros(count), at="edges"), "at: expected one of vertices, faces"),
        (lambda: cagemap.carry_values(itself, ["a"] * count), "values: expected an array of real numbers"),
        (lambda: cagemap.carry_weights(itself, np.zeros(count)), r"expected an array \(n, joints\)"),
        (lambda: cagemap.carry_weights(itself, np.ones((3, 1))), f"expected {count} rows"),
        (lambda: cagemap.carry_weights(itself, "weights"), "skinning weights: expected an array of real"),
        (lambda: cagemap.carry_shapes(itself, {"smile": np.zeros((3, 3))}), f"expected {count} finite"),
        (lambda: cagemap.carry_shapes(itself, {"smile": "a"}), "shape smile: expected an array of real"),
    ):
        with pytest.raises(ParameterError, match=message):
            wrong()


def test_a_step_narrower_than_the_targets_triangles_is_carried_without_overshoot() -> None:
    """Vertices of the target are every fourth of the source: they move as these do."""
    around, across, share = 12, 8, 4
    coarse, fine = (refine(plain_mesh(torus(around * k, across * k)).mesh, 0) for k in (1, share))
    distance = np.linalg.norm(coarse.control.positions[:, None] - fine.control.positions, axis=2)
    same = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 1e-9
    surfaces = [TriangleSurface.from_faces(side.finest.positions, side.finest.faces) for side in (coarse, fine)]
    carrier = prepare_shapes(coarse, fine, PointMap.from_vertices(*surfaces, same))
    heights = fine.control.positions[:, 0]
    # A ninth of a coarse edge wide, at the centroids of triangles.
    step = np.clip((heights - np.quantile(heights, 0.55)) / 0.03, 0.0, 1.0)[:, None] * [0.0, 0.0, 0.3]
    np.testing.assert_allclose(carry_shape(carrier, step), step[same], rtol=0, atol=1e-6)
