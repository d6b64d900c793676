"""Scripts of examples/ and the first programs of docs/api.md run, are short, and find what is there."""

import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature

import cagemap

from locations import ROOT
from quick_match import remembered

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


SCRIPTS = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
WRITES = {
    "01_match_and_bake": ["deer.png"],
    "02_weights": ["deer_weights.csv"],
    "03_wrap": ["deer_as_pony.obj"],
    "04_from_arrays": [],
    "05_own_descriptor": [],
    "06_update_landmarks": [],
    "07_report": ["RESULT/map.npz", "report.html"],
    "08_many_pairs": ["pony__deer/map.npz", "deer__pony/map.npz"],
    "09_finish_pyfm": [],
}


@pytest.fixture(scope="module")
def matched_once() -> Iterator[None]:
    """Most scripts begin with the same match."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cagemap, "match", remembered(cagemap.match))
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("matched_once", "quick_fit", "small_pages")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_of_the_gallery_runs_and_writes_what_it_says(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At level 1 and by quick fits; `make demo` matches as many vertices as the scripts do, with the usual one."""
    text = script.read_text(encoding="utf-8")
    if "from pyFM" in text:
        pytest.importorskip("pyFM")
    text = re.sub(r"level=[23]", "level=1", text.replace("levels=(2, 2)", "levels=(1, 1)"))
    text = text.replace("k_process=150", "k_process=60").replace("nit=23", "nit=4")
    (tmp_path / script.name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(script.name, run_name="__main__")
    assert [name for name in WRITES[script.stem] if not (tmp_path / name).is_file()] == []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_short_and_in_the_gallery(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 40
    assert f"](../examples/{script.name})" in (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")


def test_the_gallery_names_scripts_that_are_there() -> None:
    named = re.findall(r"\]\(\.\./examples/(\w+)\.py\)", (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"))
    assert sorted(named) == [script.stem for script in SCRIPTS] == sorted(WRITES)
