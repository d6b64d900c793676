"""The basis: one level or bands, nothing lost, and what can be asked of it without the dense fine matrix."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from examples import shapes
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import read_mesh
from cagemap.operators import build_operators
from cagemap.paper.constraints import ConstraintConfig
from cagemap.spectral import BasisConfig, Surface, exact_basis, hierarchical_basis
from cagemap.spectral.basis import MIN_VERTICES, VERTICES_PER_FUNCTION, label_clusters, new_directions
from cagemap.spectral.eigenpairs import SOLVER
from cagemap.subdivision import refine

from refusals import refuses

# Counts end at gaps of the spectrum, so that "the lowest k" is one space and not a choice inside a cluster.
SURFACES = {
    "cube": (shapes.cube, 4, 16),
    "icosahedron (Loop)": (shapes.icosahedron, 4, 16),
    "torus": (lambda: shapes.torus(6, 4), 3, 35),
    "open square": (lambda: shapes.grid(5, 5), 3, 37),
    "mirror-symmetric creature": (shapes.creature, 2, 40),
}
# Solves with Gram matrices of condition below 100.
EXACT = 1e-10


@pytest.fixture(params=SURFACES, scope="module")
def surface(request):
    control, level, count = SURFACES[request.param]
    refinement = refine(control(), level)
    return refinement, build_operators(refinement), count


@pytest.fixture(scope="module")
def creature():
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    return refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(schedule=(20, 15, 10)))


def cosines(refinement, operators, basis, exact):
    """Cosines of the principal angles between the hierarchical basis and exact eigenvectors, at the finest level."""
    finest = operators.finest_level
    phi = basis.at(finest)
    weights = np.sqrt(operators.mass[-1].diagonal())[:, None]
    ours, _ = np.linalg.qr(weights * phi)
    return np.linalg.svd(ours.T @ (weights * exact.vectors), compute_uv=False)


@pytest.mark.slow
def test_a_basis_of_one_level_is_that_level_s_spectrum(surface):
    """Given by its number of functions alone; small surfaces have it on their finest level."""
    refinement, operators, count = surface
    basis = hierarchical_basis(refinement, operators, BasisConfig(count=count, accuracy=1e-9))
    level = refinement.coarsest_level(max(MIN_VERTICES, VERTICES_PER_FUNCTION * count))
    assert basis.schedule == (*(0 for _ in range(level)), count)
    exact = exact_basis(operators, level, count)
    np.testing.assert_allclose(basis.eigenvalues[1:], exact.values[1:], rtol=1e-8)
    np.testing.assert_array_equal(basis.indices, np.arange(count))
    np.testing.assert_allclose(basis.gram, np.eye(count), rtol=0, atol=EXACT)
    fine = exact_basis(operators, operators.finest_level, count)
    assert cosines(refinement, operators, basis, fine).min() > 1.0 - 1e-3


@pytest.mark.slow
def test_a_basis_of_one_level_is_on_the_coarsest_that_has_enough_vertices():
    """Levels of the creature have 154, 610, 2434 and 9730 vertices."""
    refinement = refine(shapes.creature(), 3)
    operators = build_operators(refinement)
    assert hierarchical_basis(refinement, operators, BasisConfig(count=30)).schedule == (0, 0, 0, 30)
    up_to_2 = build_operators(refinement.up_to(2))
    assert hierarchical_basis(refinement, up_to_2, BasisConfig(count=30)).schedule == (0, 0, 30)
    basis = hierarchical_basis(refinement, operators, BasisConfig(count=30))
    # The spectrum of a level with 20 vertices a function is within 4 % of the finest level's, from above.
    coarse = exact_basis(operators, 1, 30).values[1:]
    assert 1.0 <= (coarse / basis.eigenvalues[1:]).min() <= (coarse / basis.eigenvalues[1:]).max() < 1.04


@pytest.mark.slow
@pytest.mark.parametrize("schedule", [(12, 4, 4), (13, 5, 8), (4, 10, 10)])
def test_fixed_schedule_has_its_counts_and_completes_cut_clusters(schedule):
    """Bands that end inside a pair of the torus: the next band brings the other half, and no half twice."""
    refinement = refine(shapes.torus(8, 5), 2)
    operators = build_operators(refinement)
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=schedule))
    assert basis.schedule == schedule
    for level in range(3):
        exact = exact_basis(operators, level, basis.size(level) + 4)
        ends = np.flatnonzero(np.diff(label_clusters(exact.values)))  # last member of every cluster
        whole = int(ends[ends < basis.size(level)].max()) + 1
        phi = basis.at(level)
        gram = basis.gram[: basis.size(level), : basis.size(level)]
        overlap = phi.T @ (operators.mass[level] @ exact.vectors[:, :whole])
        shares = np.einsum("ij,ij->j", overlap, np.linalg.solve(gram, overlap))
        assert shares.min() > 0.9
        assert np.linalg.cond(gram) < 10.0
        own = slice(basis.size(level) - schedule[level], basis.size(level))
        np.testing.assert_allclose(gram[own, own], np.eye(schedule[level]), rtol=0, atol=EXACT)
    assert basis.residuals.max() < 1e-3


@pytest.mark.slow
def test_index_of_every_pair_is_its_place_in_the_level_s_spectrum(creature):
    _, operators, basis = creature
    for level in range(3):
        mine = np.repeat(np.arange(len(basis.bands)), basis.schedule) == level
        exact = exact_basis(operators, level, int(basis.indices[mine].max()) + 1).values
        np.testing.assert_allclose(basis.eigenvalues[mine], exact[basis.indices[mine]], rtol=1e-6, atol=1e-6)


def test_new_directions_rotates_inside_clusters_and_drops_by_count():
    """A triple eigenvalue of which the prolonged basis has one direction: the two orthogonal ones are new."""
    rng = np.random.default_rng(31)
    values = np.array([1.0, 5.0, 5.0, 5.0, 9.0])
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    prolonged = np.zeros((5, 2))
    prolonged[0, 0] = 1.0
    prolonged[1:4, 1] = 0.95 * direction
    prolonged[4, 1] = np.sqrt(1.0 - 0.95**2)
    mixing = np.array([[2.0, 0.3], [0.0, 1.0]])  # the prolonged basis need not be orthonormal
    basis = prolonged @ mixing
    rotation, positions = new_directions(values, basis.T, basis.T @ basis, present=2)
    assert rotation.shape == (5, 3)
    np.testing.assert_array_equal(positions, [2, 3, 4])
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotation[1:4, :2].T @ direction, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs(rotation[4, 2]), 1.0, rtol=0, atol=1e-12)


def test_rows_and_blocks_are_parts_of_the_dense_basis(creature, monkeypatch):
    monkeypatch.setattr(sys.modules["cagemap.spectral.basis"], "ROW_BLOCK", 333)
    refinement, operators, basis = creature
    rng = np.random.default_rng(43)
    for level in range(operators.finest_level + 1):
        phi = basis.at(level)
        assert phi.shape == (refinement.levels[level].n_vertices, basis.size(level))
        vertices = rng.integers(0, len(phi), 40)
        np.testing.assert_allclose(basis.rows(level, vertices), phi[vertices], rtol=0, atol=1e-12)
        joined = np.full_like(phi, np.nan)
        for part, values in basis.row_blocks(level):
            joined[part] = values
        np.testing.assert_allclose(joined, phi, rtol=0, atol=1e-12)
        # Eq. 8: the low columns are the refined basis of the level below.
        if level > 0:
            below = refinement.matrices[level - 1] @ basis.at(level - 1)
            np.testing.assert_allclose(phi[:, : below.shape[1]], below, rtol=0, atol=1e-12)


@settings(max_examples=10)
@given(seed=st.integers(2, 10_000), level=st.integers(0, 3))
def test_projection_gives_back_coefficients_and_is_orthogonal(creature, seed, level):
    """(Phi^T M Phi)^{-1} Phi^T M f, whatever level f lives on."""
    refinement, operators, basis = creature
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((basis.size(level), 3))
    functions = basis.at(level) @ coefficients
    found = basis.project(functions, level)
    assert found.shape == (basis.count, 3)
    np.testing.assert_allclose(found[: len(coefficients)], coefficients, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[len(coefficients) :], 0.0, rtol=0, atol=1e-9)
    # What is left of any function is orthogonal to the basis, here tested densely at the finest level.
    f = rng.standard_normal(refinement.levels[level].n_vertices)
    single = basis.project(f, level)
    phi, finest = basis.at(operators.finest_level), operators.finest_level
    rest = refinement.prolong(f, level, finest) - phi @ single
    assert np.abs(phi.T @ (operators.mass[-1].diagonal() * rest)).max() < 1e-9


def test_projection_on_the_leading_functions(creature):
    refinement, operators, basis = creature
    f = np.random.default_rng(47).standard_normal(refinement.levels[0].n_vertices)
    phi = basis.at(0)
    found = basis.project(f, 0, count=20)
    np.testing.assert_allclose(found, phi.T @ (operators.mass[0] @ f), rtol=0, atol=1e-10)


def test_it_says_what_it_is(creature):
    _, _, basis = creature
    assert repr(basis) == "HierarchicalBasis(45 functions: 20 at level 0, 15 at level 1, 10 at level 2)"
    assert basis.schedule == (20, 15, 10)
    assert basis.residuals.shape == basis.indices.shape == (45,)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "at least 1"),
        ({"accuracy": 1.0}, "1e-3"),
        ({"schedule": ()}, "level 0 first"),
        ({"schedule": (10, -1)}, "whole numbers of at least 0"),
        ({"schedule": (0, 0)}, "level 0 first"),
        ({"count": 100_000}, "refine further"),
        ({"schedule": (10, 10, 10, 10, 10)}, "one for each level"),
        ({"schedule": (200, 10)}, "154"),
    ],
)
def test_refused_parameters(creature, options, message):
    refinement, operators, _ = creature
    with pytest.raises(ParameterError, match=message):
        hierarchical_basis(refinement, operators, BasisConfig(**options))


def test_refused_questions(creature):
    _, _, basis = creature
    refuses(ParameterError, "level from 0 to 3", basis.at, 4)
    refuses(ParameterError, "vertices: expected 0 to 153", basis.rows, 0, np.array([154]))
    refuses(ParameterError, "154 rows", basis.project, np.ones(7), 0)
    refuses(ParameterError, "1 to 45", basis.project, np.ones(154), 0, count=46)


@pytest.mark.slow
def test_a_basis_of_one_level_is_near_the_exact_one_on_real_meshes(shared_data):
    """The default number of functions against the exact spectrum, finest level of 3k to 12k vertices; a few meshes."""
    meshes = sorted(shared_data.glob("*/*.obj"))[::14]
    assert len(meshes) >= 3
    for path in meshes:
        control = read_mesh(path)
        level = 1
        while control.n_vertices * 4**level < 3_000:
            level += 1
        refinement = refine(control, level)
        operators = build_operators(refinement)
        basis = hierarchical_basis(refinement, operators, BasisConfig())
        exact = exact_basis(operators, level, BasisConfig().count).values
        errors = (basis.eigenvalues - exact)[1:] / exact[1:]
        assert -1e-6 < errors.min() <= errors.max() < 0.05, f"{path.name}: {basis}"


@pytest.mark.parametrize("literal", [False, True])
def test_a_schedule_may_skip_a_level(creature, literal):
    refinement, operators, _ = creature
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=(20, 0, 10), literal=literal))
    assert basis.schedule == (20, 0, 10)
    assert (np.diff(basis.indices) > 0).all()
    assert basis.residuals.max() < 1e-3  # 6e-5 without the gap


def test_a_basis_belongs_to_its_levels(creature):
    _, _, basis = creature
    other = refine(shapes.icosahedron(), 3)
    refuses(ParameterError, "the hierarchy and the operators", replace, basis, hierarchy=other)
    refuses(ParameterError, "the hierarchy and the operators", replace, basis, operators=build_operators(other))


@pytest.mark.slow
def test_functions_that_nearly_repeat_each_other_are_warned_of(caplog):
    """A coarse level asked for nearly all that it has gives functions that finer ones repeat."""
    refinement = refine(shapes.creature(), 2)
    operators = build_operators(refinement)
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=(20, 10)))
    assert basis.condition == pytest.approx(np.linalg.cond(basis.gram))
    assert not caplog.records
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=(150, 30, 20)))
    assert basis.condition > SOLVER.ill_conditioned
    assert "condition" in caplog.text


def test_nobody_changes_a_basis(creature):
    _, operators, basis = creature
    pairs = exact_basis(operators, 1, 5)
    for array in (*basis.bands, basis.eigenvalues, basis.gram, basis.indices, pairs.values, pairs.vectors):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    assert hash(basis) != hash(replace(basis))


@pytest.mark.parametrize("laplacian", ["alexa-wardetzky", "de-goes-butts-desbrun"])
def test_the_scale_does_not_depend_on_what_was_read_first(laplacian: str) -> None:
    config = BasisConfig(count=4, laplacian=laplacian)
    first, second = (Surface(refine(shapes.creature(), 1), config) for _ in range(2))
    assert first.operators.scale != first.scale
    assert first.scale == second.scale


def test_whole_numbers_of_a_config_become_plain_ones() -> None:
    config = BasisConfig(count=np.int64(4), vertices=np.int32(100), schedule=(np.int64(3), np.int64(1)))
    assert config == BasisConfig(count=4, vertices=100, schedule=(3, 1))
    numbers = (config.count, config.vertices, *(config.schedule or ()))
    assert [type(number) for number in numbers] == [int] * 4
    assert type(ConstraintConfig(heat=np.int64(3)).heat) is int  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="vertices: expected a whole number"):
        BasisConfig(vertices=2.5)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="count: expected a whole number of at least 1, got None"):
        BasisConfig(count=None)  # type: ignore[arg-type]
