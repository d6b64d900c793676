"""Functional maps: eq. 13, eqs. 14-16, and their agreement with a plain dense least-squares solve."""

from dataclasses import replace

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.paper.constraints import ConstraintConfig, Constraints, SpectralData
from cagemap.paper.equations import extend_functional_map, laplacian_penalties, solve_functional_map

from refusals import refuses

RNG = np.random.default_rng(20190)
LITERAL = ConstraintConfig(laplacian=0.1, operators=0.3, decay=0.0)


def tridiagonal(k: int) -> np.ndarray:
    return np.triu(np.tril(RNG.standard_normal((k, k)), 1), -1)


def dense(k: int) -> np.ndarray:
    return RNG.standard_normal((k, k)) / np.sqrt(k)


def data(k: int, q: int, *operators: np.ndarray) -> SpectralData:
    return SpectralData(np.sort(RNG.uniform(0, 12 * k, k)), RNG.standard_normal((k, q)), operators)


def energy(c, constraints, weights):
    """Eq. 13 term by term, with the two additions."""
    target, source = constraints.target, constraints.source
    commutator = (c * source.eigenvalues - target.eigenvalues[:, None] * c) / (4 * np.pi)
    total = np.sum((c @ source.descriptors - target.descriptors) ** 2) + weights.laplacian * np.sum(commutator**2)
    for o1, o2 in zip(target.operators, source.operators, strict=True):
        total += weights.operators * np.sum((c @ o2 - o1 @ c) ** 2)
    return total + weights.decay * np.sum(c**2)


def is_minimum(c, constraints, weights, free):
    """No direction of the free entries lowers the energy: a quadratic with a vanishing gradient."""
    for _ in range(5):
        step = np.where(free, RNG.standard_normal(c.shape), 0.0)
        ahead, behind = (energy(c + sign * step, constraints, weights) for sign in (1.0, -1.0))
        # Rounding of the energy, and the ridge of 1e-10, are all that is left of the slope.
        assert abs(ahead - behind) < 1e-6 * (ahead + behind)
        assert ahead > energy(c, constraints, weights)


@pytest.mark.parametrize("k1", [1, 2, 7, 8])
@pytest.mark.parametrize("kind", [None, tridiagonal, dense])
@pytest.mark.parametrize("decay", [0.0, 0.7])
def test_solution_minimises_the_energy_of_eq_13(k1, kind, decay):
    """Whether the rows of C fall apart or operators couple them, dense ones too."""
    k2, q = 6, 15
    operators = () if kind is None else (kind(k1),), () if kind is None else (kind(k2),)
    constraints = Constraints(data(k1, q, *operators[0]), data(k2, q, *operators[1]))
    weights = replace(LITERAL, decay=decay)
    found = solve_functional_map(constraints, weights)
    is_minimum(found, constraints, weights, np.ones((k1, k2), dtype=bool))


def test_exact_map_is_recovered():
    """Descriptors and operators that a map satisfies exactly give that map back."""
    k = 12
    source = data(k, 30, dense(k))
    turn = np.diag(RNG.choice([-1.0, 1.0], k))  # an isometry of a shape with simple spectrum
    target = SpectralData(source.eigenvalues, turn @ source.descriptors, (turn @ source.operators[0] @ turn.T,))
    np.testing.assert_allclose(solve_functional_map(Constraints(target, source), LITERAL), turn, atol=1e-8)


def test_few_descriptors_and_the_laplacian_still_decide():
    """With fewer descriptors than functions the commutativity alone fixes what the data leave open."""
    k = 10
    same = SpectralData(4 * np.pi * np.arange(k), RNG.standard_normal((k, 3)))
    found = solve_functional_map(Constraints(same, same), ConstraintConfig(laplacian=100.0, decay=0.0))
    np.testing.assert_allclose(found, np.diag(np.diag(found)), atol=0.2)
    np.testing.assert_allclose(np.diag(found), 1.0, atol=0.05)


def test_decay_silences_rows_that_no_descriptor_speaks_about():
    """Functions without descriptors: rows of C vanish, so that they have no say in a nearest neighbour."""
    k, known = 12, 7
    same = data(k, 30)
    descriptors = np.where(np.arange(k)[:, None] < known, same.descriptors, 1e-4 * same.descriptors)
    same = replace(same, descriptors=descriptors)
    norms = np.linalg.norm(solve_functional_map(Constraints(same, same), ConstraintConfig()), axis=1)
    assert norms[:known].min() > 0.8
    assert norms[known:].max() < 1e-3


def test_weights_mean_the_same_on_all_levels():
    """alpha(O) is one number for the hierarchy: a leading block's penalties are those of the whole."""
    one, two = data(9, 4).eigenvalues, data(8, 4).eigenvalues
    whole = laplacian_penalties(one, two, 0.1)
    np.testing.assert_array_equal(laplacian_penalties(one[:5], two[:4], 0.1), whole[:5, :4])


