"""SEC operators: what section 2.2.2 and Lemma 5 of the paper promise, to machine precision."""

from functools import cache

import numpy as np
import pytest
from examples import shapes
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.operators import Operators, build_operators, named_laplacian, stiffness, vertex_areas
from cagemap.operators.laplacian import QUAD_PAIRS, TRIANGLE_PAIRS, assemble_stiffness, face_terms
from cagemap.spectral import exact_basis
from cagemap.subdivision import refine
from cagemap.surface.triangles import triangle_areas

from cotangents import triangle_cotangents
from plain_meshes import renumbered

SHAPES = {
    "cube": lambda: shapes.cube(),
    "icosahedron (Loop)": lambda: shapes.icosahedron(),
    "open grid": lambda: shapes.grid(4, 3),
    "creature": lambda: shapes.creature(),
}
# Products of sparse matrices with entries of order 1: a few hundred roundings.
EXACT = 1e-12
# The triangles of both triangulations of a quad.
QUAD_SPLITS = ([0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3])


def restrict(subdivision, fine):
    """Slow twin: Galerkin restriction by products of whole matrices."""
    coarse = sparse.csr_array(subdivision.T @ (fine @ subdivision))
    coarse.sort_indices()
    return coarse


def face_terms_reference(positions: FloatArray, faces: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Slow NumPy twin of `face_terms`, which defines it."""
    quads = faces.shape[1] == 4
    splits, pairs = (QUAD_SPLITS, QUAD_PAIRS) if quads else (([0, 1, 2],), TRIANGLE_PAIRS)
    share = 0.5 if quads else 1.0  # of each triangulation
    weights, areas = np.zeros((len(faces), len(pairs))), np.zeros(len(positions))
    for split in splits:
        triangles = faces[:, split]
        cotangents = triangle_cotangents(positions, triangles)
        for i in range(3):  # the angle at corner i faces the edge between the other two
            edge = {split[(i + 1) % 3], split[(i + 2) % 3]}
            column = next(c for c, pair in enumerate(pairs) if set(pair) == edge)
            weights[:, column] += 0.5 * share * cotangents[:, i]
            np.add.at(areas, triangles[:, i], share / 3.0 * triangle_areas(positions, triangles))
    return weights, areas


@pytest.fixture(params=SHAPES, scope="module")
def refined(request):
    refinement = refine(SHAPES[request.param](), 3)
    return refinement, build_operators(refinement)


def test_constants_are_in_the_null_space_and_area_is_one(refined):
    _, operators = refined
    for mass, stiff in zip(operators.mass, operators.stiffness, strict=True):
        ones = np.ones(mass.shape[0])
        assert abs(stiff @ ones).max() < EXACT * abs(stiff).max()
        assert abs(mass.sum() - 1.0) < EXACT


def test_operators_are_symmetric_and_definite(refined):
    _, operators = refined
    for mass, stiff in zip(operators.mass[:2], operators.stiffness[:2], strict=True):
        for matrix in (mass, stiff):
            assert abs(matrix - matrix.T).max() < EXACT * abs(matrix).max()
        masses, values = np.linalg.eigvalsh(mass.toarray()), np.linalg.eigvalsh(stiff.toarray())
        assert masses.min() > -EXACT * masses.max()
        assert values.min() > -EXACT * values.max()
        # One component: only the constants have no energy, besides functions that subdivide to zero. The cube has one,
        # +1 and -1 in turn over its corners: at valence 3 Catmull-Clark averages it away, so its M^0 is singular.
        vanishing = np.sum(masses < 1e-9 * masses.max())
        assert vanishing == (1 if mass.shape[0] == 8 else 0)
        assert np.sum(values < 1e-9 * values.max()) == 1 + vanishing


def test_lemma_5_inner_products_do_not_depend_on_the_level(refined):
    """<S g, S h>_{M^{l+1}} = <g, h>_{M^l}, and the same for the Dirichlet form."""
    refinement, operators = refined
    rng = np.random.default_rng(505)
    for level, subdivision in enumerate(refinement.matrices):
        g, h = rng.standard_normal((2, subdivision.shape[1]))
        for family in (operators.mass, operators.stiffness):
            coarse, fine = g @ (family[level] @ h), (subdivision @ g) @ (family[level + 1] @ (subdivision @ h))
            bound = np.sqrt((g @ (family[level] @ g)) * (h @ (family[level] @ h)))
            assert abs(coarse - fine) < EXACT * max(bound, 1e-30)


def test_finest_mass_is_diagonal_and_coarser_ones_are_not(refined):
    _, operators = refined
    assert abs(operators.mass[-1] - sparse.diags_array(operators.mass[-1].diagonal())).max() == 0.0
    assert np.all(operators.mass[-1].diagonal() > 0.0)
    assert operators.mass[0].nnz > operators.mass[0].shape[0]


@settings(max_examples=15)
@given(scale=st.floats(1e-6, 1e6), seed=st.integers(2, 10_000))
def test_rigid_motion_and_scale_change_nothing(scale, seed):
    """Unit area removes the scale; the matrices see lengths and angles only."""
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    mesh = shapes.creature()
    moved = mesh.with_positions(scale * (mesh.positions @ rotation.T + rng.standard_normal(3)))
    before, after = build_operators(refine(mesh, 1)), build_operators(refine(moved, 1))
    for old, new in zip(before.stiffness + before.mass, after.stiffness + after.mass, strict=True):
        # Cotangents of thin triangles amplify the rounding of the moved positions.
        assert abs(old - new).max() < 1e-8 * abs(old).max()
    assert after.scale * scale == pytest.approx(before.scale, rel=1e-9)


def test_relabelled_vertices_give_permuted_matrices():
    mesh = shapes.creature()
    relabelled, new_number = renumbered(mesh, 77)
    before, after = build_operators(refine(mesh, 2)), build_operators(refine(relabelled, 2))
    for old, new in zip((before.mass[0], before.stiffness[0]), (after.mass[0], after.stiffness[0]), strict=True):
        assert abs(new[new_number][:, new_number] - old).max() < EXACT * abs(old).max()


def test_cotangents_of_known_triangles():
    """An equilateral triangle: 1/sqrt 3 everywhere; a right isosceles one: 0, 1, 1."""
    equilateral = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]])
    right = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    face = np.array([[0, 1, 2]])
    np.testing.assert_allclose(triangle_cotangents(equilateral, face), 1 / np.sqrt(3), rtol=1e-14)
    np.testing.assert_allclose(triangle_cotangents(right, face), [[0, 1, 1]], atol=1e-15)


def test_unit_square_quad():
    """The mean of both triangulations: no diagonal is preferred, and linear functions get their exact energy."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    face = np.array([[0, 1, 2, 3]])
    matrix = stiffness(square, face).toarray()
    np.testing.assert_allclose(matrix, np.array([[2, -1, 0, -1], [-1, 2, -1, 0], [0, -1, 2, -1], [-1, 0, -1, 2]]) / 2)
    assert square[:, 0] @ matrix @ square[:, 0] == pytest.approx(1.0)
    np.testing.assert_allclose(vertex_areas(square, face), 0.25)


def test_slivers_keep_the_stiffness_semi_definite():
    """Triangles of almost no area must not give infinite or negative energy (soma18056 has some)."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-14, 0], [0.5, 1, 0], [0.5, 0, 0]])
    matrix = stiffness(positions, np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3], [2, 2, 4]])).toarray()
    assert np.isfinite(matrix).all()
    values = np.linalg.eigvalsh(matrix)
    assert values.min() > -1e-12 * values.max()


@pytest.mark.parametrize("shape", [shapes.creature, shapes.icosahedron])
def test_face_kernel_agrees_with_its_numpy_twin(shape):
    level = refine(shape(), 2).finest
    size = level.faces.shape[1]
    faces = np.vstack([level.faces, [[0, 0, 1, 2][:size], [3] * size]])  # with collapsed faces
    for computed, expected in zip(
        face_terms(level.positions, faces), face_terms_reference(level.positions, faces), strict=True
    ):
        np.testing.assert_allclose(computed, expected, rtol=1e-9, atol=1e-12)


def test_stiffness_sums_the_pair_weights_of_all_faces():
    level = refine(shapes.creature(), 1).finest
    faces = np.vstack([level.faces, [[0, 0, 1, 2]]])
    expected = np.zeros((level.n_vertices, level.n_vertices))
    for face, weights in zip(faces, face_terms_reference(level.positions, faces)[0], strict=True):
        for (i, j), weight in zip(((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)), weights, strict=True):
            ends = [face[i], face[j]]
            expected[np.ix_(ends, ends)] += weight * np.array([[1, -1], [-1, 1]]) * (ends[0] != ends[1])
    matrix = stiffness(level.positions, faces)
    assert matrix.has_canonical_format
    np.testing.assert_allclose(matrix.toarray(), expected, atol=1e-12 * abs(expected).max())


def test_coarse_operators_are_restrictions_and_share_their_pattern(refined):
    """A^l = (S^l)^T A^{l+1} S^l; surface stores keep one pattern for both."""
    refinement, operators = refined
    for level, subdivision in enumerate(refinement.matrices):
        mass, stiff = operators.mass[level], operators.stiffness[level]
        np.testing.assert_array_equal(mass.indices, stiff.indices)
        np.testing.assert_array_equal(mass.indptr, stiff.indptr)
        for computed, fine in ((mass, operators.mass[level + 1]), (stiff, operators.stiffness[level + 1])):
            expected = restrict(subdivision, fine)
            assert computed.has_canonical_format
            assert abs(computed - expected).max() < EXACT * abs(expected).max()


LAPLACIANS = {
    f"{name} {stabilisation}": named_laplacian(name, stabilisation)
    for name, stabilisation in (
        ("mean", 1.0),
        ("alexa-wardetzky", 1.0),
        ("alexa-wardetzky", 2.0),
        ("de-goes-butts-desbrun", 1.0),
        ("de-goes-butts-desbrun", 0.5),
    )
}


@pytest.mark.parametrize("laplacian", LAPLACIANS.values(), ids=LAPLACIANS)
def test_every_laplacian_is_the_cotangent_laplacian_on_triangles(laplacian):
    finest = refine(shapes.icosahedron(), 2).finest
    positions = finest.positions + 0.02 * np.random.default_rng(3).standard_normal(finest.positions.shape)
    weights, areas = laplacian(positions, finest.faces)
    expected, areas_expected = face_terms_reference(positions, finest.faces)
    np.testing.assert_allclose(weights, expected, rtol=0, atol=EXACT * np.abs(expected).max())
    np.testing.assert_allclose(areas, areas_expected, rtol=1e-12)


@pytest.mark.parametrize("laplacian", LAPLACIANS.values(), ids=LAPLACIANS)
def test_every_laplacian_is_exact_for_linear_functions_on_flat_quads(laplacian):
    """W x vanishes inside for x linear, and x^T W x is the area times the squared gradient."""
    control = shapes.grid(5, 4)
    rng = np.random.default_rng(4)
    positions = control.positions.copy()
    flat = np.ptp(positions, axis=0) > 0
    positions[:, flat] += 0.15 * rng.uniform(-1, 1, (len(positions), 2))
    faces = control.face_indices.reshape(-1, 4)
    weights, areas = laplacian(positions, faces)
    stiff = assemble_stiffness(weights, faces, len(positions))
    gradient = np.where(flat, [0.3, -0.7, 0.45], 0.0)
    values = positions @ gradient
    boundary = np.zeros(len(positions), dtype=bool)
    assert values @ (stiff @ values) == pytest.approx(areas.sum() * gradient @ gradient, rel=1e-12)
    # Inside: every edge of the grid has two faces.
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    boundary[unique[counts == 1].ravel()] = True
    assert np.abs((stiff @ values)[~boundary]).max() < 1e-12


@pytest.mark.parametrize("laplacian", LAPLACIANS.values(), ids=LAPLACIANS)
def test_operators_of_every_laplacian_are_symmetric_definite_and_of_unit_area(laplacian):
    refinement = refine(shapes.creature(), 2)
    operators = build_operators(refinement, laplacian)
    for mass, stiff in zip(operators.mass, operators.stiffness, strict=True):
        assert abs(mass.sum() - 1.0) < EXACT
        assert abs(stiff - stiff.T).max() < EXACT * abs(stiff).max()
        assert abs(stiff @ np.ones(stiff.shape[0])).max() < EXACT * abs(stiff).max()
    values = np.linalg.eigvalsh(operators.stiffness[1].toarray())
    assert values[0] > -EXACT * values[-1]
    assert values[1] > 1e-6 * values[-1]


@cache
def spectrum(laplacian, level):
    """The lowest 20 eigenvalues of the creature."""
    return exact_basis(build_operators(refine(shapes.creature(), level), laplacian), level, 20).values


@pytest.mark.slow
@pytest.mark.parametrize("laplacian", list(LAPLACIANS.values())[1:], ids=list(LAPLACIANS)[1:])
def test_laplacians_agree_ever_more_the_finer_the_surface(laplacian):
    differences = []
    for level in (1, 2, 3):
        mean, other = (spectrum(kind, level) for kind in (face_terms, laplacian))
        differences.append(np.abs(other[1:] / mean[1:] - 1.0).max())
    # Second order: a factor of four a level in the limit.
    assert differences[1] < 0.5 * differences[0]
    assert differences[2] < 0.4 * differences[1]


@pytest.mark.parametrize("laplacian", LAPLACIANS.values(), ids=LAPLACIANS)
def test_collapsed_faces_do_no_harm(laplacian):
    finest = refine(shapes.cube(), 2).finest
    positions = finest.positions.copy()
    positions[finest.faces[0]] = positions[finest.faces[0, 0]]
    weights, areas = laplacian(positions, finest.faces)
    assert np.isfinite(weights).all()
    assert areas.min() >= 0.0
    values = np.linalg.eigvalsh(assemble_stiffness(weights, finest.faces, len(positions)).toarray())
    assert values[0] > -1e-9 * values[-1]


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_a_stabilisation_is_positive(wrong):
    # Also where it means nothing: a RESULT with such a number would not be read again.
    for name in ("alexa-wardetzky", "de-goes-butts-desbrun", "mean"):
        with pytest.raises(ParameterError, match="stabilisation"):
            named_laplacian(name, wrong)


def test_edges_with_a_cotangent_of_zero_stay_entries():
    """Both diagonals of a square, and the longest side of a right triangle: graphs take their edges from W."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert stiffness(corners, np.array([[0, 1, 2, 3]])).nnz == 16
    right = stiffness(corners, np.array([[0, 1, 2]]))
    assert right[[0], [2]][0] == 0.0
    assert right[:3].nnz == 9


def test_built_matrices_are_read_only_and_given_ones_stay_writeable() -> None:
    built = build_operators(refine(shapes.cube(), 1))
    for matrix in (*built.mass, *built.stiffness):
        assert not matrix.data.flags.writeable
    copies = tuple(matrix.copy() for matrix in built.mass)
    Operators(copies, copies, 1.0)
    Operators((np.eye(3),), (np.eye(3),), 1.0)  # type: ignore[arg-type]
    assert all(matrix.data.flags.writeable for matrix in copies)
