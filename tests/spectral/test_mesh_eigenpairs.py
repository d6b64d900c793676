"""Eigenpairs of a mesh to a residual, and DiffusionNet's operators against its published formulas."""

import numpy as np
import pytest
from examples import shapes
from scipy import sparse
from scipy.sparse.linalg import eigsh

import cagemap
from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.operators import stiffness, vertex_areas
from cagemap.spectral import BasisConfig, residual_norms
from cagemap.spectral.eigenpairs import band_pairs
from cagemap.subdivision import level_triangles, refine

from refusals import refuses


@pytest.fixture(scope="module")
def arrays():
    """2434 vertices, and triangles."""
    refinement = refine(shapes.creature(), 2)
    return refinement.finest.positions, level_triangles(refinement, 2)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-5, 1e-9])
def test_residuals_are_below_the_accuracy_and_values_within_the_bound(arrays, accuracy):
    """The bound of the docstring: ||W x - lambda M x|| in M^-1 holds for the eigenvalue next to it."""
    pairs = cagemap.eigenpairs(arrays, 60, accuracy)
    weights, areas = stiffness(*arrays), vertex_areas(*arrays)
    x, mass = pairs.vectors, sparse.csc_array(sparse.diags_array(areas))
    assert residual_norms(pairs.values, weights @ x, areas[:, None] * x, areas).max() <= accuracy
    np.testing.assert_allclose(x.T @ (areas[:, None] * x), np.eye(60), atol=1e-12)
    exact = np.sort(eigsh(sparse.csc_array(weights), 60, mass, sigma=-1.0)[0])
    scale = np.maximum(exact, 4 * np.pi / areas.sum())
    assert (np.abs(pairs.values - exact) / scale).max() <= accuracy
    assert x.dtype == np.float64


@pytest.mark.parametrize("count", [1, 33, 65])  # one more than blocks of columns
def test_every_number_of_pairs_is_possible(arrays, count):
    pairs = cagemap.eigenpairs(arrays, count)
    np.testing.assert_allclose(pairs.values, cagemap.eigenpairs(arrays, 70).values[:count], rtol=1e-8, atol=1e-8)


def test_lengths_are_those_of_the_file(arrays):
    """Twice as large, eigenvalues are a quarter, and functions half."""
    one, two = (cagemap.eigenpairs((factor * arrays[0], arrays[1]), 12) for factor in (1.0, 2.0))
    np.testing.assert_allclose(one.values[1:], 4.0 * two.values[1:], rtol=1e-8)
    assert abs(abs(two.vectors[:, 1]).max() / abs(one.vectors[:, 1]).max() - 0.5) < 1e-3


def test_meshes_of_quads_boundaries_and_two_parts_are_taken():
    grid = shapes.grid(6, 5)
    assert cagemap.eigenpairs(grid, 4).values[0] < 1e-8 < cagemap.eigenpairs(grid, 4).values[1]
    cube = shapes.cube()
    twice = np.vstack([cube.positions, cube.positions + 5.0])
    faces = np.vstack([cube.face_indices.reshape(-1, 4), cube.face_indices.reshape(-1, 4) + cube.n_vertices])
    assert (np.abs(cagemap.eigenpairs((twice, faces), 3).values) < 1e-8).tolist() == [True, True, False]


def ball(level):
    """Positions and triangles of a subdivided icosahedron, whose eigenvalues repeat 3 to 5 times."""
    refinement = refine(shapes.icosahedron(), level)
    return refinement.finest.positions, level_triangles(refinement, level)


@pytest.mark.parametrize("count", [3, 45])
def test_meshes_of_many_parts_are_taken(count):
    """Zero is an eigenvalue of high multiplicity, which one Lanczos iteration for all parts does not find."""
    positions, triangles = ball(2)
    sizes = np.linspace(0.5, 1.5, 40)
    together = np.vstack([size * positions + 5.0 * i for i, size in enumerate(sizes)])
    faces = np.vstack([triangles + i * len(positions) for i in range(40)])
    pairs = cagemap.eigenpairs((together, faces), count)
    of_one = cagemap.eigenpairs((positions, triangles), 4).values
    expected = np.sort(np.outer(1.0 / sizes**2, of_one).ravel())
    np.testing.assert_allclose(pairs.values, expected[:count], atol=1e-8)
    areas = vertex_areas(together, faces)
    np.testing.assert_allclose(pairs.vectors.T @ (areas[:, None] * pairs.vectors), np.eye(count), atol=1e-10)


def test_parts_too_many_for_one_iteration_are_not_tried_together(monkeypatch):
    positions, triangles = ball(0)
    n, sizes = len(positions), []
    together = np.vstack([positions + 5.0 * i for i in range(101)])
    faces = np.vstack([triangles + i * n for i in range(101)])

    def counted(weights, *given, **options):
        sizes.append(weights.shape[0])
        return band_pairs(weights, *given, **options)

    monkeypatch.setattr("cagemap.spectral.mesh_eigenpairs.band_pairs", counted)
    pairs = cagemap.eigenpairs((together[::-1], len(together) - 1 - faces), 110)
    assert sizes == 101 * [n]
    assert np.count_nonzero(np.abs(pairs.values) < 1e-8) == 101


