"""Eigenfunctions that cannot be computed: every message says which, what is wrong, and what to do."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube

from cagemap import BasisConfig, eigenpairs, prepare_surface
from cagemap.spectral import exact_basis
from cagemap.spectral.eigenpairs import SOLVER, band_pairs, count_below, factor, shift_invert_lanczos, shifted_matrix

from refusals import Refusal


@cache
def matrices() -> tuple[Any, Any]:
    """Stiffness and mass of level 2 of a creature."""
    operators = prepare_surface(creature(), 2, BasisConfig(count=5)).operators
    return operators.stiffness[2], operators.mass[2]


def inertia(patch: pytest.MonkeyPatch, counted: int | None) -> None:
    """Factorisations that count no eigenvalues, or always as many."""
    stand_in = SimpleNamespace(negative_eigenvalues=counted)
    patch.setattr("cagemap.spectral.eigenpairs.factor", lambda *given, **options: stand_in)


def without_inertia(patch: pytest.MonkeyPatch) -> None:
    level = matrices()
    inertia(patch, None)
    count_below(*level, 3.5)


def without_shift(patch: pytest.MonkeyPatch) -> None:
    level = matrices()
    inertia(patch, 0)
    band_pairs(*level, SOLVER.dense_rows // 100, SOLVER.dense_rows // 100 + 4)


def too_accurate(_: object) -> None:
    shifted = factor(shifted_matrix(*matrices(), -1.0))
    shift_invert_lanczos(shifted, matrices()[1], -1.0, 0, 5, accuracy=1e-300)


def never_accurate(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("cagemap.spectral.mesh_eigenpairs.residual_norms", lambda *given: np.ones(1))
    eigenpairs(creature(), 5)


def literal(_: object) -> Any:
    return prepare_surface(cube(), 1, BasisConfig(schedule=(6, 20), literal=True)).basis


def of_no_level(_: object) -> Any:
    return exact_basis(prepare_surface(cube(), 1, BasisConfig(count=5)).operators, -1, 5)


REFUSED = {
    "a level below the first": Refusal(of_no_level, "level from 0 to 1", "got -1"),
    "more functions above the last than a level has": Refusal(
        literal, "schedule: expected at most ", "at level 1, which has so many above", "move counts to finer levels"
    ),
    "no shift in the band": Refusal(
        without_shift, "shift: expected one among eigenvalues", "of the level, found none", "Ask for fewer"
    ),
    "no inertia": Refusal(
        without_inertia,
        "eigenvalues below 3.5: ",
        "expected to count them, but the factorisation tells no inertia there",
        "Install rslab.",
    ),
    "an accuracy that is never reached": Refusal(
        too_accurate,
        "expected 5 eigenpairs within a Krylov space of ",
        "got fewer to accuracy 1e-300",
        "ask for fewer pairs or a lower accuracy",
    ),
    "residuals that stay": Refusal(
        never_accurate,
        "eigenpairs: ",
        "expected residuals up to 1e-05, reached 1.0e+00",
        "remove triangles of almost no area, or ask `cagemap.eigenpairs` for a lower accuracy, at most 0.01",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_eigenfunctions_that_cannot_be_computed_are_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    REFUSED[name].check(monkeypatch)
