"""The first programs of docs/api.md run as they are, on arrays, and find what is there."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

from locations import ROOT

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # of NumPy: wrong numbers to be

SECTION = (ROOT / "docs" / "api.md").read_text(encoding="utf-8").split("## First programs")[1].split("\n## ")[0]
PROGRAMS = re.findall(r"```python\n(.*?)```", SECTION, re.DOTALL)


def run(number: int) -> dict[str, Any]:
    """What a program leaves behind: the source is the target, turned, scaled and renumbered."""
    mesh = creature()
    vertices, faces = mesh.positions, mesh.face_indices.reshape(-1, 4)
    truth = np.random.default_rng(5).permutation(len(vertices))
    others = np.empty_like(vertices)
    others[truth] = 3.0 * vertices[:, [2, 1, 0]] * [1, 1, -1]
    chosen = np.arange(0, len(vertices), 9)
    names = {
        "V1": vertices, "F1": faces, "V2": others, "F2": truth[faces], "truth": truth,
        "landmarks": np.column_stack([chosen, truth[chosen]]),
        "descriptor": lambda surface: np.linalg.norm(surface.vertices * surface.scale, axis=1, keepdims=True),
    }  # fmt: skip
    exec(compile(PROGRAMS[number], f"api.md, program {number}", "exec"), names)
    return names


def test_there_are_five_of_ten_lines() -> None:
    assert [len(re.findall(r"^.+$", program, re.MULTILINE)) <= 10 for program in PROGRAMS] == [True] * 5


def test_arrays_in_and_map_out() -> None:
    names = run(0)
    np.testing.assert_array_equal(names["vertices"], names["truth"])
    # Limit surfaces of the same mesh: what differs is what the fit leaves, well below an edge's length.
    limit = names["source"].vertices[names["truth"]]
    assert np.linalg.norm(names["places"] - limit, axis=1).max() < 0.01 * np.ptp(names["V2"], axis=0).max()
    assert names["P"].shape == (len(names["target"].vertices), len(names["source"].vertices))


@pytest.mark.slow
def test_functional_map() -> None:
    names = run(1)
    assert names["C"].shape == (60, 60)
    # The height is a function of the shape alone, and smooth: 60 functions say it to a few percent.
    wanted = 3.0 * names["target"].vertices[:, 1]
    assert np.abs(names["carried"] - wanted).max() < 0.1 * np.ptp(wanted)


@pytest.mark.slow
def test_own_descriptor() -> None:
    names = run(2)
    count = len(names["V1"])
    found = names["vertices"][:count]
    assert (found == names["truth"]).mean() > 0.5
    without = names["research"].functional_map(names["pair"], names["research"].gather_constraints(names["pair"]))
    assert np.abs(names["C"] - without).max() > 1e-6


def test_basis_at_a_level() -> None:
    names = run(3)
    phi, mass = names["phi"], names["M"]
    assert phi.shape == (mass.shape[0], 60) == (names["W"].shape[0], 60)
    assert (np.diff(names["eigenvalues"][:40]) >= -1e-9).all()
    np.testing.assert_allclose(names["coefficients"], np.eye(60)[5], atol=1e-8)


@pytest.mark.slow
def test_error_against_truth(capsys: pytest.CaptureFixture[str]) -> None:
    names = run(4)
    assert len(names["errors"]) == len(names["V1"])
    assert names["errors"].max() < 0.01
    assert re.fullmatch(r"mean geodesic error x100: 0\.\d\d\n", capsys.readouterr().out)
