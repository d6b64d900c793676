"""Lemmas 1, 2, 3 and 5 of the paper, with eigenpairs that are exact at their level."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from cagemap.basis import BasisConfig, exact_basis, hierarchical_basis
from cagemap.mesh import shapes
from cagemap.operators import build_operators
from cagemap.refinement import refine

# The paper proves equalities; dense eigenpairs of a few hundred unknowns keep them to a few hundred roundings.
EXACT = 1e-10
COUNT = 12


def pebble(loop: bool = False):
    """A shape without symmetry, so that no eigenvalue repeats (what Lemma 3 assumes)."""
    control = shapes.icosahedron() if loop else shapes.creature()
    rng = np.random.default_rng(77)
    return control.with_positions(control.positions + 0.25 * rng.standard_normal(control.positions.shape))


@pytest.fixture(params=["Catmull-Clark", "Loop"], scope="module")
def surface(request):
    refinement = refine(pebble(loop=request.param == "Loop"), 3 if request.param == "Loop" else 2)
    return refinement, build_operators(refinement)


def levels(surface):
    """Pairs of neighbouring levels that are large enough for the eigenpairs used here."""
    refinement, operators = surface
    return [level for level in range(refinement.n_levels) if operators.mass[level].shape[0] > 2 * COUNT]


def test_lemma_1_prolonged_pairs_are_weak_pairs(surface):
    """Eqs. 4 and 5: <g, L Phi^ - Phi^ Lambda^>_M = 0 for all g in the image of S, and <Phi^, Phi^>_M = I."""
    refinement, operators = surface
    for level in levels(surface):
        pairs = exact_basis(operators, level, COUNT)
        prolonged = refinement.matrices[level] @ pairs.vectors
        mass, stiffness = operators.mass[level + 1], operators.stiffness[level + 1]
        residual = stiffness @ prolonged - mass @ prolonged * pairs.values
        coarse = np.random.default_rng(19).standard_normal((refinement.matrices[level].shape[1], 5))
        g = refinement.matrices[level] @ coarse
        sizes = np.linalg.norm(g, axis=0)[:, None] * np.linalg.norm(stiffness @ prolonged, axis=0)[None, 1:]
        assert np.abs(g.T @ residual)[:, 1:].max() < EXACT * sizes.min()
        # Not because the residual itself vanishes: these are no eigenpairs of level l + 1.
        assert np.linalg.norm(residual[:, -1]) > 1e-6 * np.linalg.norm(stiffness @ prolonged[:, -1])
        np.testing.assert_allclose(prolonged.T @ (mass @ prolonged), np.eye(COUNT), rtol=0, atol=EXACT)


def test_lemma_2_representation_error_is_bounded(surface):
    """Eq. 6: ||g - Phi^ Phi^+ g||^2 <= ||grad g||^2 / lambda_{k+1} <= lambda_max / lambda_{k+1} ||g||^2."""
    refinement, operators = surface
    rng = np.random.default_rng(23)
    for level in levels(surface):
        mass, stiffness = operators.mass[level + 1], operators.stiffness[level + 1]
        if mass.shape[0] > 700:
            continue  # all its eigenvalues would take seconds
        highest = linalg.eigh(
            stiffness.toarray(),
            mass.toarray(),
            eigvals_only=True,
            subset_by_index=(mass.shape[0] - 1, mass.shape[0] - 1),
        )[0]
        pairs = exact_basis(operators, level, COUNT + 1)
        phi = refinement.matrices[level] @ pairs.vectors[:, :COUNT]
        rough = rng.standard_normal((refinement.matrices[level].shape[1], 8))
        smooth = pairs.vectors @ rng.standard_normal((COUNT + 1, 8))
        # The next eigenvector alone attains the first bound.
        g = refinement.matrices[level] @ np.hstack([rough, smooth, pairs.vectors[:, [COUNT]]])
        rest = g - phi @ (phi.T @ (mass @ g))
        error = np.einsum("ij,ij->j", rest, mass @ rest)
        gradient = np.einsum("ij,ij->j", g, stiffness @ g)
        norm = np.einsum("ij,ij->j", g, mass @ g)
        following = pairs.values[COUNT]
        assert np.all(error <= gradient / following * (1 + EXACT))
        assert np.all(gradient <= highest * norm * (1 + EXACT))
        np.testing.assert_allclose(error[-1], gradient[-1] / following, rtol=1e-9)


def test_lemma_3_basis_is_approximately_blockwise_orthonormal():
    """Eqs. 9-11, with a basis of three levels."""
    refinement = refine(pebble(), 2)
    operators = build_operators(refinement)
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=(COUNT, 6, 5), accuracy=1e-10))
    phis = [basis.at(level) for level in range(3)]
    grams = [phi.T @ (operators.mass[level] @ phi) for level, phi in enumerate(phis)]
    np.testing.assert_allclose(grams[0], np.eye(COUNT), rtol=0, atol=EXACT)  # eq. 10
    for level in (1, 2):
        low, high = basis.size(level - 1), basis.size(level)
        gram = grams[level]
        np.testing.assert_allclose(gram[:low, :low], grams[level - 1], rtol=0, atol=EXACT)  # eq. 9
        np.testing.assert_allclose(gram[low:, low:], np.eye(high - low), rtol=0, atol=EXACT)
        np.testing.assert_array_equal(basis.indices[low:high], np.arange(low, high))
        # Eq. 11. band_j is orthogonal to every exact phi_i below it, so E_ij = <S phi~_i - phi_i, band_j>, and Bessel's
        # inequality bounds each row of E by the distance from prolonged to exact.
        error = gram[:low, low:]
        mass = operators.mass[level]
        exact = exact_basis(operators, level, low).vectors
        prolonged = refinement.matrices[level - 1] @ phis[level - 1]
        difference = prolonged - exact * np.sign(np.einsum("ij,ij->j", exact, mass @ prolonged))
        squares = np.einsum("ij,ij->j", difference, mass @ difference)
        assert squares.max() < 0.5, "prolonged and exact eigenvectors belong together"
        assert np.all(np.sum(error**2, axis=1) <= squares + EXACT)
        assert np.abs(error).sum() / (high - low) <= np.sqrt(squares).sum() + EXACT
        assert np.abs(error).max() > 1e-6, "only approximately"


def test_lemma_5_gram_matrix_needs_coarse_products_only(surface):
    """The Gram matrix of the prolonged basis is the same at every level, and is known without the fine basis."""
    refinement, operators = surface
    basis = hierarchical_basis(refinement, operators, BasisConfig(count=20, tolerance=0.05))
    for level in range(refinement.n_levels + 1):
        phi = basis.at(level)
        assert phi.shape[1] == basis.size(level)
        np.testing.assert_allclose(phi.T @ (operators.mass[level] @ phi), basis.gram_at(level), rtol=0, atol=EXACT)
