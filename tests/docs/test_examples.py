"""The scripts of examples/ run, are short, and are all in docs/gallery.md."""

from __future__ import annotations

import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

import cagemap

from locations import ROOT
from quick_match import remembered

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
