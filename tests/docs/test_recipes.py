"""Every recipe runs where its libraries are installed, is short, and finds the map that is known."""

import importlib.util
import re
from functools import cache
from typing import Any

import numpy as np
import pytest

import cagemap
from cagemap import research

from locations import ROOT

TEXT = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
FIRST, *BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
# Recipes that others begin with, by number from 1; what needs a library is skipped without it.
BEFORE = {4: (3,)}
MAP = "T = cagemap.PointMap.from_vertices(t1, t2, truth)"


@cache
def beginning() -> dict[str, Any]:
    """What the first block of all recipes leaves behind, and a map; made once, since nothing changes these values."""
    names: dict[str, Any] = {}
    exec(compile(f"{FIRST}\n{MAP}", "recipes.md, first block", "exec"), names)
    return names


def run(number: int) -> dict[str, Any]:
    """What a recipe leaves behind; a known map stands for T where an earlier recipe made it."""
    blocks = [*(BLOCKS[before - 1] for before in BEFORE.get(number, ())), BLOCKS[number - 1]]
    for module in {found for block in blocks for found in re.findall(r"^(?:import|from) (\w+)", block, re.MULTILINE)}:
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    if "torch." in blocks[-1] or "trimesh." in blocks[-1]:
        blocks.insert(0, "torch = trimesh = None")
        for module in ("torch", "trimesh"):
            if f"{module}." in blocks[-1]:
                blocks[0] += f"\nimport {module}"
                pytest.importorskip(module)
    names = dict(beginning())
    for block in blocks:
        exec(compile(block, f"recipes.md, recipe {number}", "exec"), names)
    return names


def error(names: dict[str, Any], found: Any, name: str = "pair") -> float:
    """Mean geodesic error x100."""
    return 100 * float(cagemap.geodesic_error(research.point_map(names[name], found), names["truth"]).mean())


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch, quick_fit):
    monkeypatch.chdir(tmp_path)


def test_recipes_are_ten_and_more_of_at_most_fifteen_lines():
    assert len(BLOCKS) >= 10
    assert [block for block in (FIRST, *BLOCKS) if len(re.findall(r"^.+$", block, re.MULTILINE)) > 15] == []
    assert [int(n) for n in re.findall(r"^## (\d+)\. ", TEXT, re.MULTILINE)] == list(range(1, len(BLOCKS) + 1))


@pytest.mark.slow
def test_trimesh():
    names = run(1)
    assert names["bodies"][0].visual.vertex_colors.shape == (642, 4)


@pytest.mark.slow
def test_eigenpairs():
    names = run(2)
    np.testing.assert_allclose(names["pairs"].values[1:4], 2.0, rtol=1e-2)  # of the unit sphere
    np.testing.assert_allclose(names["smooth"], np.exp(-0.2) * names["mesh"].vertices[:, 2], atol=1e-2)


@pytest.mark.slow
def test_pyfm_there():
    names = run(3)
    assert names["C"].shape == (20, 20)
    assert error(names, names["T"]) < 0.2 * error(names, names["model"].get_p2p())


@pytest.mark.slow  # .ci/run installs the library before these
def test_pyfm_back():
    names = {**run_without_fit(), "research": research}
    exec(compile(BLOCKS[3], "recipes.md, recipe 4", "exec"), names)
    from pyFM.spectral import p2p_to_FM

    theirs = p2p_to_FM(names["truth"], names["psi2"][:, :40], names["psi1"][:, :40], names["model"].mesh2.A)
    assert names["model"].FM_12.shape == (40, 40)
    assert np.abs(names["model"].FM_12 - theirs)[:20, :20].max() < 0.05
    assert error(names, names["vertices"]) < 3.0
    np.testing.assert_allclose(names["back"].images.positions, names["T"].images.positions, atol=1e-12)


def run_without_fit() -> dict[str, Any]:
    """Recipe 3 up to its eigenvectors, with the known map."""
    pytest.importorskip("pyFM")
    made = re.sub(r"^(model\.(preprocess|fit)|C = |T = ).*(\n    .*\n\))?$", "", BLOCKS[2], flags=re.MULTILINE)
    made = made.replace("psi2", "model.mesh1.process(60), model.mesh2.process(60)\npsi2")
    names = dict(beginning())
    exec(compile(made, "recipes.md, recipe 3", "exec"), names)
    return names


def test_geomfum():
    names = run(5)
    assert names["C"].shape == (40, 40)
    np.testing.assert_allclose(names["again"][:20, :20], names["matrix"][:20, :20], atol=0.05)


@pytest.mark.slow
def test_zoomout_and_elastic():
    names = run(6)
    assert error(names, names["spectral"]) < 4.0
    assert error(names, names["fitted"]) < 0.5 * error(names, names["spectral"])


@pytest.mark.slow
def test_vertices_without_landmarks():
    names = run(7)
    assert error(names, names["T"]) < 0.5 * error(names, names["vertices"])


@pytest.mark.slow
def test_the_papers_method_from_a_point_map():
    names = run(8)
    assert len(names["mirrored"].symmetries) == 1
    assert error(names, names["T_paper"], "mirrored") < 1.5


def test_torch():
    names = run(9)
    expected = names["T"].to_sparse().T @ (2 * (names["t2"].positions - names["t1"].positions))
    np.testing.assert_allclose(names["functions"][1].grad.numpy(), expected, atol=1e-9)
    assert names["C"].shape == (names["target"].basis.count, names["source"].basis.count)


def test_diffusion_net():
    names = run(10)
    assert names["gradX"].is_sparse
    assert names["gradX"].dtype == names["mass"].dtype == names["heights"].dtype
    assert names["evecs"].shape == (names["t2"].n, 64)
    assert float(names["slope"].norm(dim=0).max()) < 1.5 * names["source"].scale ** -1


@pytest.mark.slow  # .ci/run installs the library before these
def test_potpourri3d():
    names = run(11)
    assert names["errors"].max() < 1e-3
    shifted = names["truth"].copy()
    shifted[:] = names["t2"].triangles[0, 0]
    solver = names["solver"].compute_distance
    theirs, mine = (cagemap.geodesic_error(names["T"], shifted, distances=by) for by in (solver, None))
    assert np.abs(theirs - mine).mean() < 0.02 * mine.mean()


@pytest.mark.slow
def test_files():
    names = run(12)
    np.testing.assert_array_equal(names["again"].triangle, names["T"].triangle)
    assert cagemap.read_result("RESULT").point_map.target.n == names["t1"].n


def test_polyscope(monkeypatch):
    ps = pytest.importorskip("polyscope")
    init = ps.init
    monkeypatch.setattr(ps, "init", lambda: init("openGL_mock"))
    monkeypatch.setattr(ps, "show", lambda: None)
    names = run(13)
    assert names["shown"].n_vertices() == names["t1"].n


def test_pyvista(monkeypatch):
    pv = pytest.importorskip("pyvista")
    monkeypatch.setattr(pv.Plotter, "show", lambda self: None)
    monkeypatch.setattr(pv, "OFF_SCREEN", True)
    assert run(14)["mesh"].n_points == run(14)["t1"].n