@pytest.mark.parametrize("kind", [None, tridiagonal, dense])
def test_extension_keeps_the_coarse_block_and_solves_the_others(kind):
    """Eq. 14: C_l stays bit for bit; other blocks minimise the energy, by eq. 15 block diagonal unless dense."""
    k1, k2, low1, low2, q = 9, 8, 5, 4, 25
    operators = ((), ()) if kind is None else ((kind(k1),), (kind(k2),))
    constraints = Constraints(data(k1, q, *operators[0]), data(k2, q, *operators[1]))
    coarse = RNG.standard_normal((low1, low2))
    extended = extend_functional_map(coarse, constraints, LITERAL)
    np.testing.assert_array_equal(extended[:low1, :low2], coarse)
    split = constraints
    if kind is tridiagonal:
        cut = []
        for side, low in ((constraints.target, low1), (constraints.source, low2)):
            operator = side.operators[0].copy()
            operator[low:, :low] = operator[:low, low:] = 0.0
            cut.append(replace(side, operators=(operator,)))
        split = Constraints(*cut)
    free = np.ones((k1, k2), dtype=bool)
    free[:low1, :low2] = False
    is_minimum(extended, split, LITERAL, free)


def test_high_to_low_block_is_found_alone():
    """Eq. 16: C_lh does not depend on what the high rows are asked for."""
    k1, k2, low1, low2 = 9, 8, 5, 4
    constraints = Constraints(data(k1, 25, tridiagonal(k1)), data(k2, 25, tridiagonal(k2)))
    other = replace(constraints.target, descriptors=constraints.target.descriptors.copy())
    other.descriptors[low1:] = RNG.standard_normal((k1 - low1, 25))
    coarse = RNG.standard_normal((low1, low2))
    found = [
        extend_functional_map(coarse, Constraints(t, constraints.source), LITERAL) for t in (constraints.target, other)
    ]
    # Conjugate gradients stop at 1e-12 of the right side; the blocks are solved in one run.
    np.testing.assert_allclose(found[0][:low1], found[1][:low1], atol=1e-9)
    assert abs(found[0][low1:] - found[1][low1:]).max() > 0.1


def test_extension_of_an_exact_map_is_exact():
    """Solving level by level loses nothing when the data are those of a true map."""
    k, low = 14, 6
    source = data(k, 40)
    signs = np.diag(RNG.choice([-1.0, 1.0], k))
    constraints = Constraints(replace(source, descriptors=signs @ source.descriptors), source)
    coarse = solve_functional_map(constraints.leading(low, low), LITERAL)
    np.testing.assert_allclose(extend_functional_map(coarse, constraints, LITERAL), signs, atol=1e-7)


@pytest.mark.parametrize("grown", ["target", "source", "neither"])
@pytest.mark.parametrize("kind", [None, tridiagonal])
def test_extension_with_one_empty_band(grown, kind):
    """A level may add functions on one side only; the coarse block is still kept."""
    k1, k2 = (7, 5) if grown == "target" else (5, 7) if grown == "source" else (5, 5)
    operators = ((), ()) if kind is None else ((kind(k1),), (kind(k2),))
    constraints = Constraints(data(k1, 20, *operators[0]), data(k2, 20, *operators[1]))
    coarse = RNG.standard_normal((5, 5))
    extended = extend_functional_map(coarse, constraints, ConstraintConfig())
    assert extended.shape == (k1, k2)
    np.testing.assert_array_equal(extended[:5, :5], coarse)


def test_own_descriptors_and_operators_are_added():
    constraints = Constraints(data(6, 4), data(5, 4))
    more = constraints.with_descriptors(RNG.standard_normal((6, 3)), RNG.standard_normal((5, 3)), weight=2.0)
    more = more.with_operators(np.eye(6), np.eye(5))
    np.testing.assert_allclose(np.linalg.norm(more.source.descriptors[:, 4:], axis=0), 2.0)
    np.testing.assert_array_equal(more.leading(4, 3).target.descriptors, more.target.descriptors[:4])
    assert more.leading(4, 3).target.operators[0].shape == (4, 4)


def test_data_that_cannot_be_compared_are_refused():
    refuses(ParameterError, "as many target as source descriptors, got 4 and 5", Constraints, data(3, 4), data(3, 5))
    with pytest.raises(ParameterError, match="as many target as source operators, got 1 and 0"):
        Constraints(data(3, 4, np.eye(3)), data(3, 4))
    refuses(ParameterError, "source: expected 3 rows", Constraints, data(3, 4, np.eye(3)), data(3, 4, np.eye(4)))
    refuses(ParameterError, "decay: expected a number of at least 0, got -1", ConstraintConfig, decay=-1.0)
    with pytest.raises(ParameterError, match="known block"):
        solve_functional_map(Constraints(data(3, 4), data(3, 4)), ConstraintConfig(), known=np.zeros((4, 2)))
