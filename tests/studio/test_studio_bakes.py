"""The finish in a real browser: each kind of control used, files as the command line writes them, errors, ends."""

from __future__ import annotations

import re
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import typed_request
from test_studio_finish_files import compared, rich_finish, same, write_inputs

from cagemap.studio.finish import commands
from cagemap.studio.opening import built_in_files
from cagemap.studio.state import Files
from cagemap.tasks.requests.catalogue import all_options

from browser_page import Page, studio

pytestmark = [pytest.mark.slow, pytest.mark.browser]
# Labels of the fields of `rich_finish` in their folds, and what is chosen or typed there; True: the box is pressed.
ASKED: dict[str, dict[str, str | bool]] = {
    "More images": {
        "Normal map": "normals.png",
        "Green": "down",
        "Displacement": "bumps.png",
        "Height scale": "0.01",
        "Sharpness": "linear",
        "Maps": "roughness=bumps.png",
    },
    "Detailed mesh": {"Mesh": "pony.obj", "normal": True, "ao": True, "Rays": "8"},
    "Rig": {"Skin weights": "skin.csv", "Influences": "1", "Blend shapes": "faces", "Attribute": "age.npy"},
    "Wrap": {"Wrap": True, "Fairness": "0.001", "Displacement": True, "Normal map": True, "MakeHuman file": True},
    "Match": {"Functions": "60"},
    "Files": {"Bits": "16", "UVs of the source": True, "Map file": ".npz", "Report": True},
}
VERTICES, SIZE = 1000, 512
# Seconds that a finish of many commands may take on a loaded machine.
LONG = 900.0


class FoldedPage(Page):
    """A page whose fields are looked for in one fold."""

    fold = ""

    def field(self, side: str, label: str) -> Any:
        """The input beside a label of the fold."""
        if not self.fold:
            return super().field(side, label)
        self.into(side)
        look = """const [fold, label] = arguments, named = (at, text) => [...at.querySelectorAll('*')].find(
            e => e.children.length < 2 && e.innerText?.trim() == text);
            const climb = at => { while (at && !at.querySelector('input')) at = at.parentElement; return at; };
            const name = named(climb(named(document, fold)), label);
            const field = name && climb(name).querySelector('input');
            return field?.offsetParent && field.closest('[aria-hidden=true]') === null ? field : null;"""
        return self.until(lambda: self.browser.execute_script(look, self.fold, label), f"{label!r} in {self.fold!r}")

    def filled(self, label: str, text: str) -> bool:
        """Type into a field, once that can be done."""
        self.fill("target", label, text)
        return True

    def unfold(self, side: str, label: str) -> None:
        """Open a fold, or fold it up."""
        self.into(side)
        look = """return [...document.querySelectorAll('*')].find(
            e => e.children.length < 2 && e.innerText?.trim() == arguments[0])"""
        found = self.until(lambda: self.browser.execute_script(look, label), f"a fold {label!r}")
        self.browser.execute_script("arguments[0].scrollIntoView(); arguments[0].click()", found)

    def finished(self, words: str) -> str:
        """Wait for the end of a finish; what the page says."""
        self.until(lambda: words in self.text("status"), words, LONG)
        return self.text("status")


def test_what_the_page_bakes_is_what_the_command_line_writes(tmp_path: Path, browser: Any) -> None:
    (tmp_path / "page").mkdir()
    files = built_in_files(tmp_path / "page")
    write_inputs(files)
    shutil.copytree(tmp_path / "page", tmp_path / "line")
    with studio(*arguments(files)) as (process, address), ThreadPoolExecutor(1) as beside:
        page = FoldedPage(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        before = page.picture("target").astype(float)
        page.fill("target", "Vertices", str(VERTICES))
        page.choose("target", "Texels", str(SIZE))
        for fold, fields in ASKED.items():
            fill_in(page, fold, fields)
        page.button("target", "Bake")
        typed = beside.submit(run_typed, tmp_path / "line")
        page.until(lambda: re.search(r"finish \d", page.text("status")), "a running finish")
        browser.get("about:blank")  # stops nothing
        page = FoldedPage(browser, address)
        assert page.value("target", "Vertices").replace(",", "") == str(VERTICES)
        page.finished("finish: done")
        same_files(files, typed.result())
        page.until(lambda: np.abs(page.picture("target") - before).max(axis=2).mean() > 0.05, "the bake on the model")
        assert page.value("target", "On the model").endswith(".png")
        an_error_is_said_and_the_rest_is_made(page, files)
        a_killed_studio_leaves_nothing_half_written(page, files, process)


def arguments(files: Files) -> list[str]:
    named = ["--target", files.target, "--source", files.source, "--texture", files.texture]
    named += ["--landmarks", files.landmarks, "--result", files.result, "--vertices", VERTICES]
    return list(map(str, named))


def fill_in(page: FoldedPage, fold: str, fields: dict[str, str | bool]) -> None:
    """Unfold a fold, fill in fields, and fold it up again."""
    page.unfold("target", fold)
    page.fold = fold
    for label, value in fields.items():
        field = page.field("target", label)
        if value is True:
            page.switch("target", label)
        elif field.get_attribute("aria-haspopup") == "listbox":
            page.choose("target", label, str(value))
        else:
            page.until(lambda name=label, text=value: page.filled(name, str(text)), label)
    page.fold = ""
    page.unfold("target", fold)


def run_typed(folder: Path) -> Path:
    """Run the commands that one would type in a folder; returns it."""
    own = built_in_files(folder)
    asked = replace(rich_finish(own, SIZE, VERTICES), report=False)
    for command in commands(all_options(), own, asked, landmarks=True):
        typed_request.run_typed(command.request)
    return folder


def same_files(files: Files, folder: Path) -> None:
    """The files of the page's bake are those of the commands that one would type."""
    typed = compared(folder)
    assert len(typed) > 20
    made = files.target.parent
    assert [path.name for path in typed if not same(path, made / path.relative_to(folder))] == []
    assert not list(made.glob("*.html"))


def an_error_is_said_and_the_rest_is_made(page: FoldedPage, files: Files) -> None:
    """A file of somebody else's is refused with the remedy, and the other images are baked, of the map there is."""
    theirs, other = (files.result.with_name(f"deer_from_{name}.png") for name in ("normals", "bumps"))
    theirs.write_text("not ours")
    other.unlink()
    map_file = files.result / "map.npz"
    written = map_file.stat().st_mtime_ns
    page.button("target", "Bake")
    said = page.finished(theirs.name)
    assert "Overwrite, under Files" in said
    assert theirs.read_text() == "not ours"
    page.until(other.is_file, "the image after it", LONG)
    page.button("source", "Cancel")
    page.finished("finish: cancelled")
    assert map_file.stat().st_mtime_ns == written


def a_killed_studio_leaves_nothing_half_written(page: FoldedPage, files: Files, process: Any) -> None:
    """Whoever computes for a studio ends with it."""
    fill_in(page, "Files", {"Name": "late"})
    page.fill("target", "Vertices", "200000")  # lasts until it is killed
    page.button("target", "Bake")
    page.until(lambda: "match:" in page.text("status"), "a running match")
    children = psutil.Process(process.pid).children(recursive=True)
    assert children
    process.kill()
    _, alive = psutil.wait_procs(children, timeout=60)
    assert alive == []
    time.sleep(0.1)
    folder = files.result.parent
    assert [path.name for path in folder.iterdir() if path.name.startswith("late") or ".part" in path.name] == []