@pytest.mark.parametrize("count", [5, 51])
def test_values_ascend_within_a_repeated_eigenvalue(count):
    values = cagemap.eigenpairs(ball(4), count, 1e-9).values
    assert (np.diff(values) >= 0.0).all()


def test_what_cannot_be_computed_is_refused(arrays):
    loose = np.vstack([arrays[0], [[9.0, 9.0, 9.0]]]), arrays[1]
    refuses(InvalidMeshError, "found none at 1 of them, such as \\[2434\\]", cagemap.eigenpairs, loose, 5)
    for outside in (-1, 99):
        refuses(InvalidMeshError, "vertex numbers from 0 to 2", cagemap.eigenpairs, (np.eye(3), [[0, 1, outside]]), 1)
    refuses(ParameterError, "k: expected 1 to 2434", cagemap.eigenpairs, arrays, 0)
    refuses(ParameterError, "accuracy: expected a residual", cagemap.eigenpairs, arrays, 5, 0.5)
    refuses(ParameterError, "mesh: expected ControlMesh, got 3", cagemap.eigenpairs, 3, 5)


@pytest.fixture(scope="module")
def surface():
    return cagemap.prepare_surface(shapes.creature(), 2, BasisConfig(count=20))


def reference(positions, triangles, count):
    """Mass, L, evals, evecs, gradX, gradY by the formulas of DiffusionNet's `compute_operators`, vertex by vertex.

    The package is on no registry. As there, L and the areas are potpourri3d's, eigenpairs SciPy's.
    """
    pp3d = pytest.importorskip("potpourri3d")
    weights = pp3d.cotan_laplacian(positions, triangles, denom_eps=1e-10)
    areas = pp3d.vertex_areas(positions, triangles)
    areas = areas + 1e-8 * areas.mean()
    shifted = (weights + 1e-8 * sparse.identity(len(areas))).tocsc()
    values, vectors = eigsh(shifted, count, sparse.diags(areas), sigma=1e-8)
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    of_faces = np.cross(b - a, c - a)
    of_faces /= np.linalg.norm(of_faces, axis=1, keepdims=True) + 1e-6
    normals = np.zeros_like(positions)
    for i in range(3):
        np.add.at(normals, triangles[:, i], of_faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    gradient = np.zeros((2, len(areas), len(areas)))
    for i in range(len(areas)):
        first = np.eye(3)[0] if abs(normals[i, 0]) < 0.9 else np.eye(3)[1]
        x = first - normals[i] * (first @ normals[i])
        x /= np.linalg.norm(x) + 1e-6
        axes = np.stack([x, np.cross(normals[i], x)])
        ring = np.setdiff1d(weights[[i]].indices, [i])
        edges = (positions[ring] - positions[i]) @ axes.T
        solved = np.linalg.inv(edges.T @ edges + 1e-5 * np.eye(2)) @ edges.T
        gradient[:, i, ring] = solved
        gradient[:, i, i] = -solved.sum(axis=1)
    order = np.argsort(values)
    return areas, weights, values[order], vectors[:, order], *gradient


@pytest.mark.parametrize("level", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_operators_are_those_of_diffusion_net(surface, level):
    triangles = surface.triangles(level)
    ours = cagemap.operators_for_diffusion_net(surface, level, count=24)
    theirs = reference(triangles.positions, triangles.triangles, 24)
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-5)
    np.testing.assert_allclose(ours[1].toarray(), theirs[1].toarray(), atol=1e-5)
    np.testing.assert_allclose(ours[2], theirs[2], atol=1e-5 * 4 * np.pi, rtol=1e-5)  # they add 1e-8 to L
    # The same functions up to rotations among equal eigenvalues.
    inside = ours[3].T @ (theirs[0][:, None] * theirs[3])
    np.testing.assert_allclose(np.linalg.norm(inside[:20], axis=1), 1.0, atol=1e-5)
    for mine, other in zip(ours[4:], theirs[4:], strict=True):
        assert np.abs(mine.toarray() - other).max() < 1e-5 * np.abs(other).max()


def test_gradients_are_those_of_linear_functions():
    """On a flat grid in the plane of x and y, with X along x."""
    flat = cagemap.prepare_surface(shapes.grid(8, 8), 1, BasisConfig(count=5))
    *_, grad_x, grad_y = cagemap.operators_for_diffusion_net(flat, count=4, regularisation=1e-12)
    x, y, z = flat.finest_triangles.positions.T
    away = np.ptp(z) < 1e-12
    assert away
    np.testing.assert_allclose(grad_x @ (2 * x - y), 2.0, atol=1e-4)
    np.testing.assert_allclose(np.abs(grad_y @ (2 * x - y)), 1.0, atol=1e-4)
    refuses(ParameterError, "regularisation: expected", cagemap.operators_for_diffusion_net, flat, regularisation=0.0)
