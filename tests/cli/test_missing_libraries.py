"""Libraries that may be missing: rslab has a stand-in, and what embreex and xatlas are needed for says so."""

import builtins
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube
from packaging.requirements import Requirement

from cagemap.errors import MissingLibraryError
from cagemap.files.meshes.formats import write_mesh
from cagemap.numerics import sparse_algebra
from cagemap.pictures.render import Model
from cagemap.pipeline import MatchResult, choose_level, match, prepare_surfaces
from cagemap.subdivision import level_triangles
from cagemap.transfer.unwrap import unwrap

from example_once import example_pair
from job_text import job_text
from locations import ROOT
from refusals import refuses


def matched() -> MatchResult:
    example = example_pair(64)
    levels = choose_level(example.target, 500), choose_level(example.source, 500)
    return match(*prepare_surfaces(example.target, example.source, levels), example.landmarks)


def images(result: MatchResult) -> np.ndarray:
    """(n, 3) places on the source, its area being 1."""
    refinement, point_map = result.source.refinement, result.point_map
    corners = level_triangles(refinement, refinement.finest_level)[point_map.triangle]
    places = np.einsum("ij,ijk->ik", point_map.barycentric, refinement.finest.positions[corners])
    return np.asarray(places * result.source.operators.scale)


@pytest.mark.slow
def test_a_whole_match_without_rslab_is_the_same(monkeypatch: pytest.MonkeyPatch, quick_fit: None) -> None:
    with_rslab = matched()
    monkeypatch.setattr(sparse_algebra, "rslab", None)
    without = matched()
    assert without.target.basis.schedule == with_rslab.target.basis.schedule
    np.testing.assert_allclose(
        without.target.basis.eigenvalues, with_rslab.target.basis.eigenvalues, rtol=1e-6, atol=1e-6
    )
    # Rounding decides about single folds and closest points; a hundredth of the spacing is far below any error.
    apart = np.linalg.norm(images(without) - images(with_rslab), axis=1)
    assert apart.mean() < 2e-4
    assert apart.max() < 2e-2


@pytest.fixture
def without_embreex_and_xatlas(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] in ("embreex", "xatlas")]:
        monkeypatch.delitem(sys.modules, name)
    honest = builtins.__import__

    def importing(name, *rest):  # type: ignore[no-untyped-def]
        if name.split(".")[0] in ("embreex", "xatlas"):
            raise ImportError(f"No module named {name!r}")
        return honest(name, *rest)

    monkeypatch.setattr(builtins, "__import__", importing)
    monkeypatch.setattr("cagemap.numerics.process.import_module", lambda name: importing(name))


def test_pictures_and_layouts_name_the_library_they_miss(without_embreex_and_xatlas: None) -> None:
    mesh = cube()
    with pytest.raises(MissingLibraryError, match="pictures: expected the library embreex"):
        _ = Model(mesh.positions, np.array([[0, 1, 2]])).scene
    refuses(MissingLibraryError, r"`unwrap`.*expected the library xatlas.*version of Python", unwrap, mesh)


def test_pip_takes_only_what_has_a_wheel() -> None:
    """Of xatlas there is none for Python 3.14, of it and embreex none for Linux on aarch64: pip would compile."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [Requirement(text) for text in project["dependencies"]]

    def asked(python: str, system: str, machine: str) -> set[str]:
        place = {"python_version": python, "sys_platform": system, "platform_machine": machine}
        return {one.name for one in needed if one.marker is None or one.marker.evaluate(place)} & {"xatlas", "embreex"}

    assert asked("3.13", "linux", "x86_64") == asked("3.11", "win32", "AMD64") == {"xatlas", "embreex"}
    for place in (("linux", "x86_64"), ("win32", "AMD64"), ("darwin", "arm64")):
        assert asked("3.14", *place) == {"embreex"}
    assert asked("3.12", "linux", "aarch64") == asked("3.14", "linux", "aarch64") == set()


@pytest.mark.slow
def test_a_job_without_dask_can_be_looked_at_and_says_what_to_install(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_mesh(tmp_path / f"{name}.obj", cube())
    job = job_text("vertices = 50\nk = 20", {"a": {}, "b": {}}, [{"source": "a", "target": "b"}])
    (tmp_path / "job.toml").write_text(job)
    without = (
        "import sys\nfor name in ('dask', 'distributed'): sys.modules[name] = None\n"
        "import importlib.util, runpy\nhonest = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name == 'distributed' else honest(name, *rest)\n"
        "for words in (['--dry-run'], [], ['--task', '1']):\n"
        "    sys.argv[1:] = ['run', 'job.toml', *words]\n"
        "    try: runpy.run_module('cagemap', run_name='__main__')\n"
        "    except SystemExit as ended: print('code', ended.code, flush=True)"
    )
    ran = subprocess.run([sys.executable, "-c", without], cwd=tmp_path, capture_output=True, text=True, check=False)
    dry, wet, alone, _ = re.split(r"(?<=code \d)\n", ran.stdout)
    assert "match a -> b" in dry, ran.stderr
    assert dry.endswith("code 0")
    assert wet == "code 2"
    assert 'pip install "cagemap[dask]"' in ran.stderr
    assert "1 prepare" in alone
    assert alone.endswith("code 0")
