"""Values, weights and shapes as arrays: kept by the identity; a coarse target follows shapes over whole triangles."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature, grid, torus

import cagemap
from cagemap.deform.problem import Problem
from cagemap.errors import ParameterError
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import result_of_fit
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.plain import plain_mesh
from cagemap.pipeline import prepare_pair, prepare_surface
from cagemap.subdivision import refine
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.tasks.carry_arrays import trusted_vertices
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes

from example_result import identity_result

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
